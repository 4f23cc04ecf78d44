"""Loss of contact: tissue pushes and pulls only within its adhesion."""

from __future__ import annotations

import math

from numba import njit

from tissueid.twin import bus
from tissueid.twin._kernel import grown
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

REACH_M = 3e-5
"""Gap at which the adhesion is half as strong as at the surface, m."""
LEAST_DAMPING = 1e-3
"""Least damping of the free surface, N s/m: without damping and mass it would return at once."""

# Places in the state.
OFF, SURFACE, SURFACE_VELOCITY, SURFACE_ACCELERATION, TIME_OFF, GAP, PULLED = range(7)
PROBE_DEPTH, PROBE_VELOCITY, PROBE_ACCELERATION = range(7, 10)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def pull(begin: float, end: float) -> float:
    """Return the mean share of the adhesion while the gap changes from one width to the other, m.

    Within one step the gap can pass the range of the adhesion, or close, where none is left.
    """
    near, far = min(begin, end), max(begin, end)
    if far <= 0.0:
        return 0.0
    if far - near < 1e-9:
        return 1.0 / (1.0 + (far / REACH_M) ** 2)
    return float(REACH_M * (math.atan(far / REACH_M) - math.atan(max(near, 0.0) / REACH_M)) / (far - near))


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply loss of contact; ``p`` holds the slowing time and the adhesion, ``s`` is as numbered above."""
    if where == bus.LIFT_OFF:
        if s[OFF] != 0.0:
            # The laws of the tissue act on the free surface, at its midpoint.
            s[PROBE_DEPTH], s[PROBE_VELOCITY], s[PROBE_ACCELERATION] = (
                b[bus.DEPTH],
                b[bus.VELOCITY],
                b[bus.ACCELERATION],
            )
            b[bus.DEPTH] = s[SURFACE] + 0.5 * dt * s[SURFACE_VELOCITY]
            b[bus.VELOCITY], b[bus.ACCELERATION] = s[SURFACE_VELOCITY], s[SURFACE_ACCELERATION]
        return
    mass, taken = b[bus.MASS], b[bus.TISSUE_MASS]
    if s[OFF] != 0.0:
        surface = b[bus.DEPTH]
        b[bus.DEPTH], b[bus.VELOCITY], b[bus.ACCELERATION] = s[PROBE_DEPTH], s[PROBE_VELOCITY], s[PROBE_ACCELERATION]
    else:
        surface = b[bus.DEPTH]
    middle = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    # Contact force while probe and tissue move together.
    resisting = b[bus.TISSUE_FORCE] + b[bus.TISSUE_DAMPING] * middle
    pushing = b[bus.FORCE] - b[bus.DAMPING] * (middle + b[bus.SURFACE_VELOCITY])
    pressing = resisting + taken * ((pushing - resisting) / (mass + taken) + b[bus.FRAME_ACCELERATION])
    if s[OFF] == 0.0:
        if pressing >= -p[1]:
            return
        s[SURFACE] = b[bus.DEPTH]
        s[SURFACE_VELOCITY] = middle
    else:
        before = s[SURFACE_VELOCITY]
        damping = max(b[bus.TISSUE_DAMPING] * (1.0 + (s[TIME_OFF] + 0.5 * dt) / p[0]), LEAST_DAMPING)
        pulled = p[1] * pull(s[GAP], max(s[GAP] + dt * (before - middle), 0.0))
        settled = -(b[bus.TISSUE_FORCE] + pulled) / damping
        kept = math.exp(-dt * damping / taken) if taken > 0.0 else 0.0
        s[SURFACE_VELOCITY] = settled + (before - settled) * kept
        s[SURFACE_ACCELERATION] = (s[SURFACE_VELOCITY] - before) / dt
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
        # The tissue was evaluated at the free surface and now yields to the probe.
        probe, growth = b[bus.DEPTH], b[bus.STIFFNESS_GROWTH]
        yielding = grown(b[bus.STIFFNESS], growth, probe) * probe - grown(b[bus.STIFFNESS], growth, surface) * surface
        b[bus.TISSUE_FORCE] += yielding
        pressing += yielding * mass / (mass + taken)
        # Inelastic contact at a fraction of a step: the motion since then is corrected, so that the result does not
        # depend on the position of the contact within a step.
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
    s[SURFACE_ACCELERATION] = 0.0
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
    signature="where the command is lowest or falls fastest the probe moves further out than attached tissue allows, "
    "and returns late; without a command it drifts off if the device hangs; nothing at depth, nothing on the "
    "spring",
    source="Johnson, Contact Mechanics (1985), ch. 5 (adhesion) and 6 (viscoelastic contact); Brogliato, Nonsmooth "
    "Mechanics (2016)",
    parameters=(
        Parameter("slowing_s", "s", None, 1e-3, 10.0, True, meaning="time until the surface returns half as fast"),
        Parameter(
            "adhesion_n", "N", math.inf, 1e-3, 20.0, True, meaning="adhesion: largest pull that the tissue follows"
        ),
    ),
    starts=((0.1, 0.01), (0.1, 0.1), (0.5, 0.2)),
    mistaken_for=("directional_damping", "tissue_hysteresis", "tissue_stiffening", "reflex"),
    places=(bus.LIFT_OFF, bus.TISSUE),
    hook=hook,
    switches=True,
    acts_on=ActsOn.LIFT_OFF,
    on_spring=False,
    in_living_tissue=True,
    remedy="Raise the mean of the command or lower its amplitude so that the probe stays on the surface.",
)
