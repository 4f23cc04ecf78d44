"""``tissueid gap blind-check``: score the diagnosis on scenarios with sealed labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.messages import MISSING
from tissueid.procedures.output_files import check_different
from tissueid_lab.blind_check.answers import CheckInProgress
from tissueid_lab.blind_check.check import BlindCheckPlan, run_blind_check
from tissueid_lab.blind_check.scoring import Score

_CONTROLS = ("permuted_labels_top1", "always_friction_top1", "in_sample_top1")
"""JSON keys of the controls, in the order of the score."""


def check_blind(plan: BlindCheckPlan, json_file: Path | None) -> None:
    """Run the check, print its scores and write the JSON.

    Raises:
        UnusableInputError: the check cannot be run, continued or scored.
        CancelledError: the check was interrupted.
    """
    check_json(json_file)
    check_different(json_file, plan.page)
    out = human_output(json_file)

    def say_sealed(begun: CheckInProgress) -> None:
        what = "resumed" if plan.resume else "recorded"
        out.print(f"{begun.n} scenarios {what}; SHA-256 of their labels: {begun.seal}", markup=False)

    with console_control() as control:
        checked = run_blind_check(plan, control, say_sealed)
    check = checked.check
    for title, count, score in check.scores.values():
        _print_result(out, title, count, score)
    if plan.page is not None:
        out.print(f"report: {plan.page}", markup=False)
    if json_file is not None:
        kinds = {kind: score_answer(score) for kind, (_, _, score) in check.scores.items()}
        about = {"seal": check.seal, "n": check.n, "seed": check.seed, "laboratory": check.laboratory}
        about |= {"skin": check.skin, "against_twin": check.against_twin}
        write_json(json_file, about | {"kinds": kinds, "answers": checked.answers})


def _print_result(console: Console, title: str, count: int, score: Score) -> None:
    console.print(score_table(f"{title}: {count} scenarios", score))
    controls = ", ".join(
        f"{item.what} {item.value:.0%}" if item.value == item.value else f"{item.what} {MISSING}"
        for item in score.controls
    )
    if score.controls:
        console.print(f"  controls, top-1: {controls}", markup=False)
    for failure in score.failures:
        console.print(f"  failure: {failure}", markup=False)


def score_table(title: str, score: Score) -> Table:
    """Return the table of targets and measured values."""
    rows = table(title, "", "Target", "Measured", "95 % (Wilson)", "Cases", "")
    for rate in score.rates:
        low, high = rate.interval
        rows.add_row(
            rate.what,
            f"{'' if rate.at_least else 'at most '}{rate.target:.0%}",
            f"{rate.share:.0%}" if rate.cases else MISSING,
            f"{low:.0%} to {high:.0%}" if rate.cases else MISSING,
            str(rate.cases),
            _kept(rate.reached),
        )
    for figure in score.figures:
        asked = MISSING if figure.target is None else f"{'' if figure.at_least else 'at most '}{figure.target:g}"
        rows.add_row(figure.what, asked, f"{figure.value:.3g}", MISSING, str(figure.cases), _kept(figure.reached))
    return rows


def _kept(kept: bool | None) -> str:
    return MISSING if kept is None else "reached" if kept else "not reached"


def score_answer(score: Score) -> dict[str, Any]:
    """Return a score for JSON."""
    return {
        "rates": [
            {
                "what": rate.what,
                "share": rate.share,
                "interval": list(rate.interval),
                "hits": rate.hits,
                "cases": rate.cases,
                "asked": rate.target,
                "kept": rate.reached,
            }
            for rate in score.rates
        ],
        "figures": [
            {
                "what": figure.what,
                "value": figure.value,
                "cases": figure.cases,
                "asked": figure.target,
                "kept": figure.reached,
            }
            for figure in score.figures
        ],
        "confusion": score.confusion,
        "risk_coverage": [list(point) for point in score.risk_coverage],
        "failures": list(score.failures),
        **{key: item.value for key, item in zip(_CONTROLS, score.controls, strict=bool(score.controls))},
    }
