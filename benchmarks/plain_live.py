"""Least mean squares over the latest seconds without stored state: FFT correlations, recomputed for each estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

Array = NDArray[np.float64]


def responses(u: Array, y: Array, lags: int, window: int, every: int, taper: float, ridge: float) -> Array:
    """Return impulse responses (looks, lags) over the latest ``window`` samples, at every ``every`` samples."""
    found = []
    for end in range(every, u.size + 1, every):
        x, z = u[max(0, end - window) : end], y[max(0, end - window) : end]
        fade = signal.windows.tukey(x.size, taper)
        x, z = (x - x.mean()) * fade, (z - z.mean()) * fade
        auto = signal.correlate(x, x, method="fft")[x.size - 1 :][:lags] / x.size
        cross = signal.correlate(z, x, method="fft")[x.size - 1 :][:lags] / x.size
        auto[0] *= 1.0 + ridge
        found.append(linalg.solve_toeplitz(auto, cross))
    return np.array(found)
