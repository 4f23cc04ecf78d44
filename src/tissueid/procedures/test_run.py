"""A test from opening the instrument to the saved session, in the thread that owns the instrument."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import predict_heating, rest, run_while_polling, temperature_c
from tissueid.acquisition.guided import GuidedTest, Progress, check_test, place, run_guided_test
from tissueid.acquisition.journal import JournalError
from tissueid.acquisition.live import LiveIdentification
from tissueid.acquisition.multistep import PLACING, MultistepTest, Step, check_multistep, run_multistep
from tissueid.acquisition.playback import Phase
from tissueid.acquisition.recorder import SessionRecorder, log_no_recording
from tissueid.acquisition.stimulus_choice import playable, playable_file, test_kind
from tissueid.acquisition.surface_detection import Placement, place_in_air
from tissueid.audit import AuditTrail
from tissueid.calibration.active import ActiveCalibration, activate_calibration
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, LinkLostError, SessionExistsError, TissueIDError
from tissueid.instrument import PROFILES, Instrument, Limits, SimulatedInstrument, open_instrument
from tissueid.language import marked
from tissueid.messages import Action, Message
from tissueid.procedures.audit_queries import settle
from tissueid.procedures.control import Control
from tissueid.procedures.output_files import check_session_path
from tissueid.procedures.test_plan import TestPlan, design_stimulus
from tissueid.sessions import Session, Subject, Test
from tissueid.stimuli import FeedbackKind, Stimulus
from tissueid.stimuli.kinds.noise import Noise
from tissueid.test_settings import USUAL_FORCE_N, USUAL_SEED
from tissueid.wire import Fault

if TYPE_CHECKING:
    from tissueid.instrument.simulated import Wait


_MOST_NAMES = 20
"""Names that are tried for a session, one after another, while other programs take them."""
TestStep = Step
"""One test of a test in steps, and how it was designed."""


class TestControl(Control):
    """What a test reports beyond its progress. All is called from the thread of the procedure."""

    __test__ = False  # not a test case for pytest

    def ready(self, instrument: Instrument, limits: Limits) -> None:
        """Take note that the instrument answers, its calibration is active, and these limits hold."""

    def planned(self, total_s: float) -> None:
        """Take the duration of the stimulus with its preload, s."""

    def identifying(self, identification: LiveIdentification) -> None:
        """Take the identification of the next test, which is fed by the procedure."""

    def identified(self, identification: LiveIdentification) -> None:
        """Take note that a test was played to its end and its identification is closed."""

    def placed(self, surface_m: float) -> None:
        """Take the position of the surface, m."""

    def received(self, progress: Progress) -> None:
        """Take new samples of the placement or of a test."""

    def aborted(self, error: BaseException) -> None:
        """Take note that the test ended early; closing the instrument and saving may take seconds from here on."""


@dataclass(frozen=True)
class TestOutcome:
    """How a test ended.

    ``session`` is None where nothing was recorded or saved. ``steps`` are those of a test in steps. ``error`` is why
    the test ended early, ``not_saved`` why the recording could not be saved: its journal stays then.
    """

    __test__ = False

    path: Path
    session: Session | None
    steps: tuple[Step, ...] = ()
    error: BaseException | None = None
    not_saved: Exception | None = None

    def saved(self) -> Session:
        """Return the saved session.

        Raises:
            BaseException: why the test ended early, or the recording could not be saved.
        """
        if (reason := self.error or self.not_saved) is not None:
            raise reason
        assert self.session is not None  # it is None only with a reason
        return self.session

    @property
    def cancelled(self) -> bool:
        """Whether the control cancelled it."""
        return isinstance(self.error, CancelledError)

    @property
    def by_button(self) -> bool:
        """Whether the button of the instrument stopped it."""
        return isinstance(self.error, FirmwareFaultError) and bool(self.error.faults & Fault.BUTTON)

    @property
    def instrument_failed(self) -> bool:
        """Whether the instrument or its cable failed, not this computer's disk."""
        harmless = self.cancelled or self.by_button or isinstance(self.error, JournalError)
        return self.error is not None and not harmless

    @property
    def link_lost(self) -> LinkLostError | None:
        """The error where the line to the instrument was lost: nothing then confirms that the coil is free."""
        return self.error if isinstance(self.error, LinkLostError) else None


