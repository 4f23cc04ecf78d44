"""Parameters of the baseline chain: the instrument and the tissue."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class InstrumentParameters:
    """Amplifier, coil and moving part, SI (thesis 2.2.1, 2.3, Table 2.1). The order is the compiled loop's.

    ``weight_n`` is the moving part's weight along the stroke, positive into the tissue.
    """

    amplifier_gain: float = 1.0
    amplifier_limit_v: float = 48.0
    resistance_ohm: float = 12.0
    inductance_h: float = 1.0e-3
    force_constant_n_per_a: float = 3.0
    moving_mass_kg: float = 0.060
    bearing_damping_n_s_per_m: float = 3.5
    weight_n: float = 0.060 * STANDARD_GRAVITY
    stroke_m: float = 0.032
    filter_time_s: float = 0.0

    def to_array(self) -> NDArray[np.float64]:
        """Return all parameters in order, shape (10,)."""
        return np.array(list(vars(self).values()), np.float64)


@dataclass(frozen=True)
class Tissue:
    """Tissue as a dynamic parameter nonlinearity whose stiffness and damping grow exponentially with depth.

    Stiffness times depth is the force (thesis Eq. 3.33, 5.2 and C.1.4); the mass is constant. It acts on either side
    of ``surface_m``. The order is the compiled loop's.
    """

    surface_m: float = 0.010
    mass_kg: float = 0.025
    damping_n_s_per_m: float = 8.0
    damping_growth_per_m: float = 250.0
    stiffness_n_per_m: float = 500.0
    stiffness_growth_per_m: float = 250.0

    def to_array(self) -> NDArray[np.float64]:
        """Return all parameters in order, shape (6,)."""
        return np.array(list(vars(self).values()), np.float64)


def spring(rest_m: float, stiffness_n_per_m: float, mass_kg: float = 0.0, damping_n_s_per_m: float = 0.0) -> Tissue:
    """Return the parameters of the calibration spring, with its small moving mass and damping."""
    return Tissue(rest_m, mass_kg, damping_n_s_per_m, 0.0, stiffness_n_per_m, 0.0)


def nothing() -> Tissue:
    """Return the parameters of free air."""
    return Tissue(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
