"""One guided test from opening the instrument to the saved session: runs in a thread that alone touches it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType

from tissueid.acquisition import (
    GuidedTest,
    JournalError,
    MultistepTest,
    Phase,
    Progress,
    SessionRecorder,
    check_multistep,
    journal_path,
    run_guided_test,
    run_multistep,
)
from tissueid.acquisition.choice import test_kind
from tissueid.acquisition.guided import check_test, place
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.placing import place_in_air
from tissueid.acquisition.waiting import meanwhile
from tissueid.app.emergency import NO_ANSWER, EmergencyStop
from tissueid.app.instruments import greatest_force_n
from tissueid.app.live import LiveSignals
from tissueid.app.pacing import PacedInstrument, Wait
from tissueid.app.plan import MULTISTEP, Plan
from tissueid.app.safety import SafetyWatch
from tissueid.app.words import in_words, sentence
from tissueid.audit import Trail
from tissueid.calibration.in_force import calibrated
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, LinkLostError
from tissueid.instrument import PROFILES, Instrument, Limits, SimulatedInstrument
from tissueid.instrument.answers import describe_faults
from tissueid.language import _
from tissueid.sessions import Session, Subject, Test
from tissueid.stimuli import Stimulus
from tissueid.wire import Fault


@dataclass(frozen=True)
class Outcome:
    """How a test ended: what was saved, if anything, and what went wrong, in words.

    ``stopped`` is true where a person stopped it, ``by_button`` where that was with the button of the instrument.
    ``unanswered`` is true where the window stood still for too long.
    ``instrument_failed`` is true where what went wrong was the instrument or its cable, not this computer's disk.
    ``link_lost`` is the error where the line to the instrument was lost: nothing then confirms that the coil is free.
    ``trouble``, which is in ``problem`` too, is why the recording could not be saved; ``unlogged`` why the audit log
    lacks something.
    """

    path: Path
    session: Session | None
    problem: str = ""
    stopped: bool = False
    by_button: bool = False
    unanswered: bool = False
    instrument_failed: bool = False
    trouble: str = ""
    unlogged: str = ""
    link_lost: LinkLostError | None = None


def measure(
    plan: Plan,
    live: LiveSignals,
    stop: EmergencyStop,
    opener: Callable[[str], Instrument],
    wait: Wait | None = None,
    apart: bool = True,
    trail: Trail | None = None,
    calibrate: Callable[[Instrument], object] = calibrated,
    earlier: Sequence[Test] = (),
) -> Outcome:
    """Run the planned test. However it ends, the coil is released and what was recorded is kept.

    ``stop`` ends it within a poll. ``wait`` paces the simulation in this process: by the clock, cut short by
    ``stop``, unless another is given. ``apart`` lets a process of its own look at the test while it runs; without it
    the looks are made between the polls. What is done goes into the audit log by ``trail``. ``calibrate`` puts the
    instrument's calibration in force. ``earlier`` are the tests of the same sitting, against which the quality gate
    judges this one.

    Raises:
        TissueIDError, OSError: the test could not begin; there is no file.
    """
    recorder: SessionRecorder | None = None
    problem: Exception | None = None
    try:
        instrument = opener(plan.url)
        try:
            simulated = isinstance(instrument, SimulatedInstrument)
            calibrate(instrument)
            device, limits = instrument.device, instrument.narrowed(PROFILES[plan.limits])
            live.greatest_force_n = greatest_force_n(instrument)
            live.begin(SafetyWatch(device, limits, winding=not simulated))
            plan = plan.within(live.greatest_force_n)
            run = meanwhile(instrument, functools.partial(_prepared, plan, device, limits), stop.check)
            live.total_s = run.total_s
            stop.check()
            recorder = SessionRecorder(plan.path, device, Subject(plan.pseudonym), trail=trail)
            meanwhile(instrument, functools.partial(_remember, recorder, earlier), stop.check)
            if simulated:
                instrument = PacedInstrument(instrument, wait or stop.wait)

            if isinstance(run.test, GuidedTest):
                live.identification = LiveIdentification(
                    device,
                    preload_s=run.test.opening.preload_s,
                    stop=plan.stop_rule(),
                    apart=apart,
                    external_spring_n_per_m=plan.external_spring_n_per_m,
                )
            identification = live.identification

            def show(progress: Progress) -> None:
                live.add(progress, device)
                if identification is not None and progress.phase is not Phase.PLACE:
                    identification.feed(progress.samples)
                    identification.step()

            placement = (
                place_in_air(instrument, stop.check)
                if plan.under_probe == "free_air"
                else place(instrument, limits, progress=show, cancelled=stop.check)
            )
            live.placed(placement.surface_m)
            if isinstance(run.test, GuidedTest):
                assert identification is not None
                run_guided_test(
                    instrument,
                    run.test,
                    recorder,
                    surface_m=placement,
                    progress=show,
                    cancelled=stop.check,
                    enough=identification.enough,
                    why=lambda: identification.reason,
                )
            else:
                run_multistep(
                    instrument,
                    run.test,
                    recorder,
                    surface_m=placement,
                    progress=lambda _step, progress: show(progress),
                    cancelled=stop.check,
                )
        finally:
            try:
                instrument.close()
            finally:
                if live.identification is not None:
                    live.identification.close()
    except CancelledError as error:
        problem = error
    except Exception as error:
        if recorder is None:
            raise
        problem = error
    session, trouble = _keep(recorder, problem)
    said = _said(problem, session, trouble)
    by_button = isinstance(problem, FirmwareFaultError) and describe_faults(Fault.BUTTON) in str(problem)
    cancelled = isinstance(problem, CancelledError)
    lacking = "" if trail is None else trail.settle()
    return Outcome(
        plan.path,
        session,
        " ".join(filter(None, [said, trouble])),
        stopped=by_button or (cancelled and stop.reason != NO_ANSWER),
        by_button=by_button,
        unanswered=cancelled and stop.reason == NO_ANSWER,
        instrument_failed=not isinstance(problem, NoneType | CancelledError | JournalError) and not by_button,
        trouble=trouble,
        link_lost=problem if isinstance(problem, LinkLostError) else None,
        unlogged=sentence(_("not in the audit log: {problem}").format(problem=lacking)) if lacking else "",
    )


@dataclass(frozen=True)
class _Prepared:
    """A test that could be played, or several in steps, and how long it lasts, s."""

    test: GuidedTest | MultistepTest
    total_s: float


def _prepared(plan: Plan, device: DeviceDescription, limits: Limits) -> _Prepared:
    """Build and check what a plan asks for.

    Raises:
        LimitError, UnusableInputError: it could not be played.
    """
    if plan.stimulus_kind == MULTISTEP:
        steps = plan.multistep(device.sample_rate_hz, limits)
        check_multistep(steps, device)
        return _Prepared(steps, plan.total_s)
    stimulus = plan.prepared(device.sample_rate_hz)
    test = GuidedTest(
        stimulus, plan.site, plan.under_probe or test_kind(stimulus), plan.set_up(), limits, notes=plan.notes
    )
    check_test(test, device)
    seconds = stimulus.seconds if isinstance(stimulus, Stimulus) else plan.total_s
    return _Prepared(test, seconds)


def _remember(recorder: SessionRecorder, earlier: Sequence[Test]) -> None:
    """Let the quality gate see the repeats before, which stand in files of their own."""
    for test in earlier:
        recorder.gate.judge(test)


def _said(problem: Exception | None, session: Session | None, trouble: str) -> str:
    """How it broke off, in words. Of a disk that failed, what is left on it is said once."""
    if problem is None:
        return ""
    if not isinstance(problem, JournalError) or session is not None:
        return in_words(problem)
    return "" if trouble else f"{_cause(problem)} {_('Nothing was recorded.')}"


def _cause(error: Exception) -> str:
    """Why it failed; what a failing journal says of recovery is for the command line."""
    cause = error.__cause__ if isinstance(error, JournalError) else None
    return in_words(cause if isinstance(cause, Exception) else error)


def _keep(recorder: SessionRecorder | None, problem: Exception | None) -> tuple[Session | None, str]:
    """Turn what was recorded into a session; where that fails its journal stays, and the words say so."""
    if recorder is None:
        return None, ""
    try:
        return recorder.finish_or_discard(problem), ""
    except Exception as error:  # noqa: BLE001 - whatever it was, the journal must be let go of and mentioned
        recorder.abandon()
        kept = _("The recording stays in {path}; it is offered for recovery at the next start.").format(
            path=journal_path(recorder.path)
        )
        return None, f"{_cause(error)} {kept}"
