"""Commands of the laboratory, which an entry point of the group ``tissueid.commands`` adds to ``tissueid``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from tissueid.cli.lazy_command import JsonFile, add_command
from tissueid.errors import UnusableInputError
from tissueid.messages import MISSING

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid_lab.blind_check.answers import CheckInProgress
    from tissueid_lab.blind_check.check import BlindCheckPlan
    from tissueid_lab.conformance.procedure import ConformancePlan
    from tissueid_lab.thesis.reproduction import ReproductionPlan


def add_commands(app: typer.Typer, gap: typer.Typer) -> None:
    """Add the commands of the laboratory to the groups ``tissueid`` and ``tissueid gap``."""
    add_command(app, "conformance", "tissueid_lab.conformance.procedure")(conformance)
    add_command(app, "reproduce", "tissueid_lab.thesis.reproduction")(reproduce)
    add_command(gap, "blind-check", "tissueid_lab.blind_check.check")(blind_check)


def conformance(plan: ConformancePlan, json_file: JsonFile = None) -> None:
    """Test a device against the protocol, clause by clause.

    Exit status 0: no clause failed; 1: a clause failed.
    """
    from tissueid.cli.output import at_terminal, check_json, console_control, human_output, table, write_json
    from tissueid.procedures.instrument_access import audit_trail
    from tissueid.procedures.output_files import check_different
    from tissueid_lab.conformance.procedure import run_conformance
    from tissueid_lab.conformance.suite import answer_of

    check_different(plan.out, json_file)
    check_json(json_file)
    if plan.attended and not at_terminal():
        raise UnusableInputError(
            "conformance.no_terminal", "--attended needs a person at a terminal, and there is no terminal"
        )
    with console_control() as control:
        found = run_conformance(plan, control, audit_trail("technician"))
    out = human_output(json_file, width=120)
    rows = table(f"Conformance of {found.device or found.url}", "clause", "what the device does", "result")
    reasons: dict[str, list[str]] = {}
    for item in found.results:
        rows.add_row(item.id, item.title, "FAILED" if item.outcome == "failed" else item.outcome)
        reasons.setdefault(item.reason, []).append(item.id)
    for column in rows.columns:
        column.justify = "left"
    out.print(rows)
    for reason, clauses in reasons.items():
        if reason:
            out.print(f"{', '.join(clauses)}: {reason}", markup=False, soft_wrap=True)
    out.print(found.headline, markup=False)
    if json_file is not None:
        write_json(json_file, answer_of(found))
    if not found.passed:
        raise typer.Exit(1)


def reproduce(plan: ReproductionPlan, json_file: JsonFile = None) -> None:
    """Make figures and tables of the thesis from simulated tests.

    Shows its numbers and those found here. Without --out, lists them.
    """
    from tissueid.cli.output import check_json, console_control, human_output, table, write_json
    from tissueid_lab.thesis.figures import FIGURES
    from tissueid_lab.thesis.reproduction import answer_of, run_reproduction

    check_json(json_file)
    out = human_output(json_file, width=150)
    if plan.out is None and not plan.numbers:
        answers = [{"number": figure.number, "title": str(figure.title)} for figure in FIGURES]
        rows = table("Figures and tables of the thesis", "number", "content")
        for answer in answers:
            rows.add_row(*answer.values())
        out.print(rows)
        out.print("--out DIR makes them; name some to make only those")
    else:
        with console_control() as control:
            made = run_reproduction(plan, control)
        answers = [answer_of(one) for one in made]
        rows = table("Thesis and simulated instrument", "figure", "quantity", "thesis", "here")
        for one in made:
            for row in (*one.rows, *([(one.why, "", "")] if one.why else [])):
                rows.add_row(one.figure.number, *row)
        out.print(rows)
        out.print(f"report: {(plan.out or Path()) / 'report.html'}", markup=False)
    if json_file is not None:
        write_json(json_file, {"figures": answers})


def blind_check(plan: BlindCheckPlan, json_file: JsonFile = None) -> None:
    """Score the diagnosis on scenarios with sealed labels.

    The scenarios are simulated. The labels stay sealed until all scenarios are diagnosed.
    """
    from tissueid.cli.output import check_json, console_control, human_output, table, write_json
    from tissueid.procedures.output_files import check_different
    from tissueid_lab.blind_check.check import run_blind_check
    from tissueid_lab.blind_check.page import score_table
    from tissueid_lab.blind_check.scoring import score_answer

    check_json(json_file)
    check_different(json_file, plan.page)
    out = human_output(json_file)

    def say_sealed(begun: CheckInProgress) -> None:
        what = "resumed" if plan.resume else "recorded"
        out.print(f"{begun.n} scenarios {what}; SHA-256 of their labels: {begun.seal}", markup=False)

    with console_control() as control:
        check = run_blind_check(plan, control, say_sealed)
    for title, count, score in check.scores.values():
        scores = score_table(score)
        rows = table(f"{title}: {count} scenarios", *scores.head)
        for row in scores.rows:
            rows.add_row(*row)
        out.print(rows)
        if score.controls:
            controls = (
                f"{one.what} {one.value:.0%}" if one.cases else f"{one.what} {MISSING}" for one in score.controls
            )
            out.print(f"  controls, top-1: {', '.join(controls)}", markup=False)
        for failure in score.failures:
            out.print(f"  failure: {failure}", markup=False)
    if plan.page is not None:
        out.print(f"report: {plan.page}", markup=False)
    if json_file is not None:
        kinds = {kind: score_answer(score) for kind, (_, _, score) in check.scores.items()}
        draw = {name: value for name, value in asdict(check.begun).items() if name not in ("full_share", "software")}
        write_json(json_file, draw | {"kinds": kinds, "answers": check.answers})
