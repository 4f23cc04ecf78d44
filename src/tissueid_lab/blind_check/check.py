"""Blind check of the diagnosis on scenarios of the simulated laboratory with sealed labels."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from tissueid.atomic_write import private_folder
from tissueid.child_process import run
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control, CountedProgress
from tissueid.procedures.output_files import HTML, check_output, writing

if TYPE_CHECKING:  # each takes long to import
    from tissueid_lab.blind_check.answers import BlindCheck, CheckInProgress
    from tissueid_lab.blind_check.scoring import Answered, BlindScore


class LaboratoryName(StrEnum):
    """The simulated laboratory that records the scenarios."""

    FIRST = "first"
    SECOND = "second"

    @property
    def module(self) -> str:
        """Module that records scenarios in its own process."""
        return "firmware_sim.laboratory" if self is LaboratoryName.FIRST else "firmware_sim.second_laboratory"


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
    laboratory: Annotated[
        LaboratoryName | None,
        Option("--laboratory", help="simulated laboratory, default first; second has other machines, stimuli and laws"),
    ] = None
    skin: Annotated[
        bool, Option("--skin", help="forearms and upper arms with 0 to 2 hidden instrument effects; scores sets")
    ] = False
    against_twin: Annotated[
        bool,
        Option(
            "--against-twin",
            help="later sessions of people with 0 or 1 new instrument effect, diagnosed against the accepted twin",
        ),
    ] = False
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


def run_blind_check(
    plan: BlindCheckPlan, control: Control, sealed: Callable[[CheckInProgress], None] = lambda _: None
) -> BlindCheck:
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
            "blind.no_folder", "--resume needs the folder of the interrupted check: add --keep DIR"
        )
    for kind, asked in (("--against-twin", plan.against_twin), ("--skin", plan.skin)):
        if asked and (plan.laboratory is LaboratoryName.SECOND or plan.take_out):
            raise _not_with(kind, "--take-out" if plan.take_out else "--laboratory second")
    try:
        if plan.keep is not None:
            return _checked(plan, plan.keep, control, sealed)
        with tempfile.TemporaryDirectory() as scratch:
            return _checked(plan, Path(scratch), control, sealed)
    except (KeyboardInterrupt, CancelledError):
        raise CancelledError(_interrupted(plan.keep)) from None


def _not_with(kind: str, option: str) -> UnusableInputError:
    return UnusableInputError(
        "blind.skin_alone",
        "{kind} cannot be combined with {option}: omit one of the two",
        kind=Verbatim(kind),
        option=option,
    )


def _interrupted(keep: Path | None) -> str:
    from tissueid.gap.answer import FOLDER

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
    from tissueid_lab.blind_check.answers import CheckInProgress, begin_check, check_in_progress, seal

    if not plan.resume:
        n = _N if plan.n is None else plan.n
        seed = _SEED if plan.seed is None else plan.seed
        share = _FULL_SHARE if plan.full_share is None else plan.full_share
        laboratory, skin = plan.laboratory or LaboratoryName.FIRST, plan.skin or plan.against_twin
        record_scenarios(folder, n, seed, share, laboratory, skin=skin, later=plan.against_twin)
        begun = CheckInProgress(n, seed, share, seal(folder), laboratory.value, skin, plan.against_twin)
        begin_check(folder, begun)
        return begun
    begun = check_in_progress(folder)
    for name, asked, held in (
        ("--n", plan.n, begun.n),
        ("--seed", plan.seed, begun.seed),
        ("--full-share", plan.full_share, begun.full_share),
        ("--laboratory", plan.laboratory, begun.laboratory),
    ):
        if asked is not None and asked != held:
            raise UnusableInputError(
                "blind.other_option",
                "the check in {folder} was begun with {option} {held}, not {asked}",
                folder=str(folder),
                option=name,
                held=Verbatim(held),
                asked=Verbatim(asked),
            )
    for option, asked_for, has in (
        ("--skin", plan.skin, begun.skin),
        ("--against-twin", plan.against_twin, begun.against_twin),
    ):
        if asked_for and not has:
            raise UnusableInputError(
                "blind.not_begun_so",
                "the check in {folder} was begun without {option}: omit it",
                folder=str(folder),
                option=Verbatim(option),
            )
    if plan.take_out and begun.skin:
        raise _not_with("--skin", "--take-out")
    _check_seal(folder, begun)
    return begun


def _check_seal(folder: Path, begun: CheckInProgress) -> None:
    from tissueid_lab.blind_check.answers import seal

    if seal(folder) != begun.seal:
        raise UnusableInputError("blind.altered", "the labels were altered while sealed: the check is not scored")


def _checked(
    plan: BlindCheckPlan, folder: Path, control: Control, sealed: Callable[[CheckInProgress], None]
) -> BlindCheck:
    from tissueid.gap import executor
    from tissueid_lab.blind_check.answers import BlindCheck, answers, scenario_names, unseal, with_labels

    begun = _begin(plan, folder)
    sealed(begun)
    names = scenario_names(folder)
    diagnosed = partial(answers, folder, cancelled=control.check, keep=plan.keep is not None)
    with executor(plan.workers) as pool:
        answers_by_name = diagnosed(names, pool, CountedProgress(control, _DIAGNOSING, len(names)))
        _check_seal(folder, begun)
        labels = unseal(folder)
        if labels.keys() != set(names):
            raise UnusableInputError(
                "blind.other_labels",
                "the scenarios in {folder} do not match its labels: the check is not scored",
                folder=str(folder),
            )
        cases = with_labels(answers_by_name, labels)
        again: list[Answered] = []
        if plan.take_out:
            taken_out = {case.name: case.label.effects for case in cases if case.single}
            count = CountedProgress(control, _TAKEN_OUT, len(taken_out))
            again = with_labels(diagnosed(list(taken_out), pool, count, without=taken_out), labels)
    check = BlindCheck(begun, dict(_scores(cases, again, begun)), answers_by_name)
    if plan.page is not None:
        from tissueid_lab.blind_check.page import write_blind_report

        with writing(plan.page):
            write_blind_report(check, plan.page)
    return check


def _scores(
    cases: Sequence[Answered], again: Sequence[Answered], begun: CheckInProgress
) -> Iterator[tuple[str, tuple[str, int, BlindScore]]]:
    from tissueid_lab.blind_check.scoring import FULL, SINGLE, score_of
    from tissueid_lab.blind_check.set_scoring import score_of_later_sessions, score_of_sets

    for key, title, full, targets in (
        ("single", "One stochastic test", False, SINGLE),
        ("full", "Full session", True, FULL),
    ):
        if not (chosen := [case for case in cases if case.label.full == full]):
            continue
        if begun.against_twin:
            score = score_of_later_sessions(chosen)
        elif begun.skin:
            score = score_of_sets(chosen)
        else:
            score = score_of(chosen, targets, [case for case in again if case.label.full == full])
        yield key, (title, len(chosen), score)


def record_scenarios(
    folder: Path,
    n: int,
    seed: int,
    full_share: float,
    laboratory: LaboratoryName = LaboratoryName.FIRST,
    *,
    skin: bool = False,
    later: bool = False,
) -> None:
    """Record scenarios of a simulated laboratory, which runs in its own process; with ``skin`` those of people's skin,
    with ``later`` as well later sessions of the same people.

    Raises:
        UnusableInputError: it cannot be run, or failed.
    """
    private_folder(folder)
    command = ["-m", laboratory.module, "--seed", str(seed), "--n", str(n), "--out", str(folder), "--clean"]
    command += ["--full-share", str(full_share), *(["--skin"] if skin else []), *(["--later"] if later else [])]
    try:
        done = run(*command, capture_output=True, text=True, timeout=MOST_SECONDS, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnusableInputError(
            "blind.no_laboratory", "the simulated laboratory cannot be run: {why}", why=Verbatim(error)
        ) from error
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise UnusableInputError(
            "blind.laboratory_failed", "the simulated laboratory failed: {why}", why=Verbatim(last)
        )
