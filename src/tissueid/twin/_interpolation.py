"""Interpolation between samples. Private."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def interpolate(values: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate at fractional sample numbers by a cubic Lagrange polynomial; hold the ends.

    Laakso et al., IEEE Signal Processing Magazine 13 (1996) 30-60, table 1. Fewer than four samples are returned
    unchanged.
    """
    if values.size < 4:
        return values
    inside = np.clip(at, 0.0, values.size - 1.0)
    first = np.clip(np.floor(inside).astype(np.int64), 1, values.size - 3)
    t = inside - first
    found: FloatArray = (
        values[first - 1] * (-t * (t - 1.0) * (t - 2.0) / 6.0)
        + values[first] * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
        + values[first + 1] * (-(t + 1.0) * t * (t - 2.0) / 2.0)
        + values[first + 2] * ((t + 1.0) * t * (t - 1.0) / 6.0)
    )
    return found
