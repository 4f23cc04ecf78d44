"""Interpolation between samples, and smooth curves through values at equal distances along the stroke. Private."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def interpolate(values: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate at fractional sample numbers by a cubic Lagrange polynomial; hold the ends.

    Laakso et al., IEEE Signal Processing Magazine 13 (1996) 30-60, table 1. Fewer than four samples are returned
    unchanged.
    """
    if values.size < 4:
        return values
    result = np.empty(at.size)
    for n in range(at.size):
        inside = min(max(at[n], 0.0), values.size - 1.0)
        first = min(max(int(inside), 1), values.size - 3)
        t = inside - first
        result[n] = (
            values[first - 1] * (-t * (t - 1.0) * (t - 2.0) / 6.0)
            + values[first] * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
            + values[first + 1] * (-(t + 1.0) * t * (t - 2.0) / 2.0)
            + values[first + 2] * ((t + 1.0) * t * (t - 1.0) / 6.0)
        )
    return result


FARTHEST_M = 0.045
"""Largest plausible position of a probe, m."""
_OUTSIDE = 0.002
"""Share of the readings at either end that is excluded from the range."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def along(p, first, size, share):  # type: ignore[no-untyped-def]
    """Return the curve through ``p[first]`` to ``p[first + size - 1]`` at a share of the range; hold it beyond the
    ends."""
    z = min(max(share, 0.0), 1.0) * (size - 1)
    k = min(int(z), size - 2)
    t = z - k
    low, high = p[first + k], p[first + k + 1]
    rise = high - low
    into = 0.5 * (high - p[first + k - 1]) if k > 0 else rise
    out_of = 0.5 * (p[first + k + 2] - low) if k < size - 2 else rise
    return low + t * (into + t * (3.0 * rise - 2.0 * into - out_of + t * (into + out_of - 2.0 * rise)))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def curve(values, shares):  # type: ignore[no-untyped-def]
    """Return the curve through all ``values`` at each share of the range, shape (n,)."""
    result = np.empty(shares.size)
    for n in range(shares.size):
        result[n] = along(values, 0, values.size, shares[n])
    return result


def travelled_range(tests: Sequence[Mapping[str, Any]]) -> tuple[float, float] | None:
    """Return the range of positions (m) in all tests with a stimulus; None where there is no range."""
    moved = [test for test in tests if "position" in test and "command" in test and np.ptp(test["command"]) > 0.0]
    places = [test["position"][np.isfinite(test["position"])] for test in moved]
    every = np.concatenate(places) if places else np.zeros(0)
    every = every[np.abs(every) < FARTHEST_M]
    if not every.size:
        return None
    low, high = np.quantile(every, [_OUTSIDE, 1.0 - _OUTSIDE])
    return (float(low), float(high)) if high - low > 1e-4 else None
