"""Change of the flux, and thus of the force constant, by the coil's current."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

CORNER_A = 0.05
"""Width of the smooth transition between the two branches of the law, A."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply the force constant at the start of the step to the back-EMF, and that of the mean current to the force."""
    fall, power, other, bias = p[0], p[1], p[2], p[3]
    current = b[bus.CURRENT]
    share = 1.0
    for k in range(2):
        # The law with the current, relative to that without current.
        flux = current + bias if k == 0 else bias
        square = flux * flux + CORNER_A * CORNER_A
        strength = fall * math.exp(0.5 * power * math.log(square))
        strength *= 0.5 * (1.0 + other + (1.0 - other) * flux / math.sqrt(square))
        remaining = math.exp(-strength) if strength < 0.0 else 1.0 / (1.0 + strength)
        share = remaining if k == 0 else share / remaining
    share = min(share, 3.0)
    if where == bus.COIL:
        s[0] = share
        b[bus.FORCE_CONSTANT] *= share
    else:
        b[bus.FORCE] += b[bus.FORCE_CONSTANT] * (share / s[0] - 1.0) * current


EFFECT = Effect(
    name="flux_saturation",
    stage="coil",
    title="The force constant depends on current",
    equation="kf(i) / kf(0) = f(i + b) / f(b), f(x) = 1 / (1 + a |x|^n), r a in place of a for x < 0; vanishes with "
    "a = 0",
    signature="force per ampere and back-EMF change with current at every position, without delay; even distortion of "
    "position under a mean current, odd without one; little change in the current itself",
    source="Klippel, J. Audio Eng. Soc. 54 (2006) 907-939 (flux modulation)",
    parameters=(
        Parameter(
            "fall",
            "1/A^n",
            0.0,
            -0.3,
            1.0,
            meaning="relative fall of the force constant at one ampere",
            scales_with=("force_constant_n_per_a", 2),
        ),
        Parameter(
            "power", "1", None, 1.0, 5.0, prior=2.0, prior_std=1.0, meaning="power with which it grows with current"
        ),
        Parameter(
            "other_sign", "1", None, -2.0, 2.0, prior=0.5, prior_std=0.8, meaning="share of the fall for negative flux"
        ),
        Parameter(
            "bias_a",
            "A",
            None,
            -3.0,
            3.0,
            prior=0.0,
            prior_std=0.7,
            meaning="flux of the magnet, as a current",
            scales_with=("force_constant_n_per_a", -1),
        ),
    ),
    starts=((0.04, 2.0, 1.0, 0.0), (0.04, 1.2, -1.0, 0.0), (0.1, 1.2, 1.0, 0.6), (0.1, 1.2, 1.0, -0.6)),
    mistaken_for=("reluctance_force", "force_constant_position", "amplifier_clipping"),
    places=(bus.COIL, bus.MECHANICS),
    hook=hook,
    remedy="Measure force against current with the coil blocked; keep to smaller currents.",
)
