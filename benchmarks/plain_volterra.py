"""Exact orthonormalisation of Chen 2010, Eqs. 4.4-4.14 and C.3.1, in vectorised numpy.

Recursions of the thesis are loops (r in 4.7-4.10, m and i in 4.12); everything inside them is vectorised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EPSILON = 1e-10


@dataclass(frozen=True)
class Orthonormalised:
    """alpha (M, M), beta (M, samples) and chi (M,), which can be stored for an input."""

    alpha: Array
    beta: Array
    chi: Array


def construct(x: Array, memory: int) -> Array:
    """Return P (M, samples) of Eq. 4.4 for lags 0 to ``memory``, without the first ``memory`` samples."""
    n = x.size
    lagged = np.array([x[memory - i : n - i] for i in range(memory + 1)])
    first, second = np.triu_indices(memory + 1)
    return np.vstack([np.ones((1, n - memory)), lagged, lagged[first] * lagged[second]])


def orthonormalise(p: Array) -> Orthonormalised:
    """Apply modified Gram-Schmidt, Eqs. 4.6-4.10. P is overwritten: its rows become beta."""
    m = p.shape[0]
    alpha = np.zeros((m, m))
    chi = np.empty(m)
    for r in range(m):
        beta = p[r]
        chi[r] = beta @ beta
        if chi[r] < EPSILON:
            chi[r] += EPSILON
        alpha[r + 1 :, r] = p[r + 1 :] @ beta / chi[r]
        p[r + 1 :] -= np.outer(alpha[r + 1 :, r], beta)
    return Orthonormalised(alpha, p, chi)


def answer(stored: Orthonormalised, y: Array) -> Array:
    """Compute gamma of Eq. 4.11, then A (M,) of Eqs. 4.12-4.13."""
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
    """Return A (M,), computed without stored factors."""
    return answer(orthonormalise(construct(x, memory)), y[memory:])
