"""The sensors: position along the stroke, thermometer, accelerometer; what supplies and mains do to all channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.findings import Findings, column, quantity
from tissueid.calibration.levels import Levels, mean, noise_of_mean
from tissueid.calibration.line import Line, straight_line
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)
_MAINS_CHANCE = 1e-6
"""Noise alone shows mains as clearly as this once in so many channels and lines."""

MOST_NONLINEAR = 0.01
"""Share of the span by which one position may be off the line."""
_LEAST_GAIN = 0.1
MOST_TEMPERATURE_JUMP_C = 2.0
JUMP_S = 0.1
_HEATING_SEEN_J = 20.0
_LEAST_RISE_C_PER_J = 0.005
MOST_ACCELERATION_ERROR = 0.15
MOST_SUPPLY_DRIFT = 0.005
MOST_POSITION_DRIFT_M = 20e-6
"""By so much, and four deviations, may the same place read differently at the end."""
NOISE_BOUNDS = {"voltage": 0.05, "current": 0.10, "position": 20e-6, "temperature": 1.0, "acceleration_x": 1.0}
"""Noise of a sample beyond which a channel is not fit for use, SI: some five to twenty times the ordinary."""
_UNITS = {"voltage": "V", "current": "A", "position": "m", "temperature": "degC", "acceleration_x": "m/s^2"}
_SUFFIX = {"voltage": "v", "current": "a", "position": "m", "temperature": "c", "acceleration_x": "m_s2"}


def position_line(truth_m: NDArray[np.float64], rests: Sequence[NDArray[np.void]]) -> Line:
    """Readings at rest, samples for each place, against known places, shape (n,).

    Raises:
        UnusableInputError: fewer than three places, or they agree on no line, or all read the same.
    """
    readings = np.array([mean(rest, "position") for rest in rests])
    noise = max(noise_of_mean(rest, "position") for rest in rests)
    line = straight_line(truth_m, readings, noise)
    if abs(line.slope.value) < _LEAST_GAIN:
        raise UnusableInputError("the position reads the same at every place: check its sensor, and the fixture")
    return line


def position_findings(truth_m: NDArray[np.float64], line: Line, offset_m: Estimate | None) -> Findings:
    """Gain and offset of the position channel, and how far it is from straight.

    ``offset_m`` is the reading where the position is nothing; None where only distances between places were known.
    """
    span = float(np.ptp(truth_m)) * line.slope.value
    problems = []
    if line.worst > MOST_NONLINEAR * abs(span):
        problems.append(
            f"the position sensor is not straight: {1e6 * line.worst:.0f} um off over {1e3 * abs(span):.1f} mm"
        )
    if not 0.8 < line.slope.value < 1.2:
        problems.append(f"one millimetre reads as {line.slope.value:.3f} mm: that is not believed; check the places")
    count = int(np.count_nonzero(line.outliers))
    quantities = {
        "position_gain": quantity(line.slope, ""),
        "position_nonlinearity_m": quantity(line.worst, "m"),
    }
    if offset_m is not None:
        quantities["position_offset_m"] = quantity(offset_m, "m")
    return Findings(
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
        notes=(f"position along the stroke: {count} of {line.outliers.size} places left out",) if count else (),
    )


def temperature_findings(rest: NDArray[np.void], levels: Levels, ambient_c: float | None) -> Findings:
    """The thermometer: its zero against the room's temperature before the coil is used, and if it follows heat."""
    reading = mean(rest, "temperature")
    rise = levels.last_temperature_c - levels.first_temperature_c
    problems = []
    if levels.heat_j > _HEATING_SEEN_J and not rise > _LEAST_RISE_C_PER_J * levels.heat_j:
        problems.append(
            f"the thermometer rises by {rise:.2f} °C where {levels.heat_j:.0f} J went into the coil: "
            "see whether it is loose or broken; its limit cannot be relied on"
        )
    jump = _largest_jump(rest["temperature"], levels)
    if jump > MOST_TEMPERATURE_JUMP_C:
        problems.append(f"the thermometer jumps by {jump:.1f} °C: see whether it has a loose contact")
    quantities = {
        "temperature_at_rest_c": quantity(Estimate(reading, noise_of_mean(rest, "temperature")), "degC"),
        "temperature_rise_c": quantity(rise, "degC"),
        "heat_j": quantity(levels.heat_j, "J"),
    }
    notes: tuple[str, ...] = ("the thermometer's zero was not found: the room's temperature was not given",)
    if ambient_c is not None:
        notes = ()
        offset = reading - ambient_c
        quantities["temperature_offset_c"] = quantity(Estimate(offset, noise_of_mean(rest, "temperature")), "degC")
        if abs(offset) > 10.0:
            problems.append(
                f"the thermometer reads {reading:.1f} °C in a room of {ambient_c:.1f} °C: "
                "let the coil cool, or see to it"
            )
    return Findings(quantities=quantities, problems=tuple(problems), notes=notes)


def _largest_jump(temperature: NDArray[np.float64], levels: Levels) -> float:
    """The largest step between neighbouring means over a tenth of a second, degC, at rest and at no voltage."""
    found = 0.0
    for values in (temperature, levels.rest["temperature"]):
        parts = np.array_split(values, max(2, round(values.size / 200)))
        means = np.array([float(np.mean(part)) for part in parts if part.size])
        found = max(found, float(np.abs(np.diff(means)).max(initial=0.0)))
    return found


