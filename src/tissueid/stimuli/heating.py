"""How warm a coil gets from what is played: one heat capacity, one way out for the heat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from tissueid.stimuli.base import Array


@dataclass(frozen=True)
class Range:
    """A figure that is assumed, with the least and the most that it may be."""

    least: float
    usual: float
    most: float


@dataclass(frozen=True)
class Thermal:
    """Thermal figures of a coil: assumptions, since no source gives them for this one.

    The thesis winds 12 ohm of 28 gage copper (2.2.1): 0.213 ohm/m and 0.72 g/m make 56 m and 40 g, at 385 J/(kg K) 16
    J/K. That is the least heat capacity; what part of the bobbin warms with the wire adds up to half of it. Some 50
    cm2 of surface at 12 to 50 W/(m2 K), still air to air that the moving coil stirs, make 4 to 16 K/W. The resistance
    is taken as cold: warm copper at the same voltage takes less current, so the figures err to the high side.
    """

    heat_capacity_j_per_k: Range = Range(16.0, 20.0, 25.0)
    resistance_k_per_w: Range = Range(4.0, 8.0, 16.0)


@dataclass(frozen=True)
class Heating:
    """By how much a coil warms at the most while a stimulus is played, K.

    ``expected`` is for the usual figures; ``least`` and ``most`` are for their ranges; ``bound`` is what the wire alone
    would reach if it kept all its heat: no coil of this wire gets warmer. ``energy_j`` is the heat, J.
    """

    expected_k: float
    least_k: float
    most_k: float
    bound_k: float
    energy_j: float


def heating(current_a: Array, resistance_ohm: float, sample_rate_hz: float, thermal: Thermal | None = None) -> Heating:
    """Heating of a coil by a current (n,), A, each value held for one sample, from a coil at the room's temperature.

    Solves C dT/dt = I^2 R - T / R_th exactly for a held current.
    """
    figures = thermal or Thermal()
    capacity, resistance = figures.heat_capacity_j_per_k, figures.resistance_k_per_w
    power = current_a**2 * resistance_ohm  # (n,) W
    energy = float(np.sum(power)) / sample_rate_hz

    def warmest(capacity_j_per_k: float, resistance_k_per_w: float) -> float:
        kept = float(np.exp(-1.0 / (sample_rate_hz * capacity_j_per_k * resistance_k_per_w)))
        return float(np.max(signal.lfilter([(1.0 - kept) * resistance_k_per_w], [1.0, -kept], power)))

    return Heating(
        expected_k=warmest(capacity.usual, resistance.usual),
        least_k=warmest(capacity.most, resistance.least),
        most_k=warmest(capacity.least, resistance.most),
        bound_k=energy / capacity.least,
        energy_j=energy,
    )
