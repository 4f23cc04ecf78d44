"""Commands of the sim-to-real gap and of twins: gap, twin."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from tissueid.cli.output import Output, at_terminal, console, table
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.formatting import number
from tissueid.gap import Diagnosis, as_answer
from tissueid.gap.statement import (
    GapHistoryEntry,
    alternatives_of,
    headline_of,
    history_headline,
    members_of,
    ordered_candidates,
    percent,
    sentences_of,
    shown_probability,
)
from tissueid.gap.twin_export import NamedEffects
from tissueid.instrument.twin_file import TwinFile, read_twin
from tissueid.messages import MISSING
from tissueid.procedures.diagnosis import (
    TwinFolderPlan,
    TwinPlan,
    accept_effects,
    diagnose_folder,
    diagnose_session,
    saved_twins,
    watch_folder,
)
from tissueid.procedures.gap_plans import AcceptPlan, DiagnosisPlan, FolderPlan, WatchPlan
from tissueid.procedures.instruments import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, Effect


def run_diagnose(plan: DiagnosisPlan, out: Output) -> None:
    """Diagnose a session, print the result and write the requested files.

    Raises:
        UnusableInputError: the session, the twin or an option cannot be used.
    """
    check_different(out.json_file, plan.report, plan.twin_out)
    trail = audit_trail()
    diagnosed = out.run(diagnose_session, plan)
    diagnosis = diagnosed.diagnosis
    out.print_lines(summary_lines(diagnosis))
    if ordered_candidates(diagnosis):
        out.print(ranking_table(diagnosis))
    out.write_json(as_answer(diagnosis))
    out.print_files(report=plan.report)
    if plan.twin_out is not None:
        out.run(accept_effects, AcceptPlan(session=plan.session, out=plan.twin_out), trail, diagnosed.named)
    out.print_files(twin=plan.twin_out)


def run_batch(
    plan: FolderPlan,
    json_file: Annotated[Path, typer.Option("--json", metavar="FILE", help="write the results by file name")],
) -> None:
    """Diagnose every session of a folder, print a line for each and write the answers.

    Raises:
        UnusableInputError: there are no session files.
    """
    out = Output(json_file)
    answers = out.run(diagnose_folder, plan, _line_and_answer)
    written: dict[str, Any] = {}
    for path, answer in answers.items():
        line = answer if isinstance(answer, str) else answer.pop("line")
        written[path.name] = {"error": answer} if isinstance(answer, str) else answer
        out.print(f"{path.name}: {line}", soft_wrap=True)
    out.write_json(written)


def _line_and_answer(diagnosis: Diagnosis) -> dict[str, Any]:
    return {"line": _short(diagnosis)} | as_answer(diagnosis)


def _short(diagnosis: Diagnosis) -> str:
    named = " + ".join(diagnosis.combination) or diagnosis.verdict.replace("_", " ")
    figures = diagnosis.gap
    details = [f"stage {' and '.join(diagnosis.at_fault)}"] if diagnosis.at_fault else []
    probabilities = [
        (member.effect, shown_probability(diagnosis, member.effect, member.probability))
        for member in members_of(diagnosis)
    ]
    details += [f"{name} {percent(share)} %" for name, share in probabilities if np.isfinite(share)]
    about = f" ({', '.join(details)})" if details else ""
    return (
        f"{named}{about}; gap {figures.before:.2%} to {figures.after:.2%}, floor {figures.floor:.2%}, "
        f"{diagnosis.seconds:.0f} s"
    )


def summary_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the diagnosis as a few lines."""
    figures = diagnosis.gap
    lines = [f"{headline_of(diagnosis)[0]}."]
    lines.append(f"Gap on held-out data: {figures.before:.2%}; noise floor {figures.floor:.2%}.")
    if diagnosis.verdict == "no_gap":
        lines += map(str, sentences_of(diagnosis))
    if diagnosis.combination:
        lines.append(
            f"With {' and '.join(diagnosis.combination)}: {figures.after:.2%}, {figures.closed:.0%} of the gap closed "
            f"({_interval(figures.closed_ci)})."
        )
    if diagnosis.budget is not None and len(diagnosis.budget.steps) > 1:
        alternatives = alternatives_of(diagnosis)
        lines += [
            f"  {step.effect}: closes {step.added:.0%} ({_interval(step.added_ci)}) when it is added, "
            f"{step.removed:.0%} ({_interval(step.removed_ci)}) when it alone is removed"
            + (f"; in its place possible: {', '.join(others)}." if (others := alternatives[step.effect]) else ".")
            for step in diagnosis.budget.steps
        ]
    if np.isfinite(diagnosis.ceiling):
        lines.append(f"Ceiling: {diagnosis.ceiling:.0%}, closed by a flexible regression or by the best candidate.")
    if diagnosis.at_fault:
        lines.append(f"Stage at fault: {' and '.join(STAGE_NAMES[stage] for stage in diagnosis.at_fault)}.")
    if diagnosis.next_experiment is not None:
        lines.append(f"Next: {diagnosis.next_experiment.kind}. {diagnosis.next_experiment.why}")
        if diagnosis.next_experiment.command_line:
            lines.append(f"      {diagnosis.next_experiment.command_line}")
    lines += diagnosis.remarks
    return lines


