"""Dynamic sweep: a stochastic test on the calibration spring at positions along the stroke (Chen 2010, 2.4.1).

A gentle test at each position predicts the swing of the probe, and thus the largest excitation that keeps it away from
the ends of the stroke. The mean load is zero: with a mean current, the slope of the force constant would act as an
additional spring.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition import GuidedTest, Progress, SessionRecorder, run_guided_test
from tissueid.acquisition.playback import POLL_S, never_stop
from tissueid.acquisition.surface_detection import Orientation, Placement, find_orientation
from tissueid.calibration.plans import MIN_SWING_M, SweepPlan
from tissueid.calibration.spring_points import SweepTest, gentle_test_model, max_swing, noise, noise_amplitude
from tissueid.calibration.step_levels import mean, rest_samples
from tissueid.device import GRAVITY_M_S2
from tissueid.errors import CancelledError, FirmwareFaultError, LimitError, TissueIDError, UnusableInputError
from tissueid.instrument import Instrument, SerialInstrument
from tissueid.messages import Message, Quantity
from tissueid.sessions import Session
from tissueid.stimuli import with_preload
from tissueid.test_settings import TestSettings
from tissueid.wire import Fault

PRELOAD_S = 0.3
"""Time without load before the noise, s: longer than the soft start of the device."""
KIND = "spring"
"""Kind of the tests of a sweep in a session."""
_REST_S = 0.2
"""Duration of the readings at rest, s."""
_NEAR_M = 0.3e-3
"""Tolerance of the position that a motorised stage reaches, m."""
_AT_END_M = 0.3e-3
"""Distance from a position limit, m, at which the probe counts as having reached it."""
_MAX_SAG_M = 3.0e-3
"""Maximum extension of the spring by the weight of the coil, m."""
_RETRY_SHARE = 0.5
"""Amplitude of the second attempt relative to the first."""

MoveSpring = Callable[[float], None]
"""Function that asks the operator to move the spring to a position, m, and returns when it is reached."""


class Sweep:
    """Sweep on one instrument, recorded into one session.

    ``remarks`` lists the skipped positions with the reason. ``has_stage`` is true until the instrument reports that it
    has no stage. ``stage_m`` is the position of the stage; None if it was not moved or is back in mid-stroke.
    """

    def __init__(
        self,
        instrument: Instrument,
        plan: SweepPlan,
        recorder: SessionRecorder,
        *,
        bring: MoveSpring | None = None,
        progress: Callable[[float], None] = lambda _: None,
        cancelled: Callable[[], bool] = never_stop,
    ) -> None:
        self.remarks: list[str] = []
        self._instrument = instrument
        self._device = instrument.device
        self._plan = plan
        self._recorder = recorder
        self._bring = bring
        self._progress = progress
        self._cancelled = cancelled
        self.has_stage = True
        self.stage_m: float | None = None
        # Extension of the spring by the weight of the coil; corrected at the first position.
        self._sag_m = self._device.moving_mass_kg * GRAVITY_M_S2 / self._device.calibration_spring_n_per_m
        self._seen = (np.inf, -np.inf)

    def run(self) -> None:
        """Measure at all positions, upwards and, in the next repeat, downwards.

        Afterwards, also after a failure, a motorised stage returns to mid-stroke. After a cancellation nothing moves,
        and ``stage_m`` is the position of the stage.

        Raises:
            UnusableInputError: there is neither a motorised stage nor an operator to move the spring.
            CancelledError, LimitError, InstrumentError, JournalError: the coil is released; completed tests are kept.
        """
        try:
            self._run()
        except CancelledError:
            raise
        except Exception:
            with contextlib.suppress(TissueIDError):  # the first error is raised
                self._return_stage()
            raise
        self._return_stage()

    def _return_stage(self) -> None:
        """Move the stage to mid-stroke if it was moved."""
        if self.stage_m is None:
            return
        middle_m = float(np.clip(0.5 * self._device.stroke_m - self._sag_m, 0.0, self._device.stroke_m))
        find_orientation(self._instrument)  # reads on until the release ramp of the previous run is over
        if self._instrument.move_stage(middle_m):
            self.stage_m = None
            self._instrument.poll(0.0)  # discard the samples from while the stage was moving

    def _run(self) -> None:
        places = self._plan.positions_m
        total = len(places) * self._plan.repeats
        for repeat in range(self._plan.repeats):
            for number, position in enumerate(places if repeat % 2 == 0 else places[::-1]):
                done = repeat * len(places) + number
                self.measure(position, done, repeat, total)
                self._progress((done + 1) / total)

    def measure(self, place_m: float, done: int, repeat: int, total: int) -> None:
        """Measure at one position, or add a remark on why it was skipped."""
        at = Quantity(1e3 * place_m, "mm", 1)
        self._seen = (np.inf, -np.inf)
        stage_m = self._move_to(place_m)
        rest_m = mean(rest_samples(self._instrument, _REST_S, cancelled=self._cancelled), "position")
        if max_swing(rest_m, self._plan.limits) < MIN_SWING_M:
            self._leave_out(
                at,
                Message(
                    "sweep.too_near",
                    "the probe stood at {position}, too near an end of the stroke",
                    position=Quantity(1e3 * rest_m, "mm", 1),
                ),
            )
            return

        def shown(share: float, item: Progress) -> None:
            self._update_range(item)
            self._progress((done + share * item.fraction) / total)

        try:
            about_m, answer = gentle_test_model(
                self._instrument,
                self._plan.limits,
                self._plan.seed + done,
                lambda item: shown(0.2, item),
                self._cancelled,
            )
        except UnusableInputError as error:
            self._leave_out(at, error.message)
            return
        except (LimitError, FirmwareFaultError) as error:
            self._clear_end_fault(error)
            self._leave_out(at, Message("sweep.gentle_end", "the gentle test reached an end of the stroke"))
            return
        swing = min(self._plan.swing_m, max_swing(about_m, self._plan.limits))
        if swing < MIN_SWING_M:
            self._leave_out(at, Message("sweep.no_room", "there is too little room for a swing"))
            return
        rate, seed = self._device.sample_rate_hz, self._plan.seed + done
        unit = noise(1.0, self._plan.seconds, seed, rate)
        volts = noise_amplitude(answer, unit, swing, self._device, self._plan.limits)
        for share in (1.0, _RETRY_SHARE):
            notes: dict[str, str | float] = {"wanted_m": place_m, "sweep": float(repeat), "volts": share * volts}
            test = GuidedTest(
                with_preload(noise(share * volts, self._plan.seconds, seed, rate), PRELOAD_S),
                TestSettings(site=f"calibration spring at {at}"),
                kind=KIND,
                limits=self._plan.limits,
                notes=notes if stage_m is None else notes | {"stage_m": stage_m},
            )
            try:
                run_guided_test(
                    self._instrument,
                    test,
                    self._recorder,
                    surface_m=Placement(rest_m, self._orientation()),
                    progress=lambda item: shown(1.0, item),
                    cancelled=self._cancelled,
                )
            except (LimitError, FirmwareFaultError) as error:
                self._clear_end_fault(error)
                continue
            return
        self._leave_out(
            at, Message("sweep.end_twice", "the probe reached an end of its stroke, and again with half the force")
        )

    def _leave_out(self, at: Quantity, why: str) -> None:
        self.remarks.append(Message("sweep.left_out", "{position} was left out: {reason}", position=at, reason=why))

    def _move_to(self, place_m: float) -> float | None:
        """Move the probe to a position; return that of the stage, None if the operator moved the spring."""
        self._orientation()  # reads on until the release ramp of the previous run is over
        if not self.has_stage:
            self._ask(place_m)
            return None
        for _ in range(2):
            stage_m = float(np.clip(place_m - self._sag_m, 0.0, self._device.stroke_m))
            if not self._instrument.move_stage(stage_m):
                self.has_stage = False
                self._ask(place_m)
                return None
            self.stage_m = stage_m
            self._instrument.poll(0.0)  # discard the samples from while the stage was moving
            stands = mean(rest_samples(self._instrument, _REST_S, cancelled=self._cancelled), "position")
            if abs(stands - place_m) <= _NEAR_M or abs(stands - stage_m) > _MAX_SAG_M:
                break
            self._sag_m = stands - stage_m
        return stage_m

    def _ask(self, place_m: float) -> None:
        """Ask the operator to move the spring.

        Raises:
            UnusableInputError: there is no operator.
        """
        if self._bring is None:
            raise UnusableInputError(
                "sweep.no_person",
                "this instrument has no motorised stage, so a person has to move the calibration spring from "
                "position to position: run the command in a terminal, where it says when and where to",
            )
        self._bring(place_m)

    def _orientation(self) -> Orientation:
        return find_orientation(self._instrument, self._cancelled)

    def _update_range(self, item: Progress) -> None:
        """Update the range of positions of this run."""
        position = item.samples["position"]
        position = position[np.isfinite(position)]
        if position.size:
            low, high = self._seen
            self._seen = min(low, float(position.min())), max(high, float(position.max()))

    def _clear_end_fault(self, error: LimitError | FirmwareFaultError) -> None:
        """Clear the fault of a run that ended at an end of the stroke.

        Raises:
            LimitError, FirmwareFaultError: the run ended for another reason.
        """
        low, high = self._seen
        limits = self._plan.limits
        status = self._instrument.status if isinstance(self._instrument, SerialInstrument) else None
        by_stroke = status is None or not status.faults & ~Fault.STROKE
        if not by_stroke or (low > limits.min_position_m + _AT_END_M and high < limits.max_position_m - _AT_END_M):
            raise error
        self._seen = (np.inf, -np.inf)
        if isinstance(self._instrument, SerialInstrument):
            self._instrument.clear_faults()


def sweep_tests(session: Session) -> list[SweepTest]:
    """Return the completed tests of a sweep in a session.

    Raises:
        UnusableInputError: there are none.
    """
    tests = [SweepTest.of_session(test) for test in session.tests if test.kind == KIND and test.status == "completed"]
    if not tests:
        raise UnusableInputError("sweep.no_test", "the session contains no completed test on the calibration spring")
    return tests


POSITION_TOLERANCE_M = 0.5e-3
"""Tolerance of the position, m; later steps use the measured position."""
STILL_M = 20e-6
"""Standard deviation of the position, m, below which the probe counts as at rest."""
STILL_S = 1.0
"""Time for which the probe must be at rest, s."""


@dataclass(frozen=True)
class ProbePosition:
    """Current position of the probe, and whether it is within the tolerance."""

    position_m: float
    in_place: bool


def wait_for_position(
    instrument: Instrument,
    place_m: float,
    tell: Callable[[ProbePosition], None] = lambda _: None,
    cancelled: Callable[[], bool] = never_stop,
) -> None:
    """Wait until the probe has been at rest at a position for ``STILL_S``; call ``tell`` for each reading.

    Raises:
        CancelledError: ``cancelled`` returned True.
        InstrumentError: see ``poll``.
    """
    wanted = round(STILL_S * instrument.device.sample_rate_hz)
    recent = np.zeros(0)
    while True:
        if cancelled():
            raise CancelledError(Message("cancelled.coil_free", "cancelled; the coil is free"))
        read = instrument.poll(POLL_S)["position"]
        recent = np.concatenate([recent, read[np.isfinite(read)]])[-wanted:]
        if not recent.size:
            continue
        standing = ProbePosition(float(recent[-1]), bool(abs(float(recent[-1]) - place_m) <= POSITION_TOLERANCE_M))
        tell(standing)
        if standing.in_place and recent.size == wanted and float(recent.std()) <= STILL_M:
            return
