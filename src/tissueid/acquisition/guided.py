"""The guided test: place, preload at the mean load, stochastic stimulus, release (thesis 2.4.2, 7.1.1)."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.choice import PRELOAD_S
from tissueid.acquisition.feedback import SetPoints, preload, rehearse, set_point_count
from tissueid.acquisition.recorder import SessionRecorder
from tissueid.acquisition.waiting import meanwhile
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, LimitError, LinkLostError, TissueIDError, UnusableInputError
from tissueid.instrument import CLINICAL, SAMPLE, Instrument, Limits, Run, check_stimulus
from tissueid.stimuli.base import Array, Stimulus, Unit, to_voltage
from tissueid.stimuli.feedback import FeedbackKind

POLL_S = 0.05
CONTACT_FORCES_N = (0.10, 0.05)
"""Net forces while the surface is sought: the weight of the coil is carried by the coil itself, but for these."""
PLACE_S = 1.2
_RELEASE_S = 0.08
"""The ramp of 50 ms at the end of a run, and the frames that tell of it."""
_RELEASE_POLLS = 40
_SETTLED_S = 0.2
_STILL_M = 50e-6
_STROKE_MARGIN_M = 1.0e-3
GRAVITY_M_S2 = 9.80665


class Phase(Enum):
    """Where a guided test stands."""

    PLACE = "place"
    PRELOAD = "preload"
    STIMULUS = "stimulus"
    RELEASE = "release"


@dataclass(frozen=True)
class Progress:
    """What a running test tells: its phase, how much of the run is played (0 to 1), and the newest samples."""

    phase: Phase
    fraction: float
    samples: NDArray[np.void]


@dataclass(frozen=True)
class GuidedTest:
    """One test to be run: the stimulus, where, and how far it may go.

    An open-loop stimulus brings its preload with it; one that is generated while the test runs is given one of
    ``preload_s``. ``notes`` go into the session with the test.
    """

    stimulus: Stimulus | FeedbackKind
    site: str
    kind: str = "stochastic"
    configuration: str = "indentation"
    limits: Limits = CLINICAL
    repeat_of: int | None = None
    preload_s: float = PRELOAD_S
    notes: dict[str, str | float] = field(default_factory=dict)

    @property
    def opening(self) -> Stimulus:
        """What is known and loaded before the test: all of it, or the preload of a feedback stimulus.

        Raises:
            UnusableInputError: the preload is shorter than its rise.
        """
        if isinstance(self.stimulus, FeedbackKind):
            return preload(self.stimulus, self.preload_s)
        return self.stimulus


def _ignore(_: Progress) -> None:
    """Nobody wants to know."""


def _never() -> bool:
    return False


def _enough_was_known() -> str:
    return "enough was known"


def play(
    instrument: Instrument,
    command_v: NDArray[np.float64],
    limits: Limits,
    *,
    started: Callable[[Run], None] | None = None,
    on_samples: Callable[[NDArray[np.void], float], None],
    cancelled: Callable[[], bool] = _never,
    set_points: SetPoints | None = None,
    enough: Callable[[], bool] = _never,
) -> Run:
    """Play one stimulus, shape (n,), V, and hand over its samples as they come, with the fraction played.

    ``set_points`` follow the stimulus, made from what it measures. ``enough`` is asked after every poll; when it says
    so, the run ends there by a soft release. Returns the run as it was played. Whatever goes wrong, the coil is
    released before the error leaves this function.

    Raises:
        CancelledError: ``cancelled`` said so.
        LimitError, InstrumentError: as the instrument says.
        UnusableInputError: set-points that are none.
    """
    instrument.load(command_v)
    # Set-points have a date to keep: what is there before the run is left out of the garbage collections during it,
    # one of which takes 100 ms and more otherwise.
    gc.freeze()
    try:
        if set_points is not None:
            instrument.follow(set_points.samples, set_points.hold_v)
        instrument.arm(limits)
        planned = run = instrument.start()
        if started is not None:
            started(run)
        last = run.first_index
        while last < run.end_index:
            samples = instrument.poll(POLL_S)
            if samples.size:
                last = int(samples["index"][-1]) + 1
                inside = samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]
                if set_points is not None:
                    set_points.take(inside)
                    if run is planned:
                        set_points.send_due(instrument)
                on_samples(inside, min(1.0, (last - run.first_index) / run.samples))
            if cancelled():
                raise CancelledError("cancelled; the coil is released and what was recorded is kept")
            if run is planned and last < run.end_index and enough():
                run = Run(run.first_index, min(run.samples, instrument.finish()))
        if set_points is not None or run is not planned:
            _see_off(instrument, run)
    except BaseException:
        instrument.release()
        raise
    finally:
        gc.unfreeze()
    return run


def _see_off(instrument: Instrument, run: Run) -> None:
    """Read on until the release of a run is over: only then has the instrument said all that there is to say of it.

    Raises:
        FirmwareFaultError: it did not end as it was told to; what it says came after the last sample.
    """
    over = run.end_index + round(_RELEASE_S * instrument.device.sample_rate_hz)
    try:
        for _ in range(_RELEASE_POLLS):
            samples = instrument.poll(POLL_S)
            if samples.size and samples["index"][-1] >= over:
                break
    except LinkLostError:
        pass  # all of the run was received; whoever uses the instrument next is told


def _cause(error: BaseException) -> str:
    """Why a test broke off, in words."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, TissueIDError):
        return str(error)
    return f"a defect of the software: {type(error).__name__}: {error}"