def run_test(
    plan: TestPlan,
    control: TestControl,
    trail: AuditTrail | None,
    *,
    opener: Callable[[str], Instrument] | None = None,
    calibrate: Callable[[Instrument], object] | None = None,
    pace: Wait | None = None,
    separate_process: bool = True,
    earlier: Sequence[Test] = (),
    another_name: Callable[[], Path] | None = None,
) -> TestOutcome:
    """Place the probe once, and run the planned tests. In every case the coil is released and the samples are saved.

    Args:
        plan: the tests.
        control: progress and cancellation; ``control.check`` is called after every poll.
        trail: audit log of the session.
        opener: opens an instrument by its address; by default ``open_instrument``.
        calibrate: activates the calibration of the instrument; by default the one that the plan says.
        pace: slows a simulation in this process down to real time; without it, it waits for nothing.
        separate_process: whether another process identifies the running test; otherwise this is done between polls.
        earlier: previous tests of the same sitting, against which the quality gate judges.
        another_name: returns an unused path for the session, where another program has taken that of the plan; without
            it, the test does not start then.

    Raises:
        TissueIDError, OSError: the test could not start; there is no file.
    """
    plan.check()
    check_session_path(plan.out, taken=another_name is not None)
    run = _Run(plan, control)
    error: BaseException | None = None
    steps: tuple[Step, ...] = ()
    try:
        instrument = (opener or open_instrument)(plan.url)
        try:
            run.prepare(instrument, trail, calibrate)
            run.open_recorder(trail, earlier, another_name)
            if isinstance(instrument, SimulatedInstrument):
                separate_process = separate_process and pace is not None
                if pace is not None:
                    instrument.play_in_real_time(pace)
            steps = run.play(separate_process=separate_process)
        except BaseException as reason:
            control.aborted(reason)
            raise
        finally:
            try:
                instrument.close()
            finally:
                run.end_identification()
    except BaseException as reason:
        if run.recorder is None:
            if trail is not None:
                log_no_recording(trail, run.path, Subject(plan.subject), plan.site, reason)
                settle(trail, control)
            if not isinstance(reason, CancelledError):
                raise
        error = reason
    session, not_saved = _kept(run.recorder, error)
    if trail is not None:
        settle(trail, control)
    return TestOutcome(run.path, session, steps, _without_frames(error), not_saved)


def _without_frames(error: BaseException | None) -> BaseException | None:
    """Return an error without the frames that it came through, which hold the instrument, samples and recording.

    An error that is kept would keep these alive. A defect keeps its frames, for its report.
    """
    step = error if isinstance(error, TissueIDError) else None
    while step is not None:
        step.__traceback__ = None
        step = step.__cause__ or step.__context__  # type: ignore[assignment]
    return error


def _kept(recorder: SessionRecorder | None, error: BaseException | None) -> tuple[Session | None, Exception | None]:
    """Save the recording as a session; where that fails, keep its journal and return the reason."""
    if recorder is None:
        return None, None
    try:
        return recorder.finish_or_discard(error), None
    except Exception as reason:  # noqa: BLE001 - whatever it was, the journal must be let go of and mentioned
        recorder.abandon()
        return None, reason


