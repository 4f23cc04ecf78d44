"""Force proportional to the square of current, of iron in the coil's field."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of the mean current of the step, independent of its sign."""
    strength, slope = p[0], p[1]
    along = math.exp(slope * (b[bus.POSITION] - 0.5 * b[bus.STROKE]))
    b[bus.FORCE] += strength * along * b[bus.CURRENT] * b[bus.CURRENT]


EFFECT = Effect(
    name="reluctance_force",
    stage="coil",
    title="Reluctance force",
    equation="F = k i^2 exp(b (x - stroke/2)); vanishes with k = 0",
    signature="force with the square of current in one direction only: even distortion of position, a mean shift in the"
    " spring test, twice the frequency of the command; current and back-EMF unchanged",
    source="Woodson and Melcher, Electromechanical Dynamics I (1968) ch. 3; Klippel, J. Audio Eng. Soc. 54 (2006) 907",
    parameters=(
        Parameter(
            "strength_n_per_a2",
            "N/A^2",
            0.0,
            -2.0,
            2.0,
            meaning="force at one ampere in the middle of the stroke",
            scales_with=("force_constant_n_per_a", 2),
        ),
        Parameter(
            "growth_per_m", "1/m", None, -250.0, 250.0, prior=0.0, prior_std=80.0, meaning="growth along the stroke"
        ),
    ),
    starts=((0.05, 0.0), (-0.05, 0.0)),
    mistaken_for=("flux_saturation", "tissue_stiffening", "inductance_position"),
    places=(bus.MECHANICS,),
    hook=hook,
    remedy="Measure force against current of either sign with the coil blocked; compensate in the force estimate.",
)
