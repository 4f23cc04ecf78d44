"""Mass of the tissue that is recruited with depth."""

from __future__ import annotations

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M = 3e-3


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Mass by a power of depth, with the force that a mass which changes with position exerts."""
    ratio = b[bus.DEPTH] / REFERENCE_M
    if ratio <= 0.0:
        return
    mass = p[0] * min(ratio, 5.0) ** p[1]
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    b[bus.TISSUE_MASS] += mass
    # Kinetic energy m(d) v^2 / 2 is conserved by m v' + m'(d) v^2 / 2 (Lagrange).
    b[bus.TISSUE_FORCE] += 0.5 * p[1] * mass / (ratio * REFERENCE_M + 1e-5) * velocity * velocity


EFFECT = Effect(
    name="added_mass",
    stage="tissue",
    title="Mass recruited with depth",
    equation="m = m3 (d / 3 mm)^p, force m a + m'(d) v^2 / 2; vanishes with m3 = 0",
    signature="resonance lower the deeper the probe, at equal stiffness in the slow ramp; error at high frequency, "
    "even distortion; nothing on the spring",
    source="thesis 5.3.2 (mass by depth); Goldstein, Classical Mechanics (2002), ch. 1 (Lagrange)",
    parameters=(
        Parameter("mass_kg", "kg", 0.0, 1e-4, 0.5, True, meaning="recruited at 3 mm"),
        Parameter("exponent", "1", None, 0.1, 5.0, True, prior=1.0, prior_std=0.7, meaning="power of depth"),
    ),
    starts=((0.005, 1.0), (0.02, 2.0)),
    mistaken_for=("viscoelasticity", "directional_damping", "mount_resonance"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Report mass by depth; a smaller probe recruits less.",
)
