"""Dry friction that differs by direction."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """One bristle with a level for either direction; ``s[0]`` is its force by the mean of both levels."""
    coulomb, difference, give = p[0], p[1], p[2]
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    level = 1.0 + difference if velocity > 0.0 else 1.0 - difference
    # The bristle is as stiff either way, so it gives further where it holds more.
    path = abs(velocity) * dt / (give * level)
    settled = level if velocity > 0.0 else -level
    left = s[0] - settled
    mean = settled + left * (1.0 - 0.5 * path if path < 1e-6 else (1.0 - math.exp(-path)) / path)
    s[0] = settled + left * math.exp(-path)
    b[bus.FORCE] -= coulomb * mean


EFFECT = Effect(
    name="directional_friction",
    stage="mechanics",
    title="Dry friction that differs by direction",
    equation="F = -Fc z, dz/dt = (v - |v| z / (1 + a sgn v)) / z0; vanishes with Fc = 0; a = 0 is plain dry friction",
    signature="as dry friction, but one branch of every loop is shifted further than the other: a steady force while "
    "it slides that is absent while it sticks, so mean position depends on whether and how the probe moves",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138; Dahl 1968",
    parameters=(
        Parameter("coulomb_n", "N", 0.0, 1e-3, 5.0, True, meaning="mean of the friction forces in and out"),
        Parameter("difference", "1", None, -0.95, 0.95, meaning="half of in less out, by their mean"),
        Parameter("presliding_m", "m", None, 1e-6, 3e-4, True, meaning="displacement before it slides"),
    ),
    starts=((0.2, 0.4, 2e-5), (0.2, -0.4, 2e-5)),
    mistaken_for=("dry_friction", "directional_damping", "tissue_hysteresis", "preconditioning"),
    places=(bus.MECHANICS,),
    hook=hook,
    remedy="Look for a bent or one-sidedly loaded bearing; turn the device over and measure again in free air.",
)
