"""Drift of the tissue's stiffness with time and work."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

POWER_W = 0.1
"""Power at which work counts as much as time, W, as in a stochastic test."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Scale the force by the drift; ``s[0]`` is its progress from 0 to 1, from 0 in every test."""
    force = b[bus.TISSUE_FORCE]
    power = abs(force * b[bus.VELOCITY]) / POWER_W
    rate = ((1.0 - p[2]) + p[2] * power) / p[1]
    s[0] = 1.0 - (1.0 - s[0]) * math.exp(-rate * dt)
    b[bus.TISSUE_FORCE] = force * (1.0 + p[0] * s[0])


EFFECT = Effect(
    name="preconditioning",
    stage="tissue",
    acts_on=ActsOn.ELASTIC_FORCE,
    title="Stiffness drifts as the tissue is worked",
    equation="Fe (1 + a s), ds/dt = (1 - s) (1 - h + h |Fe v| / 0.1 W) / T, s = 0 at the start; vanishes with a = 0",
    signature="mean depth and resonance drift over the test, fast at first; error grows or falls with time; nothing on "
    "the spring; the drift restarts in each repeat",
    source="Fung, Biomechanics (1993), ch. 7 (preconditioning); thesis 7.1.1 (acclimation before a test)",
    parameters=(
        Parameter("change", "1", 0.0, -0.95, 3.0, meaning="final relative change of stiffness"),
        Parameter("time_s", "s", None, 0.03, 60.0, True, meaning="time constant of the drift"),
        Parameter(
            "by_work", "1", None, 0.0, 1.0, prior=0.5, prior_std=0.5, meaning="share that follows work, not time"
        ),
    ),
    starts=((-0.1, 1.0, 0.5), (0.1, 1.0, 0.5), (-0.3, 10.0, 0.5), (-0.1, 0.15, 0.5)),
    mistaken_for=("viscoelasticity", "coil_heating", "amplifier_drift", "physiological_motion"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Move the tissue for some seconds before the test, or let it rest equally long before every test.",
)
