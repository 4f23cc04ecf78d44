"""The calibrations of a folder as rows: kind, age, and whether each is active or why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tissueid.app.words import sentence
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.status import file_status, status_for_device
from tissueid.calibration.store import Stored
from tissueid.device import DeviceDescription
from tissueid.formatting import clean
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated

HEADERS = (marked("Date"), marked("Kind"), marked("Verdict"), marked("Age"), marked("Active"), marked("File"))
_LONGEST = 300
_IN_FILES = (marked("static"), marked("sweep"), marked("passed"), marked("failed"))
"""What calibrations say of themselves."""


@dataclass(frozen=True)
class Row:
    """A calibration with what is said of it. ``level`` is that of a colour."""

    item: Stored
    date: str
    kind: str
    verdict: str
    age: str
    force: str
    level: str

    def cell(self, column: int) -> str:
        """What stands in a column."""
        name = clean(self.item.path.name)[:120]
        return (self.date, _(self.kind), _(self.verdict), self.age, self.force, name)[column]


def rows_of(stored: Sequence[Stored], nominal: DeviceDescription | None, now: datetime) -> tuple[Row, ...]:
    """Rows in the order of ``stored``. ``nominal`` is what was asked; without it each is judged by its age alone."""
    if nominal is None:
        return tuple(_row(item, None, frozenset(), frozenset(), now) for item in stored)
    known = apply_calibrations(nominal, stored, now).calibration
    named = frozenset(str(known[name]) for name in ("static_file", "sweep_file") if name in known)
    sources = frozenset(_sources(stored, nominal, now))
    return tuple(_row(item, nominal, named, sources, now) for item in stored)


def _row(
    item: Stored, nominal: DeviceDescription | None, named: frozenset[str], sources: frozenset[Path], now: datetime
) -> Row:
    calibration = item.calibration
    if calibration is None:
        return Row(
            item,
            MISSING,
            MISSING,
            MISSING,
            MISSING,
            _said(_("no: {problem}").format(problem=translated(item.problem))),
            "poor",
        )
    days = calibration.age_days(now)
    age = _("in the future") if days < -1.0 else _("today") if days < 1.0 else _("{days:.0f} days").format(days=days)
    date = calibration.date[:10]
    if nominal is None:
        found = file_status(item, now)
        force, level = _said(translated(found.words)), "" if found.state == "valid" else "check"
    else:
        state, why = status_for_device(item, nominal, now)
        reason = translated(why)
        usable = state in ("valid", "stale")
        if usable and item.path.name in named:
            force, level = (
                (_("Yes"), "good")
                if state == "valid"
                else (_said(_("yes, but {reason}").format(reason=reason)), "check")
            )
        elif usable and item.path in sources:
            force, level = _("In part, together with another one"), "good"
        elif usable:
            force, level = translated(Message("calibrations.superseded", "No: a newer one is")), ""
        else:
            force, level = _said(_("no: {reason}").format(reason=reason)), "" if state == "foreign" else "poor"
    if calibration.verdict == "failed":
        level = "poor"
    return Row(item, date, calibration.kind, calibration.verdict, age, force, level)


def _sources(stored: Sequence[Stored], nominal: DeviceDescription, now: datetime) -> set[Path]:
    """The static calibrations of which a figure is in force: the newest good one that holds it, else a stale one."""
    usable = [(status_for_device(item, nominal, now)[0], item) for item in stored]
    statics = [
        (state == "stale", item, item.calibration)
        for state, item in usable
        if state in ("valid", "stale") and item.calibration is not None and item.calibration.kind == "static"
    ]
    statics.sort(key=lambda entry: (not entry[0], entry[2].made, entry[1].path.name), reverse=True)
    source: dict[str, Path] = {}
    for _stale, item, calibration in statics:
        for name in calibration.quantities:
            source.setdefault(name, item.path)
    known = apply_calibrations(nominal, stored, now).calibration
    return {path for name, path in source.items() if name in known}


def _said(text: str) -> str:
    return sentence(clean(text)[:_LONGEST])
