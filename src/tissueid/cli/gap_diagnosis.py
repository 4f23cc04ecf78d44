"""``tissueid gap diagnose`` and ``batch``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.gap import Diagnosis, as_answer
from tissueid.gap.statement import (
    alternatives_of,
    headline_of,
    members_of,
    ordered_candidates,
    percent,
    sentences_of,
    shown_probability,
)
from tissueid.messages import MISSING
from tissueid.procedures.accept_effects import accept_effects
from tissueid.procedures.diagnosis import diagnose_session
from tissueid.procedures.gap_folder import diagnose_folder
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid.twin.effect import STAGE_NAMES


def run_diagnose(plan: DiagnosisPlan, json_file: Path | None) -> None:
    """Diagnose a session, print the result and write the requested files.

    Raises:
        UnusableInputError: the session, the twin or an option cannot be used.
    """
    check_json(json_file)
    check_different(json_file, plan.report, plan.twin_out)
    trail = audit_trail()
    with console_control() as control:
        diagnosed = diagnose_session(plan, control)
    found, console = diagnosed.found, human_output(json_file)
    for line in summary_lines(found):
        console.print(line, markup=False)
    if ordered_candidates(found):
        console.print(ranking_table(found))
    if json_file is not None:
        write_json(json_file, as_answer(found))
    if plan.report is not None:
        console.print(f"report: {plan.report}", markup=False)
    if plan.twin_out is not None:
        accepted = AcceptPlan(session=plan.session, out=plan.twin_out)
        with console_control() as control:
            accept_effects(accepted, control, trail, diagnosed.named)
        console.print(f"twin: {plan.twin_out}", markup=False)


def run_batch(plan: FolderPlan, json_file: Path) -> None:
    """Diagnose every session of a folder, print a line for each and write the answers.

    Raises:
        UnusableInputError: there are no session files.
    """
    check_json(json_file)
    with console_control() as control:
        answers = diagnose_folder(plan, control, _line_and_answer)
    console = human_output(json_file)
    written: dict[str, Any] = {}
    for path, answer in answers.items():
        line = answer if isinstance(answer, str) else answer.pop("line")
        written[path.name] = {"error": answer} if isinstance(answer, str) else answer
        console.print(f"{path.name}: {line}", markup=False, soft_wrap=True)
    write_json(json_file, written)


def _line_and_answer(found: Diagnosis) -> dict[str, Any]:
    return {"line": _short(found)} | as_answer(found)


def _short(found: Diagnosis) -> str:
    named = " + ".join(found.combination) or found.verdict.replace("_", " ")
    figures = found.gap
    details = [f"stage {' and '.join(found.at_fault)}"] if found.at_fault else []
    known = [
        (member.effect, shown_probability(found, member.effect, member.probability)) for member in members_of(found)
    ]
    details += [f"{name} {percent(share)} %" for name, share in known if np.isfinite(share)]
    about = f" ({', '.join(details)})" if details else ""
    return (
        f"{named}{about}; gap {figures.before:.2%} to {figures.after:.2%}, floor {figures.floor:.2%}, "
        f"{found.seconds:.0f} s"
    )


def summary_lines(found: Diagnosis) -> list[str]:
    """Return the diagnosis as a few lines."""
    figures = found.gap
    lines = [f"{headline_of(found)[0]}."]
    lines.append(f"Gap on held-out data: {figures.before:.2%}; noise floor {figures.floor:.2%}.")
    if found.verdict == "no_gap":
        lines += map(str, sentences_of(found))
    if found.combination:
        lines.append(
            f"With {' and '.join(found.combination)}: {figures.after:.2%}, {figures.closed:.0%} of the gap closed "
            f"({_interval(figures.closed_ci)})."
        )
    if found.budget is not None and len(found.budget.steps) > 1:
        alternatives = alternatives_of(found)
        lines += [
            f"  {step.effect}: closes {step.added:.0%} ({_interval(step.added_ci)}) when it is added, "
            f"{step.removed:.0%} ({_interval(step.removed_ci)}) when it alone is removed"
            + (f"; in its place possible: {', '.join(others)}." if (others := alternatives[step.effect]) else ".")
            for step in found.budget.steps
        ]
    if np.isfinite(found.ceiling):
        lines.append(f"Ceiling: {found.ceiling:.0%}, closed by a flexible regression or by the best candidate.")
    if found.at_fault:
        lines.append(f"Stage at fault: {' and '.join(STAGE_NAMES[stage] for stage in found.at_fault)}.")
    if found.next_experiment is not None:
        lines.append(f"Next: {found.next_experiment.kind}. {found.next_experiment.why}")
        if found.next_experiment.command_line:
            lines.append(f"      {found.next_experiment.command_line}")
    lines += found.remarks
    return lines


def _interval(of: tuple[float, float]) -> str:
    return f"{of[0]:.0%} to {of[1]:.0%}" if of[0] <= of[1] else MISSING


def _share(of: float, form: str = ".0%") -> str:
    return format(of, form) if np.isfinite(of) else MISSING


def ranking_table(found: Diagnosis) -> Table:
    """Return the table of candidates, best first."""
    rows = table("Candidates", "Effect", "Stage", "Probability", "Closed", "Indistinguishable from")
    for column in rows.columns[:4]:
        column.no_wrap = True
    for item in ordered_candidates(found):
        interval = _interval(item.closed_ci)
        rows.add_row(
            item.effect,
            item.stage,
            _share(shown_probability(found, item.effect, item.probability), ".1%"),
            f"{item.closed:.0%} ({interval})" if interval != MISSING else _share(item.closed),
            ", ".join(item.indistinguishable),
        )
    return rows