def _interval(of: tuple[float, float]) -> str:
    return f"{of[0]:.0%} to {of[1]:.0%}" if of[0] <= of[1] else MISSING


def _share(of: float, form: str = ".0%") -> str:
    return format(of, form) if np.isfinite(of) else MISSING


def ranking_table(diagnosis: Diagnosis) -> Table:
    """Return the table of candidates, best first."""
    rows = table("Candidates", "Effect", "Stage", "Probability", "Closed", "Indistinguishable from")
    for column in rows.columns[:4]:
        column.no_wrap = True
    for item in ordered_candidates(diagnosis):
        interval = _interval(item.closed_ci)
        rows.add_row(
            item.effect,
            item.stage,
            _share(shown_probability(diagnosis, item.effect, item.probability), ".1%"),
            f"{item.closed:.0%} ({interval})" if interval != MISSING else _share(item.closed),
            ", ".join(item.indistinguishable),
        )
    return rows


def run_accept(
    plan: AcceptPlan,
    *,
    yes: Annotated[bool, typer.Option("--yes", help="accept all members of a combination, and do not ask")] = False,
    out: Output,
) -> None:
    """Save the twin with the effects of a diagnosis, or with those of the plan.

    At a terminal the user is asked which members of a combination to accept, except with ``yes``.

    Raises:
        UnusableInputError: the session, the twin, an effect or an option cannot be used, or there is nothing to accept.
        CancelledError: no member was chosen; nothing was written.
    """
    check_different(plan.out, out.json_file)
    trail = audit_trail()
    named: NamedEffects | None = None
    if not plan.effects:
        diagnosed = out.run(diagnose_session, plan.diagnosis)
        named = diagnosed.named
        out.print_lines(_odds(diagnosed.diagnosis))
        chosen = named.effects if yes else _chosen(named.effects)
        plan = plan.model_copy(update={"effects": chosen})
    content = out.run(accept_effects, plan, trail, named)
    print_twin(plan.out, content, out)


def _odds(diagnosis: Diagnosis) -> list[str]:
    """Return a line for each member of the combination: its probability, and the close rivals with theirs."""
    lines = []
    for position, member in enumerate(members_of(diagnosis), 1):
        rivals = ", ".join(f"{name} {percent(share)} %" for name, share in member.rivals)
        share = "unknown" if member.probability != member.probability else f"{percent(member.probability)} %"
        lines.append(f"{position}. {member.effect}: probability {share}{f'; rivals: {rivals}' if rivals else ''}")
    return lines


def _chosen(members: tuple[str, ...]) -> tuple[str, ...]:
    """Ask at the terminal which members of a combination to accept; all of them if there is no terminal.

    Raises:
        UnusableInputError: the answer names something else.
        CancelledError: the input ended.
    """
    if len(members) < 2 or not at_terminal():
        return members
    console.print("Which effects should the twin have? Numbers separated by commas; Enter selects all.")
    line = sys.stdin.readline()
    if not line:
        raise CancelledError("cancelled; nothing was written")
    numbers = line.replace(",", " ").split()
    if not all(number.isdecimal() and 1 <= int(number) <= len(members) for number in numbers):
        raise UnusableInputError(f"choose numbers from 1 to {len(members)}, not {line.strip()!r}; nothing was written")
    wanted = {int(number) for number in numbers} or set(range(1, len(members) + 1))
    return tuple(member for position, member in enumerate(members, 1) if position in wanted)


