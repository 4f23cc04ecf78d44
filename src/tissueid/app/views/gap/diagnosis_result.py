"""Result of a diagnosis as plain values, which the page shows and stores, and its outputs: twin, report and JSON."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, AwareDatetime, ConfigDict, Field, PlainSerializer, TypeAdapter

from tissueid.app.user_files import Stamp, default_path, stamp_of
from tissueid.app.views.gap.page_content import PageContent
from tissueid.app.words import sentence
from tissueid.atomic_write import open_regular, private_folder, unused_path, write_private
from tissueid.audit import AuditTrail
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument.twin_file import TwinFile
from tissueid.language import _
from tissueid.messages import translated
from tissueid.procedures.control import Control
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan
from tissueid.procedures.output_files import json_text, write_text
from tissueid.stored_values import MessageText, finite
from tissueid.untrusted_input import MAX_TESTS, json_value

if TYPE_CHECKING:
    from tissueid.gap.diagnosis import Diagnosis
    from tissueid.procedures.diagnosis import DiagnosedSession
    from tissueid.sessions import Session

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
    refused: MessageText = ""
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


_TWIN_SUFFIX = ".toml"


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
    from tissueid.procedures.diagnosis import accept_effects

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
    return unused_path(folder / f"{stem}{_TWIN_SUFFIX}")


FOLDER = "diagnoses"
MOST_KEPT = 20
MOST_BYTES = 20_000_000
"""Maximum size of a file. A diagnosis of one test takes about 600 kB, two thirds of it the report."""
_SUFFIX = ".json"
_FORMAT, _VERSION, _LOGARITHMS = "tissueid-diagnosis", "1.2", "1.1"
"""Name and version of the files, and the version whose spectra and errors are decimal logarithms."""
_ANSWER = {"verdict", "gap", "where", "ranking", "combination", "members", "next_experiment", "remarks", "seconds"}
_RESULT = TypeAdapter(DiagnosisResult)


@dataclass(frozen=True)
class KeptDiagnoses:
    """Diagnoses read from files, newest first, and the number of files that could not be read."""

    results: tuple[DiagnosisResult, ...]
    bad: int


def default_folder() -> Path:
    """Return the folder of this user's diagnoses, next to the history of analyses."""
    return default_path().with_name(FOLDER)


def keep(result: DiagnosisResult, folder: Path) -> None:
    """Write a diagnosis atomically, readable by its owner only, and remove the oldest files beyond ``MOST_KEPT``.

    Raises:
        OSError: the file cannot be written.
        UnusableInputError: the file would be rejected when it is read.
    """
    try:
        content = {"format": _FORMAT, "format_version": _VERSION} | _RESULT.dump_python(result, mode="json")
        text = json.dumps(content)
        _parsed(text.encode(), result.key)
    except ValueError as error:
        raise UnusableInputError(
            "gap.diagnosis_not_kept", "This diagnosis cannot be kept for the next start."
        ) from error
    private_folder(folder)
    write_private(folder / f"{result.key}{_SUFFIX}", text)
    for key in _keys(folder)[MOST_KEPT:]:
        remove(key, folder)


def remove(key: str, folder: Path) -> None:
    """Remove a kept diagnosis. A missing file and a failure are ignored."""
    with contextlib.suppress(OSError):
        (folder / f"{key}{_SUFFIX}").unlink()


def read_kept(folder: Path) -> KeptDiagnoses:
    """Read the kept diagnoses. A missing folder is an empty one.

    Raises:
        OSError: the folder exists and cannot be read.
    """
    results: list[DiagnosisResult] = []
    bad = 0
    for key in _keys(folder)[:MOST_KEPT]:
        try:
            results.append(_read(folder / f"{key}{_SUFFIX}", key))
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            bad += 1
    return KeptDiagnoses(tuple(results), bad)


def _read(path: Path, key: str) -> DiagnosisResult:
    with open_regular(path) as file:
        return _parsed(file.read(MOST_BYTES + 1), key)


