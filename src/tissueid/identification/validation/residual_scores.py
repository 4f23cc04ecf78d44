"""Correlations of a residual with a signal over many lags, with confidence bands valid for coloured signals.

If the residual is independent of the input, then, given the input, the variance of a sum of residuals weighted by any
function of the input follows from the autocovariance of the residual alone. No distribution of the input is assumed.
The residual is whitened by an autoregression and the signals are filtered alike, which is generalised least squares:
the band is narrow where the residual has little power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, special

from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import ROWS_AT_ONCE
from tissueid.identification.validation.prediction import Autoregression

Lags = NDArray[np.int_]

_DRAWS = 4000
"""Number of draws for the maximum of correlated Gaussian numbers; the seed is fixed, so that p-values are reproducible.
"""

_RANK_STEP = 128
"""Step of the rank for which draws are kept: few sizes serve all matrices."""

_RIDGE = 1e-6
"""Ridge of the nuisance projection relative to its power: lags of a low-pass input are nearly collinear."""

_NEGLIGIBLE_REST = 1e-4
"""Share of a signal below which the rest after projection is rounding."""

LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Scores:
    """Correlation coefficients (lags,) and their covariance (lags, lags) under the null hypothesis.

    NaN, and excluded from joint tests, for lags that cannot be tested. ``unrelated``: the covariance is diagonal.
    """

    lags: Lags
    correlation: Array
    covariance: Array
    unrelated: bool = False

    @property
    def std(self) -> Array:
        """Standard deviation at each lag under the null hypothesis, shape (lags,)."""
        return np.sqrt(np.diag(self.covariance))

    def joint(self) -> tuple[float, float]:
        """Return the p-value of the largest lag, and the threshold that 5 % of all curves exceed by chance."""
        finite = np.isfinite(self.correlation)
        if not finite.any():
            return float("nan"), float("nan")
        std = self.std[finite]
        farthest = float(np.max(np.abs(self.correlation[finite]) / std))
        if self.unrelated:
            single = special.erfc(farthest / np.sqrt(2.0))  # for a single lag
            return -float(np.expm1(std.size * np.log1p(-single))), float(
                -special.ndtri((1.0 - LEVEL ** (1 / std.size)) / 2)
            )
        related = self.covariance[np.ix_(finite, finite)] / np.outer(std, std)
        largest = _largest_of(related)
        exceeded = 1.0 + float(np.sum(largest >= farthest))
        return exceeded / (largest.size + 1.0), float(np.quantile(largest, LEVEL))


def independent_scores(lags: Lags, correlation: Array, std: Array) -> Scores:
    """Return the scores of lags that are independent under the null hypothesis; all arrays of shape (lags,)."""
    return Scores(lags, correlation, np.diag(std**2), unrelated=True)


def _largest_of(related: Array) -> Array:
    """Return draws (draws,) of the largest modulus of Gaussian numbers with this correlation matrix (k, k)."""
    values, vectors = linalg.eigh(related)
    kept = values > 1e-9 * values[-1]
    shape = (vectors[:, kept] * np.sqrt(values[kept])).astype(np.float32)  # (k, rank): single precision is sufficient
    rank = shape.shape[1]
    draws = shape @ _unit_draws(-(-rank // _RANK_STEP) * _RANK_STEP)[:rank]
    return np.asarray(np.maximum(np.max(draws, axis=0), -np.min(draws, axis=0)), dtype=np.float64)


@lru_cache(maxsize=2)
def _unit_draws(rank: int) -> NDArray[np.float32]:
    """Return independent standard Gaussian numbers (rank, draws); a lower rank gives the same first rows."""
    unit = np.random.Generator(np.random.PCG64(0)).standard_normal((rank, _DRAWS), dtype=np.float32)
    unit.flags.writeable = False
    return unit


@dataclass(frozen=True, eq=False)
class WhitenedProducts:
    """Products of a whitened residual (n,) with lags of whitened signals, as one matrix.

    ``products`` are sums over ``n_rows`` samples of all columns: a constant, the nuisance lags, the lags of each
    signal, and last the residual. All columns except the first and last were divided by their rms, the nuisance by
    ``nuisance_size``.
    """

    products: Array
    nuisance: int
    nuisance_size: float
    signals: tuple[Lags, ...]
    n_rows: int

    def scores(self, which: int, extra: Array | None = None, widening: float = 1.0, project: bool = True) -> Scores:
        """Return the scores of one signal, with the nuisance projected out unless ``project`` is off.

        ``extra`` (nuisance, nuisance) is the covariance of coefficients by which the residual may depend on the
        nuisance lags; it is used if these are not projected out. Otherwise ``widening`` multiplies the variance.
        """
        first = 1 + self.nuisance + sum(lags.size for lags in self.signals[:which])
        some = slice(first, first + self.signals[which].size)
        out = slice(0, 1 + self.nuisance if project else 1)
        p = self.products
        factor = self._nuisance_factor if project else linalg.cho_factor(p[out, out])
        weights = linalg.cho_solve(factor, p[out, some])  # (out, lags)
        sums = p[some, -1] - weights.T @ p[out, -1]
        shared = weights.T @ p[out, some]
        projected = p[some, some] - shared - shared.T + weights.T @ p[out, out] @ weights
        covariance = widening * self.innovation_power * projected
        if extra is not None and not project:
            answers = p[some, 1 : 1 + self.nuisance] - weights.T @ p[out, 1 : 1 + self.nuisance]  # (lags, nuisance)
            covariance = covariance + self.nuisance_size**2 * answers @ extra @ answers.T
        power = np.diag(p[some, some]) - p[some, 0] ** 2 / p[0, 0]
        scale = np.sqrt(np.maximum(power, 0.0) * self.n_rows * self.innovation_power)
        empty = np.diag(projected) <= _NEGLIGIBLE_REST * power
        scale[empty] = np.inf
        correlation = np.where(empty, np.nan, sums / scale)
        return Scores(self.signals[which], correlation, covariance / np.outer(scale, scale))

    @cached_property
    def innovation_power(self) -> float:
        """Variance of the whitened residual, minus what the constant and the nuisance lags explain."""
        out = slice(0, 1 + self.nuisance)
        p = self.products
        inverse = linalg.cho_solve(self._nuisance_factor, np.eye(out.stop))
        explained = float(p[-1, out] @ inverse @ p[out, -1])
        taken = float(np.sum(inverse * p[out, out].T))
        return (float(p[-1, -1]) - explained) / max(1.0, self.n_rows - taken)

    @cached_property
    def _nuisance_factor(self) -> tuple[Array, bool]:
        """Cholesky factor of the products of the constant and the nuisance lags, with the ridge."""
        out = slice(0, 1 + self.nuisance)
        p = self.products[out, out]
        load = np.full(out.stop, _RIDGE * float(np.mean(np.diag(p))))
        load[0] = 0.0
        factor, lower = linalg.cho_factor(p + np.diag(load))
        return factor, lower


def whitened_products(
    residual: Array, noise: Autoregression, nuisance: tuple[Array, int], signals: Sequence[tuple[Array, Lags]]
) -> WhitenedProducts:
    """Whiten a residual (n,) and the signals alike, and form the products.

    ``nuisance`` is a signal (n,) and its number of lags, from 0 on; each of ``signals`` is one (n,) and its lags, of
    which negative ones look ahead. Samples with any unknown value are left out.
    """
    distinct: list[tuple[Array, Lags]] = []
    position = []  # of each group of columns among the distinct ones
    for signal, lags in [(nuisance[0], np.arange(nuisance[1])), *signals]:
        same = (k for k, (other, its) in enumerate(distinct) if other is signal and np.array_equal(its, lags))
        position.append(next(same, len(distinct)))
        if position[-1] == len(distinct):
            distinct.append((signal, lags))
    columns = [(noise.whiten(signal), lags) for signal, lags in distinct]
    sizes = [_rms(signal) for signal, _ in columns]
    columns = [(signal / size, lags) for (signal, lags), size in zip(columns, sizes, strict=True)]
    whitened = noise.innovations(residual)
    rows = np.flatnonzero(_complete(whitened, columns))
    starts = np.cumsum([1, *(lags.size for _, lags in columns)])
    products = np.zeros((starts[-1] + 1, starts[-1] + 1))
    for first in range(0, rows.size, ROWS_AT_ONCE):
        block = rows[first : first + ROWS_AT_ONCE]
        matrix = np.empty((starts[-1] + 1, block.size))
        matrix[0], matrix[-1] = 1.0, whitened[block]
        for start, (signal, lags) in zip(starts, columns, strict=False):
            for k, lag in enumerate(lags, int(start)):
                np.take(signal, block - lag, out=matrix[k], mode="clip")  # all are inside; "raise" would copy
        products += matrix @ matrix.T
    groups = [np.arange(starts[k], starts[k + 1]) for k in position]
    every = np.concatenate([[0], *groups, [starts[-1]]])
    return WhitenedProducts(
        products if every.size == starts[-1] + 1 else products[np.ix_(every, every)],
        nuisance[1],
        sizes[0],
        tuple(lags for _, lags in signals),
        int(rows.size),
    )


def _rms(signal: Array) -> float:
    finite = signal[np.isfinite(signal)]
    size = float(np.sqrt(np.mean(finite**2))) if finite.size else 0.0
    return size if size > 0.0 else 1.0


def _complete(whitened: Array, columns: Sequence[tuple[Array, Lags]]) -> Mask:
    """Return the mask (n,) of samples with a known residual and known lags of all signals."""
    n = whitened.size
    complete = np.isfinite(whitened)
    for signal, lags in columns:
        if lags.size == 0:
            continue
        missing = np.concatenate([[0], np.cumsum(~np.isfinite(signal))])
        low, high = int(lags.min()), int(lags.max())
        oldest, end = np.arange(n) - high, np.arange(n) - low + 1
        inside = (oldest >= 0) & (end <= n)
        complete &= inside
        complete[inside] &= missing[end[inside]] == missing[oldest[inside]]
    return complete


@dataclass(frozen=True, eq=False)
class KernelError:
    """Uncertainty of a linear kernel fitted by least squares to ``fitted`` samples, and its effect on residuals.

    ``covariance`` (lags, lags) is that of the kernel. ``excess`` (length,) is the autocorrelation coefficient at lags
    0, 1, ... that the error of the kernel adds to residuals of other samples; ``deficit`` is the reduction in residuals
    of the fitted samples, at lag 0 that of their variance.
    """

    covariance: Array
    excess: Array
    deficit: Array


def kernel_error(x: Array, noise: Autoregression, lags: int, fitted: int, length: int) -> KernelError:
    """Return the uncertainty of a fit of ``lags`` lags to ``fitted`` samples of an input like x (n,); NaN is unknown.

    The covariance is inv(R) S inv(R) / fitted, with S from the product of the spectra of input and noise.
    """
    finite = np.isfinite(x)
    filled = np.where(finite, x - np.mean(x[finite]), 0.0)
    size = fft.next_fast_len(filled.size + lags + length, real=True)
    power = np.abs(fft.rfft(filled, size)) ** 2 / finite.sum()
    auto = fft.irfft(power, size)[: lags + length]
    filtered = np.abs(fft.rfft(np.concatenate([[1.0], -noise.coefficients]), size)) ** 2
    score = fft.irfft(power * noise.innovation_std**2 / filtered, size)[:lags]
    r = linalg.toeplitz(auto[:lags])
    inverse = linalg.inv(r + 1e-5 * auto[0] * np.eye(lags))
    covariance = inverse @ linalg.toeplitz(score) @ inverse / fitted
    both = inverse @ r @ inverse
    excess = _through_lags(both, auto, length) / fitted
    return KernelError(
        covariance=covariance,
        excess=excess,
        deficit=2.0 * _through_lags(inverse, auto, length) / fitted - excess,
    )


def _through_lags(form: Array, auto: Array, length: int) -> Array:
    """Return the trace of a symmetric form (m, m) with lagged correlation matrices, lags 0 .. length - 1."""
    m = form.shape[0]
    along = np.array([np.trace(form, offset=d) for d in range(m)])  # sums of diagonals
    both_sides = np.concatenate([along[:0:-1], along])  # (2 m - 1,)
    symmetric = np.concatenate([auto[:0:-1], auto])
    centre = auto.size - 1
    return np.array(
        [float(both_sides @ symmetric[centre + k - m + 1 : centre + k + m]) for k in range(length)], dtype=np.float64
    )
