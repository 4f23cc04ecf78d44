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
from scipy import linalg, optimize

from tissueid.identification.base import Array

Index = NDArray[np.intp]


@njit(cache=True)
def fill_pairs(along: Array, across: Array, twice_along: Index, distance: Index) -> Array:
    """Return the covariance (p, p) with entries along[u, u'] across[v, v'] for the u and v (p,) of coefficients."""
    p = twice_along.size
    covariance = np.empty((p, p))
    for m in range(p):
        along_row, across_row = along[twice_along[m]], across[distance[m]]
        for k in range(m + 1):
            covariance[m, k] = along_row[twice_along[k]] * across_row[distance[k]]
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


_SEARCH_STEPS, _TOLERANCE = 40, 2e-6

_DECAY, _RATE = (1e-3, 2.0), (3e-3, 3.0)
"""Bounds of decays and correlation rates, per lag."""

_SHAPES = FIRST + 2
"""Number of hyperparameters before the scales of the higher orders."""

_NAMES = (
    "first_std",
    "first_decay",
    "first_rate",
    "smooth_decay",
    "smooth_rate",
    "second_std",
    "second_diagonal_std",
    "third_std",
    "third_diagonal_std",
)

_SCALE_DOWN, _SCALE_UP = 14.0, 8.0

_EXPECTED = (100.0, 20.0, 5.0)
"""Initial ratio of output power to noise power for each order."""

_ON_DIAGONAL = 0.01
"""Initial share of that ratio for the diagonal parts."""

_EXPLAINED = 1e-10
"""Share of the output's power below which the unexplained part is rounding."""


class OutputCovariance:
    """Covariance of the outputs of kernels of order 1 to ``order``.

    A kernel of higher order is the sum of a smooth part and a diagonal part; a static curve before the dynamics gives
    the latter, which a smooth covariance cannot represent. The hyperparameters are the logarithms of c, a, b of h1;
    then a and b of all smooth parts; then for each higher order the scales of its smooth part and of its diagonal part,
    which decays as h1: (3,), (7,) or (9,). Scales are relative to the noise variance of a row.
    """

    def __init__(self, lags: int, order: int) -> None:
        self.order = order
        self._lag_covariance = FirstOrderCovariance(lags)

    def scales(self, hyper: Array) -> tuple[Array, Array]:
        """Return the scales of the smooth and of the diagonal parts of order 2 and higher, (order - 1,) each."""
        return np.exp(hyper[_SHAPES::2]), np.exp(hyper[_SHAPES + 1 :: 2])

    def lag_covariances(self, hyper: Array) -> tuple[Array, Array, Array]:
        """Return P of h1 with its scale, and P of the smooth and of the diagonal parts without scales, (L, L) each."""
        first = self._lag_covariance.matrix(hyper[:FIRST])
        if self.order == 1:
            return first, first, first
        return first, self._lag_covariance.matrix(self._smooth(hyper)), first * np.exp(-hyper[0])

    def between(self, hyper: Array, windows: Array, others: Array) -> Array:
        """Return the covariance (n, m) of the outputs of lagged inputs (n, L) with those of others (m, L)."""
        first, smooth, diagonal = self.lag_covariances(hyper)
        # The linear parts of all orders form one product.
        left_factors, right_factors = [windows @ first], [others]
        scales, on_diagonals = self.scales(hyper)
        for order, on_diagonal in enumerate(on_diagonals, start=2):
            left_factors.append(windows**order @ (on_diagonal * diagonal))
            right_factors.append(others**order)
        total = np.asarray(np.concatenate(left_factors, axis=1) @ np.concatenate(right_factors, axis=1).T)
        if self.order > 1:
            product = (windows @ smooth) @ others.T
            power = product
            for scale in scales:
                power = power * product
                total += scale * power
        return total

    def slopes(self, hyper: Array, windows: Array, weight: Array) -> Array:
        """Return the derivatives of sum(weight * covariance) with respect to the hyperparameters, for a symmetric
        weight (n, n).
        """
        derivatives = np.zeros(hyper.size)
        derivatives[:FIRST] = self._lag_covariance.slopes(hyper[:FIRST], windows.T @ (weight @ windows))
        if self.order > 1:
            product = (windows @ self.lag_covariances(hyper)[1]) @ windows.T
            by_product = np.zeros_like(product)
            power = np.asarray(weight * product)  # weight times the product to the order less one
            for order, scale in enumerate(self.scales(hyper)[0], start=2):
                index = _SHAPES + 2 * (order - 2)
                by_product += order * scale * power
                power *= product
                derivatives[index] = scale * float(power.sum())
                raised = windows**order
                shape = np.array([hyper[index + 1], *hyper[1:FIRST]])
                on_diagonal = self._lag_covariance.slopes(shape, raised.T @ (weight @ raised))
                derivatives[index + 1] = on_diagonal[0]
                derivatives[1:FIRST] += on_diagonal[1:]
            smooth = self._lag_covariance.slopes(self._smooth(hyper), windows.T @ (by_product @ windows))
            derivatives[FIRST:_SHAPES] = smooth[1:]
        return derivatives

    def initial(self, windows: Array, rows: float) -> Array:
        """Return initial hyperparameters: kernels decay within the memory and explain most of the output."""
        lags = windows.shape[1]
        decay, rate = np.log(min(4.0 / lags, 1.0)), np.log(min(6.0 / lags, 1.0))
        shape = self._lag_covariance.matrix(np.array([0.0, decay, rate]))

        def powers(inputs: Array) -> Array:
            return np.asarray(np.einsum("ij,ij->i", inputs @ shape, inputs))

        hyper = [float(np.log(_EXPECTED[0] * rows / np.sum(powers(windows)))), decay, rate]
        if self.order > 1:
            hyper += [decay, rate]
        for order in range(2, self.order + 1):
            expected = _EXPECTED[order - 1] * rows
            hyper.append(float(np.log(expected / np.sum(powers(windows) ** order))))
            hyper.append(float(np.log(_ON_DIAGONAL * expected / np.sum(powers(windows**order)))))
        return np.array(hyper)

    def bounds(self, begin: Array) -> list[tuple[float, float]]:
        """Return the bounds of the hyperparameters; those of the scales are relative to ``begin``."""
        shape = [(float(np.log(low)), float(np.log(high))) for low, high in (_DECAY, _RATE)]
        scales = [(float(begin[k] - _SCALE_DOWN), float(begin[k] + _SCALE_UP)) for k in self._scale_places(begin)]
        return [scales[0], *shape, *(shape if self.order > 1 else []), *scales[1:]]

    def rescaled(self, hyper: Array, factor: float) -> Array:
        """Return the hyperparameters with all scales multiplied."""
        changed = hyper.copy()
        changed[self._scale_places(hyper)] += np.log(factor)
        return changed

    def named(self, hyper: Array, density: float) -> dict[str, float]:
        """Return the hyperparameters by name, scales as standard deviations of the kernels at lag 0."""
        values = np.exp(hyper)
        values[self._scale_places(hyper)] = np.sqrt(values[self._scale_places(hyper)] * density)
        return dict(zip(_NAMES, values.tolist(), strict=False))

    @staticmethod
    def _scale_places(hyper: Array) -> list[int]:
        return [0, *range(_SHAPES, hyper.size)]

    @staticmethod
    def _smooth(hyper: Array) -> Array:
        return np.concatenate([[0.0], hyper[FIRST:_SHAPES]])