class _Run:
    """The tests of one plan on one instrument."""

    def __init__(self, plan: TestPlan, control: TestControl) -> None:
        self.recorder: SessionRecorder | None = None
        self.path = plan.out
        """Path of the session."""
        self._plan = plan
        self._control = control
        self._identification: LiveIdentification | None = None
        self._step: str = PLACING

    def prepare(
        self, instrument: Instrument, trail: AuditTrail | None, calibrate: Callable[[Instrument], object] | None
    ) -> None:
        """Activate the calibration, and build and check the tests.

        Raises:
            LimitError, UnusableInputError: they could not be played.
        """
        plan, control = self._plan, self._control
        in_force = (
            activate_calibration(instrument, plan.calibrations, wanted=plan.calibration)
            if calibrate is None
            else calibrate(instrument)
        )
        if trail is not None and isinstance(in_force, ActiveCalibration):
            trail.note("calibration.in_force", subject=instrument.device.serial_number, new=in_force.summary)
        self._instrument = instrument
        self._limits = limits = instrument.effective_limits(PROFILES[plan.limits])
        control.ready(instrument, limits)
        self._plan = plan = self._lowered(plan)
        device = instrument.device
        self._test: GuidedTest | MultistepTest
        if plan.multistep is not None:
            self._test = run_while_polling(instrument, lambda: _multistep_test(plan, device, limits), control.check)
            control.planned(plan.total_s)
        else:
            self._test, command = run_while_polling(
                instrument, lambda: _guided_test(plan, device, limits, control), control.check
            )
            stimulus = self._test.stimulus
            control.planned(stimulus.seconds if isinstance(stimulus, Stimulus) else plan.total_s)
            self._warn_of_heat(self._test, command)
        control.check()

    def _lowered(self, plan: TestPlan) -> TestPlan:
        """Return the plan within the force of the instrument; a usual force that is lowered is a notice."""
        most = min(self._instrument.device.greatest_force_n, math.floor(10.0 * self._limits.max_force_n) / 10.0)
        lowered = plan.within(most)
        if lowered is not plan:
            usual = USUAL_FORCE_N[1] if plan.max_force_n is None else plan.max_force_n
            self._control.notice(
                Message(
                    "test.force_lowered",
                    "the highest force is {force:g} N instead of {usual:g} N, the limit of this instrument "
                    "({option} sets a lower one)",
                    force=most,
                    usual=usual,
                    option=Action("test.highest_force", "--max-force", marked("Highest force")),
                )
            )
        return lowered

    def _warn_of_heat(self, test: GuidedTest, command: NDArray[np.float64]) -> None:
        """Give a notice if the tests will heat the coil too much, as far as that is known.

        A simulation in this process has no coil, and the force of a feedback stimulus is not known in advance.
        """
        instrument, plan = self._instrument, self._plan
        if isinstance(instrument, SimulatedInstrument) or not isinstance(test.stimulus, Stimulus):
            return
        begin_c = temperature_c(instrument, self._control.check)
        if math.isnan(begin_c):
            return
        forecast = predict_heating(
            command,
            instrument.nominal,
            repeats=plan.repeats,
            rest_s=plan.rest_s,
            begin_c=begin_c,
            limit_c=test.limits.max_temperature_c,
        )
        if forecast.warning:
            self._control.notice(Message("test.warning", "warning: {warning}", warning=forecast.warning))

    def open_recorder(
        self, trail: AuditTrail | None, earlier: Sequence[Test], another_name: Callable[[], Path] | None
    ) -> None:
        """Begin the session, and judge the earlier tests of the sitting, which are in other files."""
        instrument, subject = self._instrument, Subject(self._plan.subject)

        def opened() -> SessionRecorder:
            for _attempt in range(_MOST_NAMES):
                try:
                    return SessionRecorder(self.path, instrument.device, subject, trail=trail)
                except (SessionExistsError, JournalError) as error:
                    if another_name is None or error.code not in ("session.exists", "journal.exists"):
                        raise
                    self.path = another_name()
            return SessionRecorder(self.path, instrument.device, subject, trail=trail)

        self.recorder = recorder = run_while_polling(instrument, opened)  # not cancelled: its journal would be left

        def judge() -> None:
            for test in earlier:
                recorder.gate.judge(test)

        run_while_polling(instrument, judge, self._control.check)

    def play(self, *, separate_process: bool) -> tuple[Step, ...]:
        """Place the probe and run the tests; return the steps of a test in steps."""
        if isinstance(self._test, MultistepTest):
            return self._play_steps(self._test)
        self._play_repeats(self._test, separate_process=separate_process)
        return ()

    def _play_steps(self, test: MultistepTest) -> tuple[Step, ...]:
        assert self.recorder is not None

        def received(step: str, progress: Progress) -> None:
            self._step = step
            self._received(progress)

        return run_multistep(
            self._instrument,
            test,
            self.recorder,
            surface_m=self._placed(),
            progress=received,
            cancelled=self._control.check,
        )

    def _play_repeats(self, test: GuidedTest, *, separate_process: bool) -> None:
        assert self.recorder is not None
        plan, control, instrument = self._plan, self._control, self._instrument
        rule = plan.stop_rule()
        placement: Placement | None = None
        for repeat in range(plan.repeats):
            values = {"number": repeat + 1, "count": plan.repeats}
            if repeat and plan.rest_s:
                resting = Message("test.resting", "rest before test {number} of {count}", **values)
                rest(
                    instrument,
                    plan.rest_s,
                    progress=lambda share, step=resting: control.progress(share, step),  # type: ignore[misc]
                    cancelled=control.check,
                )
            if plan.live or rule is not None:
                self._identification = LiveIdentification(
                    instrument.device,
                    preload_s=test.opening.preload_s,
                    method=plan.shown_method,
                    stop=rule,
                    separate_process=separate_process,
                    external_spring_n_per_m=plan.external_spring_n_per_m,
                )
                control.identifying(self._identification)
            if placement is None or plan.place_again:
                placement = self._placed()
            self._step = Message("test.step", "test {number} of {count}", **values)
            # A feedback stimulus depends on the measured depth: a second run is not a repeat.
            same = repeat > 0 and isinstance(test.stimulus, Stimulus)
            identification = self._identification
            run_guided_test(
                instrument,
                replace(test, repeat_of=1 if same else None),
                self.recorder,
                surface_m=placement,
                progress=self._received,
                cancelled=control.check,
                enough=lambda running=identification: running is not None and running.enough(),  # type: ignore[misc]
                why=lambda running=identification: "" if running is None else running.reason,  # type: ignore[misc]
            )
            if identification is not None:
                run_while_polling(instrument, self.end_identification)  # the last estimate may take a while
                control.identified(identification)

    def _placed(self) -> Placement:
        """Place the probe."""
        if self._plan.kind == "free_air":
            placement = place_in_air(self._instrument, self._control.check)
        else:
            placement = place(self._instrument, self._limits, progress=self._received, cancelled=self._control.check)
        self._control.placed(placement.surface_m)
        return placement

    def _received(self, progress: Progress) -> None:
        if self._identification is not None and progress.phase in (Phase.PRELOAD, Phase.STIMULUS):
            self._identification.feed(progress.samples)
            self._identification.step()
        self._control.received(progress)
        self._control.progress(progress.fraction, self._step)

    def end_identification(self) -> None:
        """Make the last estimate, and end the process of the estimates, if there is one."""
        identification, self._identification = self._identification, None
        if identification is not None:
            identification.close()


