"""Effects between the command and the coil's terminals."""

from __future__ import annotations

from math import exp, pi, sin, sqrt
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numba import njit

from firmware_sim.effects import base
from firmware_sim.effects.base import Array, DrawConditions, Effect, ParameterRange, Stage, bounds, log_uniform


class Latency(Effect):
    """Delay of the command; ``level`` in seconds, also fractions of a sample."""

    name: ClassVar[str] = "latency"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "s"
    typical: ClassVar[float] = 1e-3

    level: Annotated[float, bounds(0.0, 0.02), log_uniform(1.5e-4, 4e-3)]


class AmplifierLag(Effect):
    """Two poles in the amplifier; ``level`` is the time constant of their natural frequency, s."""

    name: ClassVar[str] = "amplifier_lag"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "s"
    typical: ClassVar[float] = 4e-4

    level: Annotated[float, bounds(0.0, 0.01), log_uniform(4e-5, 1e-3)]
    damping_ratio: Annotated[float, bounds(0.3, 3.0), ParameterRange(0.65, 1.6)] = 1.0


class AmplifierClipping(Effect):
    """Limit of the output voltage; ``level`` is its reciprocal, 1/V, so that zero means no limit.

    ``share_below`` is the lower limit relative to the upper one. A soft limit is reached gradually; a hard one is a
    corner.
    """

    name: ClassVar[str] = "amplifier_clipping"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "1/V"
    typical: ClassVar[float] = 1.0 / 24.0

    level: Annotated[float, bounds(0.0, 1.0)]
    kind: Literal["hard", "soft"] = "hard"
    share_below: Annotated[float, bounds(0.1, 10.0), ParameterRange(0.6, 1.4)] = 1.0
    sharpness: Annotated[float, bounds(2.0, 30.0), log_uniform(4.0, 16.0)] = 8.0

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return a limit between 0.3 and 2.2 standard deviations above the mean."""
        limit = around.mean_v + around.spread_v * random.uniform(0.3, 2.2)
        return cls.model_validate(cls._drawn(random) | {"level": 1.0 / limit})


class AmplifierDeadband(Effect):
    """Crossover distortion: within ``level`` volts of zero the output has only ``share_left`` of its gain."""

    name: ClassVar[str] = "amplifier_deadband"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "V"
    typical: ClassVar[float] = 2.0

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.2, 5.0)]
    share_left: Annotated[float, bounds(0.0, 0.95), ParameterRange(0.0, 0.3)] = 0.0


class AmplifierDrift(Effect):
    """Drift of gain or offset from the start of each test: an exponential plus a random walk.

    ``level`` is the share of the gain, or of 10 V of offset, that the exponential reaches.
    """

    name: ClassVar[str] = "amplifier_drift"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 0.05

    level: Annotated[float, bounds(-0.8, 0.8), log_uniform(0.01, 0.25, either_sign=True)]
    of: Literal["gain", "offset"] = "gain"
    time_s: Annotated[float, bounds(0.05, 100.0), log_uniform(0.5, 6.0)] = 2.0
    walk_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.3)] = 0.1
    pattern: Annotated[int, bounds(0, 10_000)] = 1


class SlewRate(Effect):
    """Limit of the rate of change of the output; ``level`` is its reciprocal, s/V."""

    name: ClassVar[str] = "slew_rate"
    stage: ClassVar[Stage] = "drive"
    unit: ClassVar[str] = "s/V"
    typical: ClassVar[float] = 1.0 / 12_000.0
    listed: ClassVar[bool] = False

    level: Annotated[float, bounds(0.0, 1e-2), log_uniform(3e-5, 2e-4)]


@njit
def phase(pattern: float, k: int) -> float:
    """Return a pseudo-random angle, rad, determined by pattern and number."""
    x = sin(pattern * 12.9898 + k * 78.233) * 43758.5453
    return float(2.0 * pi * (x - np.floor(x)))


@njit
def walk(pattern: float, t: float) -> float:
    """Return a random-walk-like function of time t, s, of order 1 after 5 s (a Fourier sum over 80 s)."""
    value = 0.0
    for k in range(1, 25):
        angle = phase(pattern, k)
        value += (sin(2.0 * pi * k * t / 80.0 + angle) - sin(angle)) / k
    return 1.2 * value


@njit
def drive(commanded: float, t: float, step: float, first: bool, figures: Array, memory: Array, rings: Array) -> float:
    """Return the coil voltage for command times gain, volts, ``t`` seconds after the start of the test."""
    volts = commanded
    if figures[base.LATENCY, 0] != 0.0:
        volts = delayed(rings[0], memory[base.LATENCY], volts, figures[base.LATENCY, 0] / step, first)
    if figures[base.AMPLIFIER_DRIFT, 0] != 0.0:
        row = figures[base.AMPLIFIER_DRIFT]
        moved = row[0] * (1.0 - exp(-t / row[2]) + row[3] * walk(row[4], t))
        volts = volts * (1.0 + moved) if row[1] == 0.0 else volts + 10.0 * moved
    if figures[base.AMPLIFIER_LAG, 0] != 0.0:
        row, kept = figures[base.AMPLIFIER_LAG], memory[base.AMPLIFIER_LAG]
        if first:
            kept[0], kept[1] = volts, 0.0
        # Two poles with implicit integration of the rate: stable for any step.
        ratio = step / row[0]
        kept[1] = (kept[1] + ratio * (volts - kept[0]) / row[0]) / (1.0 + 2.0 * row[1] * ratio + ratio * ratio)
        kept[0] += step * kept[1]
        volts = kept[0]
    if figures[base.SLEW_RATE, 0] != 0.0:
        kept = memory[base.SLEW_RATE]
        if first:
            kept[0] = volts
        most = step / figures[base.SLEW_RATE, 0]
        kept[0] += min(max(volts - kept[0], -most), most)
        volts = kept[0]
    if figures[base.AMPLIFIER_DEADBAND, 0] != 0.0:
        row = figures[base.AMPLIFIER_DEADBAND]
        inside = min(max(volts, -row[0]), row[0])
        volts -= (1.0 - row[1]) * inside
    if figures[base.AMPLIFIER_CLIPPING, 0] != 0.0:
        volts = _clipped(volts, figures[base.AMPLIFIER_CLIPPING])
    return float(volts)


@njit
def _clipped(volts: float, row: Array) -> float:
    limit = 1.0 / row[0] if volts >= 0.0 else row[2] / row[0]
    if row[1] == 0.0:
        return float(min(max(volts, -limit), limit))
    return float(volts / (1.0 + (abs(volts) / limit) ** row[3]) ** (1.0 / row[3]))


@njit
def delayed(ring: Array, kept: Array, value: float, delay: float, first: bool) -> float:
    """Return the value of ``delay`` calls ago, also fractional, from a ring buffer; ``kept[0]`` is its index."""
    size = ring.shape[0]
    if first:
        ring[:] = value
        kept[0] = 0.0
    place = int(kept[0])
    ring[place] = value
    kept[0] = (place + 1) % size
    whole = int(delay)
    share = delay - whole
    return float((1.0 - share) * ring[(place - whole) % size] + share * ring[(place - whole - 1) % size])


@njit
def smooth_size(value: float, width: float) -> float:
    """Return a smooth approximation of |value|."""
    return sqrt(value * value + width * width) - width
