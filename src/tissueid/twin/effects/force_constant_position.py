"""The force constant falls along the stroke, and back-EMF with it."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """A plateau that falls off to both sides; a fall on one side is one whose centre lies elsewhere."""
    centre, width, steepness, left, peak = p[0], p[1], p[2], p[3], p[4]
    away = (b[bus.POSITION] - centre) / width
    fall = 1.0 / (1.0 + math.exp(0.5 * steepness * math.log(away * away + 1e-6)))
    b[bus.FORCE_CONSTANT] *= peak * (left + (1.0 - left) * fall)


EFFECT = Effect(
    name="force_constant_position",
    stage="coil",
    title="The force constant falls along the stroke",
    equation="kf = kf0 k (f + (1 - f) / (1 + |(x - c)/w|^p)), in force and back-EMF alike; vanishes with f = k = 1",
    signature="force per ampere and back-EMF fall together with position, static force curve bent in the ramp; current "
    "rises where the probe moves fast far from the plateau; there on the spring as well",
    source="Chen, MIT thesis (2010) 2.3; Klippel, J. Audio Eng. Soc. 54 (2006) 907-939",
    parameters=(
        Parameter("centre_m", "m", None, -0.02, 0.052, prior=0.014, prior_std=0.012, meaning="middle of the plateau"),
        Parameter("width_m", "m", math.inf, 2e-3, 2.0, True, meaning="from there to where half the fall is done"),
        Parameter("steepness", "1", None, 1.2, 10.0, True, prior=2.5, prior_std=0.6, meaning="2: a bell, 4: a plateau"),
        Parameter("left_share", "1", 1.0, 0.0, 1.0, prior=0.0, prior_std=0.4, meaning="of the force, far off"),
        Parameter("peak", "1", 1.0, 0.9, 2.0, prior=1.0, prior_std=0.1, meaning="on the plateau, over nominal"),
    ),
    starts=(
        (0.006, 0.02, 2.5, 0.1, 1.0),
        (0.022, 0.02, 2.5, 0.1, 1.0),
        (0.012, 0.01, 2.5, 0.1, 1.0),
        (0.0, 0.0145, 6.0, 0.3, 1.0),
        (0.028, 0.0145, 6.0, 0.3, 1.0),
    ),
    mistaken_for=("tissue_stiffening", "flux_saturation", "sensor_nonlinearity"),
    places=(bus.COIL,),
    jointly=True,
    hook=hook,
    remedy="Run the dynamic sweep along the stroke and put its force-constant table in force.",
)
