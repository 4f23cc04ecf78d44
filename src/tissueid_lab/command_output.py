"""Output of the commands of the laboratory: conformance, reproduce, blind-check."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from tissueid.cli.output import Output, at_terminal, table
from tissueid.errors import UnusableInputError
from tissueid.messages import MISSING
from tissueid.procedures.instruments import audit_trail
from tissueid.procedures.output_files import check_different
from tissueid_lab.blind_check.check import BlindCheckPlan, run_blind_check
from tissueid_lab.conformance.procedure import ConformancePlan, run_conformance
from tissueid_lab.thesis.reproduction import ReproductionPlan, run_reproduction
from tissueid_lab.thesis.reproduction import answer_of as figure_answer

if TYPE_CHECKING:
    from tissueid_lab.blind_check.answers import CheckInProgress


def conformance(plan: ConformancePlan, out: Output) -> None:
    """Test a device against the protocol, clause by clause.

    Raises:
        UnusableInputError: an option cannot be used.
        typer.Exit: a clause failed: exit status 1.
    """
    from tissueid_lab.conformance.suite import answer_of as conformance_answer

    check_different(plan.out, out.json_file)
    if plan.attended and not at_terminal():
        raise UnusableInputError(
            "conformance.no_terminal", "--attended needs a person at a terminal, and there is no terminal"
        )
    result = out.run(run_conformance, plan, audit_trail("technician"))
    out.widen(120)
    rows = table(f"Conformance of {result.device or result.url}", "clause", "what the device does", "result")
    reasons: dict[str, list[str]] = {}
    for item in result.results:
        rows.add_row(item.id, item.title, "FAILED" if item.outcome == "failed" else item.outcome)
        reasons.setdefault(item.reason, []).append(item.id)
    for column in rows.columns:
        column.justify = "left"
    out.print(rows)
    for reason, clauses in reasons.items():
        if reason:
            out.print(f"{', '.join(clauses)}: {reason}", soft_wrap=True)
    out.print(result.headline)
    out.write_json(conformance_answer(result))
    if not result.passed:
        raise typer.Exit(1)


def reproduce(plan: ReproductionPlan, out: Output) -> None:
    """Make figures and tables of the thesis and print its numbers next to the simulated ones; or list them."""
    from tissueid_lab.thesis.figures import FIGURES

    out.widen(150)
    if plan.out is None and not plan.numbers:
        answers = [{"number": figure.number, "title": str(figure.title)} for figure in FIGURES]
        rows = table("Figures and tables of the thesis", "number", "content")
        for answer in answers:
            rows.add_row(*answer.values())
        out.print(rows)
        out.print("--out DIR makes them; name some to make only those")
    else:
        made = out.run(run_reproduction, plan)
        answers = [figure_answer(reproduced) for reproduced in made]
        rows = table("Thesis and simulated instrument", "figure", "quantity", "thesis", "here")
        for reproduced in made:
            for row in (*reproduced.rows, *([(reproduced.why, "", "")] if reproduced.why else [])):
                rows.add_row(reproduced.figure.number, *row)
        out.print(rows)
        out.print(f"report: {(plan.out or Path()) / 'report.html'}")
    out.write_json({"figures": answers})


def blind_check(plan: BlindCheckPlan, out: Output) -> None:
    """Score the diagnosis on scenarios with sealed labels, and print the scores and the failures."""
    from tissueid_lab.blind_check.page import score_table
    from tissueid_lab.blind_check.scoring import score_answer

    check_different(out.json_file, plan.page)

    def say_sealed(begun: CheckInProgress) -> None:
        what = "resumed" if plan.resume else "recorded"
        out.print(f"{begun.n} scenarios {what}; SHA-256 of their labels: {begun.seal}")

    check = out.run(run_blind_check, plan, say_sealed)
    for title, count, score in check.scores.values():
        scores = score_table(score)
        rows = table(f"{title}: {count} scenarios", *scores.head)
        for row in scores.rows:
            rows.add_row(*row)
        out.print(rows)
        if score.controls:
            controls = (
                f"{control.what} {control.value:.0%}" if control.cases else f"{control.what} {MISSING}"
                for control in score.controls
            )
            out.print(f"  controls, top-1: {', '.join(controls)}")
        for failure in score.failures:
            out.print(f"  failure: {failure}")
    if plan.page is not None:
        out.print(f"report: {plan.page}")
    if out.json_file is not None:
        kinds = {kind: score_answer(score) for kind, (_, _, score) in check.scores.items()}
        draw = {name: value for name, value in asdict(check.begun).items() if name not in ("full_share", "software")}
        out.write_json(draw | {"kinds": kinds, "answers": check.answers})
