"""``tissueid gap blind-check``: score the diagnosis on scenarios with sealed labels."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tissueid.atomic_write import private_folder
from tissueid.child_process import run
from tissueid.cli.output import check_json, human_output, progress_bars, table, write_json
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import executor
from tissueid.gap.answer_store import FOLDER, CheckInProgress, begin_check, check_in_progress
from tissueid.gap.blind_check import BlindCheck, answers, full_library, with_labels
from tissueid.gap.blind_scoring import FULL, SINGLE, Answered, Score, score_of
from tissueid.gap.scenarios import scenario_names, seal, unseal
from tissueid.messages import MISSING, Message
from tissueid.procedures.output_files import check_different, check_output

LABORATORY = "firmware_sim.laboratory"
MOST_SECONDS = 3600.0
"""Time limit of the simulated laboratory."""
_N, _SEED, _FULL_SHARE = 40, 1, 0.3
_CONTROLS = ("permuted_labels_top1", "always_friction_top1", "in_sample_top1")
"""JSON keys of the controls, in the order of the score."""


@dataclass(frozen=True)
class BlindPlan:
    """Options of the command; None where not given."""

    n: int | None
    seed: int | None
    full_share: float | None
    workers: int | None
    take_out: bool
    keep: Path | None
    resume: bool
    out: Path | None
    json_file: Path | None


def run_blind_check(plan: BlindPlan) -> None:
    """Draw, record, seal, diagnose, unseal and score scenarios; or continue an interrupted check.

    Raises:
        UnusableInputError: the simulated laboratory cannot be run, there is no check to continue, or its labels were
            altered while sealed.
        CancelledError: the check was interrupted.
    """
    check_json(plan.json_file)
    check_output(plan.out, ("<!",))
    check_different(plan.json_file, plan.out)
    if plan.resume and plan.keep is None:
        raise UnusableInputError("--resume needs the folder of the interrupted check: add --keep DIR")
    try:
        if plan.keep is not None:
            _check(plan, plan.keep)
        else:
            with tempfile.TemporaryDirectory() as scratch:
                _check(plan, Path(scratch))
    except KeyboardInterrupt:
        raise CancelledError(_interrupted(plan.keep)) from None


def _interrupted(keep: Path | None) -> str:
    if keep is None or not (keep / FOLDER).is_dir():
        return "cancelled; nothing was written"
    return Message(
        "blind.interrupted",
        "cancelled; the answers so far are kept in {folder}: continue by the same command with --resume",
        folder=str(keep),
    )


def _begin(plan: BlindPlan, folder: Path) -> CheckInProgress:
    """Record and seal a new check, or read an interrupted one.

    Raises:
        UnusableInputError: the check cannot be recorded, or the interrupted one has other options.
    """
    if not plan.resume:
        n = _N if plan.n is None else plan.n
        seed = _SEED if plan.seed is None else plan.seed
        share = _FULL_SHARE if plan.full_share is None else plan.full_share
        _record(folder, n, seed, share)
        begun = CheckInProgress(n, seed, share, seal(folder))
        begin_check(folder, begun)
        return begun
    begun = check_in_progress(folder)
    for name, asked, held in (
        ("--n", plan.n, begun.n),
        ("--seed", plan.seed, begun.seed),
        ("--full-share", plan.full_share, begun.full_share),
    ):
        if asked is not None and asked != held:
            raise UnusableInputError(
                Message(
                    "blind.other_option",
                    "the check in {folder} was begun with {option} {held:g}, not {asked:g}",
                    folder=str(folder),
                    option=name,
                    held=held,
                    asked=asked,
                )
            )
    _check_seal(folder, begun)
    return begun


def _check_seal(folder: Path, begun: CheckInProgress) -> None:
    if seal(folder) != begun.seal:
        raise UnusableInputError(
            Message("blind.altered", "the labels were altered while sealed: the check is not scored")
        )


def _check(plan: BlindPlan, folder: Path) -> None:
    console = human_output(plan.json_file)
    begun = _begin(plan, folder)
    what = "resumed" if plan.resume else "recorded"
    console.print(f"{begun.n} scenarios {what}; SHA-256 of their labels: {begun.seal}", markup=False)
    names = scenario_names(folder)
    keep = plan.keep is not None
    with progress_bars() as show, executor(plan.workers) as pool:
        found = answers(folder, names, pool, _counter(show, "diagnosing", len(names)), full_library, keep)
        _check_seal(folder, begun)
        labels = unseal(folder)
        if labels.keys() != set(names):
            raise UnusableInputError(
                Message(
                    "blind.other_labels",
                    "the scenarios in {folder} do not match its labels: the check is not scored",
                    folder=str(folder),
                )
            )
        cases = with_labels(found, labels)
        again: list[Answered] = []
        if plan.take_out:
            known = {
                case.name: case.label.effects
                for case in cases
                if len(case.label.effects) == 1 and case.label.listed[0] and case.survives
            }
            count = _counter(show, "without the true effect", len(known))
            one_out = answers(folder, list(known), pool, count, known.__getitem__, keep)
            again = with_labels(one_out, labels)
    check = BlindCheck(begun.seal, begun.n, begun.seed, dict(_scores(cases, again)))
    for title, count_of, score in check.scores.values():
        _print_result(console, title, count_of, score)
    if plan.out is not None:
        from tissueid.reports.gap_blind import write_blind_report

        write_blind_report(check, plan.out)
        console.print(f"report: {plan.out}", markup=False)
    if plan.json_file is not None:
        kinds = {kind: score_answer(score) for kind, (_, _, score) in check.scores.items()}
        report = {"seal": begun.seal, "n": begun.n, "seed": begun.seed, "kinds": kinds, "answers": found}
        write_json(plan.json_file, report)


def _scores(cases: Sequence[Answered], again: Sequence[Answered]) -> Iterator[tuple[str, tuple[str, int, Score]]]:
    for key, title, full, asked in (
        ("single", "One stochastic test", False, SINGLE),
        ("full", "Full session", True, FULL),
    ):
        chosen = [case for case in cases if case.label.full == full]
        if chosen:
            score = score_of(chosen, asked, [case for case in again if case.label.full == full])
            yield key, (title, len(chosen), score)


def _print_result(console: Console, title: str, count: int, score: Score) -> None:
    console.print(score_table(f"{title}: {count} scenarios", score))
    controls = ", ".join(
        f"{item.what} {item.value:.0%}" if item.value == item.value else f"{item.what} {MISSING}"
        for item in score.controls
    )
    console.print(f"  controls, top-1: {controls}", markup=False)
    for failure in score.failures:
        console.print(f"  failure: {failure}", markup=False)


def _record(folder: Path, n: int, seed: int, full_share: float) -> None:
    private_folder(folder)
    command = ["-m", LABORATORY, "--seed", str(seed), "--n", str(n), "--out", str(folder), "--clean"]
    command += ["--full-share", str(full_share)]
    try:
        done = run(*command, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnusableInputError(f"the simulated laboratory cannot be run: {error}") from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise UnusableInputError(f"the simulated laboratory failed: {last}")


def _counter(show: Any, what: str, total: int) -> Any:
    count = 0

    def done() -> None:
        nonlocal count
        count += 1
        show(what, count / max(total, 1))

    show(what, 0.0)
    return done


def score_table(title: str, score: Score) -> Table:
    """Return the table of targets and measured values."""
    rows = table(title, "", "Target", "Measured", "95 % (Wilson)", "Cases", "")
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
        **{key: item.value for key, item in zip(_CONTROLS, score.controls, strict=True)},
    }
