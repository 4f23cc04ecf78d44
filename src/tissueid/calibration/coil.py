"""Static calibration of the coil: voltage to current to force, against a known spring or known weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.calibration.file import CalibrationFindings, column, quantity, utc_date
from tissueid.calibration.plans import Spring
from tissueid.calibration.status import IMPLAUSIBLE
from tissueid.calibration.step_levels import Levels, StraightLine, hold_levels, mean, noise_of_mean, straight_line
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import CLINICAL, Instrument, Limits
from tissueid.language import marked
from tissueid.messages import Message, Quantity
from tissueid.records import Estimate

MAX_NONLINEARITY = 0.01
"""Largest deviation of a point from its line, relative to the span of the points."""
MAX_HYSTERESIS = 0.01
"""Largest hysteresis, relative to the swing."""
MAX_OUTLIERS = 0.25
"""Largest share of outliers in a line fit."""
MAX_LEAK_A = 0.01
"""Largest current at 0 V, A."""
UNKNOWN_GAIN = 0.01
"""Relative standard deviation of the position scale without calibration."""
_CURRENT_LINE = marked("current against voltage")
_GAIN_LINE = marked("voltage against the command")
_SPRING_LINE = marked("position against current")
_RESISTANCE = marked("the coil resistance")
_VOLTAGE = marked("the voltage per volt of command")
_FORCE = marked("the force constant")


def electrical_findings(levels: Levels, rest: NDArray[np.void], device: DeviceDescription) -> CalibrationFindings:
    """Return resistance, channel offsets and voltage gain, from current against voltage against command.

    All are in the units of the uncalibrated channels. ``rest`` are samples with the coil free, which give the offsets
    of voltage and current.

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
        *_line_problems(line, levels.current_a, _CURRENT_LINE),
        *_line_problems(gain, levels.voltage_v, _GAIN_LINE),
        *_clipping_problem(gain, levels),
        *_nominal_problem(_RESISTANCE, resistance.value, device.coil_resistance_ohm, "Ω"),
        *_nominal_problem(_VOLTAGE, gain.slope.value, device.amplifier_gain, "V"),
    ]
    if abs(leak) > MAX_LEAK_A:
        problems.append(
            Message(
                "calibration.leak",
                "{current} flow at 0 V: the zero of current or voltage depends on the amplifier",
                current=Quantity(1e3 * leak, "mA"),
            )
        )
    return CalibrationFindings(
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
        notes=(*_outlier_notes(line, _CURRENT_LINE), *_outlier_notes(gain, _GAIN_LINE)),
    )


def resistance_of(line: StraightLine, device: DeviceDescription) -> Estimate:
    """Return the coil resistance, ohm, from the line of current against voltage.

    Raises:
        UnusableInputError: no current flows, or its sign is inverted.
    """
    conductance = line.slope
    if conductance.value * device.coil_resistance_ohm < -0.1:
        raise UnusableInputError(
            "calibration.inverted",
            "the current reading falls with the voltage: one of the two channels is inverted; check its wiring",
        )
    if conductance.value * device.coil_resistance_ohm < 0.1:
        raise UnusableInputError(
            "calibration.no_current", "no current flows through the coil: check that it is connected"
        )
    return Estimate(1.0 / conductance.value, (conductance.std or 0.0) / conductance.value**2)


def spring_line(levels: Levels, zero_a: float) -> StraightLine:
    """Fit position readings, m, against offset-corrected current.

    Raises:
        UnusableInputError: the levels do not lie on a line.
    """
    return straight_line(levels.current_a - zero_a, levels.position_m, levels.noise["position"])


