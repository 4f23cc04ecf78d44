"""Position recorded in coarse steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from tissueid.twin.effect import Effect, FloatArray, Parameter, Readings

COARSE_M = 2e-6
"""Steps below this are the converter's own, no more than the noise, and no effect."""
WIDEST_BLUR = 0.7
"""In steps: beyond it less than 0.01 % of the stairs is left."""
EDGES = 4


def recording(readings: Readings, values: FloatArray) -> Readings:
    """The expected value of a rounded reading before which noise (or the prediction's error) of ``blur`` comes."""
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
    """Standard deviation that rounding leaves round the expected reading, m; at most a step over the root of 12."""
    step, _, _, blur = values
    order = np.arange(1, 2000)
    known = 0.5 * float(np.sum((np.exp(-2.0 * (np.pi * order * blur) ** 2) / (np.pi * order)) ** 2))
    return {"position": step * math.sqrt(max(1.0 / 12.0 - known, 0.0))}


def grid(values: FloatArray) -> tuple[float, float] | None:
    """Step and origin of the grid on which recorded values lie; None where it is finer than ``COARSE_M`` or none."""
    known = np.unique(values[np.isfinite(values)])
    gaps = np.diff(known)
    gaps = gaps[gaps > 1e-7]
    if gaps.size < 3:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    base = float(known[known.size // 2])
    # Many steps apart, the values say it more exactly; one round is the start of the next.
    for reach in (8.0, 64.0, 512.0, math.inf):
        off = known[np.abs(known - base) <= reach * step] - base
        counts = np.round(off / step)
        if counts.any():
            step = float(counts @ off / (counts @ counts))
    left = (known - base) / step - np.round((known - base) / step)
    if step < COARSE_M or float(np.abs(left).max()) > 0.1:
        return None
    return step, base + step * float(np.mean(left))


def from_test(signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    """Step and origin from the values that occur; a step that is none where they lie on no grid."""
    found = grid(signals["position"])
    step, origin = found if found is not None else (COARSE_M / 4.0, 0.0)
    return {"step_m": step, "origin_m": origin - step * round(origin / step)}


EFFECT = Effect(
    name="quantization",
    stage="sensing",
    title="Position in coarse steps",
    equation="y = E[x0 + s round((x - x0) / s + t + n)], n normal with std b, so that y - x = s t + s sum of (-1)^k / "
    "(pi k) exp(-2 (pi k b)^2) sin(2 pi k ((x - x0) / s + t)); vanishes with s = 0",
    signature="recorded positions lie on a grid, none between; errors of s / sqrt(12) at most, white once the motion "
    "spans several steps; voltage and current untouched",
    source="Widrow & Kollar, Quantization Noise (2008), ch. 4 and 19; Carbone & Petri, IEEE Trans. Instrum. Meas. 43 "
    "(1994) 389 (dither)",
    parameters=(
        Parameter("step_m", "m", 0.0, 1e-7, 1e-3, True, per_test=True, fixed=True, meaning="read off the record"),
        Parameter("origin_m", "m", None, -1e-3, 1e-3, per_test=True, fixed=True, meaning="read off the record"),
        Parameter("threshold", "1", None, -0.5, 0.5, meaning="0: rounds, 0.5: always up, -0.5: always down"),
        Parameter("blur", "1", None, 0.01, 1.0, True, prior=0.08, prior_std=1.0, meaning="noise before it, in steps"),
    ),
    starts=((5e-7, 0.0, 0.0, 0.15), (5e-7, 0.0, -0.5, 0.15), (5e-7, 0.0, 0.5, 0.15)),
    mistaken_for=("sensor_backlash",),
    recording=recording,
    needs=frozenset({"position"}),
    from_test=from_test,
    irreducible=irreducible,
    remedy="Use the sensor's finer range or a converter of more bits.",
)
