"""Fits of all block structures to one record; fits of simpler structures are starting points of larger ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from scipy import fft, linalg

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import (
    Blocks,
    CascadeData,
    LagBank,
    Signals,
    Structure,
    fit_curve,
    lag_basis,
    run,
    slopes,
)
from tissueid.identification.levenberg_marquardt import Problem, minimise
from tissueid.identification.static_nonlinearity import Form, StaticNonlinearity
from tissueid.identification.validation import aicc

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
    left_vectors, _, _ = np.linalg.svd(between.T @ free @ along)
    weights = linalg.solve_triangular(between.T, left_vectors[:, 0])
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
    candidates = [bank.nearest(_minimum_phase_power(linear, share)) for share in (0.3, 0.6)]
    candidates += [bank.nearest(np.exp(-np.arange(lags) / (share * lags))) for share in (0.02, 0.05, 0.12)]
    return candidates + quadratic_weights(data, 1)


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


_ROUNDS = 3

_EXCEEDED, _UNDERFILLED = 0.02, 0.7
"""The outer curve is refitted when z exceeds its range by the first share of it, or fills less than the second."""


@dataclass(frozen=True, eq=False)
class FittedCascade:
    """Blocks with the sum of squared errors over the fitted rows."""

    blocks: Blocks
    rss: float


def squared_error(blocks: Blocks, data: CascadeData) -> float:
    """Return the sum of squared errors of the free run over the fitted rows."""
    error = data.measured - run(blocks, data).output[data.rows]
    return float(error @ error)


def refine(blocks: Blocks, data: CascadeData, iterations: int = 40, tolerance: float = 1e-6) -> FittedCascade:
    """Minimise the simulation error over all blocks. The result is never worse than the start.

    ``tolerance`` is the relative decrease of the squared error below which the iteration ends. The damping is scaled by
    the sensitivities, so that it does not depend on the division of gains between blocks.
    """
    problem = _SimulationError(data)
    best = FittedCascade(blocks, squared_error(blocks, data))
    for _ in range(_ROUNDS):
        before = best.rss
        start = problem.point(_with_refitted_outer_curve(best, data).blocks)
        minimum = minimise(problem, start, most_steps=iterations, tolerance=tolerance, idle_steps=2).point
        tried = FittedCascade(minimum.blocks, minimum.cost)
        if tried.rss < best.rss:
            best = tried
        if before - best.rss <= 10.0 * tolerance * before or _fits_range(best.blocks, data):
            break
    return best


@dataclass(frozen=True, eq=False)
class _Point:
    """Blocks with the signals between them, the errors of the fitted rows (m,) and their sum of squares."""

    blocks: Blocks
    signals: Signals
    error: Array
    cost: float

    @property
    def theta(self) -> Array:
        return self.blocks.vector


class _SimulationError(Problem[_Point]):
    """The squared error of a cascade by all its parameters."""

    def __init__(self, data: CascadeData) -> None:
        self._data = data

    def point(self, blocks: Blocks) -> _Point:
        """Return blocks with their signals and their squared error."""
        signals = run(blocks, self._data)
        error = self._data.measured - signals.output[self._data.rows]
        return _Point(blocks, signals, error, float(error @ error))

    def linearised(self, at: _Point) -> tuple[Array, Array]:
        by_all = slopes(at.blocks, self._data, at.signals)  # (p, rows)
        return by_all @ by_all.T, by_all @ at.error

    def attempt(self, at: _Point, step: Array) -> _Point:
        return self.point(at.blocks.with_vector(at.theta + step))


def _fits_range(blocks: Blocks, data: CascadeData) -> bool:
    if blocks.outer is None:
        return True
    inside = run(blocks, data).inside[data.rows]
    width = blocks.outer.high - blocks.outer.low
    return bool(
        inside.min() >= blocks.outer.low - _EXCEEDED * width
        and inside.max() <= blocks.outer.high + _EXCEEDED * width
        and np.ptp(inside) >= _UNDERFILLED * width
    )


def _with_refitted_outer_curve(fitted: FittedCascade, data: CascadeData) -> FittedCascade:
    """Return the system with its outer curve refitted over the present range of its argument."""
    outer = fitted.blocks.outer
    if outer is None or _fits_range(fitted.blocks, data):
        return fitted
    inside = run(fitted.blocks, data).inside[data.rows]
    target = outer(inside) if fitted.blocks.second is not None else data.measured
    blocks = with_outer(fitted.blocks, outer.refit(inside, target))
    return FittedCascade(blocks, squared_error(blocks, data))


def with_outer(blocks: Blocks, outer: StaticNonlinearity) -> Blocks:
    """Return the blocks with another outer curve. If no block follows it, its value at rest becomes the offset."""
    offset = blocks.offset if blocks.second is not None else float(outer(np.zeros(1))[0])
    return replace(blocks, outer=outer, offset=offset)


_FIRST_DEGREE = 3
"""Degree of the polynomials used to compare starting points."""

_SCREENING_STEPS, _SCREENING_ROWS_PER_PARAMETER = 6, 20
"""Steps of the first refinement of every starting point, and rows per parameter used in it."""

_REFINED_STARTS = 2
_KNOT_SPACINGS = (1.5, 2.0, 3.0)
"""Spacings of the knots tried for the blocks of an LNL system, relative to the closest spacing."""

_STEPS, _TOLERANCE = 25, 1e-4


def fit_linear(data: CascadeData) -> FittedCascade:
    """Return the best linear approximation by least squares."""
    blocks = _with_fitted_offset(Blocks(None, linear_weights(data), None, None, 0.0), data)
    return FittedCascade(blocks, squared_error(blocks, data))


def hammerstein_passes(data: CascadeData, form: Form, degree: int, passes: int) -> list[FittedCascade]:
    """Return the Hammerstein systems after each pass of alternating least squares, starting from Bai's estimate (1998).

    The passes use a polynomial; for another ``form``, that form is fitted to the polynomial of each pass.
    """
    curves = legendre_columns(data.input - data.rest, degree)
    systems = []
    for done in rank_one(curves, data, passes):
        inner = fit_curve(form, data.input, done.channels @ curves, degree)
        blocks = _with_fitted_offset(Blocks(inner, done.lags, None, None, 0.0), data)
        systems.append(FittedCascade(blocks, squared_error(blocks, data)))
    return systems


def fit_lnl(data: CascadeData, form: Form, degree: int, simpler: Iterable[Blocks]) -> FittedCascade:
    """Fit an LNL cascade: complete each of several first blocks to an LNL system by a Hammerstein fit, and refine the
    best.
    """
    impulse = data.bank.nearest(np.eye(1, data.bank.basis.shape[0])[0])
    wiener = [blocks.first for blocks in simpler if blocks.structure == "wiener"]
    firsts = [*first_blocks(data), impulse, *wiener]
    finished = [_lnl_blocks(weights, data, form, degree) for weights in firsts]
    finished.sort(key=lambda done: done[0])
    return _best([blocks for _, blocks in finished[: _REFINED_STARTS + 1]], data)


def fit_nln(data: CascadeData, form: Form, degree: int, simpler: Iterable[Blocks]) -> FittedCascade:
    """Fit an NLN cascade, starting from a canonical correlation of curves of the output with lagged curves of the
    input.
    """
    starts = [_nln_blocks(data, form, degree)]
    for blocks in simpler:
        if blocks.structure == "hammerstein":
            inside = run(blocks, data).inside[data.rows]
            starts.append(with_outer(blocks, fit_curve(form, inside, data.measured, degree)))
        if blocks.structure == "wiener":
            starts.append(replace(blocks, inner=fit_curve(form, data.input, data.input - data.rest, degree)))
    return _best(starts, data)


def fit_structures(
    data: CascadeData, form: Form, degree: int, wanted: Iterable[Structure]
) -> dict[Structure, FittedCascade]:
    """Fit structures, and the simpler ones from which they start.

    Args:
        data: the record.
        form: family of the static curves.
        degree: degree of a polynomial, or pieces of a spline.
        wanted: the structures.
    """
    asked = set(wanted)
    fits: dict[Structure, FittedCascade] = {}
    if "linear" in asked:
        fits["linear"] = fit_linear(data)
    if asked & {"hammerstein", "nln"}:
        passes = hammerstein_passes(data, form, degree, 4)
        fits["hammerstein"] = refine(min(passes, key=lambda done: done.rss).blocks, data)
    if asked & {"wiener", "lnl", "nln"}:
        starts = [linear_weights(data), *quadratic_weights(data, 2)]
        fits["wiener"] = _best([_wiener_blocks(weights, data, form, degree) for weights in starts], data)
    simpler = [done.blocks for done in fits.values()]
    if "lnl" in asked:
        fits["lnl"] = fit_lnl(data, form, degree, simpler)
    if "nln" in asked:
        fits["nln"] = fit_nln(data, form, degree, simpler)
    return fits


def over_whole_range(fitted: FittedCascade, data: CascadeData) -> FittedCascade:
    """Return a fit to a part of the data with its inner curve over the range of all inputs."""
    inner = fitted.blocks.inner
    if inner is None or (inner.low <= data.input.min() and data.input.max() <= inner.high):
        return fitted
    blocks = replace(fitted.blocks, inner=inner.refit(data.input, inner(data.input)))
    return FittedCascade(blocks, squared_error(blocks, data))


def refine_until_converged(fitted: FittedCascade, data: CascadeData) -> tuple[Blocks, CascadeData]:
    """Return the converged blocks, with the data in whose basis their weights are given.

    The division of an LNL system's dynamics between its blocks is weakly determined, and free lags overfit. Its blocks
    are therefore also fitted with fewer basis functions, and the fit with the smallest AICc is returned.
    """
    if fitted.blocks.structure == "linear":
        return fitted.blocks, data
    blocks = refine(fitted.blocks, data).blocks
    if blocks.second is None:
        return blocks, data
    best = (_aicc_of(blocks, data), blocks, data)
    for wider in _KNOT_SPACINGS:
        basis = lag_basis(data.bank.basis.shape[0], wider * data.spacing)
        leaner = replace(data, bank=LagBank(basis, data.input.size))
        first = leaner.bank.nearest(data.bank.basis @ blocks.first)
        second = leaner.bank.nearest(data.bank.basis @ blocks.second)
        tried = refine(replace(blocks, first=first, second=second), leaner).blocks
        best = min(best, (_aicc_of(tried, leaner), tried, leaner), key=lambda candidate: candidate[0])
    return best[1], best[2]


def _aicc_of(blocks: Blocks, data: CascadeData) -> float:
    error = data.measured - run(blocks, data).output[data.rows]
    return aicc(error, blocks.n_parameters)


def _best(starts: list[Blocks], data: CascadeData) -> FittedCascade:
    """Refine every starting point by a few steps, refine the best ones until convergence, and return the best fit."""
    some = data.thinned(_SCREENING_ROWS_PER_PARAMETER * max(blocks.vector.size for blocks in starts))
    screened = sorted((refine(blocks, some, _SCREENING_STEPS, 1e-3) for blocks in starts), key=lambda done: done.rss)
    refined = (refine(done.blocks, data, _STEPS, _TOLERANCE) for done in screened[:_REFINED_STARTS])
    return min(refined, key=lambda done: done.rss)


def _with_fitted_offset(blocks: Blocks, data: CascadeData) -> Blocks:
    """Return the blocks with the offset that makes the mean error zero."""
    error = data.measured - run(blocks, data).output[data.rows]
    return replace(blocks, offset=blocks.offset + float(error.mean()))


def _with_unit_output(weights: Array, data: CascadeData, signal: Array) -> Array:
    """Return the weights of a linear block scaled to an output of unit standard deviation for an input (n,)."""
    spread = float(np.std(data.bank.apply(weights, signal)[data.rows]))
    return weights / spread if spread > 0.0 else weights


def _wiener_blocks(weights: Array, data: CascadeData, form: Form, degree: int) -> Blocks:
    weights = _with_unit_output(weights, data, data.input - data.rest)
    inside = data.bank.apply(weights, data.input - data.rest)[data.rows]
    straight = Blocks(None, weights, None, None, 0.0)
    return with_outer(straight, fit_curve(form, inside, data.measured, degree))


def _lnl_blocks(weights: Array, data: CascadeData, form: Form, degree: int) -> tuple[float, Blocks]:
    weights = _with_unit_output(weights, data, data.input - data.rest)
    inside = data.bank.apply(weights, data.input - data.rest)
    curves = legendre_columns(inside, min(degree, _FIRST_DEGREE))
    done: RankOne = rank_one(curves, data, 2)[-1]
    outer: StaticNonlinearity = fit_curve(form, inside[data.rows], (done.channels @ curves)[data.rows], degree)
    return done.rss, _with_fitted_offset(Blocks(None, weights, outer, done.lags, 0.0), data)


def _nln_blocks(data: CascadeData, form: Form, degree: int) -> Blocks:
    low = min(degree, _FIRST_DEGREE)
    weights = canonical_weights(data, low)
    curves = legendre_columns(data.input - data.rest, low)
    left_vectors, sizes, right = np.linalg.svd(weights)
    inner = fit_curve(form, data.input, left_vectors[:, 0] @ curves, degree)
    lags = sizes[0] * right[0]
    driven = inner(data.input) - inner(np.array([data.rest]))
    lags = _with_unit_output(lags, data, driven)
    inside = data.bank.apply(lags, driven)[data.rows]
    return with_outer(Blocks(inner, lags, None, None, 0.0), fit_curve(form, inside, data.measured, degree))
