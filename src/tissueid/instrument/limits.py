"""Limits on force, stroke, coil temperature and time: checked before sending and again on every sample received.

The firmware holds the same limits on its own (docs/protocol.md, section 5); neither relies on the other.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError

FORCE_MARGIN = 1.05
"""A running test is stopped this far above its force limit: noise on a test at the limit must not end it."""


GENTLE_FORCE_N = 2.0
"""Up to this force the probe may go to the ends of its stroke and lean on them: that is how they are found."""

BEYOND_STROKE_M = 1.0e-3
"""How far the position limits may then lie beyond either end."""

LIFT_S = 0.5
"""A device that points upwards has its free probe at the near end: a run may take so long to lift it off."""


@dataclass(frozen=True)
class Limits:
    """What a test may do. Defaults: the research device's (thesis 2.1: forces under 15 N).

    Where ``max_force_n`` is 2 N or less the position limits may lie up to 1 mm beyond the ends of the stroke.

    Raises:
        LimitError: a limit is none, or the lower position lies above the upper one.
    """

    max_force_n: float = 15.0
    min_position_m: float = 0.0003
    max_position_m: float = 0.0317
    max_temperature_c: float = 80.0
    max_seconds: float = 30.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            gentle = name == "min_position_m" and self.max_force_n <= GENTLE_FORCE_N
            if not np.isfinite(value) or not (value >= -BEYOND_STROKE_M if gentle else value > 0):
                raise LimitError(f"the limit {name} must be a positive number, not {value}")
        if self.min_position_m >= self.max_position_m:
            raise LimitError("the lower position limit lies above the upper one")


RESEARCH = Limits()
CLINICAL = Limits(max_force_n=12.0)
"""Gentler, for people who did not build the device (thesis 7.1.1: under 10 to 12 N)."""

PROFILES = {"research": RESEARCH, "clinical": CLINICAL}


def check_stimulus(
    command_v: NDArray[np.float64], device: DeviceDescription, limits: Limits, following: int = 0
) -> None:
    """Refuse a stimulus, shape (n,) in V, that would break a limit, before a byte of it is sent.

    ``following`` is how many set-points come after it: they count towards its length.

    Raises:
        LimitError: says which limit, and by how much.
    """
    seconds = (command_v.size + following) / device.sample_rate_hz
    if seconds > limits.max_seconds:
        raise LimitError(
            f"the stimulus lasts {seconds:.1f} s in all, preload included; the limit is {limits.max_seconds:g} s"
        )
    check_command(command_v, device, limits)


def check_command(command_v: NDArray[np.float64], device: DeviceDescription, limits: Limits) -> None:
    """Refuse commands, shape (n,) in V, that the amplifier cannot give or that push too hard.

    Force is judged at standstill, gain V * force constant / resistance. Motion with the push lowers it and motion
    against it raises it, which only the measured current shows.

    Raises:
        LimitError: says which limit, and by how much.
    """
    if command_v.ndim != 1 or command_v.size == 0 or not np.all(np.isfinite(command_v)):
        raise LimitError("the stimulus must be a row of finite voltages")
    volts = float(np.abs(command_v).max()) * device.amplifier_gain
    if volts > device.amplifier_limit_v:
        raise LimitError(f"the stimulus needs {volts:.1f} V; the amplifier gives {device.amplifier_limit_v:g} V")
    newtons = volts * device.force_constant_n_per_a / device.coil_resistance_ohm
    if newtons > limits.max_force_n:
        raise LimitError(f"the stimulus reaches {newtons:.1f} N; the limit is {limits.max_force_n:g} N")


def check_limits(limits: Limits, device: DeviceDescription) -> None:
    """Refuse position limits that lie beyond the device's stroke, but for gentle ones.

    Raises:
        LimitError: says how far the probe can go.
    """
    furthest = device.stroke_m + (BEYOND_STROKE_M if limits.max_force_n <= GENTLE_FORCE_N else 0.0)
    if limits.max_position_m > furthest:
        raise LimitError(
            f"the limit max_position_m, {limits.max_position_m * 1e3:.1f} mm, lies beyond the stroke of "
            f"{device.stroke_m * 1e3:g} mm"
        )


def check_samples(
    samples: NDArray[np.void], device: DeviceDescription, limits: Limits, first_index: int | None
) -> None:
    """Judge samples, shape (k,), as they arrive; samples that were not received are passed over.

    ``first_index`` is that of the running test's first sample, None when nothing is running.

    Raises:
        LimitError: says which limit and the value that broke it. The caller releases the coil.
    """

    def worst(values: NDArray[np.float64]) -> float:
        finite = values[np.isfinite(values)]
        return float(finite.max()) if finite.size else -np.inf

    force = worst(np.abs(samples["current"])) * device.force_constant_n_per_a
    if force > limits.max_force_n * FORCE_MARGIN:
        raise LimitError(f"the force reached {force:.1f} N; the limit is {limits.max_force_n:g} N")
    deep, shallow = worst(samples["position"]), -worst(-samples["position"])
    if deep > limits.max_position_m or shallow < limits.min_position_m:
        where = deep if deep > limits.max_position_m else shallow
        raise LimitError(f"the probe reached the end of its stroke, at {where * 1e3:.1f} mm")
    if (temperature := worst(samples["temperature"])) > limits.max_temperature_c:
        raise LimitError(
            f"the coil is at {temperature:.0f} °C; the limit is {limits.max_temperature_c:g} °C: let it cool"
        )
    if first_index is not None and samples.size:
        seconds = (int(samples["index"][-1]) - first_index) / device.sample_rate_hz
        if seconds > limits.max_seconds + 1.0:
            raise LimitError(f"the test ran for {seconds:.1f} s; the limit is {limits.max_seconds:g} s")