def find_surface(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    progress: Callable[[Progress], None] = _ignore,
    cancelled: Callable[[], bool] = _never,
) -> float:
    """The position, m, where the tissue begins: from two light contacts with the coil's weight carried by itself.

    Raises:
        UnusableInputError: the probe does not rest on anything within its stroke, or does not keep still.
    """
    device = instrument.device
    weight = device.moving_mass_kg * GRAVITY_M_S2
    levels = np.array([device.voltage_for_force(force - weight) for force in CONTACT_FORCES_N])
    samples_per_level = round(PLACE_S / levels.size * device.sample_rate_hz)
    blocks: list[NDArray[np.void]] = []

    def take(samples: NDArray[np.void], fraction: float) -> None:
        blocks.append(samples)
        progress(Progress(Phase.PLACE, fraction, samples))

    command = np.repeat(levels, samples_per_level)
    play(instrument, command, limits, on_samples=take, cancelled=cancelled)
    position = np.concatenate([*blocks, np.zeros(0, SAMPLE)])["position"]
    if position.size < command.size:
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    late = position.reshape(levels.size, -1)[:, -round(_SETTLED_S * device.sample_rate_hz) :]  # (levels, settled)
    if np.isnan(late).any():
        raise UnusableInputError("samples were lost while the probe was placed; check the link and try again")
    # A straight line through the two depths, taken back to no force at all.
    slope = (late[0].mean() - late[1].mean()) / (CONTACT_FORCES_N[0] - CONTACT_FORCES_N[1])
    surface = float(late[1].mean() - CONTACT_FORCES_N[1] * slope)
    if not _STROKE_MARGIN_M < surface < device.stroke_m - _STROKE_MARGIN_M:
        raise UnusableInputError(
            f"the probe is at the end of its stroke ({surface * 1e3:.1f} mm): place it on the tissue and try again"
        )
    # Creep of the tissue is a slope; what shakes about it is a hand.
    time = np.arange(late.shape[1])
    creep = np.polynomial.polynomial.polyfit(time, late.T, 1)  # (2, levels)
    shaking = (late - creep[0][:, None] - creep[1][:, None] * time).std(axis=1)
    if float(shaking.max()) > _STILL_M:
        raise UnusableInputError("the probe does not keep still: hold the reference surface firmly and try again")
    return surface


def check_test(test: GuidedTest, device: DeviceDescription) -> NDArray[np.float64]:
    """The command of a test, shape (n,), V; refused before anybody is touched when it could not be played.

    Of a feedback stimulus the command is the preload, and what is judged is the whole range that it may ask for; then
    it is rehearsed.

    Raises:
        LimitError: too strong, too long, or beyond the amplifier.
        UnusableInputError: another sample rate than the device's, or a source that leaves its range.
    """
    opening, kind = test.opening, test.stimulus
    if opening.sample_rate_hz != device.sample_rate_hz:
        raise UnusableInputError(
            f"the stimulus has {opening.sample_rate_hz:g} samples a second, the instrument {device.sample_rate_hz:g}"
        )
    command = _command(opening.values, opening.unit, device, test.limits)
    if isinstance(kind, FeedbackKind):
        ends = np.array([kind.force_min_n, kind.force_max_n])
        _command(np.resize(ends, command.size + set_point_count(kind)), "N", device, test.limits)
        rehearse(kind)
    return command


def _command(values: Array, unit: Unit, device: DeviceDescription, limits: Limits) -> NDArray[np.float64]:
    """The command, V, shape (n,), for values (n,), within the limits. Who asked for newtons is answered in newtons.

    Raises:
        LimitError: says which limit.
    """
    peak = float(np.max(np.abs(values), initial=0.0))
    if unit == "N" and peak > limits.max_force_n:
        raise LimitError(f"the stimulus reaches {peak:.1f} N; the limit is {limits.max_force_n:g} N")
    command = to_voltage(values, device, unit)
    check_stimulus(command, device, limits)
    return command


