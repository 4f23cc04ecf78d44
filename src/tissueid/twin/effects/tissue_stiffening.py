"""A static law of the tissue other than the twin's: a layer engages, bone, a power law."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M = 1e-3
CORNER_M = 1e-4


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """A spring with play and a power law, alike either side of the surface, beside the twin's own."""
    depth, play = b[bus.DEPTH], p[1]
    # How far the depth is outside the play, with rounded corners: odd in depth, and 0 at 0 whatever the play.
    beyond, short = depth - play, depth + play
    square = CORNER_M * CORNER_M
    into = depth - 0.5 * (math.sqrt(short * short + square) - math.sqrt(beyond * beyond + square))
    size = min(abs(into) / REFERENCE_M, 20.0)
    force = p[0] * size ** p[2] if size > 0.0 else 0.0
    b[bus.TISSUE_FORCE] += force if into > 0.0 else -force


EFFECT = Effect(
    name="tissue_stiffening",
    stage="tissue",
    title="Another static law: a layer engages",
    equation="F = F1 sgn(d) (max(|d| - d1, 0) / 1 mm)^n beside the twin's K exp(g d) d; vanishes with F1 = 0",
    signature="position at large depth against current: stiffness rises (or falls) from one depth on, slow ramp and "
    "stochastic test alike; no loops, nothing on the spring",
    source="Fung, Biomechanics: Mechanical Properties of Living Tissues (1993); Worden & Tomlinson, Nonlinearity "
    "in Structural Dynamics (2001) (cubic and bilinear stiffness)",
    parameters=(
        Parameter("force_n", "N", 0.0, -10.0, 30.0, meaning="force at 1 mm beyond the play"),
        Parameter("depth_m", "m", None, 0.0, 0.012, meaning="depth from which it acts"),
        Parameter("exponent", "1", None, 1.0, 4.0, meaning="power by which it grows"),
    ),
    starts=((0.2, 0.002, 1.5), (0.3, 0.004, 1.5), (-0.1, 0.002, 1.5), (0.02, 0.0005, 3.0)),
    mistaken_for=("end_stop", "cogging", "sensor_nonlinearity", "force_constant_position", "contact_loss"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Take the depth from which it acts as a finding; test at a mean depth either side of it.",
)
