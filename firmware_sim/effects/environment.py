"""Effects of the surroundings: mains hum, and motion of the body."""

from __future__ import annotations

from math import cos, exp, pi, sin
from typing import Annotated, ClassVar

import numpy as np
from numba import njit

from firmware_sim.effects.base import Array, Effect, ParameterRange, Stage, bounds, log_uniform
from firmware_sim.effects.drive import phase


class MainsHum(Effect):
    """Mains frequency with third and fifth harmonics on the measured channels, with a separate gain for each.

    ``level`` is the amplitude of the first harmonic on the voltage, V; those of other channels are relative to it.
    """

    name: ClassVar[str] = "mains_hum"
    stage: ClassVar[Stage] = "environment"
    unit: ClassVar[str] = "V"
    typical: ClassVar[float] = 0.1

    level: Annotated[float, bounds(0.0, 10.0), log_uniform(0.02, 0.8)]
    sixty: bool = False
    frequency_error: Annotated[float, bounds(-0.01, 0.01), ParameterRange(-0.002, 0.002)] = 0.0
    third_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.05, 0.5)] = 0.3
    fifth_share: Annotated[float, bounds(0.0, 1.0), ParameterRange(0.0, 0.3)] = 0.15
    current_a_per_v: Annotated[float, bounds(0.0, 10.0), log_uniform(0.02, 0.5)] = 0.1
    position_m_per_v: Annotated[float, bounds(0.0, 0.01), log_uniform(3e-5, 1e-3)] = 1e-4
    pattern: Annotated[int, bounds(0, 10_000)] = 1

    @classmethod
    def _drawn(cls, random: np.random.Generator) -> dict[str, object]:
        values = super()._drawn(random)
        return values | {"sixty": bool(int(str(values["pattern"])) % 2)}


class PhysiologicalMotion(Effect):
    """Motion of the surface by breathing, pulse and tremor; ``level`` is the height of a breath, m."""

    name: ClassVar[str] = "physiological_motion"
    stage: ClassVar[Stage] = "environment"
    unit: ClassVar[str] = "m"
    typical: ClassVar[float] = 3e-4

    level: Annotated[float, bounds(0.0, 0.01), log_uniform(1.2e-5, 6e-4)]
    breathing_hz: Annotated[float, bounds(0.05, 2.0), ParameterRange(0.15, 0.4)] = 0.25
    pulse_share: Annotated[float, bounds(0.0, 2.0), ParameterRange(0.03, 0.3)] = 0.12
    pulse_hz: Annotated[float, bounds(0.4, 4.0), ParameterRange(0.9, 1.7)] = 1.2
    tremor_share: Annotated[float, bounds(0.0, 2.0), ParameterRange(0.0, 0.08)] = 0.03
    tremor_hz: Annotated[float, bounds(3.0, 20.0), ParameterRange(8.0, 12.0)] = 9.5
    pattern: Annotated[int, bounds(0, 10_000)] = 1


@njit
def hum(t: float, channel: int, row: Array) -> float:
    """Return the hum at a session time, s, relative to the gain of the channel."""
    turn = 2.0 * pi * (60.0 if row[1] != 0.0 else 50.0) * (1.0 + row[2]) * t
    angle = phase(row[7], channel)
    value = sin(turn + angle)
    value += row[3] * sin(3.0 * turn + phase(row[7], 10 + channel))
    value += row[4] * sin(5.0 * turn + phase(row[7], 20 + channel))
    return float(row[0] * value)


@njit
def surface(t: float, row: Array) -> float:
    """Return the displacement of the surface towards the probe at a session time, m."""
    # Exhalation is longer than inhalation; a heartbeat is a wave with an echo; tremor is a beat of close frequencies.
    breath = 2.0 * pi * row[1] * t + phase(row[6], 1) + 0.3 * sin(2.0 * pi * 0.037 * t)
    raised = (0.5 * (1.0 + sin(breath + 0.6 * cos(breath)))) ** 1.6
    beat = 2.0 * pi * row[3] * t + phase(row[6], 2) + 0.5 * sin(breath) + 0.2 * sin(2.0 * pi * 0.1 * t)
    pulse = exp(6.0 * (cos(beat) - 1.0)) + 0.4 * exp(9.0 * (cos(beat - 1.9) - 1.0))
    tremor = 0.0
    for k in range(5):
        tremor += 0.4 * sin(2.0 * pi * row[5] * (1.0 + 0.045 * (k - 2)) * t + phase(row[6], 3 + k))
    return float(row[0] * (raised + row[2] * pulse + row[4] * tremor))
