"""Static law of the tissue that differs from the twin's: an engaging layer, bone, a power law."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import Effect, FloatArray, Parameter

REFERENCE_M = 1e-3
CORNER_M = 1e-4
"""Starting value of the width of the onset, m."""
SHARES = (0.3, 0.5, 0.7, 0.85, 0.95)
"""Quantiles of the depth at which further starting points lie."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Add a spring with play and a power law, symmetric around the surface."""
    depth, play = b[bus.DEPTH], p[1]
    # Depth outside the play, with rounded corners: odd in depth, and 0 at 0 for any play.
    beyond, short = depth - play, depth + play
    square = p[3] * p[3]
    into = depth - 0.5 * (math.sqrt(short * short + square) - math.sqrt(beyond * beyond + square))
    size = min(abs(into) / REFERENCE_M, 20.0)
    force = p[0] * size ** p[2] if size > 0.0 else 0.0
    b[bus.TISSUE_FORCE] += force if into > 0.0 else -force


def starts_within_depths(
    tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float
) -> tuple[tuple[float, ...], ...]:
    """Return starting points with the onset within the depths of the deepest test."""
    depths = []
    for test in tests:
        positions = test["position"][np.isfinite(test["position"])] if "position" in test else np.zeros(0)
        if positions.size > 1 and np.ptp(test.get("command", positions)) > 0.0:
            depths.append(positions - positions[0])
    if not depths:
        return ()
    deepest = max(depths, key=lambda depth: float(np.median(depth)))
    places = [min(max(float(depth), 2e-4), 0.011) for depth in np.quantile(deepest, SHARES)]
    return tuple((0.2, onset, 1.2, CORNER_M) for onset in dict.fromkeys(places))


EFFECT = Effect(
    name="tissue_stiffening",
    stage="tissue",
    title="Different static law, such as an engaging layer",
    equation="F = F1 sgn(d) (max(|d| - d1, 0) / 1 mm)^n in addition to the twin's K exp(g d) d, its corner rounded; "
    "vanishes with F1 = 0",
    signature="position at large depth against current: stiffness rises (or falls) from one depth on, slow ramp and "
    "stochastic test alike; no loops, nothing on the spring",
    source="Fung, Biomechanics: Mechanical Properties of Living Tissues (1993); Worden & Tomlinson, Nonlinearity "
    "in Structural Dynamics (2001) (cubic and bilinear stiffness)",
    parameters=(
        Parameter("force_n", "N", 0.0, -10.0, 30.0, meaning="force at 1 mm beyond the play"),
        Parameter("depth_m", "m", None, 0.0, 0.012, meaning="depth at which it begins"),
        Parameter("exponent", "1", None, 1.0, 4.0, meaning="exponent of its growth"),
        Parameter("corner_m", "m", None, 1e-5, 1e-3, True, prior=CORNER_M, prior_std=1.0, meaning="width of the onset"),
    ),
    starts=(
        (0.2, 0.002, 1.5, CORNER_M),
        (0.3, 0.004, 1.5, CORNER_M),
        (-0.1, 0.002, 1.5, CORNER_M),
        (0.02, 0.0005, 3.0, CORNER_M),
    ),
    starts_from=starts_within_depths,
    mistaken_for=("end_stop", "cogging", "sensor_nonlinearity", "force_constant_position", "contact_loss"),
    places=(bus.TISSUE,),
    hook=hook,
    on_spring=False,
    remedy="Report the depth at which it begins; test at a mean depth on either side of it.",
)
