"""Dry friction that depends on direction."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter
from tissueid.twin.effects.dry_friction import BRISTLE_SHARE, SPREAD, STRIBECK_SPEED_M_S, friction_share


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add dry friction and a force of one sign during sliding in either direction."""
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    ratio = velocity / STRIBECK_SPEED_M_S
    level = p[0] * (1.0 + p[3] * math.exp(-min(ratio * ratio, 50.0)))
    share = friction_share(s, velocity, p[2], p[5], p[4], dt)
    b[bus.FORCE] -= level * share * (1.0 + p[1] * share)


EFFECT = Effect(
    name="directional_friction",
    stage="mechanics",
    title="Dry friction that differs by direction",
    equation="F = -Fc g(v) z (1 + a z), z what dry friction holds, from -1 to 1: Fc (1 + a) in and Fc (1 - a) out; "
    "vanishes with Fc = 0; a = 0 is plain dry friction",
    signature="as dry friction, but one branch of every loop is shifted further than the other: a constant force during"
    " sliding that is absent during sticking, so the mean position depends on the motion of the probe",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138; Iwan, J. Applied Mechanics 33 "
    "(1966) 893-900",
    parameters=(
        Parameter("coulomb_n", "N", 0.0, 1e-3, 5.0, True, meaning="mean of the friction forces in and out"),
        Parameter("difference", "1", None, -0.95, 0.95, meaning="(in − out) / (in + out)"),
        Parameter("presliding_m", "m", None, 1e-6, 3e-4, True, meaning="displacement before it slides"),
        Parameter("stribeck_ratio", "1", None, -0.5, 3.0, prior=0.2, prior_std=0.5, meaning="extra friction at rest"),
        BRISTLE_SHARE,
        SPREAD,
    ),
    starts=(
        (0.1, 0.4, 2e-5, 0.2, 0.0, 1.0),
        (0.1, -0.4, 2e-5, 0.2, 0.0, 1.0),
        (0.5, 0.4, 5e-5, 0.2, 0.0, 1.0),
        (0.5, -0.4, 5e-5, 0.2, 0.0, 1.0),
    ),
    mistaken_for=("dry_friction", "directional_damping", "tissue_hysteresis", "preconditioning"),
    places=(bus.MECHANICS,),
    hook=hook,
    remedy="Check for a bent bearing or one loaded on one side; turn the device over and measure again in free air.",
)
