"""A force that repeats along the stroke."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M = 0.0135
"""Where phase is told: amid the positions of a test, so that period and phase are fitted apart."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Adds the periodic force at the present position."""
    angle = 2.0 * math.pi * (b[bus.POSITION] - REFERENCE_M) / p[2]
    b[bus.FORCE] += p[0] * math.sin(angle) + p[1] * math.cos(angle)


EFFECT = Effect(
    name="cogging",
    stage="mechanics",
    title="Periodic force along the stroke",
    equation="F = a sin(2 pi (x - x0) / l) + b cos(2 pi (x - x0) / l), x0 = 13.5 mm; vanishes with a = b = 0",
    signature="a static force that waves with position, the same in every test, tissue or spring; in the ramp position "
    "goes in steps; its stiffness changes sign along the stroke",
    source="Gieras, Piech & Tomczuk, Linear Synchronous Motors (2012) (detent force)",
    parameters=(
        Parameter("sine_n", "N", 0.0, -5.0, 5.0, meaning="in phase with the distance from 13.5 mm"),
        Parameter("cosine_n", "N", 0.0, -5.0, 5.0, meaning="a quarter of a period ahead"),
        Parameter("period_m", "m", None, 4e-4, 1.5e-2, True, meaning="from one wave to the next"),
    ),
    starts=((0.02, 0.02, 8e-3), (0.02, 0.02, 3.5e-3), (0.02, 0.02, 2e-3), (0.02, 0.02, 1.2e-3)),
    mistaken_for=("tissue_stiffening", "force_constant_position", "sensor_nonlinearity"),
    places=(bus.MECHANICS,),
    hook=hook,
    jointly=True,
    remedy="Look for iron or magnetic dirt in the gap; map the force along the stroke in free air.",
)
