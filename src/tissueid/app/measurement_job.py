"""One guided test from opening the instrument to the saved session, in the thread that owns the instrument."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING

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
from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.guided import check_test, place
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.stimulus_choice import test_kind
from tissueid.acquisition.surface_detection import place_in_air
from tissueid.app.emergency import NO_ANSWER, EmergencyStop
from tissueid.app.instruments import greatest_force_n
from tissueid.app.live_signals import LiveSignals
from tissueid.app.plan import MULTISTEP, Plan
from tissueid.app.safety import SafetyWatch
from tissueid.app.words import in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.calibration.active import calibrated
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, LinkLostError
from tissueid.instrument import PROFILES, Instrument, Limits, SimulatedInstrument
from tissueid.messages import Message, Verbatim, translated
from tissueid.sessions import Session, Subject, Test
from tissueid.stimuli import Stimulus
from tissueid.wire import Fault

if TYPE_CHECKING:
    from tissueid.instrument.simulated import Wait


@dataclass(frozen=True)
class Outcome:
    """How a test ended: the saved session, if any, and error messages.

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
    separate_process: bool = True,
    trail: AuditTrail | None = None,
    calibrate: Callable[[Instrument], object] = calibrated,
    earlier: Sequence[Test] = (),
) -> Outcome:
    """Run the planned test. In every case the coil is released and the recorded part is saved.

    ``stop`` ends it within a poll. ``wait`` slows a simulation in this process down to real time; the default
    is interrupted by ``stop``. With ``separate_process`` another process identifies the
    running test; otherwise this is done between the polls. The test is logged by ``trail``. ``calibrate`` puts the
    instrument's calibration in force. ``earlier`` are the tests of the same sitting, against which the quality gate
    judges this one.

    Raises:
        TissueIDError, OSError: the test could not start; there is no file.
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
            run = run_while_polling(instrument, functools.partial(_prepared, plan, device, limits), stop.check)
            live.total_s = run.total_s
            stop.check()
            recorder = SessionRecorder(plan.path, device, Subject(plan.pseudonym), trail=trail)
            run_while_polling(instrument, functools.partial(_remember, recorder, earlier), stop.check)
            if isinstance(instrument, SimulatedInstrument):
                instrument.play_in_real_time(wait or stop.wait)

            if isinstance(run.test, GuidedTest):
                live.identification = LiveIdentification(
                    device,
                    preload_s=run.test.opening.preload_s,
                    stop=plan.stop_rule(),
                    separate_process=separate_process,
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
    by_button = isinstance(problem, FirmwareFaultError) and bool(problem.faults & Fault.BUTTON)
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
        unlogged=sentence(translated(Message("audit.not_logged", "not in the audit log: {problem}", problem=lacking)))
        if lacking
        else "",
    )


@dataclass(frozen=True)
class _Prepared:
    """A checked test, or a series of tests, and its duration, s."""

    test: GuidedTest | MultistepTest
    total_s: float


def _prepared(plan: Plan, device: DeviceDescription, limits: Limits) -> _Prepared:
    """Build and check the test of a plan.

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
    """Give the quality gate the previous tests of the sitting, which are in other files."""
    for test in earlier:
        recorder.gate.judge(test)


def _said(problem: Exception | None, session: Session | None, trouble: str) -> str:
    """Return the error of a test as a sentence; empty where ``trouble`` already reports the failed disk."""
    if problem is None:
        return ""
    if not isinstance(problem, JournalError) or session is not None:
        return in_words(problem)
    return "" if trouble else f"{_cause(problem)} {translated(Message('outcome.nothing', 'Nothing was recorded.'))}"


def _cause(error: Exception) -> str:
    """Return the cause of a failure; the recovery advice of a journal is meant for the command line."""
    cause = error.__cause__ if isinstance(error, JournalError) else None
    return in_words(cause if isinstance(cause, Exception) else error)


def _keep(recorder: SessionRecorder | None, problem: Exception | None) -> tuple[Session | None, str]:
    """Save the recording as a session; where that fails, keep its journal and return the reason."""
    if recorder is None:
        return None, ""
    try:
        return recorder.finish_or_discard(problem), ""
    except Exception as error:  # noqa: BLE001 - whatever it was, the journal must be let go of and mentioned
        recorder.abandon()
        kept = Message(
            "outcome.recording_stays",
            "The recording stays in {path}; it is offered for recovery at the next start.",
            path=Verbatim(journal_path(recorder.path)),
        )
        return None, f"{_cause(error)} {translated(kept)}"
