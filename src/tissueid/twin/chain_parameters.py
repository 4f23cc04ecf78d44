"""Parameters of the baseline chain: the instrument and the tissue."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

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


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of the coupling; ``s[0]`` and ``s[1]`` are position (m) and velocity (m/s) of the second mass."""
    angular, other, own = 2.0 * math.pi * p[0], p[2], b[bus.MASS]
    force = 0.0
    if p[4] > 0.5:
        # The second mass is driven, and not the mass of the output.
        force = b[bus.FORCE_CONSTANT] * b[bus.CURRENT] / (other * own)
        b[bus.FORCE] -= b[bus.FORCE_CONSTANT] * b[bus.CURRENT]
    s[0] += 0.5 * dt * s[1]
    pull = angular * angular * (s[0] - b[bus.POSITION])
    loss = 2.0 * p[1] * angular
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    drag = 0.5 * dt * (loss / other + p[3])
    then = (s[1] * (1.0 - drag) + dt * (force - (pull - loss * velocity) / other)) / (1.0 + drag)
    b[bus.FORCE] += own * (pull + loss * (0.5 * (s[1] + then) - velocity))
    s[1] = then
    s[0] += 0.5 * dt * then


COUPLING = Effect(
    name="coupling",
    stage="mechanics",
    title="Two masses with a flexible coupling",
    equation="m x'' = F1 + k (y - x) + c (y' - x'), M (y'' + d y') = F2 - k (y - x) - c (y' - x')",
    signature="an antiresonance and a resonance, or two resonances, that no friction moves",
    source="Inman, Engineering Vibration (2014), ch. 4",
    parameters=(
        Parameter("resonance_hz", "Hz", None, 0.05, 2e3, True, meaning="resonance of the mass of the output alone"),
        Parameter("damping_ratio", "1", None, 1e-4, 3.0, True, meaning="damping ratio of the coupling"),
        Parameter("mass_ratio", "1", None, 0.01, 100.0, True, meaning="other mass relative to that of the output"),
        Parameter("drag_1_s", "1/s", None, 1e-6, 1e4, True, meaning="damping of the other mass relative to it"),
        Parameter("other_driven", "1", None, -1.0, 2.0, fixed=True, meaning="1 where the other mass is driven"),
    ),
    starts=((30.0, 0.05, 1.0, 0.1, 0.0),),
    places=(bus.MECHANICS,),
    hook=hook,
)
"""Part of the baseline and not of the library."""