def _parsed(data: bytes, key: str) -> DiagnosisResult:
    if len(data) > MOST_BYTES:
        raise ValueError("too long")
    content = json_value(data)
    version = content.pop("format_version")
    if content.pop("format") != _FORMAT or version not in (_VERSION, _LOGARITHMS):
        raise ValueError("the file is no diagnosis of this version")
    if version == _LOGARITHMS:
        del content["asked"]["language"]
        _undo_logarithms(content["story"])
    result = _RESULT.validate_python(content)
    if result.key != key:
        raise ValueError("the key differs from the name of the file")
    if not result.answer.keys() >= _ANSWER or result.answer["verdict"] != result.story.verdict:
        raise ValueError("the answer does not belong to this diagnosis")
    named = {name for name, _title, is_named in result.story.offered if is_named}
    if result.accepted is not None and not named <= {item.name for item in result.accepted.effects}:
        raise ValueError("the twin does not belong to this diagnosis")
    return result


def _undo_logarithms(story: dict[str, Any]) -> None:
    del story["gap"]
    if (spectrum := story["spectrum"]) is not None:
        del spectrum["unit"]
        curves = {name: _powers(values) for name, values in spectrum["lines"].items()}
        bands = [_powers(band) for band in spectrum["bands"]]
        spectrum |= {"frequency": _powers(spectrum["frequency"]), "lines": curves, "bands": bands}
    for profile in story["profiles"].values():
        profile["error"] = _powers(profile["error"])
    for overlay in story["overlays"]:
        del overlay["unit"], overlay["fine_unit"]


def _powers(logarithms: list[float]) -> list[float]:
    powers: list[float] = (10.0 ** np.asarray(logarithms, dtype=np.float64)).tolist()
    return powers


def _keys(folder: Path) -> list[str]:
    """Return the names of the kept diagnoses, newest first."""
    try:
        names = [entry.name for entry in os.scandir(folder)]
    except FileNotFoundError:
        return []
    keys = [name.removesuffix(_SUFFIX) for name in names if name.endswith(_SUFFIX)]
    return sorted((key for key in keys if KEY.fullmatch(key)), reverse=True)


def run_diagnosis(plan: DiagnosisPlan, control: Control, *, separate_process: bool) -> DiagnosisResult:
    """Diagnose a session, in other processes if ``separate_process`` is true.

    Raises:
        UnusableInputError: the session, the twin or the numbers of tests cannot be used.
        CancelledError: it was cancelled.
    """
    from tissueid.procedures.separate_process import run_in_process

    if separate_process:
        return run_in_process(functools.partial(_diagnosed, plan), control)
    return _diagnosed(plan.model_copy(update={"workers": 1}), control)


def _diagnosed(plan: DiagnosisPlan, control: Control) -> DiagnosisResult:
    # Imported here and not above: the window should not wait for what only this needs.
    from tissueid.procedures.diagnosis import diagnose_session

    stamp = stamp_of(plan.session)
    return result_of(diagnose_session(plan, control), stamp)


def result_of(diagnosed: DiagnosedSession, stamp: Stamp | None = None) -> DiagnosisResult:
    """Return the values of a diagnosis that the page shows and stores, without its records.

    Args:
        diagnosed: the diagnosis.
        stamp: of the session file, from before it was read.
    """
    from tissueid.gap import as_answer

    diagnosis, session, named = diagnosed.diagnosis, diagnosed.session, diagnosed.named
    return DiagnosisResult(
        diagnosed.plan,
        session.session_id,
        diagnosis.dataset.instrument,
        diagnosed.twin,
        page_content_of(diagnosis, session),
        finite(as_answer(diagnosis)),
        diagnosed.report_html,
        named.twin,
        named.refused,
        stamp,
    )


def page_content_of(diagnosis: Diagnosis, session: Session) -> PageContent:
    """Return the content of the page for a diagnosis."""
    from tissueid.app.views.gap.page_content import proposal_of
    from tissueid.gap.answer import content_of

    return PageContent(**vars(content_of(diagnosis)), proposal=proposal_of(diagnosis, session))