class _Recording:
    """One test on its way into the recorder."""

    def __init__(
        self,
        instrument: Instrument,
        test: GuidedTest,
        recorder: SessionRecorder,
        surface_m: float,
        progress: Callable[[Progress], None],
    ) -> None:
        self.opening = test.opening
        self.preload_samples = round(self.opening.preload_s * self.opening.sample_rate_hz)
        self.set_points: SetPoints | None = None
        self.planned: Run | None = None
        self.taken = 0
        self._instrument = instrument
        self._test = test
        self._recorder = recorder
        self._surface_m = surface_m
        self._progress = progress
        self._gaps_before = len(instrument.gaps)

    def begin(self, run: Run) -> None:
        """The coil is energised."""
        self.planned = run
        limits: dict[str, str | float] = {f"limit_{name}": value for name, value in asdict(self._test.limits).items()}
        self._recorder.begin_test(
            run,
            kind=self._test.kind,
            configuration=self._test.configuration,
            site=self._test.site,
            sample_rate_hz=self._instrument.device.sample_rate_hz,
            preload_s=self.opening.preload_s,
            surface_position_m=self._surface_m,
            stimulus=self.opening.description,
            seed=self.opening.seed,
            repeat_of=self._test.repeat_of,
            notes=limits | self._test.notes,
        )

    def take(self, samples: NDArray[np.void], fraction: float) -> None:
        """Samples of the run, and the fraction of it that is played."""
        self._recorder.add(samples)
        self.taken += samples.size
        phase = Phase.PRELOAD if self.taken < self.preload_samples else Phase.STIMULUS
        self._progress(Progress(phase, fraction, samples))

    def end(self, run: Run, why: Callable[[], str]) -> None:
        """It was played, to its end or to where it was enough."""
        assert self.planned is not None
        early: dict[str, str | float] = {}
        if run.samples < self.planned.samples:
            seconds = (run.samples - self.preload_samples) / self._instrument.device.sample_rate_hz
            early = {"ended_early_s": seconds, "reason": f"ended after {seconds:.2f} s: {why()}"}
        self._close("completed", run, early)
        self._progress(Progress(Phase.RELEASE, 1.0, np.zeros(0, SAMPLE)))

    def abort(self, reason: str) -> None:
        """It broke off; where it had not begun there is nothing to close."""
        if self.planned is not None:
            self._close("aborted", self.planned, {"reason": reason})

    def _close(self, status: str, run: Run, notes: dict[str, str | float]) -> None:
        for gap in self._instrument.gaps[self._gaps_before :]:
            self._recorder.event("gap", first_index=gap.first_index, count=gap.count)
        if self.set_points is not None:
            notes["late_blocks"] = float(self._instrument.late_blocks)
            notes["held_samples"] = float(self._instrument.held_samples)
            if (margin := self._instrument.setpoint_margin_s) is not None:
                notes["setpoint_margin_s"] = margin
            notes |= self.set_points.notes(run, whole=status == "completed")
        self._recorder.end_test(status, run.samples, **notes)


def run_guided_test(
    instrument: Instrument,
    test: GuidedTest,
    recorder: SessionRecorder,
    *,
    surface_m: float | None = None,
    progress: Callable[[Progress], None] = _ignore,
    cancelled: Callable[[], bool] = _never,
    enough: Callable[[], bool] = _never,
    why: Callable[[], str] = _enough_was_known,
    clock: Callable[[], float] = time.perf_counter,
) -> int:
    """Run one guided test into the recorder; returns its number.

    A test that breaks off is closed as aborted with what was recorded, and the error goes on to the caller. One that
    ends after its preload because ``enough`` says so is completed, with as many samples as were played and a note of
    when and ``why`` it ended. ``surface_m`` is where the tissue begins; without it the probe is placed first.
    ``clock`` times the generation of a feedback stimulus.

    Raises:
        CancelledError, LimitError, InstrumentError, JournalError, UnusableInputError.
    """
    device = instrument.device
    command = meanwhile(instrument, lambda: check_test(test, device), cancelled)
    if surface_m is None:
        surface_m = find_surface(instrument, test.limits, progress=progress, cancelled=cancelled)
    recording = _Recording(instrument, test, recorder, surface_m, progress)
    if isinstance(test.stimulus, FeedbackKind):
        recording.set_points = SetPoints(test.stimulus, device, surface_m, command.size, clock=clock)
    try:
        run = play(
            instrument,
            command,
            test.limits,
            started=recording.begin,
            on_samples=recording.take,
            cancelled=cancelled,
            set_points=recording.set_points,
            enough=lambda: recording.taken > recording.preload_samples and enough(),
        )
    except BaseException as error:
        recording.abort(_cause(error))
        raise
    recording.end(run, why)
    return recorder.tests_begun
