"""Steps of a static calibration, and the instructions to the operator who sets up the fixture for each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.calibration.coil import electrical_findings, force_by_spring, force_by_weights, spring_line
from tissueid.calibration.file import Calibration, CalibrationFindings, mean_of_repeats, stored_messages, utc_date
from tissueid.calibration.plans import StaticPlan
from tissueid.calibration.sensors import (
    Crossing,
    acceleration_findings,
    balancing_current,
    cross_stroke,
    position_findings,
    position_line,
    range_findings,
    supply_findings,
    temperature_findings,
)
from tissueid.calibration.status import first_implausible, stored_text
from tissueid.calibration.step_levels import Levels, StraightLine, hold_levels, mean, rest_samples
from tissueid.device import GRAVITY_M_S2
from tissueid.errors import FirmwareFaultError, LimitError, UnusableInputError
from tissueid.instrument import Instrument
from tissueid.language import marked
from tissueid.messages import Action, Message, Quantity
from tissueid.records import Estimate
from tissueid.version import SOFTWARE
from tissueid.wire import Fault

LEVELS_V = (0.0, 4.0, 8.0, 12.0, 8.0, 4.0, 0.0, -4.0, -8.0, -12.0, -8.0, -4.0, 0.0)
"""Voltages of both signs, V, at most 3 N. Each level except the outermost is reached from below and from above."""
PUSH_LEVELS_V = (0.0, 3.0, 6.0, 9.0, 12.0, 9.0, 6.0, 3.0, 0.0)
"""Voltages, V, for a spring that is not fixed to the probe."""
HOLD_S = 0.45
"""Time at each voltage, s."""
RISE_S = 0.05
"""Duration of the raised cosine between two voltages, s."""
REST_S = 2.0
"""Duration of the readings at rest, s."""
PLACE_S = 0.4
"""Duration of the readings at each position, s."""
PLACES = 9
"""Positions along the stroke with a motorised stage."""
WEIGHT_STD = 0.1
"""Relative standard deviation of the nominal weight of the moving part if it was not measured."""
_MAX_GRAVITY = 10.5
"""Largest gravity, m/s², accepted from the accelerometer."""
_RELEASED_S = 0.05
"""Time after a run until its release ramp is over, s."""
_MIN_CLEARANCE_M = 4.0e-3
"""Minimum distance of the probe from the ends of the stroke, m: more than its travel at the largest voltage."""

Show = Callable[[str, float], None]
Ask = Callable[[str], None]
"""Function that shows an instruction to the operator and returns when it is done."""

SPRING_INSTRUCTION = Message(
    "calibration.ask.spring",
    "Put the calibration spring under the probe and fix it there, so that the probe stands in mid-stroke.",
)
FREE_INSTRUCTION = Message(
    "calibration.ask.free",
    "Take everything away from under the probe: it will move from end to end, with 2 N at most.",
)
BARE_INSTRUCTION = Message("calibration.ask.bare", "Take the weight off the probe.")
TURN_OVER_INSTRUCTION = Message(
    "calibration.ask.over", "Turn the instrument over, so that the probe points the other way, and hold it still."
)
TURN_BACK_INSTRUCTION = Message("calibration.ask.back", "Turn the instrument back to its previous orientation.")


def gauge_instruction(height_m: float) -> Message:
    """Return the instruction for a gauge block."""
    return Message(
        "calibration.ask.gauge",
        "Put the gauge block of {height:g} mm under the probe, so that the probe rests on it.",
        height=1e3 * height_m,
    )


def weight_instruction(mass_kg: float) -> Message:
    """Return the instruction for a weight."""
    return Message(
        "calibration.ask.weight",
        "Put the weight of {mass:g} g on the probe, so that it hangs freely.",
        mass=1e3 * mass_kg,
    )


PUSH_ONLY = Action(
    "calibrate.push_only",
    "tissueid calibrate static --push-only",
    marked("clear “Spring fixed to the probe” on the page Calibration"),
)


class Procedure:
    """Executes the steps on one instrument. ``has_stage`` is true until the instrument reports that it has none."""

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
        self._run = 1
        self._shown: tuple[int, str] = 1, ""
        self._begun = 0

    def run(self, number: int) -> CalibrationFindings:
        """Execute all requested and possible steps once; ``number`` counts the repeats from 1.

        Raises:
            UnusableInputError: something is missing, samples were lost, or a channel does not respond.
            CancelledError, LimitError, InstrumentError: the coil is released.
        """
        self._run = number
        plan, wanted = self._plan, self._plan.steps
        self._place_spring()
        rest = self._rest(Message("calibration.step.rest", "at rest"))
        levels = self._levels(Message("calibration.step.levels", "voltage to current to force"))
        electrical = electrical_findings(levels, rest, self._device)
        findings = electrical if "electrical" in wanted else CalibrationFindings()
        zero_a = electrical.value("current_offset_a")
        if "temperature" in wanted:
            findings += temperature_findings(rest, levels, plan.ambient_c)
        turned = self._turned_samples() if "acceleration" in wanted and plan.turn_over else None
        acceleration = acceleration_findings(rest, turned)
        gravity = acceleration.value("gravity_along_stroke_m_s2")
        if "acceleration" in wanted:
            findings += acceleration
        if abs(gravity) > _MAX_GRAVITY:
            gravity = GRAVITY_M_S2
        weighed = [levels, *self._weight_levels()] if "force" in wanted and plan.weights_kg else []
        places, line = self._position_readings() if "position" in wanted else (np.zeros(0), None)
        crossings = self._crossings(gravity) if "range" in wanted else ()
        findings += self._skipped_notes(line, crossings)
        slope = spring_line(levels, zero_a).slope.value
        offset = None
        gain = None if line is None else line.slope
        if line is not None:
            offset, shared = self._offset(line, crossings, slope, gravity, zero_a)
            findings += position_findings(places, line, offset)
            findings += CalibrationFindings(shared={"position_offset_m": shared})
        force = force_by_spring(levels, self._device, plan.spring, gain, zero_a, check_nominal=not weighed)
        if weighed:
            along = gravity / GRAVITY_M_S2
            force += force_by_weights(weighed, (0.0, *plan.weights_kg), self._device, along, zero_a)
        if "force" in wanted:
            zero = CalibrationFindings(
                {"current_offset_a": electrical.quantities["current_offset_a"]}
            )  # the force constant was measured with it
            findings += force + zero
        if crossings:
            findings += range_findings(
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
                self._place_spring()
            again = self._rest(Message("calibration.step.rest_again", "at rest again"))
            last_levels = self._levels(Message("calibration.step.levels_again", "voltage to current again"))
            last = electrical_findings(last_levels, again, self._device)
            same_place = self.has_stage or not put_back
            findings += supply_findings(electrical, last, rest, again, self._device, same_place=same_place)
        self.drain_release()
        return findings

    # -- what the steps need ------------------------------------------------------------------------------

    def drain_release(self) -> None:
        """Poll until the release ramp of the previous run is over."""
        rest_samples(self._instrument, _RELEASED_S, cancelled=self._cancelled)

    def _move(self, position_m: float | None, instruction: str) -> None:
        """Move the fixture by the stage, or ask the operator to.

        Raises:
            UnusableInputError: there is neither.
        """
        self.drain_release()
        if self.has_stage and self._instrument.move_stage(position_m):
            self._instrument.poll(0.0)  # discard the samples from while the stage was moving
            return
        self.has_stage = False
        if not self._plan.in_place:
            self._ask_person(instruction)

    def _ask_person(self, instruction: str) -> None:
        ask = self._ask
        if ask is None:
            raise UnusableInputError(
                "calibration.no_person",
                "this instrument has no motorised stage, and no person is present to put the spring under the "
                "probe: run the command in a terminal, or give --in-place if the spring is already there",
            )
        run_while_polling(self._instrument, lambda: ask(instruction), self._cancelled)

    def _show_step(self, step: Message, fraction: float) -> None:
        """Show a step and the completed share of the whole calibration, whose steps count alike."""
        repeats = self._plan.repeats
        if self._shown != (self._run, str(step)):
            self._shown, self._begun = (self._run, str(step)), self._begun + 1
        fraction = min(1.0, (self._begun - 1 + fraction) / (repeats * self._plan.shown_steps))
        if repeats > 1:
            step = Message("calibration.step.run", "{step} ({run} of {runs})", step=step, run=self._run, runs=repeats)
        self._show(step, fraction)

    def _place_spring(self) -> None:
        """Place the spring under the probe in mid-stroke.

        Raises:
            UnusableInputError: the probe is too close to an end of the stroke.
        """
        stroke = self._device.stroke_m
        self._move(0.5 * stroke, SPRING_INSTRUCTION)
        stands = mean(rest_samples(self._instrument, 0.1, cancelled=self._cancelled), "position")
        if not _MIN_CLEARANCE_M < stands < stroke - _MIN_CLEARANCE_M:
            raise UnusableInputError(
                "calibration.spring_place",
                "the probe stands at {position}: put the spring so that it stands between {low:g} and {high:g} mm, "
                "best in mid-stroke",
                position=Quantity(1e3 * stands, "mm", 1),
                low=1e3 * _MIN_CLEARANCE_M,
                high=1e3 * (stroke - _MIN_CLEARANCE_M),
            )

    def _rest(self, step: Message) -> NDArray[np.void]:
        return rest_samples(
            self._instrument,
            REST_S,
            progress=lambda fraction: self._show_step(step, fraction),
            cancelled=self._cancelled,
        )

    def _levels(self, step: Message) -> Levels:
        try:
            return hold_levels(
                self._instrument,
                np.array(PUSH_LEVELS_V if self._plan.push_only else LEVELS_V),
                self._plan.limits,
                hold_s=HOLD_S,
                rise_s=RISE_S,
                progress=lambda fraction: self._show_step(step, fraction),
                cancelled=self._cancelled,
            )
        except (LimitError, FirmwareFaultError) as error:
            if isinstance(error, FirmwareFaultError) and not error.faults & Fault.STROKE:
                raise
            raise type(error)(
                Message(
                    "calibration.spring_missing",
                    "{problem}. Check that the calibration spring is under the probe. If it is not fixed to the probe: "
                    "{action}",
                    problem=error.message,
                    action=PUSH_ONLY,
                )
            ) from error

    def _turned_samples(self) -> NDArray[np.void]:
        self._ask_person(TURN_OVER_INSTRUCTION)
        turned = self._rest(Message("calibration.step.turned", "turned over"))
        self._ask_person(TURN_BACK_INSTRUCTION)
        return turned

    def _weight_levels(self) -> list[Levels]:
        series = []
        for mass in self._plan.weights_kg:
            self._ask_person(weight_instruction(mass))
            series.append(self._levels(Message("calibration.step.weight", "{mass:g} g on the probe", mass=1e3 * mass)))
        self._ask_person(BARE_INSTRUCTION)
        return series

    def _position_readings(self) -> tuple[NDArray[np.float64], StraightLine | None]:
        """Return known positions (n,), m, rising with the reading, and the line fit of the readings."""
        stroke, gauges = self._device.stroke_m, self._plan.gauges_m
        if self.has_stage:
            truth = np.linspace(0.1, 0.9, PLACES) * stroke
            rests = [self._rest_at(number, position, "") for number, position in enumerate(truth)]
        elif gauges and not self._plan.in_place:
            truth = -np.array(gauges)
            rests = [self._rest_at(number, None, gauge_instruction(height)) for number, height in enumerate(gauges)]
        else:
            return np.zeros(0), None
        return truth, position_line(truth, rests)

    def _rest_at(self, number: int, position_m: float | None, instruction: str) -> NDArray[np.void]:
        self._move(position_m, instruction)
        places = len(self._plan.gauges_m) if instruction else PLACES
        samples = rest_samples(self._instrument, PLACE_S, cancelled=self._cancelled)
        self._show_step(Message("calibration.step.position", "position along the stroke"), (number + 1) / places)
        return samples

    def _crossings(self, gravity: float) -> tuple[Crossing, ...]:
        if self._plan.in_place and not self.has_stage:
            return ()
        self._move(None, FREE_INSTRUCTION)
        try:
            return cross_stroke(
                self._instrument,
                gravity,
                progress=lambda fraction: self._show_step(
                    Message("calibration.step.range", "range of motion"), fraction
                ),
                cancelled=self._cancelled,
            )
        except LimitError as error:
            raise LimitError(
                "calibration.range_limit",
                "{problem}, in free air. Remove what is in the way of the probe, or leave this step out by --steps",
                problem=error.message,
            ) from error

    def _offset(
        self, line: StraightLine, crossings: Sequence[Crossing], slope_m_per_a: float, gravity: float, zero_a: float
    ) -> tuple[Estimate | None, float]:
        """Return the reading at position zero, corrected for the extension of the spring by the weight of the coil.

        The second value is the part of its standard deviation that is common to all repeats, m.
        """
        shared = 0.0
        if not self.has_stage:
            return None, shared
        if crossings:
            carrying = balancing_current(tuple(crossings))
            current, current_std = carrying.value - zero_a, carrying.std or 0.0
        else:
            current = -self._device.moving_mass_kg * gravity / self._device.force_constant_n_per_a
            current_std = WEIGHT_STD * abs(current)
            shared = abs(slope_m_per_a) * current_std
        std = float(np.hypot(line.intercept.std or 0.0, slope_m_per_a * current_std))
        return Estimate(line.intercept.value + slope_m_per_a * current, std), shared

    def _skipped_notes(self, line: StraightLine | None, crossings: Sequence[Crossing]) -> CalibrationFindings:
        """Return notes on the requested steps that were not possible."""
        notes = []
        if "position" in self._plan.steps and line is None:
            notes.append(
                Message(
                    "calibration.skipped.position",
                    "the position along the stroke was left out: it needs a motorised stage, or gauge blocks (--gauge "
                    "MM)",
                )
            )
        if "range" in self._plan.steps and not crossings:
            notes.append(
                Message("calibration.skipped.range", "the range of motion was left out: the spring stays in place")
            )
        return CalibrationFindings(notes=tuple(notes))


@dataclass(frozen=True)
class StaticCalibration:
    """The calibration to be stored, notes for the user, and the duration."""

    calibration: Calibration
    notes: tuple[str, ...]
    seconds: float


def calibrate_static(
    instrument: Instrument,
    plan: StaticPlan | None = None,
    *,
    ask: Ask | None = None,
    progress: Show = lambda _label, _fraction: None,
    cancelled: Callable[[], bool] = lambda: False,
    now: datetime | None = None,
) -> StaticCalibration:
    """Calibrate an instrument, starting from its nominal values; the active calibration is deactivated.

    Args:
        instrument: opened, with the calibration spring under the probe or a motorised stage.
        plan: steps and references; all steps by default.
        ask: shows an instruction to the operator and returns when it is done; None without an operator. Required
            without a motorised stage.
        progress: receives the name of the current step and its completed share.
        cancelled: polled throughout; True cancels the calibration.
        now: date of the calibration.

    Raises:
        UnusableInputError: something is missing, samples were lost, or a channel does not respond.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    plan = plan or StaticPlan()
    begin = time.perf_counter()
    procedure = Procedure(instrument, plan, ask, progress, cancelled)
    procedure.drain_release()
    instrument.use_calibration(instrument.nominal, {})
    findings = mean_of_repeats([procedure.run(run) for run in range(1, plan.repeats + 1)])
    device = instrument.device
    conditions: dict[str, float | str] = {"repeats": float(plan.repeats), "steps": ", ".join(plan.steps)}
    if plan.ambient_c is not None:
        conditions["ambient_c"] = plan.ambient_c
    if "temperature_at_rest_c" in findings.quantities:
        conditions["coil_temperature_c"] = findings.quantities["temperature_at_rest_c"].value
    conditions["by"] = (
        "motorised stage" if procedure.has_stage else "spring in place" if plan.in_place or ask is None else "hand"
    )
    conditions |= {f"note_{number}": stored_text(note) for number, note in enumerate(findings.notes, start=1)}
    problems = findings.problems
    calibration = Calibration(
        kind="static",
        model=device.model,
        serial_number=device.serial_number,
        firmware_version=device.firmware_version,
        date=utc_date(now or datetime.now(UTC)),
        valid_days=plan.valid_days,
        software=SOFTWARE,
        conditions=conditions,
        verdict="failed" if problems else "passed",
        problems=tuple(map(stored_text, problems)),
        quantities=findings.quantities,
        tables=findings.tables,
        messages=stored_messages((*problems, *findings.notes)),
    )
    if calibration.verdict == "passed" and (strange := first_implausible(calibration, instrument.nominal)):
        problem = Message(
            "calibration.implausible",
            "{reason}: this is not plausible; check the fixture and the wiring",
            reason=strange,
        )
        messages = stored_messages((problem, *findings.notes))
        failed = {"verdict": "failed", "problems": (stored_text(problem),), "messages": messages}
        calibration = calibration.model_copy(update=failed)
    return StaticCalibration(calibration, findings.notes, time.perf_counter() - begin)
