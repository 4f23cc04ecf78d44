"""Algorithms of Chen 2010 as printed, in vectorised numpy: what the times of the thesis are compared with.

The recursions of the thesis are loops, and everything inside them is vectorised; nothing is compiled. The engines give
the same results by other routes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import optimize, signal
from scipy.linalg import toeplitz

from tissueid.identification.base import Array

_EPSILON = 1e-10
"""Added to a norm that is smaller (Eq. 4.8)."""


@dataclass(frozen=True, eq=False)
class Orthonormalised:
    """alpha (M, M), beta (M, samples) and chi (M,), which can be stored for an input."""

    alpha: Array
    beta: Array
    chi: Array


def construct_volterra(x: Array, memory: int) -> Array:
    """Return P (M, samples) of Eq. 4.4 for an input (n,) and lags 0 to ``memory``, without the first ``memory``."""
    n = x.size
    lagged = np.array([x[memory - i : n - i] for i in range(memory + 1)])
    first, second = np.triu_indices(memory + 1)
    return np.vstack([np.ones((1, n - memory)), lagged, lagged[first] * lagged[second]])


def construct_partitions(x: Array, y: Array, breakpoints: Array, lags: int) -> Array:
    """Return P (1 + partitions x lags, samples) of Eq. 5.1, without the first ``lags`` - 1 samples."""
    rows = [np.ones(x.size - lags + 1)]
    for low, high in pairwise(breakpoints):
        inside = np.where((y >= low) & (y < high), x, 0.0)
        rows += [inside[lags - 1 - lag : x.size - lag] for lag in range(lags)]
    return np.array(rows)


def orthonormalise(p: Array) -> Orthonormalised:
    """Apply modified Gram-Schmidt, Eqs. 4.6 to 4.10. P is overwritten: its rows become beta."""
    m = p.shape[0]
    alpha = np.zeros((m, m))
    chi = np.empty(m)
    for r in range(m):
        beta = p[r]
        chi[r] = beta @ beta
        if chi[r] < _EPSILON:
            chi[r] += _EPSILON
        alpha[r + 1 :, r] = p[r + 1 :] @ beta / chi[r]
        p[r + 1 :] -= np.outer(alpha[r + 1 :, r], beta)
    return Orthonormalised(alpha, p, chi)


def solve(stored: Orthonormalised, y: Array) -> Array:
    """Return A (M,) of Eqs. 4.11 to 4.13 for an output (samples,)."""
    m = stored.chi.size
    gamma = stored.beta @ y / stored.chi
    coefficients = np.empty(m)
    for first in range(m):
        v = np.empty(m - first)
        v[0] = 1.0
        for i in range(1, m - first):
            v[i] = -(stored.alpha[first + i, first : first + i] @ v[:i])
        coefficients[first] = gamma[first:] @ v
    return coefficients


def volterra(x: Array, y: Array, memory: int) -> Array:
    """Return A (M,) of a second-order system, Eqs. 4.4 to 4.13."""
    return solve(orthonormalise(construct_volterra(x, memory)), y[memory:])


def depth_partitions(x: Array, y: Array, breakpoints: Array, lags: int) -> Array:
    """Return A (1 + partitions x lags,), Eqs. 5.1 and 4.6 to 4.13: the offset, then the kernels."""
    return solve(orthonormalise(construct_partitions(x, y, breakpoints, lags)), y[lags - 1 :])


def impulse_response(x: Array, y: Array, lags: int) -> tuple[Array, float]:
    """Return an impulse response (lags,) and the condition number of its matrix (Eqs. 3.2 to 3.5, C.1.1).

    From all biased correlations, the dense Toeplitz matrix and its pseudo-inverse.
    """
    n = x.size
    x = x - x.mean()
    y = y - y.mean()
    auto = signal.correlate(x, x, method="fft") / n  # lags -(n - 1) .. n - 1
    cross = signal.correlate(y, x, method="fft") / n
    matrix = toeplitz(auto[n - 1 : n - 1 + lags])
    return np.linalg.pinv(matrix) @ cross[n - 1 : n - 1 + lags], float(np.linalg.cond(matrix))


def wiener(u: Array, y: Array, lags: int, passes: int) -> tuple[float, float]:
    """Return C1 and C2 after a number of iterations, each with all correlations (Eqs. 3.17 to 3.26, C.2.2)."""
    target = y

    def exponential(z: Array, c1: float, c2: float, offset: float) -> Array:
        return np.asarray(offset + c1 * (1.0 - np.exp(-c2 * z)))

    guess = [float(np.ptp(y)), 0.2, float(np.min(y))]
    for _ in range(passes):
        kernel, _ = impulse_response(u, target, lags)
        linear = np.convolve(u - u.mean(), kernel)[: u.size] / kernel.sum() + u.mean()
        guess, _ = optimize.curve_fit(exponential, linear[lags:], y[lags:], p0=guess, maxfev=5000)
        c1, c2, offset = guess
        reach = np.minimum((y - offset) / c1, 1.0 - 1e-9)
        target = -np.log(1.0 - reach) / c2
    return float(guess[0]), float(guess[1])


def direct_autocorrelation(values: Array) -> Array:
    """Return all lags (n,) of the biased autocorrelation by its definition (Eq. 3.3): a scalar product for each."""
    return np.asarray(np.correlate(values, values, "full")[values.size - 1 :] / values.size)


def transformed_autocorrelation(values: Array) -> Array:
    """Return all lags (n,) of the biased autocorrelation by Fourier transforms, as MATLAB's ``xcorr``."""
    return np.asarray(signal.correlate(values, values, method="fft")[values.size - 1 :] / values.size)


def swapped_autocorrelation(values: Array, auto: Array, first: int, second: int) -> Array:
    """Return the lags of ``auto`` (lags,) after two samples of ``values`` (n,) are swapped (C.4).

    Only products with either sample change. The length of ``auto`` is the number of lags that are followed.
    """
    n, lags = values.size, auto.size
    change = float(values[second] - values[first])
    new = auto * n
    reach = np.arange(1, lags)
    for index, sign in ((first, 1.0), (second, -1.0)):
        for step in (reach, -reach):
            partner = index + step
            inside = (partner >= 0) & (partner < n) & (partner != first) & (partner != second)
            new[reach[inside]] += sign * change * values[partner[inside]]
    return np.asarray(new / n)
