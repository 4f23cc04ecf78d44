"""The steps of a static calibration: what each needs under the probe, and what a person is told to put there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.waiting import meanwhile
from tissueid.calibration.coil import Spring, electrical_findings, force_by_spring, force_by_weights, spring_line
from tissueid.calibration.findings import Findings
from tissueid.calibration.levels import Levels, at_rest, hold_levels, mean
from tissueid.calibration.line import Line
from tissueid.calibration.sensors import (
    acceleration_findings,
    position_findings,
    position_line,
    supply_findings,
    temperature_findings,
)
from tissueid.calibration.stroke import Crossing, carrying_current, move_gently, range_findings
from tissueid.device import GRAVITY_M_S2
from tissueid.errors import FirmwareFaultError, LimitError, UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, Limits
from tissueid.instrument.answers import describe_faults
from tissueid.records import Estimate
from tissueid.wire import Fault

LEVELS_V = (0.0, 4.0, 8.0, 12.0, 8.0, 4.0, 0.0, -4.0, -8.0, -12.0, -8.0, -4.0, 0.0)
"""Up and down on both sides: every level but the outermost is come to from below and from above. 3 N at most."""
PUSHED_V = (0.0, 3.0, 6.0, 9.0, 12.0, 9.0, 6.0, 3.0, 0.0)
"""The same for a spring that is not fixed to the probe, and would be left by it."""
HOLD_S = 0.45
RISE_S = 0.05
REST_S = 2.0
PLACE_S = 0.4
PLACES = 9
WEIGHT_STD = 0.1
"""Relative deviation of the moving part's nominal weight, where it was not found."""
STEPS = ("electrical", "force", "position", "range", "temperature", "acceleration", "supply")
_MOST_GRAVITY = 10.5
_MOST_GAUGE_M = 0.2
_RELEASED_S = 0.05
_ROOM_M = 4.0e-3
"""What the spring gives under the greatest voltage, and some more."""

Show = Callable[[str, float], None]
Ask = Callable[[str], None]
"""Tells a person what to do, and returns when it is done."""

SPRING_WORDS = "Put the calibration spring under the probe and fix it there, so that the probe stands in mid-stroke."
FREE_WORDS = "Take everything away from under the probe: it will move from end to end, with 2 N at most."
GAUGE_WORDS = "Put the gauge block of {0:g} mm under the probe, so that the probe rests on it."
WEIGHT_WORDS = "Put the weight of {0:g} g on the probe, so that it hangs freely."
BARE_WORDS = "Take the weight off the probe."
OVER_WORDS = "Turn the instrument over, so that the probe points the other way, and hold it still."
BACK_WORDS = "Turn the instrument back to where it was."
NOBODY = (
    "this instrument has no motorised stage, and nobody is there to put the spring under the probe: run this on a "
    "terminal, or say with --in-place that the spring is there"
)


@dataclass(frozen=True)
class StaticPlan:
    """What is to be done, and with what. ``gauges_m`` are heights of gauge blocks, for instruments without a stage.

    ``in_place`` says that the spring is under the probe and nobody is to be asked for anything: what would need a
    person is left out. With ``push_only`` the probe is not fixed to the spring, and no more than leans on it.
    ``turn_over`` asks for the instrument upside down as well.
    """

    steps: tuple[str, ...] = STEPS
    spring: Spring = field(default_factory=Spring)
    weights_kg: tuple[float, ...] = ()
    gauges_m: tuple[float, ...] = ()
    ambient_c: float | None = None
    turn_over: bool = False
    in_place: bool = False
    push_only: bool = False
    repeats: int = 1
    valid_days: int = 90
    limits: Limits = CLINICAL

    def __post_init__(self) -> None:
        for step in self.steps:
            if step not in STEPS:
                raise UnusableInputError(f"no step {step!r}; there are: {', '.join(STEPS)}")
        if not self.steps:
            raise UnusableInputError(f"name a step to be done, of: {', '.join(STEPS)}")
        if not 1 <= self.repeats <= 100:
            raise UnusableInputError("a calibration is repeated 1 to 100 times")
        if not (10.0 <= self.spring.stiffness_n_per_m <= 1e5 and 0.0 <= self.spring.relative_std < 0.5):
            raise UnusableInputError("a spring has 10 to 100000 N/m, known to better than 50 %")
        if any(not 0.001 <= mass <= 0.3 for mass in self.weights_kg) or len(self.weights_kg) > 20:
            raise UnusableInputError("weights are 1 to 300 g, 20 of them at most")
        if self.gauges_m and (len(set(self.gauges_m)) < 3 or len(self.gauges_m) > 50):
            raise UnusableInputError("gauge blocks are 3 to 50 different heights")
        if not all(0.0 <= height <= _MOST_GAUGE_M for height in self.gauges_m):
            raise UnusableInputError(f"gauge blocks are 0 to {1e3 * _MOST_GAUGE_M:g} mm high")
        if self.ambient_c is not None and not -10.0 <= self.ambient_c <= 50.0:
            raise UnusableInputError("the room's temperature is -10 to 50 °C")


