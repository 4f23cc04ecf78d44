"""Temperature rise of a coil from a stimulus: first-order thermal model, one capacity and one resistance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from tissueid.stimuli.base import Array


@dataclass(frozen=True)
class AssumedValue:
    """Assumed value with a lower and an upper bound."""

    least: float
    usual: float
    most: float


@dataclass(frozen=True)
class ThermalParameters:
    """Assumed thermal parameters of the coil; no source gives measured ones.

    The thesis winds 12 ohm of 28 gauge copper (2.2.1): 0.213 ohm/m and 0.72 g/m give 56 m and 40 g, at 385 J/(kg K) 16
    J/K. That is the lower bound of the heat capacity; the part of the bobbin that warms with the wire adds up to half
    of it. About 50 cm2 of surface at 12 to 50 W/(m2 K), from still air to air stirred by the moving coil, give 4 to 16
    K/W. The resistance is that of the cold coil: warm copper draws less current at the same voltage, so the predictions
    err on the high side.
    """

    heat_capacity_j_per_k: AssumedValue = AssumedValue(16.0, 20.0, 25.0)
    resistance_k_per_w: AssumedValue = AssumedValue(4.0, 8.0, 16.0)


@dataclass(frozen=True)
class TemperatureRise:
    """Maximum temperature rise of a coil during a stimulus, K.

    ``expected_k`` uses the typical parameters, ``least_k`` and ``most_k`` their bounds. ``bound_k`` is the adiabatic
    rise of the wire alone, an upper limit for any coil of this wire. ``energy_j`` is the dissipated heat, J.
    """

    expected_k: float
    least_k: float
    most_k: float
    bound_k: float
    energy_j: float


def heating(
    current_a: Array, resistance_ohm: float, sample_rate_hz: float, thermal: ThermalParameters | None = None
) -> TemperatureRise:
    """Compute the heating of a coil, initially at room temperature, by a current (n,), A, held for one sample each.

    Solves C dT/dt = I^2 R - T / R_th exactly for a piecewise constant current.
    """
    figures = thermal or ThermalParameters()
    capacity, resistance = figures.heat_capacity_j_per_k, figures.resistance_k_per_w
    power = current_a**2 * resistance_ohm  # (n,) W
    energy = float(np.sum(power)) / sample_rate_hz

    def warmest(capacity_j_per_k: float, resistance_k_per_w: float) -> float:
        kept = float(np.exp(-1.0 / (sample_rate_hz * capacity_j_per_k * resistance_k_per_w)))
        return float(np.max(signal.lfilter([(1.0 - kept) * resistance_k_per_w], [1.0, -kept], power)))

    return TemperatureRise(
        expected_k=warmest(capacity.usual, resistance.usual),
        least_k=warmest(capacity.most, resistance.least),
        most_k=warmest(capacity.least, resistance.most),
        bound_k=energy / capacity.least,
        energy_j=energy,
    )
