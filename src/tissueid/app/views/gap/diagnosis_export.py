"""Outputs of a diagnosis: twin, report and JSON. The functions run in worker threads."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from tissueid.app.views.gap.diagnosis_result import DiagnosisRequest, DiagnosisResult
from tissueid.app.views.gap.separate_process import Step, run_in_process
from tissueid.atomic_write import write_private
from tissueid.audit import AuditTrail
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.output_files import unused_path

if TYPE_CHECKING:
    from tissueid.gap.workers import Executor
    from tissueid.instrument.twin_file import TwinFile

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}")
_SUFFIX = ".toml"


def why_not_accepted(result: DiagnosisResult) -> str:
    """Return why the diagnosis cannot be accepted into a twin; "" if it can."""
    if result.story.verdict == "no_gap":
        return Message("gap.accept_no_gap", "There is nothing to accept: there is no gap; use the twin as it is.")
    if result.story.verdict != "effect":
        return Message("gap.accept_unexplained", "There is nothing to accept: no known effect explains the gap.")
    return ""


def accept_into_twin(
    result: DiagnosisResult, path: Path, trail: AuditTrail, effects: Sequence[str], *, separate_process: bool
) -> str:
    """Save a twin with the selected effects, record it in the audit log, and return the notice to show.

    Another choice than the diagnosis names is fitted to the session first, as ``tissueid gap accept --effect`` does;
    with ``separate_process`` in other processes.

    Raises:
        UnusableInputError: nothing was named, the file's name makes no name of a twin, or it cannot be written.
    """
    from tissueid.gap.workers import SerialExecutor
    from tissueid.instrument.twin_file import check_twin_writable, write_twin

    if why := why_not_accepted(result):
        raise UnusableInputError(why)
    if not effects:
        raise UnusableInputError(Message("gap.accept_none", "There is nothing to accept: no effect is chosen."))
    check_twin_writable(path)
    name = path.stem if result.twin is None else result.twin.name
    if _NAME.fullmatch(name) is None:
        raise UnusableInputError(
            Message(
                "gap.twin_name",
                "The file name becomes the name of the twin: “{name}” must begin with a letter or digit and have only "
                "letters of the English alphabet, digits, blanks, dots, dashes and underscores",
                name=clean(name)[:40],
            )
        )
    if set(effects) == {member for member, _title, named in result.story.offered if named}:
        content = _named(result, name)
    else:
        work = functools.partial(_fitted, result.asked, result.twin, name, tuple(effects))
        made = run_in_process(work, _no_step, _never) if separate_process else work(_no_step, SerialExecutor(), _never)
        assert made is not None
        content = made
    write_twin(path, content)
    new = {"file": path.name, "name": content.name, "version": content.version}
    new |= {"effects": [item.name for item in content.effects]}
    trail.note("twin.accepted", subject=result.session_id, new=new)
    unlogged = trail.settle()
    said = _("The twin {name}, version {version}, is saved in {path}.").format(
        name=content.name, version=content.version, path=path
    )
    return (
        f"{said} {_('It is not in the audit log: {problem}').format(problem=translated(unlogged))}"
        if unlogged
        else said
    )


def _named(result: DiagnosisResult, name: str) -> TwinFile:
    if result.accepted is None:
        raise UnusableInputError(result.refused)
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return type(result.accepted)(**result.accepted.model_dump() | {"name": name, "created": created})


def _fitted(
    asked: DiagnosisRequest,
    twin: TwinFile | None,
    name: str,
    effects: tuple[str, ...],
    step: Step,
    people: Executor,
    cancelled: Callable[[], bool],
) -> TwinFile:
    from tissueid.gap.accepting import accept_named

    return accept_named(
        asked.session, effects, name, twin, people, lambda _: None, asked.fit, asked.check, cancelled=cancelled
    )


def _no_step(_what: str, _done: int, _total: int) -> None:
    """Ignore progress: it takes seconds."""


def _never() -> bool:
    return False


def write_report(result: DiagnosisResult) -> Path:
    """Write the HTML report next to the session under an unused name; return its path.

    Raises:
        OSError: it cannot be written there.
    """
    session = result.asked.session
    path = unused_path(session.with_name(f"{session.stem}-gap.html"))
    write_private(path, result.report)
    return path


def export_json(result: DiagnosisResult, path: Path) -> Path:
    """Write the JSON of ``tissueid gap diagnose --json`` atomically; return its path.

    Raises:
        OSError: it cannot be written.
    """
    write_private(path, json.dumps(result.answer, indent=2, allow_nan=False) + "\n")
    return path


def proposed_twin(result: DiagnosisResult, effects: Sequence[str]) -> Path:
    """Return the proposed file for the twin: the baseline twin, or an unused name next to the session."""
    if result.asked.twin is not None:
        return result.asked.twin
    folder = result.asked.session.parent
    stem = re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(effects)).strip("-._") or "twin"
    return unused_path(folder / f"{stem}{_SUFFIX}")
