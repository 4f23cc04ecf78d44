"""The coil: voltage to current to force, from steady voltages of both signs against a known spring or known weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.findings import Findings, column, quantity
from tissueid.calibration.levels import Levels, mean, noise_of_mean
from tissueid.calibration.line import Line, straight_line
from tissueid.calibration.plausible import IMPLAUSIBLE
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.records import Estimate

MOST_BENT = 0.01
"""A line whose points lie further off than this share of what they span is none."""
MOST_HYSTERESIS = 0.01
MOST_OUTLIERS = 0.25
MOST_LEAK_A = 0.01
UNKNOWN_GAIN = 0.01
"""Relative deviation of the position scale where it was not calibrated."""


@dataclass(frozen=True)
class Spring:
    """What the force is held against: its stiffness, N/m, and how well that is known (relative standard deviation)."""

    stiffness_n_per_m: float = 1000.0
    relative_std: float = 0.02


def electrical_findings(levels: Levels, rest: NDArray[np.void], device: DeviceDescription) -> Findings:
    """Voltage to current: resistance, zeros of both channels, voltage against the command.

    All are in the channels' own units: what they call a volt and an ampere. ``rest`` are samples with the coil free, in
    which neither voltage nor current is anything but its channel's zero.

    Raises:
        UnusableInputError: no current flows.
    """
    zeros = {name: Estimate(mean(rest, name), noise_of_mean(rest, name)) for name in ("voltage", "current")}
    voltage = levels.voltage_v - zeros["voltage"].value
    line = straight_line(voltage, levels.current_a, levels.noise["current"])
    resistance = resistance_of(line, device)
    gain = straight_line(levels.command_v, levels.voltage_v, levels.noise["voltage"])
    leak = line.intercept.value - zeros["current"].value
    problems = [
        *_bent(line, levels.current_a, "current against voltage"),
        *_bent(gain, levels.voltage_v, "voltage against the command"),
        *_short(gain, levels),
        *_implausible("the coil's resistance", resistance.value, device.coil_resistance_ohm, "ohm"),
        *_implausible("the voltage for one volt of command", gain.slope.value, device.amplifier_gain, "V"),
    ]
    if abs(leak) > MOST_LEAK_A:
        problems.append(
            f"{1e3 * leak:.0f} mA flow where no voltage is: the zero of current or voltage depends on the amplifier"
        )
    return Findings(
        quantities={
            "coil_resistance_ohm": quantity(resistance, "ohm"),
            "current_offset_a": quantity(zeros["current"], "A"),
            "current_residual_a": quantity(line.scatter, "A"),
            "voltage_gain": quantity(gain.slope, ""),
            "voltage_offset_v": quantity(zeros["voltage"], "V"),
        },
        tables={
            "electrical": {
                "command_v": column(levels.command_v),
                "voltage_v": column(levels.voltage_v),
                "current_a": column(levels.current_a),
                "residual_a": column(line.residuals),
                "outlier": column(line.outliers | gain.outliers),
                "voltage_residual_v": column(gain.residuals),
            }
        },
        problems=tuple(problems),
        notes=(*_outliers(line, "current against voltage"), *_outliers(gain, "voltage against the command")),
    )


def resistance_of(line: Line, device: DeviceDescription) -> Estimate:
    """The coil's resistance from current against voltage.

    Raises:
        UnusableInputError: no current flows, or against the voltage.
    """
    conductance = line.slope
    if conductance.value * device.coil_resistance_ohm < -0.1:
        raise UnusableInputError(
            "the current reads against the voltage: one of the two channels is the wrong way round"
        )
    if conductance.value * device.coil_resistance_ohm < 0.1:
        raise UnusableInputError("no current flows through the coil: check that it is connected")
    return Estimate(1.0 / conductance.value, (conductance.std or 0.0) / conductance.value**2)


def spring_line(levels: Levels, zero_a: float) -> Line:
    """Position as it is read against current with its zero taken off, m and A.

    Raises:
        UnusableInputError: the levels agree on no line.
    """
    return straight_line(levels.current_a - zero_a, levels.position_m, levels.noise["position"])


def force_by_spring(
    levels: Levels,
    device: DeviceDescription,
    spring: Spring,
    position_gain: Estimate | None,
    zero_a: float,
    *,
    known: bool = True,
) -> Findings:
    """The force constant, in newtons for what the current channel calls an ampere, against a spring.

    With ``known`` false the spring only holds the probe, and the force constant that follows from it is not judged.

    The spring's length follows the current in a straight line of slope gain * force constant / stiffness, where the
    gain is that of the position channel. Every level but the outermost was come to from either side: their difference
    is the hysteresis. The deviation is that of the measurement; what the spring itself is uncertain by is in
    ``calibration_relative_uncertainty``, with all else.

    Raises:
        UnusableInputError: the levels agree on no line.
    """
    current = levels.current_a - zero_a
    line = spring_line(levels, zero_a)
    gain = position_gain or Estimate(1.0, UNKNOWN_GAIN)
    value = spring.stiffness_n_per_m * line.slope.value / gain.value
    repeatability = abs((line.slope.std or 0.0) / line.slope.value) if line.slope.value else 0.0
    scale = (gain.std or 0.0) / gain.value
    hysteresis = _hysteresis(levels)
    swing = float(np.ptp(levels.position_m))
    problems = [
        *_bent(line, levels.position_m, "position against current"),
        *(_implausible("the force constant", value, device.force_constant_n_per_a, "N/A") if known else ()),
    ]
    if hysteresis > MOST_HYSTERESIS * swing:
        problems.append(
            f"the spring comes to rest {1e6 * hysteresis:.0f} um apart from either side, over {1e3 * swing:.1f} mm: "
            "look for friction, or a spring that is not seated"
        )
    return Findings(
        quantities={
            "force_constant_n_per_a": quantity(value, "N/A", abs(value) * float(np.hypot(repeatability, scale))),
            "calibration_relative_uncertainty": quantity(
                float(np.sqrt(repeatability**2 + scale**2 + spring.relative_std**2)), ""
            ),
            "spring_n_per_m": quantity(spring.stiffness_n_per_m, "N/m", spring.relative_std * spring.stiffness_n_per_m),
            "spring_slope_m_per_a": quantity(line.slope, "m/A"),
            "force_position_m": quantity(line.intercept, "m"),
            "hysteresis_m": quantity(hysteresis, "m"),
        },
        tables={
            "force": {
                "current_a": column(current),
                "position_m": column(levels.position_m),
                "residual_m": column(line.residuals),
                "outlier": column(line.outliers),
            }
        },
        problems=tuple(problems),
        notes=tuple(_outliers(line, "position against current")),
        shared={
            "force_constant_n_per_a": 0.0 if position_gain is not None else abs(value) * scale,
            "spring_n_per_m": spring.relative_std * spring.stiffness_n_per_m,
        },
    )


def force_by_weights(
    series: Sequence[Levels], weights_kg: Sequence[float], device: DeviceDescription, along: float, zero_a: float
) -> Findings:
    """The force constant from known weights on the probe; ``series`` and ``weights_kg`` begin with none, 0 kg.

    A weight shifts the line of position against current; the current that shifts it back carries the weight. Neither
    the spring's stiffness nor the position scale matters. ``along`` is the cosine between the stroke and straight down.

    Raises:
        UnusableInputError: the levels agree on no line, or the stroke lies so flat that the weights do not pull on it.
    """
    if abs(along) < 0.5:
        raise UnusableInputError("known weights need the stroke upright: they do not pull along it as it lies")
    lines = [spring_line(one, zero_a) for one in series]
    slope = float(np.mean([line.slope.value for line in lines]))
    carried = np.array([(line.intercept.value - lines[0].intercept.value) / slope for line in lines])  # A
    newtons = np.asarray(weights_kg) * GRAVITY_M_S2 * along
    noise = series[0].noise["current"]
    constant = float(newtons @ carried / (carried @ carried)) if np.any(carried) else 0.0
    off = newtons - constant * carried
    scatter = float(np.sqrt(off @ off / max(1, carried.size - 2)))
    relative = max(scatter / abs(constant), noise) / float(np.linalg.norm(carried)) if constant else 1.0
    problems = _implausible("the force constant", constant, device.force_constant_n_per_a, "N/A")
    if np.abs(off).max() > MOST_BENT * np.ptp(newtons):
        problems.append("the weights agree on no line: check what each of them weighs, and that it hangs freely")
    stiffness = constant / slope
    return Findings(
        quantities={
            "force_constant_n_per_a": quantity(Estimate(constant, abs(constant) * relative), "N/A"),
            "calibration_relative_uncertainty": quantity(relative, ""),
            "spring_n_per_m": quantity(Estimate(stiffness, abs(stiffness) * relative), "N/m"),
        },
        tables={"weights": {"weight_n": column(newtons), "current_a": column(carried), "residual_n": column(off)}},
        problems=tuple(problems),
        notes=("the force constant is from known weights; the spring's stiffness follows from it",),
    )


def _hysteresis(levels: Levels) -> float:
    """The largest distance between two levels at one command, m; each came to rest from another side."""
    apart = [0.0]
    for volts in np.unique(levels.command_v):
        same: NDArray[np.float64] = levels.position_m[levels.command_v == volts]
        apart.append(float(np.ptp(same)))
    return max(apart)


def _bent(line: Line, values: NDArray[np.float64], what: str) -> list[str]:
    """What is wrong with a line, in words."""
    share = line.worst / float(np.ptp(values)) if np.ptp(values) else 0.0
    found = []
    if share > MOST_BENT:
        found.append(f"{what} is not a straight line: {100 * share:.1f} % of its span off")
    if np.mean(line.outliers) > MOST_OUTLIERS:
        found.append(f"{what}: {np.count_nonzero(line.outliers)} of {line.outliers.size} points lie off the line")
    return found


def _short(gain: Line, levels: Levels) -> list[str]:
    """Where the greatest command of either sign gives less voltage than the others promise."""
    for number in (int(np.argmax(levels.command_v)), int(np.argmin(levels.command_v))):
        command, voltage = levels.command_v[number], levels.voltage_v[number]
        promised = gain.at(float(command))
        if abs(command) > 0 and np.sign(command) * (promised - voltage) > MOST_BENT * abs(promised):
            return [
                f"the amplifier gives {voltage:.2f} V where {promised:.2f} V were to be expected: "
                "check its supply, the voltage is clipped"
            ]
    return []


def _outliers(line: Line, what: str) -> list[str]:
    count = int(np.count_nonzero(line.outliers))
    return [f"{what}: {count} of {line.outliers.size} points left out, see the table"] if count else []


def _implausible(what: str, value: float, nominal: float, unit: str) -> list[str]:
    if abs(value / nominal - 1.0) <= IMPLAUSIBLE:
        return []
    return [
        f"{what} comes out as {value:.4g} {unit} where the device says {nominal:.4g}: more than "
        f"{100 * IMPLAUSIBLE:.0f} % apart is not believed; check the fixture and the wiring"
    ]