def acceleration_findings(rest: NDArray[np.void], turned: NDArray[np.void] | None) -> Findings:
    """The accelerometer along the stroke: gravity is what it is held against.

    From one way up, the gain is found as if its zero were right; ``turned`` is what it reads the other way up, by which
    zero and gain are known both.
    """
    along, across = mean(rest, "acceleration_x"), mean(rest, "acceleration_y")
    noise = noise_of_mean(rest, "acceleration_x")
    quantities, notes, problems = {}, [], []
    if turned is None:
        gain, std = float(np.hypot(along, across)) / GRAVITY_M_S2, noise / GRAVITY_M_S2
        notes.append("the accelerometer's zero is taken for right: the instrument was not turned over")
        offset = 0.0
    else:
        other = mean(turned, "acceleration_x")
        far = Estimate(0.5 * (along + other), noise)
        cosine = float(np.cos(np.arctan2(across, along - far.value)))
        gain = abs(0.5 * (along - other) / (GRAVITY_M_S2 * (abs(cosine) or 1.0)))
        std, offset = noise / GRAVITY_M_S2, far.value
        quantities["acceleration_offset_m_s2"] = quantity(far, "m/s^2")
    if abs(gain - 1.0) > MOST_ACCELERATION_ERROR:
        problems.append(
            f"the accelerometer reads {gain:.2f} times gravity at rest: hold the instrument still, or see to it"
        )
    quantities["acceleration_gain"] = quantity(Estimate(gain, std), "")
    gravity = (along - offset) / (gain or 1.0)
    quantities["gravity_along_stroke_m_s2"] = quantity(Estimate(gravity, noise), "m/s^2")
    return Findings(quantities=quantities, problems=tuple(problems), notes=tuple(notes))


def supply_findings(
    first: Findings,
    last: Findings,
    rest: NDArray[np.void],
    again: NDArray[np.void],
    device: DeviceDescription,
    *,
    same_place: bool = True,
) -> Findings:
    """What the supplies changed between the beginning and the end, how noisy the channels are, and the mains in them.

    ``first`` and ``last`` are the electrical steps, ``rest`` and ``again`` what was read before each, the coil free.
    With ``same_place`` false the spring was put back by hand meanwhile, and where it stands says nothing.
    """
    quantities, problems, notes = {}, [], []
    if same_place:
        moved = mean(again, "position") - mean(rest, "position")
        moved_std = float(np.hypot(noise_of_mean(rest, "position"), noise_of_mean(again, "position")))
        quantities["supply_position_drift_m"] = quantity(moved, "m", moved_std)
        if abs(moved) > MOST_POSITION_DRIFT_M + 4.0 * moved_std:
            problems.append(
                f"position at rest changed by {1e6 * moved:+.0f} um within the calibration: see whether the spring is "
                "seated, and let the supplies warm up"
            )
    for name, what, scale in (
        ("coil_resistance_ohm", "resistance", device.coil_resistance_ohm),
        ("voltage_gain", "voltage", device.amplifier_gain),
        ("current_offset_a", "current_zero", 1.0),
    ):
        before, after = first.quantities[name], last.quantities[name]
        drift = (after.value - before.value) / scale
        std = float(np.hypot(before.std or 0.0, after.std or 0.0)) / scale
        unit = "A" if name == "current_offset_a" else ""
        quantities[f"supply_{what}_drift"] = quantity(Estimate(drift, std), unit)
        if abs(drift) > MOST_SUPPLY_DRIFT + 4.0 * std:
            much = f"{1e3 * drift:+.1f} mA" if unit else f"{100 * drift:+.2f} %"
            problems.append(
                f"{what.replace('_', ' ')} changed by {much} within the calibration: let the supplies warm up, "
                "and check them"
            )
    for name, bound in NOISE_BOUNDS.items():
        values = np.asarray(rest[name], np.float64)
        noise = float(np.std(np.diff(values)) / np.sqrt(2.0))
        quantities[f"noise_{name}_{_SUFFIX[name]}"] = quantity(noise, _UNITS[name])
        if noise > bound:
            problems.append(f"{name.replace('_', ' ')} is too noisy at rest: {noise:.3g} {_UNITS[name]} a sample")
        hertz, amplitude = mains(values, device.sample_rate_hz)
        if hertz:
            quantities[f"mains_{name}_{_SUFFIX[name]}"] = quantity(amplitude, _UNITS[name])
            notes.append(f"the mains are in {name.replace('_', ' ')}: {amplitude:.2g} {_UNITS[name]} at {hertz:g} Hz")
    return Findings(quantities=quantities, problems=tuple(problems), notes=tuple(notes))


def mains(values: NDArray[np.float64], rate_hz: float) -> tuple[float, float]:
    """Frequency, Hz, and amplitude of the strongest mains line in values, shape (n,); 0 and 0 where noise explains all.

    The power at the line is held against that at the frequencies beside it, 1.5 to 6 Hz off.
    """
    time = np.arange(values.size) / rate_hz
    values = (values - values.mean()) * np.hanning(values.size)

    def power(hertz: float) -> float:
        return float(np.abs(values @ np.exp(-2j * np.pi * hertz * time)) ** 2)

    best = 0.0, 0.0
    for hertz in MAINS_HZ:
        beside = [power(hertz + off) for distance in (1.5, 3.0, 4.5, 6.0) for off in (distance, -distance)]
        floor = float(np.mean(beside))
        # Power of noise over its mean from 8 others, 2 degrees of freedom each, follows F(2, 16).
        if floor > 0 and (1.0 + power(hertz) / floor / len(beside)) ** -len(beside) < _MAINS_CHANCE:
            amplitude = 2.0 * float(np.sqrt(power(hertz))) / (0.5 * values.size)
            if amplitude > best[1]:
                best = hertz, amplitude
    return best
