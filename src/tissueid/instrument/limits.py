"""Limits on force, position, coil temperature and time: checked before sending and on every sample received.

The firmware enforces the same limits independently (docs/protocol.md, section 5).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import LimitError

FORCE_MARGIN = 1.05
"""Ratio of the measured force that stops a test to its limit, so that noise does not stop a test at the limit."""

GENTLE_FORCE_N = 2.0
"""Maximum force limit, N, with which position limits may lie beyond the stroke: the search for the
ends touches them.
"""

BEYOND_STROKE_M = 1.0e-3
"""Greatest distance of position limits beyond an end of the stroke at gentle force, m."""

LEAST_FORCE_N = 0.1
"""Smallest force limit, N: with less, the noise of a current sensor would end a test at once."""

LIFT_S = 0.5
"""Time for lifting a free probe off the near end when the device points upwards, s."""


@dataclass(frozen=True)
class Limits:
    """Limits of a test. Defaults: research device (thesis 2.1: forces under 15 N).

    If ``max_force_n`` is 2 N or less, the position limits may lie up to 1 mm beyond the ends of the stroke.

    Raises:
        LimitError: a limit is not a positive number, the force limit is below ``LEAST_FORCE_N``, or the lower position
            limit is above the upper one.
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
                raise LimitError(
                    "limit.not_positive",
                    "the limit {name} must be a positive number, not {value:g}",
                    name=name,
                    value=value,
                )
        if self.max_force_n < LEAST_FORCE_N:
            raise LimitError(
                "limit.too_small",
                "the limit {name} must be at least {least:g}, not {value:g}",
                name="max_force_n",
                least=LEAST_FORCE_N,
                value=self.max_force_n,
            )
        if self.min_position_m >= self.max_position_m:
            raise LimitError("limit.positions_reversed", "the lower position limit is above the upper one")


RESEARCH = Limits()
CLINICAL = Limits(max_force_n=12.0)
"""For patients and volunteers (thesis 7.1.1: forces under 10 to 12 N)."""

PROFILES = {"research": RESEARCH, "clinical": CLINICAL}


def check_stimulus(
    command_v: NDArray[np.float64], device: DeviceDescription, limits: Limits, following: int = 0
) -> None:
    """Check a stimulus, shape (n,) in V, before any of it is sent. ``following`` is the number of set-points after it.

    Raises:
        LimitError: the duration, voltage or force exceeds its limit.
    """
    seconds = (command_v.size + following) / device.sample_rate_hz
    if seconds > limits.max_seconds:
        raise LimitError(
            "limit.stimulus_time",
            "the stimulus lasts {seconds:.1f} s in all, preload included; the limit is {limit:g} s",
            seconds=seconds,
            limit=limits.max_seconds,
        )
    check_command(command_v, device, limits)


def check_command(command_v: NDArray[np.float64], device: DeviceDescription, limits: Limits) -> None:
    """Check commands, shape (n,) in V, against the amplifier and the force limit.

    The force is that at standstill: gain V * force constant / resistance. Motion changes it by the back-EMF, which only
    the measured current shows.

    Raises:
        LimitError: the voltage or force exceeds its limit.
    """
    if command_v.ndim != 1 or command_v.size == 0 or not np.all(np.isfinite(command_v)):
        raise LimitError("limit.command", "the stimulus must be a sequence of finite voltages")
    volts = float(np.abs(command_v).max()) * device.amplifier_gain
    if volts > device.amplifier_limit_v:
        raise LimitError(
            "limit.voltage",
            "the stimulus needs {voltage:.1f} V; the amplifier gives {limit:g} V",
            voltage=volts,
            limit=device.amplifier_limit_v,
        )
    newtons = volts * device.force_constant_n_per_a / device.coil_resistance_ohm
    if newtons > limits.max_force_n:
        raise LimitError(
            "limit.stimulus_force",
            "the stimulus reaches {force:.1f} N; the limit is {limit:g} N",
            force=newtons,
            limit=limits.max_force_n,
        )


def check_limits(limits: Limits, device: DeviceDescription) -> None:
    """Check the position limits against the stroke of the device.

    Raises:
        LimitError: the upper limit is beyond the stroke; where the force limit is at most ``GENTLE_FORCE_N``, it may be
            beyond by up to ``BEYOND_STROKE_M``.
    """
    furthest = device.stroke_m + (BEYOND_STROKE_M if limits.max_force_n <= GENTLE_FORCE_N else 0.0)
    if limits.max_position_m > furthest:
        raise LimitError(
            "limit.beyond_stroke",
            "the limit max_position_m, {position:.1f} mm, is beyond the stroke of {stroke:g} mm",
            position=1e3 * limits.max_position_m,
            stroke=1e3 * device.stroke_m,
        )


def coil_too_hot(temperature_c: float, limits: Limits) -> LimitError:
    """Return the error for a coil above its temperature limit."""
    return LimitError(
        "limit.temperature",
        "the coil is at {temperature:.0f} °C; the limit is {limit:g} °C: let it cool",
        temperature=temperature_c,
        limit=limits.max_temperature_c,
    )


def check_samples(
    samples: NDArray[np.void], device: DeviceDescription, limits: Limits, first_index: int | None
) -> None:
    """Check arriving samples, shape (k,); samples that were not received are skipped.

    ``first_index`` is the index of the first sample of the running test; None if no test runs.

    Raises:
        LimitError: a value exceeds its limit. The caller releases the coil.
    """
    # fmax and fmin skip NaN.
    force = float(np.fmax.reduce(np.abs(samples["current"]), initial=-np.inf)) * device.force_constant_n_per_a
    if force > limits.max_force_n * FORCE_MARGIN:
        raise LimitError(
            "limit.force",
            "the force reached {force:.1f} N; the limit is {limit:g} N",
            force=force,
            limit=limits.max_force_n,
        )
    position_m = samples["position"]
    deep, shallow = (
        float(np.fmax.reduce(position_m, initial=-np.inf)),
        float(np.fmin.reduce(position_m, initial=np.inf)),
    )
    if deep > limits.max_position_m or shallow < limits.min_position_m:
        position = deep if deep > limits.max_position_m else shallow
        raise LimitError(
            "limit.position", "the probe reached the end of its stroke, at {position:.1f} mm", position=1e3 * position
        )
    if (temperature := float(np.fmax.reduce(samples["temperature"], initial=-np.inf))) > limits.max_temperature_c:
        raise coil_too_hot(temperature, limits)
    if first_index is not None and samples.size:
        seconds = (int(samples["index"][-1]) - first_index) / device.sample_rate_hz
        if seconds > limits.max_seconds + 1.0:
            raise LimitError(
                "limit.time",
                "the test ran for {seconds:.1f} s; the limit is {limit:g} s",
                seconds=seconds,
                limit=limits.max_seconds,
            )