def force_by_spring(
    levels: Levels,
    device: DeviceDescription,
    spring: Spring,
    position_gain: Estimate | None,
    zero_a: float,
    *,
    check_nominal: bool = True,
) -> CalibrationFindings:
    """Return the force constant, N per ampere reading, from the line of position against current with a spring.

    The slope of the line is gain * force constant / stiffness, with the gain of the position channel. The hysteresis is
    the difference between equal levels reached from above and from below. The standard deviation of the force constant
    covers the measurement; ``calibration_relative_uncertainty`` includes the uncertainty of the spring.

    Args:
        levels: readings of the voltage steps.
        device: nominal values.
        spring: known spring.
        position_gain: gain of the position channel; None if not calibrated.
        zero_a: offset of the current channel, A.
        check_nominal: False if the spring only holds the probe; the force constant is then not checked.

    Raises:
        UnusableInputError: the levels do not lie on a line.
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
        *_line_problems(line, levels.position_m, _SPRING_LINE),
        *(_nominal_problem(_FORCE, value, device.force_constant_n_per_a, "N/A") if check_nominal else ()),
    ]
    if hysteresis > MAX_HYSTERESIS * swing:
        problems.append(
            Message(
                "calibration.hysteresis",
                "the rest positions of the spring from both sides differ by {difference}, over a swing of {swing}: "
                "look "
                "for friction, or a spring that is not seated",
                difference=Quantity(1e6 * hysteresis, "µm"),
                swing=Quantity(1e3 * swing, "mm", 1),
            )
        )
    return CalibrationFindings(
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
        notes=tuple(_outlier_notes(line, _SPRING_LINE)),
        shared={
            "force_constant_n_per_a": 0.0 if position_gain is not None else abs(value) * scale,
            "spring_n_per_m": spring.relative_std * spring.stiffness_n_per_m,
        },
    )


def force_by_weights(
    series: Sequence[Levels], weights_kg: Sequence[float], device: DeviceDescription, along: float, zero_a: float
) -> CalibrationFindings:
    """Return the force constant from known weights on the probe.

    A weight shifts the line of position against current; the current that compensates the shift balances the weight.
    The result depends neither on the stiffness of the spring nor on the position scale.

    Args:
        series: readings of the voltage steps for each weight; the first without a weight.
        weights_kg: mass of each; the first is 0.
        device: nominal values.
        along: cosine of the angle between the stroke and the vertical.
        zero_a: offset of the current channel, A.

    Raises:
        UnusableInputError: the levels do not lie on a line, or the stroke is too far from vertical.
    """
    if abs(along) < 0.5:
        raise UnusableInputError(
            "calibration.not_upright", "known weights need a vertical stroke: place the instrument upright"
        )
    lines = [spring_line(levels, zero_a) for levels in series]
    slope = float(np.mean([line.slope.value for line in lines]))
    carried = np.array([(line.intercept.value - lines[0].intercept.value) / slope for line in lines])  # A
    newtons = np.asarray(weights_kg) * GRAVITY_M_S2 * along
    noise = series[0].noise["current"]
    constant = float(newtons @ carried / (carried @ carried)) if np.any(carried) else 0.0
    off = newtons - constant * carried
    scatter = float(np.sqrt(off @ off / max(1, carried.size - 2)))
    relative = max(scatter / abs(constant), noise) / float(np.linalg.norm(carried)) if constant else 1.0
    problems = _nominal_problem(_FORCE, constant, device.force_constant_n_per_a, "N/A")
    if np.abs(off).max() > MAX_NONLINEARITY * np.ptp(newtons):
        problems.append(
            Message(
                "calibration.weights_line",
                "the weights do not lie on a line: check the mass of each of them, and that it hangs freely",
            )
        )
    stiffness = constant / slope
    return CalibrationFindings(
        quantities={
            "force_constant_n_per_a": quantity(Estimate(constant, abs(constant) * relative), "N/A"),
            "calibration_relative_uncertainty": quantity(relative, ""),
            "spring_n_per_m": quantity(Estimate(stiffness, abs(stiffness) * relative), "N/m"),
        },
        tables={"weights": {"weight_n": column(newtons), "current_a": column(carried), "residual_n": column(off)}},
        problems=tuple(problems),
        notes=(
            Message(
                "calibration.by_weights",
                "the force constant is from known weights; the stiffness of the spring follows from it",
            ),
        ),
    )


def _hysteresis(levels: Levels) -> float:
    """Return the largest difference, m, between levels at the same command, which are reached from both sides."""
    apart = [0.0]
    for volts in np.unique(levels.command_v):
        same: NDArray[np.float64] = levels.position_m[levels.command_v == volts]
        apart.append(float(np.ptp(same)))
    return max(apart)


def _line_problems(line: StraightLine, values: NDArray[np.float64], what: str) -> list[str]:
    """Return the problems of a line fit: nonlinearity and too many outliers."""
    share = line.worst / float(np.ptp(values)) if np.ptp(values) else 0.0
    problems: list[str] = []
    if share > MAX_NONLINEARITY:
        problems.append(
            Message(
                "calibration.bent",
                "{line} is not a straight line: the largest deviation is {share} of its span",
                line=what,
                share=Quantity(100.0 * share, "%", 1),
            )
        )
    if np.mean(line.outliers) > MAX_OUTLIERS:
        problems.append(
            Message(
                "calibration.outliers",
                "{line}: {count} of {points} points lie off the line",
                line=what,
                count=int(np.count_nonzero(line.outliers)),
                points=line.outliers.size,
            )
        )
    return problems


def _clipping_problem(gain: StraightLine, levels: Levels) -> list[str]:
    """Return a problem if the voltage is clipped at the largest command of either sign."""
    for number in (int(np.argmax(levels.command_v)), int(np.argmin(levels.command_v))):
        command, voltage = levels.command_v[number], levels.voltage_v[number]
        promised = gain.at(float(command))
        if abs(command) > 0 and np.sign(command) * (promised - voltage) > MAX_NONLINEARITY * abs(promised):
            return [
                Message(
                    "calibration.clipped",
                    "the amplifier gives {voltage:.2f} V instead of the expected {expected:.2f} V: the voltage is "
                    "clipped; check the supply of the amplifier",
                    voltage=float(voltage),
                    expected=promised,
                )
            ]
    return []


def _outlier_notes(line: StraightLine, what: str) -> list[str]:
    count = int(np.count_nonzero(line.outliers))
    if not count:
        return []
    return [
        Message(
            "calibration.left_out",
            "{line}: {count} of {points} points were left out, see the table",
            line=what,
            count=count,
            points=line.outliers.size,
        )
    ]


def _nominal_problem(what: str, value: float, nominal: float, unit: str) -> list[str]:
    if abs(value / nominal - 1.0) <= IMPLAUSIBLE:
        return []
    return [
        Message(
            "calibration.off_nominal",
            "{quantity} is {value:.4g} {unit}, but {nominal:.4g} {unit} by the device: a difference of more than "
            "{percent:.0f} % is not plausible; check the fixture and the wiring",
            quantity=what,
            value=value,
            nominal=nominal,
            unit=unit,
            percent=100.0 * IMPLAUSIBLE,
        )
    ]


LEVELS_V = (0.0, 3.0, 6.0, 9.0, 12.0)
"""Voltages of the check, V: up to 3 N into the tissue."""
HOLD_S = 0.3
"""Time at each voltage, s."""


@dataclass(frozen=True)
class ElectricalCheck:
    """Result of the check: coil resistance, offset of the current channel, and noise at rest."""

    coil_resistance_ohm: Estimate
    current_offset_a: Estimate
    position_noise_m: float
    residual_a: float
    passed: bool
    date: str

    def as_calibration(self) -> dict[str, float | str]:
        """Return the check as the calibration attributes of a session."""
        return {
            "kind": "electrical check",
            "date": self.date,
            "coil_resistance_ohm": self.coil_resistance_ohm.value,
            "coil_resistance_std_ohm": self.coil_resistance_ohm.std or 0.0,
            "current_offset_a": self.current_offset_a.value,
            "position_noise_m": self.position_noise_m,
            "verdict": "passed" if self.passed else "failed",
        }


def check_coil(
    instrument: Instrument,
    limits: Limits = CLINICAL,
    *,
    tolerance: float = 0.05,
    progress: Callable[[float], None] = lambda _: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> ElectricalCheck:
    """Hold five voltages, fit current against measured voltage, and compare the resistance with the nominal one.

    The check passes if the resistance lies within the relative ``tolerance`` of the nominal value.

    Raises:
        UnusableInputError: a level has no samples, or the current does not follow the voltage (open coil).
    """
    levels = hold_levels(instrument, np.array(LEVELS_V), limits, hold_s=HOLD_S, progress=progress, cancelled=cancelled)
    line = straight_line(levels.voltage_v, levels.current_a, levels.noise["current"])
    device = instrument.device
    resistance = resistance_of(line, device)
    return ElectricalCheck(
        coil_resistance_ohm=resistance,
        current_offset_a=line.intercept,
        position_noise_m=float(np.std(np.diff(levels.rest["position"])) / np.sqrt(2.0)),
        residual_a=line.scatter,
        passed=bool(abs(resistance.value / device.coil_resistance_ohm - 1.0) <= tolerance),
        date=utc_date(),
    )
