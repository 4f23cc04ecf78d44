"""Blind check of the diagnosis on scenarios of the simulated laboratory with sealed labels."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.child_process import run
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.procedures.control import Control, counted
from tissueid.procedures.output_files import HTML, check_output, unwritable
from tissueid.procedures.plan_options import Option, Plan

if TYPE_CHECKING:  # each takes long to import
    from tissueid.gap.answer_store import CheckInProgress
    from tissueid.gap.blind_check import BlindCheck
    from tissueid.gap.blind_scoring import Answered, Score

LABORATORY = "firmware_sim.laboratory"
MOST_SECONDS = 3600.0
"""Time limit of the simulated laboratory."""
_N, _SEED, _FULL_SHARE = 40, 1, 0.3
_DIAGNOSING = marked("Diagnosing")
_TAKEN_OUT = marked("Diagnosing without the true effect")


class BlindCheckPlan(Plan):
    """Scenarios of a check and its files. None is the default of a new check, or what an interrupted one began with."""

    n: Annotated[
        int | None, Option("--n", metavar="N", help="number of scenarios; default: 40"), Field(ge=1, le=5000)
    ] = None
    seed: Annotated[
        int | None, Option("--seed", help="seed of the scenarios, default 1; unknown to the diagnosis"), Field(ge=0)
    ] = None
    full_share: Annotated[
        float | None,
        Option("--full-share", help="share of full sessions, default 0.3; the others are single tests"),
        Field(ge=0.0, le=1.0),
    ] = None
    take_out: Annotated[bool, Option("--take-out", help="repeat without the true effect in the library")] = False
    keep: Annotated[
        Path | None, Option("--keep", metavar="DIR", help="keep recordings, labels and answers in this folder")
    ] = None
    resume: Annotated[bool, Option("--resume", help="continue the interrupted check in the folder of --keep")] = False
    page: Annotated[Path | None, Option("--out", metavar="PAGE", help="write the report, one HTML page")] = None
    workers: Annotated[
        int | None,
        Option("--workers", metavar="N", help="number of processes; default: one per core"),
        Field(ge=1, le=64),
    ] = None


@dataclass(frozen=True)
class CheckedDiagnoses:
    """The scores of a check, and the answer of each scenario for JSON."""

    check: BlindCheck
    answers: dict[str, dict[str, Any]]


def run_blind_check(
    plan: BlindCheckPlan, control: Control, sealed: Callable[[CheckInProgress], None] = lambda _: None
) -> CheckedDiagnoses:
    """Draw, record, seal, diagnose, unseal and score scenarios; or continue an interrupted check.

    ``sealed`` is called before the first diagnosis, with the checksum of the labels.

    Raises:
        UnusableInputError: the simulated laboratory cannot be run, there is no check to continue, or its labels were
            altered while sealed.
        CancelledError: the check was interrupted.
    """
    check_output(plan.page, HTML)
    if plan.resume and plan.keep is None:
        raise UnusableInputError(
            Message("blind.no_folder", "--resume needs the folder of the interrupted check: add --keep DIR")
        )
    try:
        if plan.keep is not None:
            return _checked(plan, plan.keep, control, sealed)
        with tempfile.TemporaryDirectory() as scratch:
            return _checked(plan, Path(scratch), control, sealed)
    except (KeyboardInterrupt, CancelledError):
        raise CancelledError(_interrupted(plan.keep)) from None


def _interrupted(keep: Path | None) -> str:
    from tissueid.gap.answer_store import FOLDER

    if keep is None or not (keep / FOLDER).is_dir():
        return Message("blind.cancelled", "cancelled; nothing was written")
    return Message(
        "blind.interrupted",
        "cancelled; the answers so far are kept in {folder}: continue by the same command with --resume",
        folder=str(keep),
    )


def _begin(plan: BlindCheckPlan, folder: Path) -> CheckInProgress:
    """Record and seal a new check, or read an interrupted one.

    Raises:
        UnusableInputError: the check cannot be recorded, or the interrupted one has other options.
    """
    from tissueid.gap.answer_store import CheckInProgress, begin_check, check_in_progress
    from tissueid.gap.scenarios import seal

    if not plan.resume:
        n = _N if plan.n is None else plan.n
        seed = _SEED if plan.seed is None else plan.seed
        share = _FULL_SHARE if plan.full_share is None else plan.full_share
        record_scenarios(folder, n, seed, share)
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
    from tissueid.gap.scenarios import seal

    if seal(folder) != begun.seal:
        raise UnusableInputError(
            Message("blind.altered", "the labels were altered while sealed: the check is not scored")
        )


def _checked(
    plan: BlindCheckPlan, folder: Path, control: Control, sealed: Callable[[CheckInProgress], None]
) -> CheckedDiagnoses:
    from tissueid.gap import executor
    from tissueid.gap.blind_check import BlindCheck, answers, full_library, with_labels
    from tissueid.gap.scenarios import scenario_names, unseal

    begun = _begin(plan, folder)
    sealed(begun)
    names = scenario_names(folder)
    keep = plan.keep is not None
    with executor(plan.workers) as pool:
        found = answers(folder, names, pool, _counter(control, _DIAGNOSING, len(names)), full_library, keep)
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
            count = _counter(control, _TAKEN_OUT, len(known))
            one_out = answers(folder, list(known), pool, count, known.__getitem__, keep)
            again = with_labels(one_out, labels)
    check = BlindCheck(begun.seal, begun.n, begun.seed, dict(_scores(cases, again)))
    if plan.page is not None:
        from tissueid.reports.gap_blind import write_blind_report

        try:
            write_blind_report(check, plan.page)
        except OSError as error:
            raise unwritable(plan.page, error) from error
    return CheckedDiagnoses(check, found)


def _scores(cases: Sequence[Answered], again: Sequence[Answered]) -> Iterator[tuple[str, tuple[str, int, Score]]]:
    from tissueid.gap.blind_scoring import FULL, SINGLE, score_of

    for key, title, full, asked in (
        ("single", "One stochastic test", False, SINGLE),
        ("full", "Full session", True, FULL),
    ):
        chosen = [case for case in cases if case.label.full == full]
        if chosen:
            score = score_of(chosen, asked, [case for case in again if case.label.full == full])
            yield key, (title, len(chosen), score)


def record_scenarios(folder: Path, n: int, seed: int, full_share: float) -> None:
    """Record scenarios of the simulated laboratory, which runs in its own process.

    Raises:
        UnusableInputError: it cannot be run, or failed.
    """
    private_folder(folder)
    command = ["-m", LABORATORY, "--seed", str(seed), "--n", str(n), "--out", str(folder), "--clean"]
    command += ["--full-share", str(full_share)]
    try:
        done = run(*command, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnusableInputError(
            Message("blind.no_laboratory", "the simulated laboratory cannot be run: {why}", why=Verbatim(error))
        ) from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise UnusableInputError(
            Message("blind.laboratory_failed", "the simulated laboratory failed: {why}", why=Verbatim(last))
        )


def _counter(control: Control, step: str, total: int) -> Callable[[], None]:
    count = 0

    def done() -> None:
        nonlocal count
        count += 1
        control.progress(count / max(total, 1), counted(step, count, total))
        control.check()

    control.progress(0.0, counted(step, 0, total))
    return done
