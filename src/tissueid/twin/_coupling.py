"""A second mass on a flexible coupling, for the baseline of input-output records. Private."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add the force of the coupling; ``s[0]`` and ``s[1]`` are position (m) and velocity (m/s) of the second mass."""
    angular, other, own = 2.0 * math.pi * p[0], p[2], b[bus.MASS]
    force = 0.0
    if p[4] > 0.5:
        # The second mass is driven, and not the mass of the output.
        force = b[bus.FORCE_CONSTANT] * b[bus.CURRENT] / (other * own)
        b[bus.FORCE] -= b[bus.FORCE_CONSTANT] * b[bus.CURRENT]
    s[0] += 0.5 * dt * s[1]
    pull = angular * angular * (s[0] - b[bus.POSITION])
    loss = 2.0 * p[1] * angular
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    drag = 0.5 * dt * (loss / other + p[3])
    then = (s[1] * (1.0 - drag) + dt * (force - (pull - loss * velocity) / other)) / (1.0 + drag)
    b[bus.FORCE] += own * (pull + loss * (0.5 * (s[1] + then) - velocity))
    s[1] = then
    s[0] += 0.5 * dt * then


COUPLING = Effect(
    name="coupling",
    stage="mechanics",
    title="Two masses with a flexible coupling",
    equation="m x'' = F1 + k (y - x) + c (y' - x'), M (y'' + d y') = F2 - k (y - x) - c (y' - x')",
    signature="an antiresonance and a resonance, or two resonances, that no friction moves",
    source="Inman, Engineering Vibration (2014), ch. 4",
    parameters=(
        Parameter("resonance_hz", "Hz", None, 0.05, 2e3, True, meaning="resonance of the mass of the output alone"),
        Parameter("damping_ratio", "1", None, 1e-4, 3.0, True, meaning="damping ratio of the coupling"),
        Parameter("mass_ratio", "1", None, 0.01, 100.0, True, meaning="other mass relative to that of the output"),
        Parameter("drag_1_s", "1/s", None, 1e-6, 1e4, True, meaning="damping of the other mass relative to it"),
        Parameter("other_driven", "1", None, -1.0, 2.0, fixed=True, meaning="1 where the other mass is driven"),
    ),
    starts=((30.0, 0.05, 1.0, 0.1, 0.0),),
    places=(bus.MECHANICS,),
    hook=hook,
)
"""Part of the baseline and not of the library."""
