"""The dynamic sweep: a stochastic test on the calibration spring at positions along the stroke (Chen 2010, 2.4.1).

At each position a gentle test comes first. It tells how far the probe would swing, and so how hard it may be shaken
there without coming to an end of its stroke. The load is nil on average: with a mean current the slope of the force
constant would act as a spring of its own.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.acquisition import GuidedTest, Progress, SessionRecorder, run_guided_test
from tissueid.acquisition.placing import Orientation, Placement, find_orientation
from tissueid.acquisition.playing import never
from tissueid.calibration.levels import at_rest, mean
from tissueid.calibration.sweep_amplitude import LEAST_SWING_M, gentle_answer, noise, room, strength
from tissueid.calibration.sweep_test import SweepTest
from tissueid.device import GRAVITY_M_S2
from tissueid.errors import CancelledError, FirmwareFaultError, LimitError, TissueIDError, UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, Limits, SerialInstrument
from tissueid.sessions import Session
from tissueid.stimuli import guided
from tissueid.wire import Fault

PRELOAD_S = 0.3
"""No load for so long before the noise: the device's soft start is over by then."""
KIND = "spring"
NOBODY = (
    "this instrument has no motorised stage, so somebody has to move the calibration spring from position to position: "
    "run this on a terminal, where it says when and where to"
)
_REST_S = 0.2
_NEAR_M = 0.3e-3
"""As near as this a motorised stage brings the probe to where it is wanted."""
_AT_END_M = 0.3e-3
_MOST_SAG_M = 3.0e-3
_MOST_POSITIONS = 200
_HALVED = 0.5

Bring = Callable[[float], None]
"""Has a person bring the spring to where the probe stands at a position, m; returns when it is there."""


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """Where, how long and how hard.

    ``swing_m`` is the farthest swing to either side where there is room for it; near the ends it is less.

    Raises:
        UnusableInputError: positions that are none, or times that no test lasts.
    """

    from_m: float = 0.002
    to_m: float = 0.030
    step_m: float = 0.002
    seconds: float = 4.0
    swing_m: float = 2.5e-3
    repeats: int = 1
    seed: int = 1
    limits: Limits = CLINICAL

    def __post_init__(self) -> None:
        if not 0.0 <= self.from_m < self.to_m <= 0.1:
            raise UnusableInputError("a sweep goes from a position to a greater one, both in mm on the stroke")
        if not 0.5e-3 <= self.step_m <= 5.0e-3:
            raise UnusableInputError("the step of a sweep is 0.5 to 5 mm")
        if (self.to_m - self.from_m) / self.step_m > _MOST_POSITIONS:
            raise UnusableInputError(f"a sweep has at most {_MOST_POSITIONS} positions: widen the step")
        if not 1.0 <= self.seconds <= 20.0:
            raise UnusableInputError("each test of a sweep lasts 1 to 20 s")
        if not 1 <= self.repeats <= 100:
            raise UnusableInputError("a sweep is repeated 1 to 100 times")
        if not LEAST_SWING_M <= self.swing_m <= 5.0e-3:
            raise UnusableInputError(f"the swing of a sweep is {1e3 * LEAST_SWING_M:g} to 5 mm")

    @property
    def positions_m(self) -> tuple[float, ...]:
        """Where the probe is to stand, rising."""
        count = 1 + round((self.to_m - self.from_m) / self.step_m - 1e-6)
        places = self.from_m + self.step_m * np.arange(count)
        return tuple(float(place) for place in places[places <= self.to_m + 1e-9])


