"""A delayed, one-sided active response of the tissue to stretch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

GRID_S = 5e-4
GRID = 480
"""Stretch is remembered so many times, this far apart: 240 ms."""
STRETCH_M = 5e-4
SPEED_M_S = 0.03
"""What a stochastic test reaches by its standard deviation."""
DEPTH_M = 3e-3
"""Depth from which stretch is told; the threshold makes of it what the tissue bears without an answer."""
RISE_S = 0.012
"""Time of activation and of contraction, where a fit begins."""
MOST_N = 1.0
"""What a small muscle presses with at most, where a fit begins."""
FELT_S = 4e-3
"""Spindles feel speed through some milliseconds."""
CORNER = 0.03
"""The one-sided corner is rounded over so much of what is usual: sharp for the eye, smooth for a fit."""
DELAYS_S = (0.03, 0.055, 0.085, 0.125)
_LATEST = GRID
_ACTIVITY = GRID + 1
_TRIGGER = GRID + 2
_PLACE = GRID + 3
_FORCE = GRID + 4
_FELT = GRID + 5


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Remembers stretch and its speed in a ring; the muscle answers what it was one delay ago, as far as it can."""
    depth = b[bus.DEPTH]
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    s[_FELT] += (velocity - s[_FELT]) * (1.0 - math.exp(-dt / p[6]))
    trigger = (1.0 - p[3]) * (depth - DEPTH_M) / STRETCH_M + p[3] * s[_FELT] / SPEED_M_S - p[2]
    trigger = 0.5 * (trigger + math.sqrt(trigger * trigger + CORNER * CORNER))
    place = (b[bus.TIME] + 0.5 * dt) / GRID_S
    now = int(place)
    while s[_LATEST] <= now:
        share = (s[_LATEST] - s[_PLACE]) / (place - s[_PLACE])
        s[int(s[_LATEST]) % GRID] = s[_TRIGGER] + share * (trigger - s[_TRIGGER])
        s[_LATEST] += 1.0
    s[_TRIGGER] = trigger
    s[_PLACE] = place
    past = place - p[1] / GRID_S
    if past >= 0.0:
        earlier = int(past)
        share = past - earlier
        delayed = (1.0 - share) * s[earlier % GRID] + share * s[(earlier + 1) % GRID]
        share = 1.0 - math.exp(-dt / p[4])
        s[_ACTIVITY] += (delayed - s[_ACTIVITY]) * share
        s[_FORCE] += (s[_ACTIVITY] - s[_FORCE]) * share
    force = p[0] * s[_FORCE]
    b[bus.TISSUE_FORCE] += force / (1.0 + abs(force) / p[5])


def usual_stretch(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Starts whose threshold lies amid the stretch of the longest pushes: half of the time it answers."""
    pushed = [test["position"] for test in tests if "position" in test and np.isfinite(test["position"]).any()]
    if not pushed:
        return ()
    depths = [float(np.nanmedian(position) - position[np.isfinite(position)][0]) for position in pushed]
    threshold = min(max(0.5 * (max(depths) - DEPTH_M) / STRETCH_M, -4.0), 7.0)
    return tuple((0.05, delay, threshold, 0.5, RISE_S, MOST_N, FELT_S) for delay in DELAYS_S)


EFFECT = Effect(
    name="reflex",
    stage="tissue",
    title="A reflex answers stretch",
    equation="F = G f / (1 + |G f| / M), (1 + T d/dt)^2 f = max(0, (1 - h) (d - 3 mm) / 0.5 mm + h w / 30 mm/s - c) "
    "one delay ago, (1 + S d/dt) w = v; vanishes with G = 0",
    signature="position pushed out 20 to 150 ms after every fast push in, never the other way; ripples in the response "
    "against frequency, spaced by the inverse of the delay; nothing on the spring",
    source="Kearney, Stein & Parameswaran, IEEE Trans. Biomed. Eng. 44 (1997) 493-504 (delayed one-sided velocity, "
    "then a second-order low-pass)",
    parameters=(
        Parameter("gain_n", "N", 0.0, -5.0, 5.0, meaning="force for a stretch of 0.5 mm, or 30 mm/s"),
        Parameter("delay_s", "s", None, 0.01, 0.2, True, meaning="from stretch to the first answer"),
        Parameter("threshold", "1", None, -5.0, 8.0, meaning="what must be passed, 1 being 0.5 mm or 30 mm/s"),
        Parameter("by_speed", "1", None, 0.0, 1.0, prior=0.5, prior_std=0.5, meaning="share that speed triggers"),
        Parameter("rise_s", "s", None, 2e-3, 0.2, True, prior=0.015, prior_std=1.0, meaning="of activation, twice"),
        Parameter("most_n", "N", None, 0.02, 50.0, True, prior=1.0, prior_std=1.5, meaning="what the muscle can do"),
        Parameter("felt_s", "s", None, 5e-4, 0.03, True, prior=FELT_S, prior_std=0.7, meaning="in which speed is felt"),
    ),
    starts=tuple((0.05, delay, 1.2, 0.5, RISE_S, MOST_N, FELT_S) for delay in DELAYS_S),
    mistaken_for=("viscoelasticity", "physiological_motion", "mount_resonance", "contact_loss"),
    places=(bus.TISSUE,),
    hook=hook,
    starts_from=usual_stretch,
    on_spring=False,
    remedy="Ask the person to relax, and test with smaller amplitude, below the reflex.",
)
