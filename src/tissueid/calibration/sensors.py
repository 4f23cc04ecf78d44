"""Static calibration of position sensor, thermometer and accelerometer; drift, noise and mains interference of all
channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition import play
from tissueid.calibration.file import CalibrationFindings, column, quantity
from tissueid.calibration.status import CHANNELS
from tissueid.calibration.step_levels import (
    Cancelled,
    Levels,
    OnProgress,
    StraightLine,
    mean,
    noise_of_mean,
    straight_line,
)
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import Instrument, Limits, join_blocks
from tissueid.language import marked
from tissueid.messages import Message, Quantity
from tissueid.records import Estimate

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)
"""Frequencies of mains interference, Hz."""
_MAINS_CHANCE = 1e-6
"""False positive rate of the mains detection, for each channel and frequency."""

MAX_NONLINEAR = 0.01
"""Largest deviation of a position from the line, relative to the span."""
_MIN_GAIN = 0.1
"""Minimum gain of a working position sensor."""
MAX_TEMPERATURE_JUMP_C = 2.0
"""Largest step of the thermometer within a tenth of a second, °C."""
_HEATING_SEEN_J = 20.0
"""Heat above which the thermometer must respond, J."""
_MIN_RISE_C_PER_J = 0.005
"""Minimum rise of the thermometer, °C per joule."""
_MAX_TEMPERATURE_OFFSET_C = 10.0
"""Largest difference of the thermometer from room temperature, °C."""
MAX_ACCELERATION_ERROR = 0.15
"""Largest relative error of the accelerometer."""
MAX_SUPPLY_DRIFT = 0.005
"""Largest relative drift of resistance and voltage, and drift of the current's zero, A, in addition to four standard
deviations."""
MAX_POSITION_DRIFT_M = 20e-6
"""Largest drift of the position at rest, m, in addition to four standard deviations."""
NOISE_BOUNDS = {"voltage": 0.05, "current": 0.10, "position": 20e-6, "temperature": 1.0, "acceleration_x": 1.0}
"""Maximum noise per sample of each channel, SI: about five to twenty times the usual noise."""
_UNITS = {"voltage": "V", "current": "A", "position": "m", "temperature": "degC", "acceleration_x": "m/s^2"}
_SHOWN = {"degC": "°C", "m/s^2": "m/s²"}
_SUFFIX = {"voltage": "v", "current": "a", "position": "m", "temperature": "c", "acceleration_x": "m_s2"}


def position_line(truth_m: NDArray[np.float64], rests: Sequence[NDArray[np.void]]) -> StraightLine:
    """Fit readings at rest, one set of samples per position, against known positions (n,), m.

    Raises:
        UnusableInputError: fewer than three positions, no line, or a sensor that does not respond.
    """
    readings = np.array([mean(rest, "position") for rest in rests])
    noise = max(noise_of_mean(rest, "position") for rest in rests)
    line = straight_line(truth_m, readings, noise)
    if abs(line.slope.value) < _MIN_GAIN:
        raise UnusableInputError(
            "calibration.position_stuck",
            "the position sensor reads the same at every position: check the sensor and the fixture",
        )
    return line


def position_findings(
    truth_m: NDArray[np.float64], line: StraightLine, offset_m: Estimate | None
) -> CalibrationFindings:
    """Return gain, offset and nonlinearity of the position channel.

    Args:
        truth_m: known positions (n,), m.
        line: fit of the readings.
        offset_m: reading at position zero; None if only distances between positions are known.
    """
    span = float(np.ptp(truth_m)) * line.slope.value
    problems = []
    if line.worst > MAX_NONLINEAR * abs(span):
        problems.append(
            Message(
                "calibration.nonlinear",
                "the position sensor is not linear: the largest deviation is {deviation} over {span}",
                deviation=Quantity(1e6 * line.worst, "µm"),
                span=Quantity(1e3 * abs(span), "mm", 1),
            )
        )
    if not 0.8 < line.slope.value < 1.2:
        problems.append(
            Message(
                "calibration.position_gain",
                "one millimetre reads as {reading:.3f} mm: this is not plausible; check the positions",
                reading=line.slope.value,
            )
        )
    count = int(np.count_nonzero(line.outliers))
    quantities = {
        "position_gain": quantity(line.slope, ""),
        "position_nonlinearity_m": quantity(line.worst, "m"),
    }
    if offset_m is not None:
        quantities["position_offset_m"] = quantity(offset_m, "m")
    return CalibrationFindings(
        quantities=quantities,
        tables={
            "position": {
                "position_m": column(truth_m),
                "reading_m": column(line.residuals + line.intercept.value + line.slope.value * truth_m),
                "residual_m": column(line.residuals),
                "outlier": column(line.outliers),
            }
        },
        problems=tuple(problems),
        notes=(
            Message(
                "calibration.positions_left_out",
                "position along the stroke: {count} of {points} positions were left out",
                count=count,
                points=line.outliers.size,
            ),
        )
        if count
        else (),
    )


def temperature_findings(rest: NDArray[np.void], levels: Levels, ambient_c: float | None) -> CalibrationFindings:
    """Return offset and rise of the thermometer, and its problems.

    Args:
        rest: samples before the coil was used.
        levels: readings of the voltage steps, which heat the coil.
        ambient_c: room temperature, °C; None if unknown.
    """
    reading = mean(rest, "temperature")
    rise = levels.last_temperature_c - levels.first_temperature_c
    problems = []
    if levels.heat_j > _HEATING_SEEN_J and not rise > _MIN_RISE_C_PER_J * levels.heat_j:
        problems.append(
            Message(
                "calibration.thermometer_stuck",
                "the thermometer rises by {rise} for {heat} into the coil: check whether it is loose or broken; the "
                "temperature limit cannot be relied on",
                rise=Quantity(rise, "°C", 2),
                heat=Quantity(levels.heat_j, "J"),
            )
        )
    jump = _largest_jump(rest["temperature"], levels)
    if jump > MAX_TEMPERATURE_JUMP_C:
        problems.append(
            Message(
                "calibration.thermometer_jumps",
                "the thermometer jumps by {jump}: check it for a loose contact",
                jump=Quantity(jump, "°C", 1),
            )
        )
    quantities = {
        "temperature_at_rest_c": quantity(Estimate(reading, noise_of_mean(rest, "temperature")), "degC"),
        "temperature_rise_c": quantity(rise, "degC"),
        "heat_j": quantity(levels.heat_j, "J"),
    }
    notes: tuple[str, ...] = (
        Message(
            "calibration.no_ambient", "the thermometer was not adjusted because the room temperature was not given"
        ),
    )
    if ambient_c is not None:
        notes = ()
        offset = reading - ambient_c
        quantities["temperature_offset_c"] = quantity(Estimate(offset, noise_of_mean(rest, "temperature")), "degC")
        if abs(offset) > _MAX_TEMPERATURE_OFFSET_C:
            problems.append(
                Message(
                    "calibration.thermometer_off",
                    "the thermometer reads {reading} in a room of {room}: let the coil cool, or check the thermometer",
                    reading=Quantity(reading, "°C", 1),
                    room=Quantity(ambient_c, "°C", 1),
                )
            )
    return CalibrationFindings(quantities=quantities, problems=tuple(problems), notes=notes)


def _largest_jump(temperature: NDArray[np.float64], levels: Levels) -> float:
    """Return the largest step between adjacent means over a tenth of a second, °C, at rest and at 0 V."""
    largest = 0.0
    for values in (temperature, levels.rest["temperature"]):
        parts = np.array_split(values, max(2, round(values.size / 200)))
        means = np.array([float(np.mean(part)) for part in parts if part.size])
        largest = max(largest, float(np.abs(np.diff(means)).max(initial=0.0)))
    return largest


def acceleration_findings(rest: NDArray[np.void], turned: NDArray[np.void] | None) -> CalibrationFindings:
    """Return gain and offset of the accelerometer along the stroke, relative to gravity.

    Args:
        rest: samples at rest.
        turned: samples at rest upside down, which give gain and offset; without them the offset is assumed to be zero.
    """
    along, across = mean(rest, "acceleration_x"), mean(rest, "acceleration_y")
    noise = noise_of_mean(rest, "acceleration_x")
    quantities, notes, problems = {}, [], []
    if turned is None:
        gain, std = float(np.hypot(along, across)) / GRAVITY_M_S2, noise / GRAVITY_M_S2
        notes.append(
            Message(
                "calibration.not_turned",
                "the zero of the accelerometer was not measured because the instrument was not turned over",
            )
        )
        offset = 0.0
    else:
        other = mean(turned, "acceleration_x")
        far = Estimate(0.5 * (along + other), noise)
        cosine = float(np.cos(np.arctan2(across, along - far.value)))
        gain = abs(0.5 * (along - other) / (GRAVITY_M_S2 * (abs(cosine) or 1.0)))
        std, offset = noise / GRAVITY_M_S2, far.value
        quantities["acceleration_offset_m_s2"] = quantity(far, "m/s^2")
    if abs(gain - 1.0) > MAX_ACCELERATION_ERROR:
        problems.append(
            Message(
                "calibration.accelerometer",
                "the accelerometer reads {gain:.2f} times gravity at rest: hold the instrument still, or check the "
                "accelerometer",
                gain=gain,
            )
        )
    quantities["acceleration_gain"] = quantity(Estimate(gain, std), "")
    gravity = (along - offset) / (gain or 1.0)
    quantities["gravity_along_stroke_m_s2"] = quantity(Estimate(gravity, noise), "m/s^2")
    return CalibrationFindings(quantities=quantities, problems=tuple(problems), notes=tuple(notes))


def supply_findings(
    first: CalibrationFindings,
    last: CalibrationFindings,
    rest: NDArray[np.void],
    again: NDArray[np.void],
    device: DeviceDescription,
    *,
    same_place: bool = True,
) -> CalibrationFindings:
    """Return the drift from the first to the last electrical step, and noise and mains interference of the channels.

    Args:
        first: first electrical step.
        last: last electrical step.
        rest: samples at rest before the first step.
        again: samples at rest before the last step.
        device: nominal values.
        same_place: False if the spring was replaced by hand in between; the position drift is then omitted.
    """
    quantities, problems, notes = {}, [], []
    if same_place:
        moved = mean(again, "position") - mean(rest, "position")
        moved_std = float(np.hypot(noise_of_mean(rest, "position"), noise_of_mean(again, "position")))
        quantities["supply_position_drift_m"] = quantity(moved, "m", moved_std)
        if abs(moved) > MAX_POSITION_DRIFT_M + 4.0 * moved_std:
            problems.append(
                Message(
                    "calibration.position_drift",
                    "the position at rest changed by {drift} during the calibration: check that the spring is seated, "
                    "and let the supplies warm up",
                    drift=Quantity(1e6 * moved, "µm"),
                )
            )
    for name, what, label, scale in (
        ("coil_resistance_ohm", "resistance", marked("resistance"), device.coil_resistance_ohm),
        ("voltage_gain", "voltage", marked("voltage"), device.amplifier_gain),
        ("current_offset_a", "current_zero", marked("zero of the current"), 1.0),
    ):
        before, after = first.quantities[name], last.quantities[name]
        drift = (after.value - before.value) / scale
        std = float(np.hypot(before.std or 0.0, after.std or 0.0)) / scale
        unit = "A" if name == "current_offset_a" else ""
        quantities[f"supply_{what}_drift"] = quantity(Estimate(drift, std), unit)
        if abs(drift) > MAX_SUPPLY_DRIFT + 4.0 * std:
            size = Quantity(1e3 * drift, "mA", 1) if unit else Quantity(100.0 * drift, "%", 2)
            problems.append(
                Message(
                    "calibration.supply_drift",
                    "{quantity} changed by {drift} during the calibration: let the supplies warm up, and check them",
                    quantity=label,
                    drift=size,
                )
            )
    for name, bound in NOISE_BOUNDS.items():
        values = np.asarray(rest[name], np.float64)
        noise = float(np.std(np.diff(values)) / np.sqrt(2.0))
        quantities[f"noise_{name}_{_SUFFIX[name]}"] = quantity(noise, _UNITS[name])
        if noise > bound:
            problems.append(
                Message(
                    "calibration.noisy",
                    "{channel} is too noisy at rest: {noise:.3g} {unit} per sample",
                    channel=CHANNELS[name],
                    noise=noise,
                    unit=_SHOWN.get(_UNITS[name], _UNITS[name]),
                )
            )
        hertz, amplitude = mains(values, device.sample_rate_hz)
        if hertz:
            quantities[f"mains_{name}_{_SUFFIX[name]}"] = quantity(amplitude, _UNITS[name])
            notes.append(
                Message(
                    "calibration.mains",
                    "mains interference in {channel}: {amplitude:.2g} {unit} at {frequency:g} Hz",
                    channel=CHANNELS[name],
                    amplitude=amplitude,
                    unit=_SHOWN.get(_UNITS[name], _UNITS[name]),
                    frequency=hertz,
                )
            )
    return CalibrationFindings(quantities=quantities, problems=tuple(problems), notes=tuple(notes))


def mains(values: NDArray[np.float64], rate_hz: float) -> tuple[float, float]:
    """Return frequency, Hz, and amplitude of the strongest mains line in values (n,); zeros without a significant line.

    The power at the line is compared with the power at neighbouring frequencies, 1.5 to 6 Hz away.
    """
    time = np.arange(values.size) / rate_hz
    values = (values - values.mean()) * np.hanning(values.size)

    def power(hertz: float) -> float:
        return float(np.abs(values @ np.exp(-2j * np.pi * hertz * time)) ** 2)

    best = 0.0, 0.0
    for hertz in MAINS_HZ:
        neighbours = [power(hertz + off) for distance in (1.5, 3.0, 4.5, 6.0) for off in (distance, -distance)]
        floor = float(np.mean(neighbours))
        # For noise, the power over the mean of 8 others, with 2 degrees of freedom each, follows F(2, 16).
        if floor > 0 and (1.0 + power(hertz) / floor / len(neighbours)) ** -len(neighbours) < _MAINS_CHANCE:
            amplitude = 2.0 * float(np.sqrt(power(hertz))) / (0.5 * values.size)
            if amplitude > best[1]:
                best = hertz, amplitude
    return best


MAX_FREE_FORCE_N = 2.0
"""Maximum force in free air, N, which limits the impact at the ends of the stroke."""
STROKE_TOLERANCE_M = 1.0e-3
"""Distance of the position limits outside the nominal stroke, m."""
PUSH_FORCES_N = (0.2, 0.4, 0.8)
"""Forces in addition to the weight, N, tried in order until the probe moves from end to end."""
CROSSING_S = 1.8
"""Time for one crossing of the stroke, s."""
RISE_S = 0.1
"""Duration of the raised cosine between two forces, s."""
_ROUNDS = 2
"""Crossings in each direction."""
_AT_END_S = 0.3
"""Final part of a crossing, s, in which the probe must be at rest."""
_STILL_M = 30e-6
"""Largest range of the position of a probe at rest, m."""
_MIN_STROKE = 0.5
"""Minimum length of a crossing, relative to the nominal stroke."""
MAX_STROKE_ERROR = 0.06
"""Largest relative difference of the stroke from the nominal one."""


@dataclass(frozen=True)
class Crossing:
    """One crossing of the stroke: speed, m/s, and current, A, at mid-stroke, and end position, m."""

    speed_m_per_s: float
    current_a: float
    current_std_a: float
    end_m: float


def cross_stroke(
    instrument: Instrument, gravity_m_s2: float, *, progress: OnProgress = lambda _: None, cancelled: Cancelled
) -> tuple[Crossing, ...]:
    """Move the probe from end to end and back, twice, with the lowest sufficient force and nothing under it.

    ``gravity_m_s2`` is gravity along the stroke, positive if it pulls the probe out.

    Raises:
        UnusableInputError: the probe does not move freely.
        CancelledError, LimitError, InstrumentError: the coil is released.
    """
    device = instrument.device
    weight = device.moving_mass_kg * gravity_m_s2
    limits = Limits(
        max_force_n=MAX_FREE_FORCE_N,
        min_position_m=-STROKE_TOLERANCE_M,
        max_position_m=device.stroke_m + STROKE_TOLERANCE_M,
    )
    for push in PUSH_FORCES_N:
        if abs(weight) + push > MAX_FREE_FORCE_N:
            break
        forces = np.array([push - weight, *([-push - weight, push - weight] * _ROUNDS)])
        hold = round(CROSSING_S * device.sample_rate_hz)
        ramp = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, round(RISE_S * device.sample_rate_hz)))
        parts, before = [], 0.0
        for force in forces:
            part = np.full(hold, force)
            part[: ramp.size] = before + ramp * (force - before)
            parts.append(part)
            before = float(force)
        command = np.concatenate(parts) * device.voltage_for_force(1.0)
        blocks: list[NDArray[np.void]] = []

        def take(samples: NDArray[np.void], fraction: float, blocks: list[NDArray[np.void]] = blocks) -> None:
            blocks.append(samples)
            progress(fraction)

        play(instrument, command, limits, on_samples=take, cancelled=cancelled)
        samples = join_blocks(blocks)
        crossings = [_crossing(samples[n * hold : (n + 1) * hold], device) for n in range(1, forces.size)]
        completed = tuple(crossing for crossing in crossings if crossing is not None)
        if len(completed) == len(crossings):
            return completed
    raise UnusableInputError(
        "calibration.stuck",
        "the probe does not move from end to end with {force:g} N: check that nothing is under it and nothing rubs",
        force=MAX_FREE_FORCE_N,
    )


def _crossing(samples: NDArray[np.void], device: DeviceDescription) -> Crossing | None:
    """Return the crossing in these samples; None if the probe did not move from end to end."""
    position = samples["position"]
    received = np.isfinite(position) & np.isfinite(samples["current"])
    late = position[-round(_AT_END_S * device.sample_rate_hz) :]
    late = late[np.isfinite(late)]
    if late.size < 10 or np.ptp(late) > _STILL_M:
        return None
    start, end = float(position[received][0]), float(late.mean())
    if abs(end - start) < _MIN_STROKE * device.stroke_m:
        return None
    share = (position - start) / (end - start)
    middle = received & (share > 0.25) & (share < 0.75)
    if np.count_nonzero(middle) < 10:
        return None
    seconds = samples["index"][middle].astype(np.float64) / device.sample_rate_hz
    speed = float(np.polynomial.polynomial.polyfit(seconds - seconds[0], position[middle], 1)[1])
    current = samples["current"][middle]
    return Crossing(speed, float(current.mean()), float(current.std() / np.sqrt(current.size)), end)


def balancing_current(crossings: tuple[Crossing, ...]) -> Estimate:
    """Return the current, A, that balances the weight of the moving part.

    Friction is equal in both directions, and the speeds are similar: scaled to equal speed, the currents of both
    directions are symmetric about the balancing current.
    """
    speed = np.array([crossing.speed_m_per_s for crossing in crossings])
    current = np.array([crossing.current_a for crossing in crossings])
    pairs = []
    for first, second in zip(range(0, speed.size, 2), range(1, speed.size, 2), strict=True):
        per_speed = (current[second] - current[first]) / (speed[second] - speed[first])
        pairs.append(0.5 * (current[first] + current[second]) - per_speed * 0.5 * (speed[first] + speed[second]))
    noise = float(np.linalg.norm([crossing.current_std_a for crossing in crossings])) / len(crossings)
    return Estimate(float(np.mean(pairs)), float(np.hypot(noise, np.ptp(pairs) / 2.0)))


def range_findings(
    crossings: tuple[Crossing, ...],
    device: DeviceDescription,
    *,
    position_gain: float,
    position_offset: Estimate,
    force_constant_n_per_a: float,
    zero_a: float,
) -> CalibrationFindings:
    """Return the ends of the stroke on the corrected position scale, and the weight of the moving part."""
    ends = np.array([(crossing.end_m - position_offset.value) / position_gain for crossing in crossings])
    low, high = ends[0::2], ends[1::2]
    carrying = balancing_current(crossings)
    unsure = (position_offset.std or 0.0) / position_gain
    length = float(high.mean() - low.mean())
    problems = []
    if abs(length / device.stroke_m - 1.0) > MAX_STROKE_ERROR:
        problems.append(
            Message(
                "calibration.stroke",
                "the stroke is {found}, but {nominal} by the device: check what is in the way of the probe",
                found=Quantity(1e3 * length, "mm", 1),
                nominal=Quantity(1e3 * device.stroke_m, "mm", 1),
            )
        )
    return CalibrationFindings(
        quantities={
            "stroke_min_m": quantity(float(low.mean()), "m", float(np.hypot(unsure, np.ptp(low) / 2.0))),
            "stroke_max_m": quantity(float(high.mean()), "m", float(np.hypot(unsure, np.ptp(high) / 2.0))),
            "carrying_current_a": quantity(Estimate(carrying.value - zero_a, carrying.std), "A"),
            "moving_weight_n": quantity(
                Estimate(
                    -force_constant_n_per_a * (carrying.value - zero_a),
                    None if carrying.std is None else force_constant_n_per_a * carrying.std,
                ),
                "N",
            ),
        },
        tables={
            "range": {
                "end_m": column(ends),
                "speed_m_per_s": column([crossing.speed_m_per_s for crossing in crossings]),
                "current_a": column([crossing.current_a for crossing in crossings]),
            }
        },
        problems=tuple(problems),
    )