class Procedure:
    """The steps on one instrument. ``has_stage`` is true until the instrument said that it has none."""

    def __init__(
        self, instrument: Instrument, plan: StaticPlan, ask: Ask | None, show: Show, cancelled: Callable[[], bool]
    ) -> None:
        self.has_stage = True
        self._instrument = instrument
        self._device = instrument.nominal
        self._plan = plan
        self._ask = ask
        self._show = show
        self._cancelled = cancelled
        self._label = ""

    def run(self, label: str) -> Findings:
        """All steps that are asked for and possible, once; ``label`` ends what progress is called.

        Raises:
            UnusableInputError, CancelledError, LimitError, InstrumentError.
        """
        self._label = label
        plan, wanted = self._plan, self._plan.steps
        self._spring()
        rest = self._rest("at rest")
        levels = self._levels("voltage to current to force")
        electrical = electrical_findings(levels, rest, self._device)
        found = electrical if "electrical" in wanted else Findings()
        zero_a = electrical.value("current_offset_a")
        if "temperature" in wanted:
            found += temperature_findings(rest, levels, plan.ambient_c)
        turned = self._turned() if "acceleration" in wanted and plan.turn_over else None
        acceleration = acceleration_findings(rest, turned)
        gravity = acceleration.value("gravity_along_stroke_m_s2")
        if "acceleration" in wanted:
            found += acceleration
        if abs(gravity) > _MOST_GRAVITY:
            gravity = GRAVITY_M_S2
        weighed = [levels, *self._weighed()] if "force" in wanted and plan.weights_kg else []
        places, line = self._places() if "position" in wanted else (np.zeros(0), None)
        crossings = self._crossings(gravity) if "range" in wanted else ()
        found += self._skipped(line, crossings)
        slope = spring_line(levels, zero_a).slope.value
        offset = None
        gain = None if line is None else line.slope
        if line is not None:
            offset, shared = self._offset(line, crossings, slope, gravity, zero_a)
            found += position_findings(places, line, offset)
            found += Findings(shared={"position_offset_m": shared})
        force = force_by_spring(levels, self._device, plan.spring, gain, zero_a, known=not weighed)
        if weighed:
            along = gravity / GRAVITY_M_S2
            force += force_by_weights(weighed, (0.0, *plan.weights_kg), self._device, along, zero_a)
        if "force" in wanted:
            zero = Findings({"current_offset_a": electrical.quantities["current_offset_a"]})  # k was found with it
            found += force + zero
        if crossings:
            found += range_findings(
                crossings,
                self._device,
                position_gain=1.0 if gain is None else gain.value,
                position_offset=offset or Estimate(0.0),
                force_constant_n_per_a=force.value("force_constant_n_per_a"),
                zero_a=zero_a,
            )
        if "supply" in wanted:
            put_back = bool(crossings) or line is not None
            if put_back:
                self._spring()
            again = self._rest("at rest again")
            last = electrical_findings(self._levels("voltage to current again"), again, self._device)
            same_place = self.has_stage or not put_back
            found += supply_findings(electrical, last, rest, again, self._device, same_place=same_place)
        self.see_off()
        return found

    # -- what the steps need ------------------------------------------------------------------------------

    def see_off(self) -> None:
        """Read on until the soft end of the run before is over."""
        at_rest(self._instrument, _RELEASED_S, cancelled=self._cancelled)

    def _move(self, position_m: float | None, words: str) -> None:
        """Bring the fixture to a place, or have it brought there.

        Raises:
            UnusableInputError: nobody is there.
        """
        self.see_off()
        if self.has_stage and self._instrument.move_stage(position_m):
            self._instrument.poll(0.0)  # what came while the stage was moving
            return
        self.has_stage = False
        if not self._plan.in_place:
            self._tell(words)

    def _tell(self, words: str) -> None:
        ask = self._ask
        if ask is None:
            raise UnusableInputError(NOBODY)
        meanwhile(self._instrument, lambda: ask(words), self._cancelled)

    def _spring(self) -> None:
        """The spring under the probe, in mid-stroke.

        Raises:
            UnusableInputError: it stands where the spring has no room.
        """
        stroke = self._device.stroke_m
        self._move(0.5 * stroke, SPRING_WORDS)
        stands = mean(at_rest(self._instrument, 0.1, cancelled=self._cancelled), "position")
        if not _ROOM_M < stands < stroke - _ROOM_M:
            raise UnusableInputError(
                f"the probe stands at {1e3 * stands:.1f} mm: put the spring so that it stands between "
                f"{1e3 * _ROOM_M:g} and {1e3 * (stroke - _ROOM_M):g} mm, best in mid-stroke"
            )

    def _rest(self, what: str) -> NDArray[np.void]:
        return at_rest(
            self._instrument,
            REST_S,
            progress=lambda fraction: self._show(what + self._label, fraction),
            cancelled=self._cancelled,
        )

    def _levels(self, what: str) -> Levels:
        try:
            return hold_levels(
                self._instrument,
                np.array(PUSHED_V if self._plan.push_only else LEVELS_V),
                self._plan.limits,
                hold_s=HOLD_S,
                rise_s=RISE_S,
                progress=lambda fraction: self._show(what + self._label, fraction),
                cancelled=self._cancelled,
            )
        except (LimitError, FirmwareFaultError) as error:
            if isinstance(error, FirmwareFaultError) and describe_faults(Fault.STROKE) not in str(error):
                raise
            raise type(error)(
                f"{error}; is the calibration spring under the probe? Where it is not fixed to the probe, say so with "
                "--push-only"
            ) from error

    def _turned(self) -> NDArray[np.void]:
        self._tell(OVER_WORDS)
        turned = self._rest("turned over")
        self._tell(BACK_WORDS)
        return turned

    def _weighed(self) -> list[Levels]:
        series = []
        for mass in self._plan.weights_kg:
            self._tell(WEIGHT_WORDS.format(1e3 * mass))
            series.append(self._levels(f"{1e3 * mass:g} g on the probe"))
        self._tell(BARE_WORDS)
        return series

    def _places(self) -> tuple[NDArray[np.float64], Line | None]:
        """Known places, m, shape (n,), growing as the position does, and the line of the readings there."""
        stroke, gauges = self._device.stroke_m, self._plan.gauges_m
        if self.has_stage:
            truth = np.linspace(0.1, 0.9, PLACES) * stroke
            rests = [self._rest_at(number, place, "") for number, place in enumerate(truth)]
        elif gauges and not self._plan.in_place:
            truth = -np.array(gauges)
            words = [GAUGE_WORDS.format(1e3 * height) for height in gauges]
            rests = [self._rest_at(number, None, text) for number, text in enumerate(words)]
        else:
            return np.zeros(0), None
        return truth, position_line(truth, rests)

    def _rest_at(self, number: int, place_m: float | None, words: str) -> NDArray[np.void]:
        self._move(place_m, words)
        places = len(self._plan.gauges_m) if words else PLACES
        samples = at_rest(self._instrument, PLACE_S, cancelled=self._cancelled)
        self._show("position along the stroke" + self._label, (number + 1) / places)
        return samples

    def _crossings(self, gravity: float) -> tuple[Crossing, ...]:
        if self._plan.in_place and not self.has_stage:
            return ()
        self._move(None, FREE_WORDS)
        try:
            return move_gently(
                self._instrument,
                gravity,
                progress=lambda fraction: self._show("range of motion" + self._label, fraction),
                cancelled=self._cancelled,
            )
        except LimitError as error:
            raise LimitError(f"{error}, in free air; --steps can leave the range of motion out") from error

    def _offset(
        self, line: Line, crossings: Sequence[Crossing], slope_m_per_a: float, gravity: float, zero_a: float
    ) -> tuple[Estimate | None, float]:
        """What the position channel reads at nothing: the coil's weight, which lengthens the spring, taken off.

        Then the part of its deviation, m, that every repeat has alike.
        """
        shared = 0.0
        if not self.has_stage:
            return None, shared
        if crossings:
            carrying = carrying_current(tuple(crossings))
            current, current_std = carrying.value - zero_a, carrying.std or 0.0
        else:
            current = -self._device.moving_mass_kg * gravity / self._device.force_constant_n_per_a
            current_std = WEIGHT_STD * abs(current)
            shared = abs(slope_m_per_a) * current_std
        std = float(np.hypot(line.intercept.std or 0.0, slope_m_per_a * current_std))
        return Estimate(line.intercept.value + slope_m_per_a * current, std), shared

    def _skipped(self, line: Line | None, crossings: Sequence[Crossing]) -> Findings:
        """What was asked for and could not be done."""
        notes = []
        if "position" in self._plan.steps and line is None:
            notes.append(
                "position along the stroke was left out: it needs a motorised stage, or gauge blocks (--gauge MM)"
            )
        if "range" in self._plan.steps and not crossings:
            notes.append("the range of motion was left out: the spring stays in place")
        return Findings(notes=tuple(notes))
