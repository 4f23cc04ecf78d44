"""Effects on the recorded position, or on the record as a whole."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numba import njit

from firmware_sim.effects import base
from firmware_sim.effects.base import Array, DrawConditions, Effect, ParameterRange, Stage, bounds, log_uniform
from firmware_sim.effects.drive import delayed, phase

_LONGEST_TEST_S = 5.0


class SensorNonlinearity(Effect):
    """Nonlinear position reading: curved along the stroke (``bent``) or periodic (``cyclic``).

    ``level`` is the error 5 mm from the middle, m, or the amplitude of the first harmonic.
    """

    name: ClassVar[str] = "sensor_nonlinearity"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "m"
    typical: ClassVar[float] = 5e-5

    level: Annotated[float, bounds(-2e-3, 2e-3)]
    kind: Literal["bent", "cyclic"] = "cyclic"
    middle_m: Annotated[float, bounds(-0.01, 0.05), ParameterRange(0.006, 0.018)] = 0.012
    cubic_share: Annotated[float, bounds(-2.0, 2.0), ParameterRange(-1.0, 1.0)] = 0.3
    pitch_m: Annotated[float, bounds(1e-4, 0.03), log_uniform(0.0004, 0.003)] = 0.001
    second_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.5)] = 0.2
    pattern: Annotated[int, bounds(0, 10_000)] = 1

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return an error up to 1 mm, or a cyclic one limited relative to its pitch, for monotone readings."""
        values = cls._drawn(random)
        if values["kind"] == "bent":
            level = ParameterRange(8e-5, 1.2e-3, True, True).draw(random)
        else:
            level = float(str(values["pitch_m"])) / (2.0 * pi) * ParameterRange(0.03, 0.6, True).draw(random)
        return cls.model_validate(values | {"level": level})


class SensorLag(Effect):
    """Two poles in the position channel only; ``level`` is the time constant of their natural frequency, s."""

    name: ClassVar[str] = "sensor_lag"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "s"
    typical: ClassVar[float] = 1e-3

    level: Annotated[float, bounds(0.0, 0.05), log_uniform(1.2e-4, 4e-3)]
    damping_ratio: Annotated[float, bounds(0.3, 3.0), ParameterRange(0.7, 1.5)] = 1.0


class SensorBacklash(Effect):
    """Play between probe and sensor; ``level`` is its full width, m."""

    name: ClassVar[str] = "sensor_backlash"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "m"
    typical: ClassVar[float] = 6e-5

    level: Annotated[float, bounds(0.0, 2e-3), log_uniform(1e-5, 3e-4)]


