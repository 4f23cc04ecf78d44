"""A force that is periodic along the stroke."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M = 0.0135
"""Reference of the phase, m: in the middle of the positions of a test, so that period and phase are uncorrelated."""
_PERIODS_M = tuple(5e-4 * 1.12**k for k in range(22))
"""Periods of the scan, 0.5 to 5.4 mm, m: fine enough that one is within a quarter period over the travel."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the periodic force at the present position; its harmonics are relative to its amplitude."""
    angle = 2.0 * math.pi * (b[bus.POSITION] - REFERENCE_M) / p[2]
    sine, cosine = math.sin(angle), math.cos(angle)
    size = math.sqrt(p[0] * p[0] + p[1] * p[1])
    twice_sine, twice_cosine = 2.0 * sine * cosine, cosine * cosine - sine * sine
    shape = p[3] * twice_sine + p[4] * twice_cosine
    shape += p[5] * (twice_sine * cosine + twice_cosine * sine) + p[6] * (twice_cosine * cosine - twice_sine * sine)
    b[bus.FORCE] += p[0] * sine + p[1] * cosine + size * shape


EFFECT = Effect(
    name="cogging",
    stage="mechanics",
    title="Periodic force along the stroke",
    equation="F = a sin(p) + b cos(p) + sqrt(a^2 + b^2) (c sin(2 p) + d cos(2 p) + e sin(3 p) + f cos(3 p)), "
    "p = 2 pi (x - 13.5 mm) / l; vanishes with a = b = 0",
    signature="a static force that is periodic in position, the same in every test, on tissue or spring; position moves"
    " in steps in the ramp; the stiffness of this force changes sign along the stroke",
    source="Gieras, Piech & Tomczuk, Linear Synchronous Motors (2012) (detent force)",
    parameters=(
        Parameter("sine_n", "N", 0.0, -5.0, 5.0, meaning="sine amplitude, with its zero at 13.5 mm"),
        Parameter("cosine_n", "N", 0.0, -5.0, 5.0, meaning="cosine amplitude"),
        Parameter("period_m", "m", None, 4e-4, 1.5e-2, True, meaning="period along the stroke"),
        Parameter(
            "second_sine", "1", None, -1.0, 1.0, prior=0.0, prior_std=0.3, meaning="second harmonic, sine, by the first"
        ),
        Parameter(
            "second_cosine",
            "1",
            None,
            -1.0,
            1.0,
            prior=0.0,
            prior_std=0.3,
            meaning="second harmonic, cosine, by the first",
        ),
        Parameter(
            "third_sine", "1", None, -0.5, 0.5, prior=0.0, prior_std=0.15, meaning="third harmonic, sine, by the first"
        ),
        Parameter(
            "third_cosine",
            "1",
            None,
            -0.5,
            0.5,
            prior=0.0,
            prior_std=0.15,
            meaning="third harmonic, cosine, by the first",
        ),
    ),
    starts=(
        (0.02, 0.02, 8e-3, 0.0, 0.0, 0.0, 0.0),
        (0.02, 0.02, 3.5e-3, 0.0, 0.0, 0.0, 0.0),
        (0.02, 0.02, 2e-3, 0.0, 0.0, 0.0, 0.0),
        (0.02, 0.02, 1.2e-3, 0.0, 0.0, 0.0, 0.0),
    ),
    scan=tuple((a, b, period, 0.0, 0.0, 0.0, 0.0) for period in _PERIODS_M for a, b in ((0.03, 0.0), (0.0, 0.03))),
    mistaken_for=("tissue_stiffening", "force_constant_position", "sensor_nonlinearity"),
    places=(bus.MECHANICS,),
    hook=hook,
    jointly=True,
    exact=True,
    remedy="Check the air gap for iron or magnetic dirt; map the force along the stroke in free air.",
)