class Sweep:
    """A sweep on one instrument into one session.

    ``remarks`` say what was left out, and why; ``has_stage`` is true until the instrument said that it has none.
    ``stage_m`` is where the stage was brought and left, None where it was not moved or is back in mid-stroke.
    """

    def __init__(
        self,
        instrument: Instrument,
        plan: SweepPlan,
        recorder: SessionRecorder,
        *,
        bring: Bring | None = None,
        progress: Callable[[float], None] = lambda _: None,
        cancelled: Callable[[], bool] = never,
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
        # By how much the weight of the coil lengthens the spring; put right at the first position.
        self._sag_m = self._device.moving_mass_kg * GRAVITY_M_S2 / self._device.calibration_spring_n_per_m
        self._seen = (np.inf, -np.inf)

    def run(self) -> None:
        """Measure at all positions, upwards and, in the next repeat, downwards again.

        A motorised stage then goes back to where the probe stands in mid-stroke, after a failure as well. It does not
        where somebody stopped the sweep: nothing moves then any more, and ``stage_m`` says where it was left.

        Raises:
            UnusableInputError: there is no motorised stage, and nobody to move the spring.
            CancelledError, LimitError, InstrumentError, JournalError: the coil is released; what was recorded is kept.
        """
        try:
            self._run()
        except CancelledError:
            raise
        except Exception:
            with contextlib.suppress(TissueIDError):  # what went wrong first is what counts
                self._go_back()
            raise
        self._go_back()

    def _go_back(self) -> None:
        """Bring the stage, where there is one and it was moved, to mid-stroke."""
        if self.stage_m is None:
            return
        middle_m = float(np.clip(0.5 * self._device.stroke_m - self._sag_m, 0.0, self._device.stroke_m))
        find_orientation(self._instrument)  # reads on: the soft end of the run before is over by then
        if self._instrument.move_stage(middle_m):
            self.stage_m = None
            self._instrument.poll(0.0)  # what came while the stage was moving

    def _run(self) -> None:
        places = self._plan.positions_m
        total = len(places) * self._plan.repeats
        for repeat in range(self._plan.repeats):
            for number, place in enumerate(places if repeat % 2 == 0 else places[::-1]):
                done = repeat * len(places) + number
                self._measure(place, done, repeat, total)
                self._progress((done + 1) / total)

    def _measure(self, place_m: float, done: int, repeat: int, total: int) -> None:
        """One position, or a remark on why not."""
        at = f"{1e3 * place_m:.1f} mm"
        self._seen = (np.inf, -np.inf)
        stage_m = self._go_to(place_m)
        rest_m = mean(at_rest(self._instrument, _REST_S, cancelled=self._cancelled), "position")
        if room(rest_m, self._plan.limits) < LEAST_SWING_M:
            self.remarks.append(f"{at} was left out: the probe stood at {1e3 * rest_m:.1f} mm, too near an end")
            return

        def shown(share: float, item: Progress) -> None:
            self._watch(item)
            self._progress((done + share * item.fraction) / total)

        try:
            about_m, answer = gentle_answer(
                self._instrument,
                self._plan.limits,
                self._plan.seed + done,
                lambda item: shown(0.2, item),
                self._cancelled,
            )
        except UnusableInputError as error:
            self.remarks.append(f"{at} was left out: {error}")
            return
        except (LimitError, FirmwareFaultError) as error:
            self._end_was_hit(error)
            self.remarks.append(f"{at} was left out: the gentle test came to an end of the stroke")
            return
        swing = min(self._plan.swing_m, room(about_m, self._plan.limits))
        if swing < LEAST_SWING_M:
            self.remarks.append(f"{at} was left out: there is too little room for a swing")
            return
        rate, seed = self._device.sample_rate_hz, self._plan.seed + done
        unit = noise(1.0, self._plan.seconds, seed, rate)
        volts = strength(answer, unit, swing, self._device, self._plan.limits)
        for share in (1.0, _HALVED):
            notes: dict[str, str | float] = {"wanted_m": place_m, "sweep": float(repeat), "volts": share * volts}
            test = GuidedTest(
                guided(noise(share * volts, self._plan.seconds, seed, rate), PRELOAD_S),
                f"calibration spring at {at}",
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
                self._end_was_hit(error)
                continue
            return
        self.remarks.append(f"{at} was left out: the probe came to an end of its stroke, and at half the force again")

    def _go_to(self, place_m: float) -> float | None:
        """Have the probe stand at a place; returns where the stage is, None where a person moved the spring."""
        self._orientation()  # reads on: the soft end of the run before is over by then
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
            self._instrument.poll(0.0)  # what came while the stage was moving
            stands = mean(at_rest(self._instrument, _REST_S, cancelled=self._cancelled), "position")
            if abs(stands - place_m) <= _NEAR_M or abs(stands - stage_m) > _MOST_SAG_M:
                break
            self._sag_m = stands - stage_m
        return stage_m

    def _ask(self, place_m: float) -> None:
        """A person moves the spring.

        Raises:
            UnusableInputError: nobody is there.
        """
        if self._bring is None:
            raise UnusableInputError(NOBODY)
        self._bring(place_m)

    def _orientation(self) -> Orientation:
        return find_orientation(self._instrument, self._cancelled)

    def _watch(self, item: Progress) -> None:
        """Remember how far the probe went in this run."""
        position = item.samples["position"]
        position = position[np.isfinite(position)]
        if position.size:
            low, high = self._seen
            self._seen = min(low, float(position.min())), max(high, float(position.max()))

    def _end_was_hit(self, error: LimitError | FirmwareFaultError) -> None:
        """Go on after a run that an end of the stroke ended.

        Raises:
            LimitError, FirmwareFaultError: it was something else.
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
    """The tests of a sweep that a session holds.

    Raises:
        UnusableInputError: there is none that came to its end.
    """
    found = [SweepTest.of_session(test) for test in session.tests if test.kind == KIND and test.status == "completed"]
    if not found:
        raise UnusableInputError("the session holds no test on the calibration spring that came to its end")
    return found
