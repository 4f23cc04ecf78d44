"""Damping of the tissue that differs between pushing and pulling."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Increase the tissue's damping in one direction and reduce it in the other."""
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    # The hyperbolic tangent, by the exponential function, which takes two thirds of the time.
    direction = 1.0 - 2.0 / (math.exp(2.0 * velocity / p[1]) + 1.0)
    b[bus.TISSUE_DAMPING] *= 1.0 + p[0] * direction


EFFECT = Effect(
    name="directional_damping",
    stage="tissue",
    title="Damping differs between pushing and pulling",
    equation="B (1 + a tanh(v / v0)) in place of B; vanishes with a = 0",
    signature="even distortion that grows with speed: mean depth falls with amplitude, position moves faster in one "
    "direction; none in the slow ramp, nothing on the spring",
    source="Worden & Tomlinson, Nonlinearity in Structural Dynamics (2001); thesis 5.4 (in and out)",
    parameters=(
        Parameter("difference", "1", 0.0, -0.98, 0.98, meaning="(in − out) / (in + out)"),
        Parameter("speed_m_s", "m/s", None, 1e-4, 0.1, True, meaning="speed over which the damping changes"),
    ),
    starts=((0.3, 0.01), (-0.3, 0.01), (0.3, 0.06)),
    mistaken_for=("directional_friction", "quadratic_drag", "added_mass", "reflex"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    in_living_tissue=True,
    remedy="Report damping in and out separately.",
)
