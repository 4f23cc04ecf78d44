"""Rubber bumpers at both ends of the stroke and one-sided contact, for an instrument simulated in real time.

They are not part of the library of effects and of the baseline, because tests should not contain them. In real time the
probe would leave the housing without them.
"""

from __future__ import annotations

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

RUBBER_N_PER_M = 1.0e5
RUBBER_N_S_PER_M = 50.0


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of the bumpers, and keep the tissue from pulling the probe."""
    if where == bus.MECHANICS:
        position, stroke = b[bus.POSITION], b[bus.STROKE]
        beyond = min(position, 0.0) + max(position - stroke, 0.0)
        if beyond != 0.0:
            b[bus.FORCE] -= p[0] * beyond
            b[bus.DAMPING] += p[1]
        return
    if p[2] == 0.0:
        return
    if b[bus.DEPTH] <= 0.0:
        b[bus.TISSUE_FORCE] = 0.0
        b[bus.TISSUE_DAMPING] = 0.0
        return
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    force = max(b[bus.TISSUE_FORCE], 0.0)
    b[bus.TISSUE_FORCE] = force
    if force + b[bus.TISSUE_DAMPING] * velocity < 0.0:
        # Limit the damping so that the total force does not pull.
        b[bus.TISSUE_DAMPING] = force / -velocity


END_BUMPERS = Effect(
    name="housing",
    stage="mechanics",
    title="The housing",
    equation="F = -K e - B v at e > 0 beyond an end of the stroke; tissue forces of either sign become at least 0",
    signature="position within the stroke; nothing pulls the probe back to a surface that it has left",
    source="kinematics; Johnson, Contact Mechanics (1985), ch. 4",
    parameters=(
        Parameter("rubber_n_per_m", "N/m", 0.0, 0.0, 1e7, meaning="stiffness of the ends"),
        Parameter("rubber_n_s_per_m", "N s/m", 0.0, 0.0, 1e4, meaning="damping of the ends"),
        Parameter("only_pushes", "1", 0.0, 0.0, 1.0, meaning="1: the tissue does not pull"),
    ),
    starts=((RUBBER_N_PER_M, RUBBER_N_S_PER_M, 1.0),),
    places=(bus.MECHANICS, bus.TISSUE),
    hook=hook,
)
