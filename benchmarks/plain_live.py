"""Least mean squares over the latest seconds without stored state: FFT correlations, recomputed for each estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

Array = NDArray[np.float64]


def responses(u: Array, y: Array, lags: int, extra: int, window: int, every: int, taper: float, ridge: float) -> Array:
    """Return impulse responses (looks, lags) over the latest ``window`` samples, at every ``every`` samples.

    ``lags + extra`` lags are estimated and the last ``extra`` cut off, except while the window has fewer complete
    memories of that length than lags. ``ridge`` is added to the diagonal, relative to it.
    """
    found = []
    for end in range(every, u.size + 1, every):
        x, z = u[max(0, end - window) : end], y[max(0, end - window) : end]
        estimated = lags + extra if x.size + 1 >= 2 * (lags + extra) else lags
        fade = signal.windows.tukey(x.size, taper)
        x, z = (x - x.mean()) * fade, (z - z.mean()) * fade
        auto = signal.correlate(x, x, method="fft")[x.size - 1 :][:estimated] / x.size
        cross = signal.correlate(z, x, method="fft")[x.size - 1 :][:estimated] / x.size
        auto[0] *= 1.0 + ridge
        found.append(linalg.solve_toeplitz(auto, cross)[:lags])
    return np.array(found)