def _guided_test(
    plan: TestPlan, device: DeviceDescription, limits: Limits, control: Control
) -> tuple[GuidedTest, NDArray[np.float64]]:
    """Return the test of a plan and its command, V, shape (n,), after checking that it can be played.

    Raises:
        LimitError, UnusableInputError: it cannot.
    """
    stimulus = _stimulus(plan, device.sample_rate_hz, control)
    kind = plan.kind or test_kind(stimulus)
    test = GuidedTest(stimulus, plan, kind, limits)
    return test, check_test(test, device)


def _stimulus(plan: TestPlan, sample_rate_hz: float, control: Control) -> Stimulus | FeedbackKind:
    """Return the stimulus with its preload, or a feedback stimulus."""
    if plan.stimulus_file is not None:
        return playable_file(plan.stimulus_file, sample_rate_hz, plan)
    specification = plan.specification(sample_rate_hz)
    if isinstance(specification, Noise):  # needs no progress
        return playable(specification)
    return playable(specification, lambda kind: design_stimulus(kind, control)[0])


def _multistep_test(plan: TestPlan, device: DeviceDescription, limits: Limits) -> MultistepTest:
    """Return the tests of a plan in steps after checking that they can be played."""
    assert plan.multistep is not None
    test = MultistepTest(
        plan.depth_design(device.sample_rate_hz),
        plan,
        steps=plan.multistep,
        seed=USUAL_SEED if plan.seed is None else plan.seed,
        limits=limits,
        **({} if plan.target is None else {"target": plan.target}),
    )
    check_multistep(test, device)
    return test
