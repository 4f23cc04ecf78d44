"""The second tab: a button for a new calibration, and a comparison of the stored ones."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QWidget

from tissueid.app import build
from tissueid.app.build import button, label
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.views.technician.calibration_panels import StaticsPanel, SweepsPanel
from tissueid.app.views.technician.tab import PiecesModel, Tab, table_of
from tissueid.app.words import sentence
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.file import Calibration
from tissueid.calibration.status import Stored, calibration_folder, file_status, status_for_device, stored_calibrations
from tissueid.device import DeviceDescription
from tissueid.formatting import clean, local_minute
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
    date = local_minute(calibration.date) or calibration.date[:10]
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


_HINT = marked(
    "Select a calibration to see its figures. Select two or more sweeps, with Ctrl or Shift, to lay them over each "
    "other and see what has drifted."
)
_TO_MEASURE = marked(
    "Press “Begin static calibration” or “Begin dynamic sweep” on the tab Calibration; the coil will move."
)
_ROLE = marked("Only a technician can calibrate: choose the role Technician at the top, then press this button again.")
_MOST_WHY = 4
_SPLIT = "instrument/calibrations/split"


def read_stored(folder: Path | None, cancelled: Callable[[], object]) -> tuple[Stored, ...]:
    """The calibrations of the folder in force, or of a given one.

    Raises:
        UnusableInputError: it is not there, or cannot be read.
    """
    cancelled()
    return stored_calibrations(calibration_folder(folder))


class CalibrationsTab(Tab):
    """A list on the left; what is selected on the right."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(context, page_job, parent)
        self._stored: tuple[Stored, ...] = ()
        self._nominal: DeviceDescription | None = None
        self.calibrate = button(_("Calibrate…"), self._go, tip=_("Shows the page Measure, where calibrations are made"))
        self.again = button(_("Read again"), self.load, name=_("Read the folder of calibrations again"))
        self.about = build.label("muted")
        self.model = PiecesModel(tuple(_(head) for head in HEADERS), Row.cell, level=lambda row: row.level, marked=4)
        self.list = table_of(self.model, _("Calibrations"), (82, 66, 74, 70, 180))
        self.list.selectionModel().selectionChanged.connect(self._show_selected)
        self.why = build.label("muted")
        self.hint = label("muted", _(_HINT), alignment=Qt.AlignmentFlag.AlignCenter)
        self.sweeps = SweepsPanel()
        self.statics = StaticsPanel()
        self.detail = build.stack(self.hint, self.sweeps, self.statics)
        left = build.holder(build.column((self.list, 1), self.why, margins=(0, 0, 6, 0)))
        self.split = build.splitter((left, 2), (self.detail, 3), sizes=(450, 600))
        if (state := context.settings.value(_SPLIT)) is not None:
            self.split.restoreState(state)
        build.column(
            build.row(self.calibrate, self.again, (self.about, 1), spacing=8),
            (self.split, 1),
            margins=(0, 8, 0, 0),
            parent=self,
        )
        self._show()

    # -- work ---------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Read the folder."""
        work = functools.partial(read_stored, self.context.services.calibrations)
        self.read_files(_("Reading the calibrations…"), work)

    def _loaded(self, stored: tuple[Stored, ...]) -> None:
        self._stored, self.read = stored, True
        self._show()

    def tell_instrument(self, nominal: DeviceDescription | None) -> None:
        """Set the instrument for which the active calibrations are shown."""
        if nominal is not self._nominal or not self.read:
            self._nominal = nominal
            self._show()

    def _go(self) -> None:
        """Show the page of calibrations; start nothing."""
        if self.context.state.role == "technician":
            self.context.calibrate(_(_TO_MEASURE))
        else:
            self.context.say(_(_ROLE))

    # -- showing ------------------------------------------------------------------------------------------

    def update_enabled(self, *, busy: bool) -> None:
        """Disable reading and calibrating while a job runs."""
        self.again.setEnabled(not busy)
        self.calibrate.setEnabled(not busy)
        if not self.read:
            self._show()

    @property
    def selected(self) -> list[Calibration]:
        """The selected readable calibrations, newest first."""
        return [row.item.calibration for row in self._rows if row.item.calibration is not None]

    @property
    def _rows(self) -> list[Row]:
        numbers = sorted(index.row() for index in self.list.selectionModel().selectedRows())
        return [self.model.rows[number] for number in numbers if number < len(self.model.rows)]

    def _show(self) -> None:
        kept = {row.item.path for row in self._rows}
        rows = rows_of(self._stored, self._nominal, datetime.now(UTC))
        self.model.show_rows(rows)
        selection = self.list.selectionModel()
        for number, row in enumerate(rows[: self.model.rowCount()]):
            if row.item.path in kept:
                selection.select(
                    self.model.index(number, 0), selection.SelectionFlag.Select | selection.SelectionFlag.Rows
                )
        if not self.read:
            self.about.setText(self.context.unread)
        elif not rows:
            self.about.setText(_("There is no calibration yet: the nominal figures are used."))
        elif self._nominal is None:
            self.about.setText(_("Check the instrument under Health to see which of them it uses."))
        else:
            self.about.setText(
                _("Column “Active”: whether the instrument {serial} uses it.").format(
                    serial=clean(self._nominal.serial_number)[:60]
                )
            )
        self._show_selected()

    def _show_selected(self) -> None:
        rows = self._rows
        self.why.setText("\n".join(f"{row.cell(5)}: {row.force}" for row in rows[:_MOST_WHY]))
        self.why.setVisible(bool(rows))
        chosen = self.selected
        sweeps = [item for item in chosen if item.kind == "sweep"]
        if sweeps and len(sweeps) >= len(chosen) - len(sweeps):
            self.sweeps.show_sweeps(sweeps)
            self.detail.setCurrentWidget(self.sweeps)
        elif chosen:
            statics = [item for item in chosen if item.kind == "static"]
            readable = [item.calibration for item in self._stored if item.calibration is not None]
            self.statics.show_statics(statics, readable)
            self.detail.setCurrentWidget(self.statics)
        else:
            self.hint.setText("\n".join(row.force for row in rows[:_MOST_WHY]) or _(_HINT))
            self.detail.setCurrentWidget(self.hint)

    def save_state(self) -> None:
        """Where the two halves part."""
        self.context.settings.setValue(_SPLIT, self.split.saveState())
