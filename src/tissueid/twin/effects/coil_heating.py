"""Heating of the winding, which raises its resistance."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

COPPER_PER_K = 0.0039
"""Relative rise of copper's resistance per kelvin near room temperature."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply one heat capacity with one time constant; ``s[0]`` is the temperature rise of the winding."""
    capacity, cooling = p[0], p[1]
    resistance = b[bus.RESISTANCE] * (1.0 + COPPER_PER_K * s[0])
    b[bus.RESISTANCE] = resistance
    power = resistance * b[bus.CURRENT] * b[bus.CURRENT]
    s[0] = (s[0] + dt * power / capacity) / (1.0 + dt / cooling)


EFFECT = Effect(
    name="coil_heating",
    stage="coil",
    title="The coil warms up",
    equation="R = R0 (1 + 0.0039/K theta), C theta' = R i^2 - C theta/T; vanishes with C = inf",
    signature="current falls against voltage over seconds, faster for larger currents; resistance follows the "
    "dissipated energy; nothing in quiet records; force against current unchanged",
    source="Button, J. Audio Eng. Soc. 40 (1992) 32-41; Klippel, J. Audio Eng. Soc. 52 (2004) 3-25",
    parameters=(
        Parameter("heat_capacity_j_per_k", "J/K", math.inf, 0.1, 1e5, True, meaning="heat capacity of the winding"),
        Parameter("cooling_s", "s", None, 0.02, 500.0, True, prior=5.0, prior_std=2.0, meaning="cooling time constant"),
    ),
    starts=((30.0, 5.0), (5.0, 0.7)),
    mistaken_for=("amplifier_drift", "flux_saturation", "preconditioning"),
    places=(bus.COIL,),
    hook=hook,
    needs=frozenset({"current"}),
    remedy="Wait between tests; correct the resistance for the winding's temperature by copper's 0.39 %/K.",
)
