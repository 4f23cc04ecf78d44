"""Prior covariances of smooth, decaying Volterra kernels.

For h1 the diagonal/correlated form of Chen, Ohlsson and Ljung (2012); for h2 that of Birpoutsoukis, Marconato, Lataire
and Schoukens (2017), rotated by 45 degrees, with separate decay and correlation along and across the diagonal. The
exponential correlation is replaced by Matern's of order 3/2, whose kernels are differentiable, as the response of a
mass is, and which has a clearly higher marginal likelihood on measured tissue.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tissueid.identification.base import Array

Index = NDArray[np.intp]


@njit(cache=True)
def fill_pairs(along: Array, across: Array, twice_along: Index, distance: Index) -> Array:
    """Return the covariance (p, p) with entries along[u, u'] across[v, v'] for the u and v (p,) of coefficients."""
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
    """Return sums of weight * across over the pairs of each u, u', and of weight * along over those of each v, v'.

    ``weight`` (p, p) is symmetric; the sums are symmetric except that a pair of entries is counted in one half only.
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


FIRST = 3
"""Number of hyperparameters of the covariance of h1; that of h2 has five."""

Tables = tuple[Array, Array, Array]
"""A covariance, and its derivatives with respect to the logarithms of decay and correlation rate."""


def matern(distance: Array, rate: float) -> tuple[Array, Array]:
    """Return the Matern correlation of order 3/2 and its derivative with respect to log ``rate``, shape of
    ``distance``.
    """
    reach = rate * distance
    fading = np.exp(-reach)
    return (1.0 + reach) * fading, -(reach**2) * fading


class FirstOrderCovariance:
    """Covariance of h1 at lags 0 .. L - 1: c exp(-a (i + j)) r(b |i - j|), of log c, log a, log b; rates per lag."""

    def __init__(self, lags: int) -> None:
        self._lag = np.arange(float(lags))

    def matrix(self, log_hyper: Array) -> Array:
        """Return the covariance (L, L)."""
        scale, decay, rate = np.exp(log_hyper)
        return _separable(self._lag, scale, decay, rate)[0]

    def slopes(self, log_hyper: Array, weight: Array) -> Array:
        """Return the derivatives (3,) of sum(weight * covariance), for a symmetric weight (L, L)."""
        scale, decay, rate = np.exp(log_hyper)
        return np.array([np.vdot(weight, table) for table in _separable(self._lag, scale, decay, rate)])


class SecondOrderCovariance:
    """Covariance of the upper triangle of h2, row by row, for L lags.

    With u = (i + j) / 2 along the diagonal and v = |i - j| across it, c exp(-a_u (u + u')) r(b_u |u - u'|) exp(-a_v (v
    + v')) r(b_v |v - v'|), of the logarithms of c, a_u, b_u, a_v, b_v; rates per lag.
    """

    def __init__(self, lags: int) -> None:
        row, column = np.triu_indices(lags)
        self._twice_along: NDArray[np.intp] = row + column
        self._across: NDArray[np.intp] = column - row
        self._along_lag, self._across_lag = 0.5 * np.arange(2.0 * lags - 1.0), np.arange(float(lags))

    def matrix(self, log_hyper: Array) -> Array:
        """Return the covariance (p, p), p = L (L + 1) / 2."""
        along, across = self._tables(log_hyper)
        return np.asarray(fill_pairs(along[0], across[0], self._twice_along, self._across))

    def variance(self, log_hyper: Array) -> Array:
        """Return the diagonal (p,) of the covariance."""
        scale, along_decay, _, across_decay, _ = np.exp(log_hyper)
        return np.asarray(scale * np.exp(-along_decay * self._twice_along - 2.0 * across_decay * self._across))

    def slopes(self, log_hyper: Array, weight: Array) -> Array:
        """Return the derivatives (5,) of sum(weight * covariance), for a symmetric weight (p, p)."""
        along, across = self._tables(log_hyper)
        by_along, by_across = gather_pairs(weight, along[0], across[0], self._twice_along, self._across)
        return np.array(
            [
                np.vdot(by_along, along[0]),
                np.vdot(by_along, along[1]),
                np.vdot(by_along, along[2]),
                np.vdot(by_across, across[1]),
                np.vdot(by_across, across[2]),
            ]
        )

    def _tables(self, log_hyper: Array) -> tuple[Tables, Tables]:
        scale, along_decay, along_rate, across_decay, across_rate = np.exp(log_hyper)
        return (
            _separable(self._along_lag, scale, along_decay, along_rate),
            _separable(self._across_lag, 1.0, across_decay, across_rate),
        )


def _separable(lag: Array, scale: float, decay: float, rate: float) -> Tables:
    """Return scale exp(-decay (t + t')) r(rate |t - t'|) at t, and its derivatives with respect to log decay and log
    rate.
    """
    fading = np.exp(-decay * lag)
    size = scale * fading[:, None] * fading
    correlation, slope = matern(np.abs(lag[:, None] - lag), rate)
    return size * correlation, -decay * (lag[:, None] + lag) * size * correlation, size * slope
