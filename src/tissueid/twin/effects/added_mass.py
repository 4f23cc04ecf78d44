"""Tissue mass that is recruited with depth."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add a mass that saturates with depth, with the force of a mass that changes with position."""
    depth = b[bus.DEPTH]
    if depth <= 0.0:
        return
    reached = (depth / p[1]) ** p[2]
    remaining = math.exp(-min(reached, 50.0))
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    b[bus.TISSUE_MASS] += p[0] * (1.0 - remaining)
    b[bus.TISSUE_FORCE] += p[3] * p[0] * remaining * p[2] * reached / (depth + 1e-5) * velocity * velocity


EFFECT = Effect(
    name="added_mass",
    stage="tissue",
    title="Mass recruited with depth",
    equation="m = M (1 - exp(-(d / D)^p)), force m a + c m'(d) v^2; vanishes with M = 0",
    signature="resonance frequency falls with depth at equal stiffness in the slow ramp; error at high frequency, even "
    "distortion; nothing on the spring",
    source="thesis 5.3.2 (mass by depth); Goldstein, Classical Mechanics (2002), ch. 1 (Lagrange)",
    parameters=(
        Parameter("mass_kg", "kg", 0.0, 1e-4, 0.5, True, meaning="mass recruited at large depth"),
        Parameter("reach_m", "m", None, 5e-4, 0.02, True, prior=4e-3, prior_std=0.7, meaning="depth of 63 %"),
        Parameter("exponent", "1", None, 0.3, 8.0, True, prior=1.5, prior_std=0.7, meaning="power of depth at first"),
        Parameter(
            "momentum",
            "1",
            None,
            0.0,
            1.0,
            prior=0.5,
            prior_std=0.3,
            default=0.5,
            meaning="force of the growing mass (1/2 conserves energy, 1 the momentum of mass at rest)",
        ),
    ),
    starts=((0.01, 6e-3, 1.0, 0.5), (0.05, 6e-3, 2.0, 0.5), (0.05, 2e-3, 3.0, 0.5)),
    mistaken_for=("viscoelasticity", "directional_damping", "mount_resonance"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    in_living_tissue=True,
    remedy="Report mass by depth; a smaller probe recruits less.",
)
