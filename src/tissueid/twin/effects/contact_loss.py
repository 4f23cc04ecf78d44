"""The probe lifts off: tissue pushes and, unless it sticks, does not pull."""

from __future__ import annotations

import math

from numba import njit

from tissueid.twin import bus
from tissueid.twin._kernel import grown
from tissueid.twin.effect import Effect, FloatArray, Parameter

REACH_M = 3e-5
"""Gap at which what sticks pulls half as much as at the surface."""
LEAST_DAMPING = 1e-3
"""N s/m; a surface without any, or mass, would be back at once."""

# What is kept from step to step.
OFF, SURFACE, SURFACE_VELOCITY, TIME_OFF, GAP, PULLED = range(6)


@njit(cache=True)  # type: ignore[untyped-decorator]
def pull(one: float, other: float) -> float:
    """Share of the adhesion that pulls on average while the gap goes from one width to the other, m.

    Within a step it may go through all of what sticks, and close: nothing is left of it then.
    """
    near, far = min(one, other), max(one, other)
    if far <= 0.0:
        return 0.0
    if far - near < 1e-9:
        return 1.0 / (1.0 + (far / REACH_M) ** 2)
    return float(REACH_M * (math.atan(far / REACH_M) - math.atan(max(near, 0.0) / REACH_M)) / (far - near))


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """``p`` holds the time in which the return slows and the adhesion; ``s`` is as numbered above."""
    mass, taken = b[bus.MASS], b[bus.TISSUE_MASS]
    middle = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    # What probe and tissue press on each other with while they move together.
    resisting = b[bus.TISSUE_FORCE] + b[bus.TISSUE_DAMPING] * middle
    pushing = b[bus.FORCE] - b[bus.DAMPING] * middle
    pressing = resisting + taken * (pushing - resisting) / (mass + taken)
    if s[OFF] == 0.0:
        if pressing >= -p[1]:
            return
        s[SURFACE] = b[bus.DEPTH]
        s[SURFACE_VELOCITY] = middle
    else:
        # The surface by itself, its law taken in the middle of what it goes on by.
        before = s[SURFACE_VELOCITY]
        surface = s[SURFACE] + 0.5 * dt * before
        stiffness = grown(b[bus.STIFFNESS], b[bus.STIFFNESS_GROWTH], surface)
        damping = grown(b[bus.SURFACE_DAMPING], b[bus.DAMPING_GROWTH], surface)
        damping = max(damping * (1.0 + (s[TIME_OFF] + 0.5 * dt) / p[0]), LEAST_DAMPING)
        pulled = p[1] * pull(s[GAP], max(s[GAP] + dt * (before - middle), 0.0))
        settled = -(stiffness * surface + pulled) / damping
        kept = math.exp(-dt * damping / taken) if taken > 0.0 else 0.0
        s[SURFACE_VELOCITY] = settled + (before - settled) * kept
        s[SURFACE] += 0.5 * dt * (before + s[SURFACE_VELOCITY])
        s[TIME_OFF] += dt
        gap = s[SURFACE] - b[bus.DEPTH]
        if gap > 0.0 or middle < s[SURFACE_VELOCITY]:
            s[GAP] = max(gap, 0.0)
            widening = 0.5 * dt * (s[SURFACE_VELOCITY] - middle)
            s[PULLED] = p[1] * pull(s[GAP] - widening, s[GAP] + widening)
            b[bus.TISSUE_FORCE] = -s[PULLED]
            b[bus.TISSUE_DAMPING] = 0.0
            b[bus.TISSUE_MASS] = 0.0
            return
        # Met again, inelastically, some share of a step before its middle: what came of it since is made up for, so
        # that the motion does not depend on where in a step it was.
        since = -gap / (s[GAP] - gap) if s[GAP] > 0.0 else 0.0
        late = (since - 0.5) * dt
        if late > 0.0:
            then = b[bus.VELOCITY] - late * (b[bus.ACCELERATION] - s[PULLED] / mass)
            b[bus.TISSUE_FORCE] *= 0.5 + since
        else:
            then = b[bus.VELOCITY] - late * (pushing + p[1]) / mass
            b[bus.TISSUE_FORCE] = (0.5 + since) * b[bus.TISSUE_FORCE] - (0.5 - since) * p[1]
        closing = then - s[SURFACE_VELOCITY] + since * (s[SURFACE_VELOCITY] - before)
        jump = -taken / (mass + taken) * closing
        b[bus.VELOCITY_JUMP] = then - b[bus.VELOCITY] + jump + late * pushing / (mass + taken)
        b[bus.POSITION_SHIFT] = late * jump
        pressing += jump * (mass * b[bus.TISSUE_DAMPING] - taken * b[bus.DAMPING]) / (mass + taken)
        b[bus.TISSUE_DAMPING] *= 0.5 + since
        if pressing >= -p[1]:
            s[OFF] = 0.0
            return
        s[SURFACE] = b[bus.DEPTH]
        s[SURFACE_VELOCITY] = middle + jump
    s[OFF] = 1.0
    s[TIME_OFF] = 0.0
    s[GAP] = 0.0
    s[PULLED] = p[1]
    b[bus.TISSUE_FORCE] = -p[1]
    b[bus.TISSUE_DAMPING] = 0.0
    b[bus.TISSUE_MASS] = 0.0


EFFECT = Effect(
    name="contact_loss",
    stage="tissue",
    title="The probe lifts off",
    equation="contact ends where the tissue would pull with more than the adhesion; the surface then comes back by its "
    "own mass, stiffness and damping, the latter growing as 1 + t / T, pulls by 1 / (1 + (gap / 30 um)^2) of the "
    "adhesion, and is met again inelastically; vanishes with adhesion = infinity",
    signature="where the command is lowest or falls fastest the probe flies further out than tissue would let it, and "
    "comes back late; without a command it drifts off if the device hangs; nothing at depth, nothing on the spring",
    source="Johnson, Contact Mechanics (1985), ch. 5 (adhesion) and 6 (viscoelastic contact); Brogliato, Nonsmooth "
    "Mechanics (2016)",
    parameters=(
        Parameter("slowing_s", "s", None, 1e-3, 10.0, True, meaning="time in which the surface's return slows to half"),
        Parameter("adhesion_n", "N", math.inf, 1e-3, 20.0, True, meaning="pull that the tissue follows"),
    ),
    starts=((0.1, 0.01), (0.1, 0.1), (0.5, 0.2)),
    mistaken_for=("directional_damping", "tissue_hysteresis", "tissue_stiffening", "reflex"),
    places=(bus.TISSUE,),
    hook=hook,
    switches=True,
    on_spring=False,
    remedy="Raise the mean of the command or lower its amplitude so that the probe stays on the surface.",
)
