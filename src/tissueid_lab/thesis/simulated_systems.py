"""Simulated systems of the thesis without an instrument: cascades of a curve and a linear stage, and a DPN system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record

RATE_HZ = 500.0
LAGS = 40
"""Length of the impulse response of the cascades, samples."""
_GAIN, _DAMPING_RATIO, _NATURAL_RAD_PER_S = 5.0, 0.5, 220.0
_INPUT_STD = 1.2
_REST = 20.0
"""Added to every output (C.3.1), and seen as the offset in Fig. 4.3."""
_C1, _C2 = 10.257, 0.2112
_SAMPLES, _WARM = 2740, 400
_STEPS = 8
"""Steps of integration to a sample of a DPN system."""

Curve = Literal["exponential", "square"]
Structure = Literal["Wiener", "Hammerstein"]


@dataclass(frozen=True, eq=False)
class SimulatedCascade:
    """Input and output, and the per-sample impulse response (lags,) of the linear stage."""

    record: Record
    impulse_response: Array


def simulated_cascade(structure: Structure, curve: Curve, seed: int = 1) -> SimulatedCascade:
    """Return a cascade with the constants of Chen 2010, C.3.1, under white Gaussian noise (Figs. 4.3 and 4.4).

    The impulse response ends at 40 samples, so that a model of that memory can hold all of it.
    """
    t = np.arange(LAGS) / RATE_HZ
    damped = _NATURAL_RAD_PER_S * np.sqrt(1.0 - _DAMPING_RATIO**2)
    h = np.exp(-_DAMPING_RATIO * _NATURAL_RAD_PER_S * t) * np.sin(damped * t)
    h *= _GAIN / h.sum()
    u = _INPUT_STD * np.random.Generator(np.random.PCG64(seed)).standard_normal(_SAMPLES + _WARM)

    def bent(v: Array) -> Array:
        return np.asarray(v**2 if curve == "square" else _C1 * (1.0 - np.exp(-_C2 * v)))

    def filtered(v: Array) -> Array:
        return np.convolve(v, h)[: v.size]

    y = bent(filtered(u)) if structure == "Wiener" else filtered(bent(u))
    return SimulatedCascade(Record(u[_WARM:], y[_WARM:] + _REST, RATE_HZ, "input", "output", "", ""), h)


@dataclass(frozen=True)
class DpnSystem:
    """M y'' + B exp(a y) y' + K (exp(b y) + d) y = force (Chen 2010, Eq. 3.33 and C.1.4), SI.

    ``mass``, ``damping`` and ``stiffness`` are its values for small motion about a position.
    """

    mass_kg: float = 0.06
    damping_n_s_per_m: float = 20.0
    stiffness_n_per_m: float = 1000.0
    damping_growth_per_m: float = 150.0
    stiffness_growth_per_m: float = 200.0
    stiffness_offset: float = 0.1

    def mass(self, position: Array) -> Array:
        """Return the mass at positions, kg."""
        return np.full_like(position, self.mass_kg)

    def damping(self, position: Array) -> Array:
        """Return the damping at positions, N s/m."""
        return np.asarray(self.damping_n_s_per_m * np.exp(self.damping_growth_per_m * position))

    def stiffness(self, position: Array) -> Array:
        """Return the slope of the static force at positions, N/m."""
        growth = self.stiffness_growth_per_m * position
        return np.asarray(self.stiffness_n_per_m * (np.exp(growth) * (1.0 + growth) + self.stiffness_offset))

    def position(self, force: Array, sample_rate_hz: float) -> Array:
        """Return positions (n,), m, under a force (n,), N, that is held between samples; at rest before the first."""
        step = 1.0 / (_STEPS * sample_rate_hz)
        y = v = 0.0
        positions = np.empty(force.size)
        for n, push in enumerate(force.tolist()):
            positions[n] = y
            for _ in range(_STEPS):  # semi-implicit: stable for a damped system at this step
                grown = np.exp(self.stiffness_growth_per_m * y)
                spring = self.stiffness_n_per_m * (grown + self.stiffness_offset) * y
                damping = self.damping_n_s_per_m * np.exp(self.damping_growth_per_m * y)
                v = (v + step * (push - spring) / self.mass_kg) / (1.0 + step * damping / self.mass_kg)
                y += step * v
        return positions


_LINEAR = SecondOrder(0.06, 20.0, 1000.0)
"""Mass, damping and stiffness of C.1.4."""


@dataclass(frozen=True)
class WienerSystem:
    """A second-order system and the curve C1 (1 - exp(-C2 K z)) (Chen 2010, Eq. 3.26 and C.1.4), SI."""

    system: SecondOrder = _LINEAR
    c1_m: float = 0.007
    c2_per_n: float = 0.2

    def mass(self, position: Array) -> Array:
        """Return the mass at positions, kg."""
        return self.system.mass * self._inverse_slope(position)

    def damping(self, position: Array) -> Array:
        """Return the damping at positions, N s/m."""
        return self.system.damping * self._inverse_slope(position)

    def stiffness(self, position: Array) -> Array:
        """Return the inverse slope of the curve at positions, N/m."""
        return self.system.stiffness * self._inverse_slope(position)

    def _inverse_slope(self, position: Array) -> Array:
        return np.asarray(1.0 / (self.c2_per_n * (self.c1_m - position) * self.system.stiffness))

    def position(self, force: Array, sample_rate_hz: float) -> Array:
        """Return positions (n,), m, under a force (n,), N, that is held between samples; at rest before the first."""
        load = self.system.stiffness * self.system.simulate(force, sample_rate_hz, "zero-order")
        return np.asarray(self.c1_m * (1.0 - np.exp(-self.c2_per_n * load)))


__all__ = ["LAGS", "RATE_HZ", "DpnSystem", "SimulatedCascade", "WienerSystem", "simulated_cascade"]
