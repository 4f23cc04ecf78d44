"""``tissueid gap blind-check``: the diagnosis scored on scenarios whose labels are sealed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from tissueid.cli.gap_diagnosis import interruptible
from tissueid.cli.output import check_json, people_read, progress_bars, table, write_json
from tissueid.errors import UnusableInputError
from tissueid.gap import crew
from tissueid.gap.blind_check import always, answers, in_sample, opened, permuted
from tissueid.gap.scenarios import scenario_names, seal, unseal
from tissueid.gap.sealed import FULL, SINGLE, Answered, Score, score_of
from tissueid.wording import MISSING

LABORATORY = "firmware_sim.laboratory"
MOST_SECONDS = 3600.0


def run_blind_check(
    n: int,
    seed: int,
    full_share: float,
    workers: int | None,
    take_out: bool,
    keep: Path | None,
    json_file: Path | None,
) -> None:
    """Draw, record, seal, diagnose, unseal and score.

    Raises:
        UnusableInputError: the simulated laboratory cannot be run, or its files were altered while sealed.
    """
    check_json(json_file)
    with interruptible():
        _check(n, seed, full_share, workers, take_out, keep, json_file)


def _check(
    n: int, seed: int, full_share: float, workers: int | None, take_out: bool, keep: Path | None, json_file: Path | None
) -> None:
    console = people_read(json_file)
    with tempfile.TemporaryDirectory() as scratch:
        folder = keep if keep is not None else Path(scratch)
        _record(folder, n, seed, full_share)
        sealed = seal(folder)
        console.print(f"{n} scenarios recorded; SHA-256 of their labels: {sealed}", markup=False)
        names = scenario_names(folder)
        with progress_bars() as show, crew(workers) as people:
            found = answers(folder, names, people, _counter(show, "diagnosing", len(names)))
            if seal(folder) != sealed:
                raise UnusableInputError("the labels were altered while they were sealed: nothing is scored")
            cases = opened(found, unseal(folder))
            again: list[Answered] = []
            if take_out:
                known = {
                    case.name: case.label.effects
                    for case in cases
                    if len(case.label.effects) == 1 and case.label.listed[0] and case.survives
                }
                one_out = answers(
                    folder, list(known), people, _counter(show, "true effect taken out", len(known)), known.__getitem__
                )
                again = opened(one_out, unseal(folder))
    report = {"seal": sealed, "n": n, "seed": seed, "kinds": {}, "answers": found}
    for title, kind, asked in (("One stochastic test", False, SINGLE), ("Full session", True, FULL)):
        chosen = [case for case in cases if case.label.full == kind]
        if not chosen:
            continue
        score = score_of(chosen, asked)
        console.print(score_table(f"{title}: {len(chosen)} scenarios", score))
        for line in [*_controls(chosen), *_taken_out([case for case in again if case.label.full == kind])]:
            console.print(line, markup=False)
        for failure in score.failures:
            console.print(f"  not as it was: {failure}", markup=False)
        report["kinds"]["full" if kind else "single"] = score_answer(score) | {  # type: ignore[index]
            "permuted_labels_top1": _top1(score_of(permuted(chosen), asked)),
            "always_friction_top1": always(chosen),
            "in_sample_top1": in_sample(chosen),
        }
    if json_file is not None:
        write_json(json_file, report)


def _record(folder: Path, n: int, seed: int, full_share: float) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", LABORATORY, "--seed", str(seed), "--n", str(n), "--out", str(folder), "--clean"]
    command += ["--full-share", str(full_share)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnusableInputError(f"the simulated laboratory cannot be run: {error}") from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        raise UnusableInputError(f"the simulated laboratory gave up: {last}")


def _counter(show: Any, what: str, total: int) -> Any:
    count = 0

    def done() -> None:
        nonlocal count
        count += 1
        show(what, count / max(total, 1))

    show(what, 0.0)
    return done


def score_table(title: str, score: Score) -> Table:
    """What was asked and what was measured."""
    rows = table(title, "", "Asked", "Measured", "95 % (Wilson)", "Cases", "")
    for rate in score.rates:
        low, high = rate.interval
        rows.add_row(
            rate.what,
            f"{'' if rate.at_least else 'at most '}{rate.asked:.0%}",
            f"{rate.share:.0%}" if rate.cases else MISSING,
            f"{low:.0%} to {high:.0%}" if rate.cases else MISSING,
            str(rate.cases),
            _kept(rate.kept),
        )
    for figure in score.figures:
        asked = MISSING if figure.asked is None else f"{'' if figure.at_least else 'at most '}{figure.asked:g}"
        rows.add_row(figure.what, asked, f"{figure.value:.3g}", MISSING, str(figure.cases), _kept(figure.kept))
    return rows


def _kept(kept: bool | None) -> str:
    return MISSING if kept is None else "reached" if kept else "not reached"


def _top1(score: Score) -> float:
    return score.rates[0].share


def _controls(cases: Sequence[Answered]) -> list[str]:
    shuffled = np_mean([_top1(score_of(permuted(cases, seed), SINGLE)) for seed in range(20)])
    return [
        f"  controls, top-1: labels permuted {shuffled:.0%}, always dry_friction {always(cases):.0%}, best fit of the "
        f"fitted samples {in_sample(cases):.0%}"
    ]


def np_mean(values: Sequence[float]) -> float:
    """Mean of the values that are numbers; NaN where there are none."""
    known = [value for value in values if value == value]
    return sum(known) / len(known) if known else float("nan")


def _taken_out(cases: Sequence[Answered]) -> list[str]:
    if not cases:
        return []
    abstained = [case for case in cases if case.verdict == "unexplained"]
    staged = [case for case in abstained if case.answer["where"]["stage"] in case.label.stages]
    return [
        f"  true effect taken out of the library: unexplained in {len(abstained)} of {len(cases)}, of these with the "
        f"right stage {len(staged)}"
    ]


def score_answer(score: Score) -> dict[str, Any]:
    """A score as JSON holds it."""
    return {
        "rates": [
            {
                "what": rate.what,
                "share": rate.share,
                "interval": list(rate.interval),
                "hits": rate.hits,
                "cases": rate.cases,
                "asked": rate.asked,
                "kept": rate.kept,
            }
            for rate in score.rates
        ],
        "figures": [
            {
                "what": figure.what,
                "value": figure.value,
                "cases": figure.cases,
                "asked": figure.asked,
                "kept": figure.kept,
            }
            for figure in score.figures
        ],
        "confusion": score.confusion,
        "risk_coverage": [list(point) for point in score.risk_coverage],
        "failures": list(score.failures),
    }
