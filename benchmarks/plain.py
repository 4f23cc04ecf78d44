"""Methods of Chen 2010, Appendices C.1.1 and C.2.2, in vectorised numpy: references of the benchmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal
from scipy.linalg import toeplitz

Array = NDArray[np.float64]


def impulse_response(x: Array, y: Array, lags: int) -> tuple[Array, float]:
    """Estimate an impulse response from all biased correlations, the dense Toeplitz matrix, its pseudo-inverse and
    condition number.
    """
    n = x.size
    x = x - x.mean()
    y = y - y.mean()
    auto = signal.correlate(x, x, method="fft") / n  # lags -(n - 1) .. n - 1
    cross = signal.correlate(y, x, method="fft") / n
    matrix = toeplitz(auto[n - 1 : n - 1 + lags])
    return np.linalg.pinv(matrix) @ cross[n - 1 : n - 1 + lags], float(np.linalg.cond(matrix))


def wiener(u: Array, y: Array, lags: int, passes: int) -> tuple[float, float]:
    """Return C1 and C2 after a number of iterations, each with all correlations."""
    target = y

    def exponential(z: Array, c1: float, c2: float, offset: float) -> Array:
        return offset + c1 * (1.0 - np.exp(-c2 * z))

    guess = [float(np.ptp(y)), 0.2, float(np.min(y))]
    for _ in range(passes):
        kernel, _ = impulse_response(u, target, lags)
        linear = np.convolve(u - u.mean(), kernel)[: u.size] / kernel.sum() + u.mean()
        guess, _ = optimize.curve_fit(exponential, linear[lags:], y[lags:], p0=guess, maxfev=5000)
        c1, c2, offset = guess
        reach = np.minimum((y - offset) / c1, 1.0 - 1e-9)
        target = -np.log(1.0 - reach) / c2
    return float(guess[0]), float(guess[1])
