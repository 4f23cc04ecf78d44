"""Outputs of a diagnosis: twin, report and JSON. The functions run in worker threads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from tissueid.app.views.gap.diagnosis_result import DiagnosisResult
from tissueid.app.words import sentence
from tissueid.atomic_write import unused_path
from tissueid.audit import AuditTrail
from tissueid.errors import UnusableInputError
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.gap_plans import AcceptPlan
from tissueid.procedures.output_files import json_text, write_text

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
    """Save a twin with the selected effects, and return the notice to show.

    Raises:
        UnusableInputError: nothing was chosen, the file's name makes no name of a twin, or it cannot be written.
    """
    from tissueid.app.job_control import JobControl
    from tissueid.gap.accepting import NamedEffects
    from tissueid.procedures.accept_effects import accept_effects

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