def search(
    covariance: OutputCovariance, windows: Array, output: Array, dependence: float, begin: Array | None = None
) -> tuple[Array, float, float]:
    """Return hyperparameters, noise variance and log marginal likelihood for lagged inputs (n, L) and an output (n,).

    ``dependence`` is the number of these rows per independent row. The scales are relative to ``dependence`` times the
    noise variance. The constant is integrated out.
    """
    rows = output.size / dependence - 1.0
    ones = np.ones(output.size)
    centred = output - output.mean()
    whole = float(centred @ centred)
    least = _EXPLAINED * whole

    def deviance(hyper: Array) -> tuple[float, Array]:
        z = covariance.between(hyper, windows, windows)
        z[np.diag_indices_from(z)] += 1.0
        try:
            inverse, logarithms = _inverse(z)
        except linalg.LinAlgError:  # the step was too long: the noise vanishes
            return 1e3 * rows, np.zeros(hyper.size)
        by_ones = inverse @ ones
        total = float(by_ones.sum())
        weights = inverse @ centred
        weights -= by_ones * (float(weights.sum()) / total)
        power = max(float(centred @ weights), least)
        value = 0.5 * (rows * np.log(power / whole) + logarithms + np.log(total))
        inverse -= np.column_stack([by_ones, weights]) @ np.stack([by_ones / total, weights * (rows / power)])
        return float(value), 0.5 * covariance.slopes(hyper, windows, inverse)

    initial = covariance.initial(windows, rows)
    bounds = covariance.bounds(initial)
    low, high = np.array(bounds).T
    minimum = optimize.minimize(
        deviance,
        np.clip(initial if begin is None else begin, low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _SEARCH_STEPS, "ftol": _TOLERANCE},
    )
    hyper = np.asarray(minimum.x, dtype=np.float64)
    z = covariance.between(hyper, windows, windows)
    z[np.diag_indices_from(z)] += 1.0
    weights = linalg.solve(z, np.column_stack([centred, ones]), assume_a="pos", check_finite=False)
    weights = weights[:, 0] - weights[:, 1] * (weights[:, 0].sum() / weights[:, 1].sum())
    noise = max(float(centred @ weights), least) / (dependence * rows)
    evidence = 0.5 * rows * (np.log(dependence * rows / whole) - np.log(2.0 * np.pi) - 1.0) - float(minimum.fun)
    return hyper, noise, evidence


def _inverse(z: Array) -> tuple[Array, float]:
    """Return the inverse of a positive definite matrix, which is overwritten, and the logarithm of its determinant."""
    factor = linalg.cholesky(z, lower=True, overwrite_a=True, check_finite=False)
    logarithms = 2.0 * float(np.sum(np.log(np.diag(factor))))
    inverse, _ = linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)
    whole = np.asarray(inverse + inverse.T)  # of a lower triangle above zeros
    whole[np.diag_indices_from(whole)] *= 0.5
    return whole, logarithms
