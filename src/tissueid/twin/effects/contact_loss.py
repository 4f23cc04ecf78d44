"""The probe lifts off: tissue pushes and, unless it sticks, does not pull."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """``s[0]`` is the depth of the tissue's own surface."""
    depth = b[bus.DEPTH]
    surface = s[0] * math.exp(-dt / p[0])
    if depth > surface:
        s[0] = depth
        return
    s[0] = surface
    gap = (surface - depth) / p[1]
    held = 1.0 / (1.0 + gap * gap)
    b[bus.TISSUE_FORCE] *= held
    b[bus.TISSUE_DAMPING] *= held
    # Mass that is picked up again was at rest: it takes its share of momentum, and no energy comes from nowhere.
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    closing = (velocity + surface / p[0]) / p[1]
    if closing > 0.0:
        b[bus.TISSUE_DAMPING] += 2.0 * gap * held * held * closing * b[bus.TISSUE_MASS]
    b[bus.TISSUE_MASS] *= held


EFFECT = Effect(
    name="contact_loss",
    stage="tissue",
    title="The probe lifts off",
    equation="all forces of the tissue by 1 / (1 + (gap / reach)^2); the surface left behind returns as exp(-t / T); "
    "vanishes with reach = infinity",
    signature="where the command is lowest the probe flies further out than tissue would let it, and comes back late; "
    "without a command it drifts off if the device hangs; nothing at depth, nothing on the spring",
    source="Johnson, Contact Mechanics (1985), ch. 5 (adhesion) and 6 (viscoelastic contact); Brogliato, Nonsmooth "
    "Mechanics (2016)",
    parameters=(
        Parameter("recovery_s", "s", None, 2e-4, 5.0, True, meaning="time in which the surface comes back"),
        Parameter("reach_m", "m", math.inf, 2e-5, 0.1, True, meaning="gap at which tissue lets go by half"),
    ),
    starts=((0.005, 1e-4), (0.05, 1e-4), (0.5, 1e-4), (0.5, 1e-3)),
    mistaken_for=("directional_damping", "tissue_hysteresis", "tissue_stiffening", "reflex"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Raise the mean of the command or lower its amplitude so that the probe stays on the surface.",
)
