"""A delayed, one-sided active response of the tissue to stretch."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

GRID_S = 5e-4
GRID = 480
"""Entries of the memory of stretch, ``GRID_S`` apart: 240 ms."""
STRETCH_M = 5e-4
SPEED_M_S = 0.03
"""Reference speed, m/s: the standard deviation in a stochastic test."""
DEPTH_M = 3e-3
"""Reference depth of the stretch, m; the threshold shifts it."""
RISE_S = 0.012
"""Starting value of the time constant of activation and contraction, s."""
MOST_N = 1.0
"""Starting value of the largest force, N, of a small muscle."""
FELT_S = 4e-3
"""Starting value of the time constant of sensed speed, s: spindles average over milliseconds."""
CORNER = 0.03
"""Width of the smoothed corner in reference units: sharp enough to be one-sided, smooth enough for a fit."""
DELAYS_S = (0.03, 0.055, 0.085, 0.125)
_LATEST = GRID
_ACTIVITY = GRID + 1
_TRIGGER = GRID + 2
_PLACE = GRID + 3
_FORCE = GRID + 4
_FELT = GRID + 5


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Store stretch and speed in a ring, and add the response to the value one delay ago, limited by the muscle."""
    depth = b[bus.DEPTH]
    velocity = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    s[_FELT] += (velocity - s[_FELT]) * (1.0 - math.exp(-dt / p[6]))
    trigger = (1.0 - p[3]) * (depth - DEPTH_M) / STRETCH_M + p[3] * s[_FELT] / SPEED_M_S - p[2]
    trigger = 0.5 * (trigger + math.sqrt(trigger * trigger + CORNER * CORNER))
    grid_time = (b[bus.TIME] + 0.5 * dt) / GRID_S
    now = int(grid_time)
    while s[_LATEST] <= now:
        share = (s[_LATEST] - s[_PLACE]) / (grid_time - s[_PLACE])
        s[int(s[_LATEST]) % GRID] = s[_TRIGGER] + share * (trigger - s[_TRIGGER])
        s[_LATEST] += 1.0
    s[_TRIGGER] = trigger
    s[_PLACE] = grid_time
    past = grid_time - p[1] / GRID_S
    if past >= 0.0:
        earlier = int(past)
        share = past - earlier
        delayed = (1.0 - share) * s[earlier % GRID] + share * s[(earlier + 1) % GRID]
        share = 1.0 - math.exp(-dt / p[4])
        s[_ACTIVITY] += (delayed - s[_ACTIVITY]) * share
        s[_FORCE] += (s[_ACTIVITY] - s[_FORCE]) * share
    force = p[0] * s[_FORCE]
    b[bus.TISSUE_FORCE] += force / (1.0 + abs(force) / p[5])


def start_from_stretch(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return starting points with a threshold in the middle of the stretch of the deepest test."""
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
    signature="position pushed out 20 to 150 ms after every fast push in, never the reverse; ripples in the frequency "
    "response, spaced by the inverse of the delay; nothing on the spring",
    source="Kearney, Stein & Parameswaran, IEEE Trans. Biomed. Eng. 44 (1997) 493-504 (delayed one-sided velocity, "
    "then a second-order low-pass)",
    parameters=(
        Parameter("gain_n", "N", 0.0, -5.0, 5.0, meaning="force at a stretch of 0.5 mm or 30 mm/s above the threshold"),
        Parameter("delay_s", "s", None, 0.01, 0.2, True, meaning="delay from the stretch to the first response"),
        Parameter("threshold", "1", None, -5.0, 8.0, meaning="threshold of the stretch, where 1 is 0.5 mm or 30 mm/s"),
        Parameter("by_speed", "1", None, 0.0, 1.0, prior=0.5, prior_std=0.5, meaning="share of speed in the stretch"),
        Parameter("rise_s", "s", None, 2e-3, 0.2, True, prior=0.015, prior_std=1.0, meaning="rise time constant"),
        Parameter(
            "most_n", "N", None, 0.02, 50.0, True, prior=1.0, prior_std=1.5, meaning="largest force of the muscle"
        ),
        Parameter(
            "felt_s", "s", None, 5e-4, 0.03, True, prior=FELT_S, prior_std=0.7, meaning="time constant of sensed speed"
        ),
    ),
    starts=tuple((0.05, delay, 1.2, 0.5, RISE_S, MOST_N, FELT_S) for delay in DELAYS_S),
    mistaken_for=("viscoelasticity", "physiological_motion", "mount_resonance", "contact_loss"),
    places=(bus.TISSUE,),
    hook=hook,
    starts_from=start_from_stretch,
    on_spring=False,
    remedy="Ask the person to relax, and test with smaller amplitude, below the reflex.",
)
