"""Compiled loops over pairs of places of a second-order kernel: its covariance, and sums over it."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@njit(cache=True)
def fill_pairs(along: Array, across: Array, twice_along: Index, distance: Index) -> Array:
    """Covariance (p, p) whose entry for two places is along[u, u'] across[v, v'], from their u and v (p,)."""
    p = twice_along.size
    covariance = np.empty((p, p))
    for m in range(p):
        one, other = along[twice_along[m]], across[distance[m]]
        for k in range(m + 1):
            covariance[m, k] = one[twice_along[k]] * other[distance[k]]
    for m in range(p):
        for k in range(m + 1, p):
            covariance[m, k] = covariance[k, m]
    return covariance


@njit(cache=True)
def gather_pairs(
    weight: Array, along: Array, across: Array, twice_along: Index, distance: Index
) -> tuple[Array, Array]:
    """Sums of weight * across over the pairs of each u, u', and of weight * along over those of each v, v'.

    ``weight`` (p, p) is symmetric, and so are the sums but for which of two halves an entry is counted in.
    """
    by_along = np.zeros_like(along)
    by_across = np.zeros_like(across)
    for m in range(twice_along.size):
        u, v = twice_along[m], distance[m]
        for k in range(m + 1):
            twice = weight[m, k] if k == m else 2.0 * weight[m, k]
            by_along[u, twice_along[k]] += twice * across[v, distance[k]]
            by_across[v, distance[k]] += twice * along[u, twice_along[k]]
    return by_along, by_across