def run_watch(plan: WatchPlan, out: Output) -> None:
    """Diagnose the sessions, print them in order of time, and write the requested files.

    Raises:
        UnusableInputError: the twin, every session, or an option cannot be used.
    """
    check_different(out.json_file, plan.report)
    history = out.run(watch_folder, plan)
    columns = ("Session", "Recorded, UTC", "Gap", "Floor", "Result")
    out.print(table("Gap against the twin", *columns, rows=map(_history_row, history.entries)))
    out.print(f"{history_headline(history)[0]}.", soft_wrap=True)
    out.write_json(history.as_answer())
    out.print_files(report=plan.report)


def _history_row(entry: GapHistoryEntry) -> tuple[str, ...]:
    date = MISSING if entry.time is None else f"{entry.time:%Y-%m-%d %H:%M}"
    if entry.answer is None:
        return entry.file, date, MISSING, MISSING, entry.reason
    result = " + ".join(entry.combination) or str(entry.answer["verdict"]).replace("_", " ")
    return entry.file, date, f"{entry.gap('before'):.2%}", f"{entry.gap('floor'):.2%}", result


def list_effects(out: Output) -> None:
    """List the effects of the library, with their declarations as JSON.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    rows = [(effect.name, STAGE_NAMES[effect.stage], effect.title) for effect in all_effects().values()]
    out.print(table("Effects", "Effect", "Stage", "Title", rows=rows))
    out.write_json([declared(effect) for effect in all_effects().values()])


def declared(effect: Effect) -> dict[str, Any]:
    """Return the declaration of an effect as plain values, SI.

    ``scales_with`` is the property of the instrument with which a parameter's bounds scale, and its exponent.
    """
    return {
        "effect": effect.name,
        "stage": effect.stage,
        "title": effect.title,
        "equation": effect.equation,
        "signature": effect.signature,
        "remedy": effect.remedy,
        "source": effect.source,
        "mistaken_for": list(effect.mistaken_for),
        "needs": sorted(effect.needs),
        "parameters": [
            {
                "name": item.name,
                "unit": item.unit,
                "meaning": str(item.meaning),
                "low": item.low,
                "high": item.high,
                "scales_with": item.scales_with and dict([item.scales_with]),
            }
            for item in effect.parameters
        ],
    }


def show_twin(plan: TwinPlan, out: Output) -> None:
    """Print a twin.

    Raises:
        UnusableInputError: the file is not a twin.
    """
    print_twin(plan.file, read_twin(plan.file), out)


def list_twins(plan: TwinFolderPlan, out: Output) -> None:
    """Print the twins in a folder.

    Raises:
        UnusableInputError: the folder does not exist.
    """
    rows = table(str(plan.folder), "file", "name", "version", "effects", "closed", "made")
    answers = []
    for path, content in saved_twins(plan).items():
        effects = ", ".join(item.name for item in content.effects)
        share = MISSING if content.source.closed is None else f"{content.source.closed:.0%}"
        rows.add_row(path.name, content.name, str(content.version), effects, share, content.created)
        answers.append({"file": str(path), **content.model_dump(mode="json")})
    out.print(rows if answers else f"there are no twins in {plan.folder}")
    out.write_json({"twins": answers})


def print_twin(path: Path, content: TwinFile, out: Output) -> None:
    """Print a twin, and write it as JSON if requested."""
    source = content.source
    share = "" if source.closed is None else f", closes {source.closed:.0%} of the gap"
    out.print(f"{path}: {content.name}, version {content.version}{share}")
    if source.improves:
        out.print(f"based on {source.improves}")
    rows = table("Values, SI", "part", "quantity", "value", "std")
    for part, figures, prefix in (
        ("instrument", content.instrument, ""),
        ("tissue", content.tissue, "tissue_"),
        *((item.name, item.parameters, "") for item in content.effects),
    ):
        stds: dict[str, float] = next((item.stds for item in content.effects if item.name == part), content.stds)
        for figure, value in figures.items():
            std = stds.get(f"{prefix}{figure}")
            rows.add_row(part, figure, number(value), MISSING if std is None else number(std))
            part = ""
    out.print(rows)
    out.print(f"to play it: tissueid test --device simulated://{path.absolute()} --site TEXT --out SESSION")
    out.write_json({"file": str(path), **content.model_dump(mode="json")})
