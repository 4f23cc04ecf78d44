"""Stiffness of slow ramps: the slope of force against displacement, separately for loading and unloading."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import ndimage

from tissueid.identification.base import Array
from tissueid.identification.impulse_response import dependence_samples
from tissueid.identification.second_order_fit import sandwich
from tissueid.records import Estimate, Record

NAMES = {1.0: "loading_stiffness_n_per_m", -1.0: "unloading_stiffness_n_per_m"}
"""Parameter of each direction of the displacement."""
_PART = (0.1, 0.9)
"""Part of a ramp, in shares of its height, whose slope is taken: without the rounded ends."""
_LEAST_HEIGHT = 0.5
"""Least height of a ramp relative to the range of the displacement."""
_STEADY = 0.8
"""Least height of a ramp relative to the way of the moving mean along it: with less it is noise."""
_FEWEST, _LEAST_LENGTH = 20, 0.01
"""Fewest samples in that part, and its least length relative to the record: a shorter one is a step, or noise."""
_MOST_TURNS = 24
"""Most ends of ramps and steps of a slow input."""
_SMOOTHED = 200
"""Lengths of the moving mean that finds the ramps in a record."""
_LOOKED_AT = 4000
"""Samples of a record among which the ends of the ramps are looked for."""


def ramp_stiffness(record: Record) -> dict[str, Estimate]:
    """Return the stiffness of the ramps of a record of force (N) and position (m), N/m; {} if it has none.

    It is the least-squares slope of the force between a tenth and nine tenths of the height of each ramp, with one
    offset for each. The standard deviation is valid for correlated residuals, such as those of a curved ramp. A ramp
    of tissue that relaxes is stiffer the faster it is.
    """
    if (record.input_unit, record.output_unit) != ("N", "m"):
        return {}
    valid = np.flatnonzero(record.valid)
    if valid.size < _FEWEST:
        return {}
    x, force = record.output[valid], record.input[valid]
    smooth = _smooth(x)
    turns = _turning_points(smooth, _LEAST_HEIGHT * float(np.ptp(smooth)))
    fewest = max(_FEWEST, round(_LEAST_LENGTH * valid.size))
    ramps: dict[float, list[np.ndarray]] = {1.0: [], -1.0: []}
    for first, last in pairwise(turns):
        height = smooth[last] - smooth[first]
        if abs(height) < _STEADY * float(np.sum(np.abs(np.diff(smooth[first : last + 1])))):
            continue
        share = (smooth[first : last + 1] - smooth[first]) / height
        inside = first + np.flatnonzero((share > _PART[0]) & (share < _PART[1]))
        if inside.size >= fewest:
            ramps[float(np.sign(height))].append(inside)
    if len(turns) - 1 > 2 * sum(map(len, ramps.values())):  # most are steps, or noise
        return {}
    return {NAMES[way]: _slope(x, force, parts, record.sample_rate_hz) for way, parts in ramps.items() if parts}


def is_slow(u: Array) -> bool:
    """Return whether an input (n,) without NaN is made of a few ramps, steps and holds, and is not noise."""
    smooth = _smooth(u)
    return len(_turning_points(smooth, _LEAST_HEIGHT * float(np.ptp(smooth)))) <= _MOST_TURNS


def _smooth(x: Array) -> Array:
    return np.asarray(ndimage.uniform_filter1d(x, max(1, x.size // _SMOOTHED), mode="nearest"), dtype=np.float64)


def _turning_points(x: Array, least: float) -> list[int]:
    """Return the ends of the rises and falls of at least ``least`` in a smooth course (n,), in order."""
    turns: list[int] = []
    low = high = way = 0
    for k in range(0, x.size, max(1, x.size // _LOOKED_AT)):
        low, high = (k if x[k] < x[low] else low), (k if x[k] > x[high] else high)
        if way <= 0 and x[k] - x[low] >= least:
            turns.append(low)
            way, high = 1, k
        elif way >= 0 and x[high] - x[k] >= least:
            turns.append(high)
            way, low = -1, k
    return [*turns, high if way > 0 else low] if way else turns


def _slope(x: Array, force: Array, parts: list[np.ndarray], rate: float) -> Estimate:
    """Return the common slope of force (n,) against x (n,) in several parts, each with its own offset."""
    away = np.concatenate([x[part] - x[part].mean() for part in parts])
    load = np.concatenate([force[part] - force[part].mean() for part in parts])
    slope = float(away @ load) / float(away @ away)
    error = load - slope * away
    block = 1 if dependence_samples(error, rate) == 1 else error.size // 8  # curvature lasts as long as a ramp
    covariance = sandwich(away[:, None], error, block)
    return Estimate(slope, None if covariance is None else float(np.sqrt(covariance[0, 0])))
