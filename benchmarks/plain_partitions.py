"""Depth partitions of Chen 2010, Eqs. 5.1-5.2 solved by 4.6-4.13, in vectorised numpy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.plain_volterra import answer, orthonormalise

Array = NDArray[np.float64]


def construct(x: Array, y: Array, breakpoints: Array, lags: int) -> Array:
    """Return P (1 + partitions x lags, samples) of Eq. 5.1, without the first ``lags`` - 1 samples."""
    rows = [np.ones(x.size - lags + 1)]
    for low, high in pairwise(breakpoints):
        inside = np.where((y >= low) & (y < high), x, 0.0)
        rows += [inside[lags - 1 - lag : x.size - lag] for lag in range(lags)]
    return np.array(rows)


def depth_partitions(x: Array, y: Array, breakpoints: Array, lags: int) -> Array:
    """Return A (1 + partitions x lags,): the offset, then the kernels."""
    return answer(orthonormalise(construct(x, y, breakpoints, lags)), y[lags - 1 :])
