"""Starting points for fits of cascades; no single method suits every system.

Hammerstein: over-parametrised least squares and its rank-one approximation (Bai 1998), then alternating least squares
(Narendra and Gallman 1966). Wiener: best linear approximation, or leading eigenvectors of the second-order kernel. LNL:
a family of first blocks, each completed by a Hammerstein fit. NLN: canonical correlation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy import fft, linalg

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import CascadeData

_ROWS_PER_COLUMN = 10
_RIDGE = 1e-8
_PRINCIPAL = 8
"""Number of principal components of the lagged input that span the second-order kernel."""

_CANONICAL_DEGREE = 3
_FLOOR = 1e-3
"""Floor of the magnitude of a best linear approximation before it is factored, relative to its peak."""


@dataclass(frozen=True, eq=False)
class RankOne:
    """Weights of the channels (p,) and of the lag basis (q,) after one pass, with the residual sum of squares."""

    channels: Array
    lags: Array
    rss: float


def legendre_columns(z: Array, degree: int) -> Array:
    """Return Legendre polynomials of degree 1 to ``degree`` over the range of z (n,), minus their values at z = 0,
    shape (degree, n).
    """
    low, high = float(z.min()), float(z.max())
    x = np.append(2.0 * (z - low) / (high - low) - 1.0, -(low + high) / (high - low))
    values = legendre.legvander(x, degree)[:, 1:].T
    return np.asarray(values[:, :-1] - values[:, -1:], dtype=np.float64)


def rank_one(channels: Array, data: CascadeData, passes: int = 6) -> list[RankOne]:
    """Fit y = offset + h * sum_b a_b channel_b for channels (p, n); return the state after each pass.

    The first pass fits free weights for every channel and lag and keeps their leading singular pair, in the metric of
    the covariances of channels and lags. The other passes alternate between the two factors.
    """
    p, q = channels.shape[0], data.bank.size
    thin = data.thinned(_ROWS_PER_COLUMN * p * q)
    lagged = np.concatenate([data.bank.rows(channel)[:, thin.rows] for channel in channels])  # (p q, rows)
    lagged -= lagged.mean(axis=1, keepdims=True)
    y = thin.measured - thin.measured.mean()
    gram = lagged @ lagged.T
    right = lagged @ y
    power = float(y @ y)
    free = solve_with_ridge(gram, right).reshape(p, q)
    blocks = gram.reshape(p, q, p, q)
    between = _root(np.einsum("ajbj->ab", blocks))  # (p, p)
    along = _root(np.einsum("aiaj->ij", blocks))  # (q, q)
    left, _, _ = np.linalg.svd(between.T @ free @ along)
    weights = linalg.solve_triangular(between.T, left[:, 0])
    answer = right.reshape(p, q)
    done: list[RankOne] = []
    for _ in range(passes):
        lags = solve_with_ridge(np.einsum("a,aibj,b->ij", weights, blocks, weights, optimize=True), weights @ answer)
        weights = solve_with_ridge(np.einsum("i,aibj,j->ab", lags, blocks, lags, optimize=True), answer @ lags)
        explained = float(weights @ answer @ lags)
        done.append(RankOne(weights, lags, (power - explained) * data.rows.size / thin.rows.size))
    return done


def linear_weights(data: CascadeData) -> Array:
    """Return the weights (q,) of the best linear approximation by least squares."""
    lagged = data.bank.rows(data.input - data.rest)[:, data.rows]
    lagged -= lagged.mean(axis=1, keepdims=True)
    return solve_with_ridge(lagged @ lagged.T, lagged @ (data.measured - data.measured.mean()))


def quadratic_weights(data: CascadeData, count: int) -> list[Array]:
    """Return the weights (q,) of the leading eigenvectors of the second-order kernel, strongest first.

    The kernels of first and second order are fitted together over the principal components of the lagged input, because
    other directions are not excited.
    """
    lagged = data.bank.rows(data.input - data.rest)[:, data.rows]
    values, vectors = linalg.eigh(lagged @ lagged.T / data.rows.size)
    kept = min(_PRINCIPAL, values.size)
    reduced = vectors[:, -kept:] / np.sqrt(np.maximum(values[-kept:], 1e-12 * values[-1]))  # (q, kept)
    whitened = reduced.T @ lagged
    first, second = np.triu_indices(kept)
    regressors = np.concatenate([whitened, whitened[first] * whitened[second]])
    regressors -= regressors.mean(axis=1, keepdims=True)
    fitted = solve_with_ridge(regressors @ regressors.T, regressors @ (data.measured - data.measured.mean()))
    kernel = np.zeros((kept, kept))
    kernel[first, second] = 0.5 * fitted[kept:]
    kernel += kernel.T
    sizes, directions = linalg.eigh(kernel)
    order = np.argsort(-np.abs(sizes))[:count]
    return [np.asarray(reduced @ directions[:, k], dtype=np.float64) for k in order]


def first_blocks(data: CascadeData) -> list[Array]:
    """Return the weights (q,) of first blocks from which the fit of an LNL system starts.

    Minimum-phase powers of the best linear approximation divide its dynamics between the two blocks; first-order lags
    of several time constants cover other divisions; the second-order kernel covers systems whose linear part is hidden
    by an even nonlinearity.
    """
    bank = data.bank
    lags = bank.basis.shape[0]
    linear = bank.basis @ linear_weights(data)
    found = [bank.nearest(_minimum_phase_power(linear, share)) for share in (0.3, 0.6)]
    found += [bank.nearest(np.exp(-np.arange(lags) / (share * lags))) for share in (0.02, 0.05, 0.12)]
    return found + quadratic_weights(data, 1)


def canonical_weights(data: CascadeData, degree: int) -> Array:
    """Return the weights (degree, q) of the lagged curves of the input that correlate best with some curve of the
    output.

    If the last curve of an NLN system is invertible, a curve of its output is the output of a Hammerstein system.
    """
    curves = legendre_columns(data.input - data.rest, degree)
    thin = data.thinned(_ROWS_PER_COLUMN * degree * data.bank.size)
    lagged = np.concatenate([data.bank.rows(curve)[:, thin.rows] for curve in curves])
    lagged -= lagged.mean(axis=1, keepdims=True)
    measured = thin.measured - thin.measured.mean()
    answers = legendre_columns(measured, _CANONICAL_DEGREE)
    answers -= answers.mean(axis=1, keepdims=True)
    cross = lagged @ answers.T  # (p q, degree)
    fitted = solve_with_ridge(lagged @ lagged.T, cross)
    values, vectors = linalg.eigh(cross.T @ fitted, answers @ answers.T)
    best = vectors[:, int(np.argmax(values))]
    return np.asarray((fitted @ best).reshape(degree, data.bank.size), dtype=np.float64)


def solve_with_ridge(gram: Array, right: Array) -> Array:
    """Return the solution of symmetric equations (p, p) for a right-hand side (p,) or (p, k).

    The columns may differ in scale. A small ridge keeps the solution finite.
    """
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    answer = linalg.solve(scaled + _RIDGE * np.eye(size.size), (right.T / size).T, assume_a="pos")
    return np.asarray((answer.T / size).T, dtype=np.float64)


def _root(gram: Array) -> Array:
    """Return the lower Cholesky factor of a Gram matrix, with the same ridge."""
    size = np.diag(gram) + 1e-300
    return np.asarray(np.linalg.cholesky(gram + _RIDGE * np.diag(size)), dtype=np.float64)


def _minimum_phase_power(kernel: Array, share: float) -> Array:
    """Return the minimum-phase kernel (lags,) with the magnitude of ``kernel`` to the power ``share``, by the real
    cepstrum.
    """
    length = fft.next_fast_len(8 * kernel.size, real=True)
    length += length % 2
    magnitude = np.abs(fft.rfft(kernel, length))
    cepstrum = fft.irfft(share * np.log(np.maximum(magnitude, _FLOOR * float(magnitude.max()))), length)
    cepstrum[1 : length // 2] *= 2.0
    cepstrum[length // 2 + 1 :] = 0.0
    return np.asarray(fft.irfft(np.exp(fft.rfft(cepstrum)), length)[: kernel.size], dtype=np.float64)
