"""Drag that grows faster than speed."""

from __future__ import annotations

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M_S = 0.05
"""Reference speed of the force, m/s, in the range of a stochastic test."""

_STANDSTILL = 1e-3


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add a viscous coefficient that grows with a power of speed."""
    ratio = (b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]) / REFERENCE_M_S
    square = min(ratio * ratio + _STANDSTILL * _STANDSTILL, 1e4)
    b[bus.DAMPING] += p[0] / REFERENCE_M_S * square ** (0.5 * (p[1] - 1.0))


EFFECT = Effect(
    name="quadratic_drag",
    stage="mechanics",
    title="Drag that grows faster than speed",
    equation="F = -F0 |v / v0|^n sgn v with v0 = 50 mm/s, n = 2 for turbulent flow; vanishes with F0 = 0",
    signature="odd distortion where speed is highest, at frequencies around the resonance; less at lower amplitude; "
    "none in the slow ramp; in the spring test as well; in position, and in current only by back-EMF",
    source="Batchelor, An Introduction to Fluid Dynamics (1967); Worden & Tomlinson, Nonlinearity in Structural "
    "Dynamics (2001)",
    parameters=(
        Parameter("force_n", "N", 0.0, 1e-4, 10.0, True, meaning="force at 50 mm/s"),
        Parameter("exponent", "1", None, 1.4, 4.0, prior=2.0, prior_std=0.5, meaning="power of speed"),
    ),
    starts=((0.05, 2.0), (0.5, 2.0)),
    mistaken_for=("directional_damping", "dry_friction", "viscoelasticity"),
    places=(bus.MECHANICS,),
    hook=hook,
    remedy="Open the vents of the coil's housing, or use lower speeds; the tissue parameters are valid once the drag"
    " is modelled.",
)
