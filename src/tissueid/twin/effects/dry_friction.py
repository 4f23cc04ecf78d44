"""Dry friction in the bearing: Coulomb, Stribeck and presliding."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """A bristle that gives way at the friction force; ``s[0]`` is its deflection."""
    coulomb, give, extra, speed = p[0], p[1], p[2], p[3]
    velocity = b[bus.VELOCITY]
    ratio = velocity / speed
    level = coulomb * (1.0 + extra * math.exp(-min(ratio * ratio, 50.0)))
    # Exact for a velocity that is constant over the step: the deflection settles at +-give.
    pull = abs(velocity) / give * coulomb / level
    kept = math.exp(-pull * dt)
    settled = give * level / coulomb
    if velocity < 0.0:
        settled = -settled
    s[0] = settled + (s[0] - settled) * kept
    b[bus.FORCE] -= coulomb * s[0] / give


EFFECT = Effect(
    name="dry_friction",
    stage="mechanics",
    title="Dry friction in the bearing",
    equation="F = -Fc z/z0, dz/dt = v - |v| z / (z0 g(v)), g = 1 + a exp(-(v/vs)^2); vanishes with Fc = 0",
    signature="position lags and flattens at reversals, the more the smaller the amplitude; loops in the slow ramp; "
    "in the spring test as well as on tissue; current untouched but for back-EMF",
    source="Canudas de Wit et al., IEEE Trans. Automatic Control 40 (1995) 419-425; Armstrong-Helouvry et al. 1994",
    parameters=(
        Parameter("coulomb_n", "N", 0.0, 1e-3, 5.0, True, meaning="friction force at speed"),
        Parameter("presliding_m", "m", None, 1e-6, 3e-4, True, meaning="displacement before it slides"),
        Parameter("stribeck_ratio", "1", None, 0.0, 2.0, meaning="how much more it holds near standstill"),
        Parameter("stribeck_speed_m_s", "m/s", None, 1e-4, 0.1, True, meaning="speed where that extra is gone"),
    ),
    starts=((0.1, 2e-5, 0.3, 5e-3), (0.3, 5e-6, 0.1, 5e-3)),
    mistaken_for=("directional_friction", "tissue_hysteresis", "sensor_backlash"),
    places=(bus.MECHANICS,),
    hook=hook,
    remedy="Clean and realign the bearing; measure again in free air.",
)
