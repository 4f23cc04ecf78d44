"""Position recorded in coarse steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter, Readings

COARSE_M = 2e-6
"""Smallest step that is an effect, m; smaller ones belong to the converter and are within the noise."""
WIDEST_BLUR = 0.7
"""Noise before rounding, in steps, from which less than 0.01 % of the steps is visible."""
EDGES = 4


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Return the expected rounded reading with noise (or prediction error) of ``blur`` before rounding."""
    step, origin, threshold, blur = values
    if step <= 0.0:
        return readings
    exact = (readings.position - origin) / step + threshold
    nearest = np.round(exact)
    off = exact - nearest
    if blur < WIDEST_BLUR:
        edges = np.arange(EDGES)[:, None] + 0.5
        over = special.ndtr((off - edges) / blur).sum(axis=0)
        under = special.ndtr((-off - edges) / blur).sum(axis=0)
        exact = nearest + over - under
    return replace(readings, position=origin + step * exact)


def irreducible(values: FloatArray) -> Mapping[str, float]:
    """Return the standard deviation of rounding around the expected reading, m; at most a step over the root of 12."""
    step, _, _, blur = values
    order = np.arange(1, 2000)
    predictable = 0.5 * float(np.sum((np.exp(-2.0 * (np.pi * order * blur) ** 2) / (np.pi * order)) ** 2))
    return {"position": step * math.sqrt(max(1.0 / 12.0 - predictable, 0.0))}


def grid(values: FloatArray) -> tuple[float, float] | None:
    """Return step and origin of the grid of recorded values; None without a grid or where finer than ``COARSE_M``."""
    levels = np.unique(values[np.isfinite(values)])
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-7]
    if gaps.size < 3:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    base = float(levels[levels.size // 2])
    # Values many steps apart determine the step more precisely; each round starts from the previous one.
    for reach in (8.0, 64.0, 512.0, math.inf):
        off = levels[np.abs(levels - base) <= reach * step] - base
        counts = np.round(off / step)
        if counts.any():
            step = float(counts @ off / (counts @ counts))
    remainders = (levels - base) / step - np.round((levels - base) / step)
    if step < COARSE_M or float(np.abs(remainders).max()) > 0.1:
        return None
    return step, base + step * float(np.mean(remainders))


def estimate_from_record(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Return step and origin from the occurring values; a negligible step where there is no grid."""
    fitted = grid(signals["position"])
    step, origin = fitted if fitted is not None else (COARSE_M / 4.0, 0.0)
    return {"step_m": step, "origin_m": origin - step * round(origin / step)}


EFFECT = Effect(
    name="quantization",
    stage="sensing",
    acts_on=ActsOn.CONVERTER,
    title="Position in coarse steps",
    equation="y = E[x0 + s round((x - x0) / s + t + n)], n normal with std b, so that y - x = s t + s sum of (-1)^k / "
    "(pi k) exp(-2 (pi k b)^2) sin(2 pi k ((x - x0) / s + t)); vanishes with s = 0",
    signature="recorded positions lie on a grid; errors of at most s / sqrt(12), white when the motion spans several "
    "steps; voltage and current unchanged",
    source="Widrow & Kollar, Quantization Noise (2008), ch. 4 and 19; Carbone & Petri, IEEE Trans. Instrum. Meas. 43 "
    "(1994) 389 (dither)",
    parameters=(
        Parameter("step_m", "m", 0.0, 1e-7, 1e-3, True, per_test=True, fixed=True, meaning="estimated from the record"),
        Parameter("origin_m", "m", None, -1e-3, 1e-3, per_test=True, fixed=True, meaning="estimated from the record"),
        Parameter("threshold", "1", None, -0.5, 0.5, meaning="rounding: 0 to the nearest, 0.5 up, −0.5 down"),
        Parameter(
            "blur", "1", None, 0.01, 1.0, True, prior=0.08, prior_std=1.0, meaning="noise before rounding, in steps"
        ),
    ),
    starts=((5e-7, 0.0, 0.0, 0.15), (5e-7, 0.0, -0.5, 0.15), (5e-7, 0.0, 0.5, 0.15)),
    mistaken_for=("sensor_backlash",),
    recording=recording,
    needs=frozenset({"position"}),
    estimate_from_record=estimate_from_record,
    irreducible=irreducible,
    remedy="Use the sensor's finer range or a converter of more bits.",
)