class ClockSkew(Effect):
    """Separate clock of the position: its samples are delayed by a time that changes during the test.

    ``level`` is the relative error of the clock, positive if it is slow; ``offset_s`` is the initial delay.
    """

    name: ClassVar[str] = "clock_skew"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "1"
    typical: ClassVar[float] = 4e-4

    level: Annotated[float, bounds(-5e-3, 5e-3), log_uniform(3e-5, 1e-3, either_sign=True)]
    offset_s: Annotated[float, bounds(0.0, 0.05)] = 0.0

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return random parameters; a fast clock starts with a delay that keeps the reading causal."""
        values = cls._drawn(random)
        offset = random.uniform(0.0, 5e-4) + max(0.0, -float(str(values["level"])) * _LONGEST_TEST_S)
        return cls.model_validate(values | {"offset_s": offset})


class Quantization(Effect):
    """Coarse quantization of the position, rounded down; ``level`` is the step, m."""

    name: ClassVar[str] = "quantization"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "m"
    typical: ClassVar[float] = 4e-5

    level: Annotated[float, bounds(0.0, 1e-3), log_uniform(1.2e-5, 2e-4)]

    def applied(self, position_m: Array) -> Array:
        """Return quantized readings, m, in their shape."""
        return self.level * np.floor(position_m / self.level) if self.acts else position_m


class DroppedSamples(Effect):
    """Samples lost without a mark, so that all later ones are shifted. ``level`` is the number of lost samples per
    second.

    ``channels`` selects all measured channels, or the position only. Missing samples at the end are NaN. Only in the
    laboratory, where a record is complete before it is read.
    """

    name: ClassVar[str] = "dropped_samples"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "1/s"
    typical: ClassVar[float] = 2.0

    level: Annotated[float, bounds(0.0, 20.0), log_uniform(0.5, 3.0)]
    channels: Literal["all", "position"] = "all"
    most_at_once: Annotated[int, bounds(1, 20)] = 3

    @classmethod
    def draw(cls, random: np.random.Generator, around: DrawConditions) -> Self:
        """Return losses of one to four samples at once; in three of four cases of all channels."""
        channels = "all" if random.random() < 0.75 else "position"
        most = int(random.integers(1, 5))
        return cls.model_validate(cls._drawn(random) | {"channels": channels, "most_at_once": most})

    def kept(self, count: int, sample_rate_hz: float, random: np.random.Generator) -> tuple[int, ...]:
        """Return the indices of the remaining samples of ``count``."""
        if not self.acts:
            return tuple(range(count))
        seconds = count / sample_rate_hz
        losses = int(random.poisson(self.level * seconds / (0.5 * (1 + self.most_at_once))))
        gone: set[int] = set()
        for _ in range(max(losses, 1)):
            first = int(random.integers(round(0.05 * count), round(0.97 * count)))
            gone |= set(range(first, first + int(random.integers(1, self.most_at_once + 1))))
        return tuple(k for k in range(count) if k not in gone)


class CurrentCrosstalk(Effect):
    """Crosstalk of the coil current into the position channel; ``level`` in m/A."""

    name: ClassVar[str] = "current_crosstalk"
    stage: ClassVar[Stage] = "sensing"
    unit: ClassVar[str] = "m/A"
    typical: ClassVar[float] = 3e-5
    listed: ClassVar[bool] = False

    level: Annotated[float, bounds(-1e-3, 1e-3), log_uniform(8e-6, 2e-4, either_sign=True)]
    lag_s: Annotated[float, bounds(0.0, 0.1), log_uniform(2e-4, 4e-3)] = 1e-3


@njit
def sense(
    position: float, current: float, t: float, step: float, first: bool, figures: Array, memory: Array, rings: Array
) -> float:
    """Return the reading of the position sensor, m, at the end of a sub-step, ``t`` seconds after the start."""
    seen = position
    if figures[base.SENSOR_NONLINEARITY, 0] != 0.0:
        row = figures[base.SENSOR_NONLINEARITY]
        if row[1] == 0.0:
            z = min(max((position - row[2]) / 5e-3, -3.0), 4.0)
            seen += row[0] * z * z * (1.0 + row[3] * z) / (1.0 + abs(row[3]))
        else:
            turn = 2.0 * pi * position / row[4]
            seen += row[0] * (sin(turn + phase(row[6], 1)) + row[5] * cos(2.0 * turn + phase(row[6], 2)))
    if figures[base.SENSOR_BACKLASH, 0] != 0.0:
        half, kept = 0.5 * figures[base.SENSOR_BACKLASH, 0], memory[base.SENSOR_BACKLASH]
        if first:
            kept[0] = seen
        kept[0] = min(max(kept[0], seen - half), seen + half)
        seen = kept[0]
    if figures[base.SENSOR_LAG, 0] != 0.0:
        row, kept = figures[base.SENSOR_LAG], memory[base.SENSOR_LAG]
        if first:
            kept[0], kept[1] = seen, 0.0
        ratio = step / row[0]
        kept[1] = (kept[1] + ratio * (seen - kept[0]) / row[0]) / (1.0 + 2.0 * row[1] * ratio + ratio * ratio)
        kept[0] += step * kept[1]
        seen = kept[0]
    if figures[base.CLOCK_SKEW, 0] != 0.0:
        row = figures[base.CLOCK_SKEW]
        old = min(max(row[1] + row[0] * t, 0.0), 0.1)
        seen = delayed(rings[2], memory[base.CLOCK_SKEW], seen, old / step, first)
    if figures[base.CURRENT_CROSSTALK, 0] != 0.0:
        row, kept = figures[base.CURRENT_CROSSTALK], memory[base.CURRENT_CROSSTALK]
        if first:
            kept[0] = current
        kept[0] += (current - kept[0]) * step / (step + row[1])
        seen += row[0] * kept[0]
    return float(seen)
