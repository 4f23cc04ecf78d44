"""What drives each test, and what of it the chain predicts: the whole chain, or as much of it as was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.equivalent import Equivalent, equivalent
from tissueid.sessions import Test

FloatArray = NDArray[np.float64]
DrivenBy = Literal["command", "voltage", "current", "input"]

UPSTREAM: dict[DrivenBy, tuple[str, ...]] = {
    "command": (),
    "voltage": ("voltage",),
    "current": ("voltage", "current"),
    "input": ("voltage", "current"),
}
"""Channels at or above what drives a test: they are not predicted."""
LEAST_SAMPLES = 100
_FIGURES = (
    "coil_resistance_ohm",
    "coil_inductance_h",
    "force_constant_n_per_a",
    "moving_mass_kg",
    "bearing_damping_n_s_per_m",
    "stroke_m",
    "calibration_relative_uncertainty",
)
_INPUTS = ("input", "force", "current", "voltage", "command")
_OUTPUTS = ("position", "output")
_LEAST_RECEIVED = 0.5
_MOST_STROKES = 10.0
_MOST_FORCES = 10.0
"""A figure so many times what the instrument can do is in another unit."""


@dataclass(frozen=True)
class Driven:
    """A test with what drives it, shape (n,), gapless, and its recorded signals, NaN where nothing was received."""

    test: Test
    by: DrivenBy
    command: FloatArray
    signals: dict[str, FloatArray]


def known_instrument(device: DeviceDescription) -> bool:
    """Whether a session says what its instrument is: only then has its chain a coil."""
    return all(np.isfinite(getattr(device, name)) and getattr(device, name) > 0.0 for name in _FIGURES)


def driven(test: Test, device: DeviceDescription) -> Driven:
    """What drives a test of a known instrument: its command if it has no gaps, or the first signal that was recorded.

    What is missing of a recorded one, at most half, is bridged by straight lines. A command says nothing where the
    session does not say what the amplifier makes of it.

    Raises:
        UnusableInputError: nothing does, or there is no position; says which.
    """
    signals: dict[str, FloatArray] = {
        name: np.where(np.isfinite(test.signals[name]), test.signals[name], np.nan)
        for name in ("voltage", "current", "position")
        if name in test.signals
    }
    if "position" not in signals:
        raise UnusableInputError("it has no position")
    _check_received("position", signals["position"])
    travel = float(np.nanmax(signals["position"]) - np.nanmin(signals["position"]))
    if travel > _MOST_STROKES * device.stroke_m:
        raise UnusableInputError(
            f"its position travels {travel:.3g} m, and the stroke is {device.stroke_m:.3g} m: is it in metres?"
        )
    if travel == 0.0 and test.kind != "quiet":
        raise UnusableInputError("its position never changes")
    command = test.signals.get("command")
    amplifier = all(np.isfinite(value) and value > 0.0 for value in (device.amplifier_gain, device.amplifier_limit_v))
    if test.kind == "spring" and not device.calibration_spring_n_per_m > 0.0:
        raise UnusableInputError("the session does not say how stiff its calibration spring is")
    if command is not None and amplifier and np.isfinite(command).all():
        return Driven(test, "command", np.ascontiguousarray(command, np.float64), signals)
    if "voltage" in signals and np.isfinite(signals["voltage"]).mean() >= _LEAST_RECEIVED:
        return Driven(test, "voltage", bridged(signals["voltage"]), signals)
    if "current" not in signals and "force" in test.signals:
        force = np.where(np.isfinite(test.signals["force"]), test.signals["force"], np.nan)
        most = device.amplifier_limit_v / device.coil_resistance_ohm * device.force_constant_n_per_a
        if amplifier and float(np.nanmax(np.abs(force), initial=0.0)) > _MOST_FORCES * most:
            raise UnusableInputError(
                f"its force reaches {np.nanmax(np.abs(force)):.3g} N, and the coil gives {most:.3g} N: is it in N?"
            )
        signals["current"] = force / device.force_constant_n_per_a
    if "current" in signals and np.isfinite(signals["current"]).mean() >= _LEAST_RECEIVED:
        return Driven(test, "current", bridged(signals["current"]), signals)
    if command is not None and not amplifier:
        raise UnusableInputError("the session says neither gain nor limit of the amplifier that its command goes to")
    if command is not None:
        raise UnusableInputError("its command has gaps, so that nothing can be played again")
    raise UnusableInputError("it has no command, voltage, current or force that drives it")


def bare(test: Test) -> tuple[str, str]:
    """Names of input and output of a test of no known instrument.

    Raises:
        UnusableInputError: there is none; says which.
    """
    output = next((name for name in _OUTPUTS if name in test.signals), None)
    given = next((name for name in _INPUTS if name in test.signals), None)
    if output is None:
        raise UnusableInputError("it has no position or output")
    if given is None:
        raise UnusableInputError("it has nothing that drives it: an input, a force, a current or a voltage")
    _check_received(output, test.signals[output])
    _check_received(given, test.signals[given])
    if not float(np.nanstd(test.signals[given])) > 0.0 or not float(np.nanstd(test.signals[output])) > 0.0:
        raise UnusableInputError("its input or output never changes")
    return given, output


def as_equivalent(tests: Sequence[Test], fitted: Sequence[Test]) -> tuple[Equivalent, list[Driven]]:
    """Tests of nothing but input and output as force and motion of a mass on a spring.

    Args:
        tests: all that ``bare`` takes, with the same names.
        fitted: those of them that say what it is like.
    """
    given, output = bare(tests[0])
    records = [(bridged(test.signals[given]), bridged(test.signals[output])) for test in fitted]
    units = tests[0].unit(given), tests[0].unit(output)
    about = equivalent(records, tests[0].sample_rate_hz, (given, output), units)
    rest = float(np.mean(np.concatenate([values for _, values in records])))
    middle = float(np.mean(np.concatenate([values for values, _ in records])))
    found = []
    for test in tests:
        force = about.input_n * (bridged(test.signals[given]) - middle)
        motion = about.output_m * (np.asarray(test.signals[output], np.float64) - rest)
        found.append(Driven(test, "input", np.ascontiguousarray(force), {"position": motion}))
    return about, found


def bridged(values: FloatArray) -> FloatArray:
    """The same with straight lines across what was not received, shape (n,)."""
    known = np.isfinite(values)
    if known.all():
        return np.ascontiguousarray(values, np.float64)
    where = np.arange(values.size)
    return np.interp(where, where[known], values[known])


def _check_received(name: str, values: FloatArray) -> None:
    received = float(np.isfinite(values).mean())
    if received < _LEAST_RECEIVED:
        raise UnusableInputError(f"{1 - received:.0%} of its {name} is missing")
