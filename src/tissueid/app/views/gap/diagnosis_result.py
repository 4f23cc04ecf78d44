"""Result of a diagnosis as plain values, which the page shows and stores, and its outputs: twin, report and JSON."""

from __future__ import annotations

import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, AwareDatetime, ConfigDict, Field, PlainSerializer

from tissueid.app.user_files import Stamp, stamp_of
from tissueid.app.views.gap.page_content import PageContent
from tissueid.app.words import sentence
from tissueid.atomic_write import unused_path
from tissueid.audit import AuditTrail
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument.twin_file import TwinFile
from tissueid.language import _
from tissueid.messages import translated
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan
from tissueid.procedures.output_files import json_text, write_text
from tissueid.stored_values import StoredText
from tissueid.untrusted_input import MAX_TESTS

State = Literal["", "changed", "missing"]
"""State of the session file since its diagnosis; "" if it is unchanged."""


def new_key(when: datetime) -> str:
    """Return a unique key for a diagnosis; keys sort by time (UTC)."""
    return f"{when.astimezone(UTC):%Y%m%dT%H%M%S%fZ}-{secrets.token_hex(4)}"


def _now() -> datetime:
    return datetime.now(UTC)


KEY = re.compile(r"[0-9]{8}T[0-9]{12}Z-[0-9a-f]{8}")
"""Form of a key."""
_STORED = frozenset({"session", "twin", "fit", "check"})
_LONGEST_PATH = 5000


def _stored_plan(plan: DiagnosisPlan) -> dict[str, Any]:
    return plan.model_dump(mode="json", include=set(_STORED))


def _checked_plan(plan: DiagnosisPlan) -> DiagnosisPlan:
    paths = [str(path) for path in (plan.session, plan.twin) if path is not None]
    if not plan.model_fields_set <= _STORED or any("\0" in path or len(path) > _LONGEST_PATH for path in paths):
        raise ValueError("a stored plan names a session, a twin and tests")
    if max(len(plan.fit), len(plan.check)) > MAX_TESTS:
        raise ValueError("a stored plan names too many tests")
    return plan


@dataclass(frozen=True)
class DiagnosisResult:
    """A diagnosis with its plan.

    ``story`` is what the page shows of it, ``answer`` the JSON of ``tissueid gap diagnose``, ``report`` its page as
    HTML. ``twin`` is the content of the baseline twin, None for the nominal one; ``accepted`` that of the twin which
    has the named effects, None where there is none, and ``refused`` says why in words. ``stamp`` is that of the session
    file as it was diagnosed.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", ser_json_inf_nan="constants")

    asked: Annotated[DiagnosisPlan, AfterValidator(_checked_plan), PlainSerializer(_stored_plan)]
    session_id: Annotated[str, Field(max_length=500)]
    instrument: DeviceDescription
    twin: TwinFile | None
    story: PageContent
    answer: dict[str, Any]
    report: str
    accepted: TwinFile | None = None
    refused: StoredText = ""
    stamp: Stamp | None = None
    when: AwareDatetime = field(default_factory=_now)
    key: Annotated[str, Field(pattern=rf"^{KEY.pattern}$")] = ""

    def __post_init__(self) -> None:
        if not self.key:
            object.__setattr__(self, "key", new_key(self.when))

    @property
    def state(self) -> State:
        """State of the session file; "" also if its stamp is unknown."""
        if self.stamp is None:
            return ""
        now = stamp_of(self.asked.session)
        return "missing" if now is None else "" if now == self.stamp else "changed"


_SUFFIX = ".toml"


def why_not_accepted(result: DiagnosisResult) -> str:
    """Return why the diagnosis cannot be accepted into a twin; "" if it can."""
    story = result.story
    return "" if story.verdict == "effect" else result.refused or story.headline


def accept_into_twin(
    result: DiagnosisResult, path: Path, trail: AuditTrail, effects: Sequence[str], *, separate_process: bool
) -> str:
    """Save a twin with the selected effects, and return the notice to show.

    Raises:
        UnusableInputError: nothing was chosen, the file's name makes no name of a twin, or it cannot be written.
    """
    from tissueid.app.jobs import JobControl
    from tissueid.gap.twin_export import NamedEffects
    from tissueid.procedures.saved_twins import accept_effects

    if why := why_not_accepted(result):
        raise UnusableInputError(why)
    asked, control = result.asked, JobControl()
    named = tuple(name for name, _title, is_named in result.story.offered if is_named)
    content = accept_effects(
        AcceptPlan(
            session=asked.session,
            fit=asked.fit,
            check=asked.check,
            workers=None if separate_process else 1,
            out=path,
            effects=tuple(effects),
        ),
        control,
        trail,
        NamedEffects(named, result.accepted, result.refused, result.twin),
        separate_process=separate_process,
    )
    said = _("The twin {name}, version {version}, is saved in {path}.").format(
        name=content.name, version=content.version, path=path
    )
    return " ".join([said, *(sentence(translated(notice)) for notice in control.notices)])


def write_report(result: DiagnosisResult) -> Path:
    """Write the HTML report next to the session under an unused name; return its path.

    Raises:
        UnusableInputError: it cannot be written there.
    """
    session = result.asked.session
    path = unused_path(session.with_name(f"{session.stem}-gap.html"))
    write_text(path, result.report)
    return path


def export_json(result: DiagnosisResult, path: Path) -> Path:
    """Write the JSON of ``tissueid gap diagnose --json`` atomically; return its path.

    Raises:
        UnusableInputError: it cannot be written.
    """
    write_text(path, json_text(result.answer))
    return path


def proposed_twin(result: DiagnosisResult, effects: Sequence[str]) -> Path:
    """Return the proposed file for the twin: the baseline twin, or an unused name next to the session."""
    if result.asked.twin is not None:
        return result.asked.twin
    folder = result.asked.session.parent
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(effects)).strip("-._") or "twin"
    return unused_path(folder / f"{stem}{_SUFFIX}")
