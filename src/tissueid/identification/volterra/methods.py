"""Methods of estimating Volterra kernels, with a common result."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import dependence_samples
from tissueid.identification.least_squares import Factor, factor
from tissueid.identification.volterra.kernel_covariance import OutputCovariance, search
from tissueid.identification.volterra.laguerre import laguerre_kernels
from tissueid.identification.volterra.prior import RegularisedKernels, regularised_fit, residual_dependence
from tissueid.identification.volterra.regressors import Kernels, VolterraRegressors, kernels_of, lagged_inputs
from tissueid.messages import Message

MAX_ROWS = 7000
"""Largest number of rows that are solved together: 400 MB, and about three seconds on one core."""

SEARCH_ROWS = 900
"""Number of rows by which the hyperparameters are selected."""

_REFIT = 1.5
"""Ratio of estimated to assumed dependence above which the hyperparameters are searched again."""

_BLOCK = 512
_LEVERAGES = 400
"""Number of evenly spaced rows whose leverage is computed; the trace of the hat matrix follows from their mean."""

_STD_STEPS = 3e10
"""Multiplications up to which standard deviations are computed for all of h2; above, only for its diagonal."""


@dataclass(frozen=True, eq=False)
class RegressionKernels:
    """Posterior of Volterra kernels in output units per input units, per lag.

    ``kernel1`` has shape (L,), ``kernel2`` (L, L), ``kernel3`` (L, L, L), symmetric, None above the order. Standard
    deviations have the shape of their kernel; ``kernel2_std`` is NaN off the diagonal if it was too expensive to
    compute. ``effective_parameters`` is the trace of the hat matrix. ``hyperparameters`` holds prior standard
    deviations at lag 0 in the unit of each kernel, that of the diagonal part, and decays and correlation rates per lag.
    ``noise_variance`` is that of the residual, ``dependence`` the number of rows per independent row, ``rows`` the
    number of rows solved, ``log_evidence`` that of the thinned rows by which the prior was selected.
    """

    kernel0: float
    kernel1: Array
    kernel2: Array | None
    kernel3: Array | None
    kernel0_std: float
    kernel1_std: Array
    kernel2_std: Array | None
    effective_parameters: float
    hyperparameters: dict[str, float]
    log_evidence: float
    noise_variance: float
    dependence: float
    rows: int
    warnings: tuple[str, ...] = ()


def regression_kernels(
    x: Array,
    y: Array,
    used: Mask,
    lags: int,
    spacing: int,
    order: int,
    *,
    max_rows: int = MAX_ROWS,
    search_rows: int = SEARCH_ROWS,
) -> RegressionKernels:
    """Return the regularised kernels of order 0 to ``order`` (1, 2 or 3).

    Args:
        x: input (n,) with its mean removed.
        y: output (n,).
        used: mask (n,) of the rows; every input of their memory must have been received.
        lags: L, number of lags of a kernel.
        spacing: samples between lags.
        order: of the highest kernel.
        max_rows: above this number rows are thinned evenly, with a warning; memory is 8 bytes times its square.
        search_rows: number of evenly spaced rows by which the prior is selected.

    Raises:
        UnusableInputError: the order is not 1 to 3, or there are fewer than ten rows.
    """
    if order not in (1, 2, 3):
        raise UnusableInputError(
            "volterra.dual_order", "kernel regression is for kernels of order 1, 2 or 3, got {order}", order=order
        )
    rows = np.flatnonzero(used)
    if rows.size < 10:
        raise UnusableInputError(
            "volterra.too_few_rows_for_kernels",
            "{rows} rows are too few for kernels: record longer, or shorten the memory",
            rows=int(rows.size),
        )
    covariance = OutputCovariance(lags, order)
    chosen = _choose(covariance, x, y, rows, lags, spacing, search_rows)
    warnings: tuple[str, ...] = ()
    solved = _thinned(rows, max_rows)
    if solved.size < rows.size:
        every = -(-rows.size // max_rows)
        warnings = (
            Message(
                "volterra.thinned",
                "the kernels are estimated from {solved} of {rows} rows, one in {every}, to limit computer memory",
                solved=int(solved.size),
                rows=int(rows.size),
                every=every,
            ),
        )
    return _posterior(covariance, chosen, lagged_inputs(x, solved, lags, spacing), y[solved], rows.size, warnings)


def simulate_third(kernel3: Array, x: Array, spacing: int) -> Array:
    """Return the output (n,) of a symmetric third-order kernel (L, L, L) for an input x (n,) minus its mean.

    At rest before the first sample; NaN where the memory contains a NaN. Takes n L^3 multiplications in blocks.
    """
    lags = kernel3.shape[0]
    row, column = np.triu_indices(lags)
    pairs = kernel3[:, row, column] * np.where(row == column, 1.0, 2.0)  # (L, L (L + 1) / 2)
    before = (lags - 1) * spacing
    padded = np.concatenate([np.zeros(before), x])
    response = np.empty(x.size)
    block = max(1, min(_BLOCK, 4_000_000 // row.size))
    for first in range(0, x.size, block):
        some = np.arange(first, min(first + block, x.size)) + before
        windows = lagged_inputs(padded, some, lags, spacing)
        products = windows @ pairs
        products *= windows[:, row]
        response[some - before] = np.einsum("ij,ij->i", products, windows[:, column])
    return response


def _thinned(rows: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Return evenly spaced rows, at most ``most`` of them."""
    return rows[:: -(-rows.size // most)]


@dataclass(frozen=True, eq=False)
class _Chosen:
    """A selected prior, with scales relative to ``density``: the noise variance of a row of the search times
    dependence.
    """

    hyper: Array
    density: float
    noise_variance: float
    log_evidence: float
    dependence: float


def _choose(
    covariance: OutputCovariance,
    x: Array,
    y: Array,
    rows: NDArray[np.intp],
    lags: int,
    spacing: int,
    search_rows: int,
) -> _Chosen:
    """Select the prior by the marginal likelihood of thinned rows; estimate the dependence of all rows from their
    residual.
    """
    some = _thinned(rows, search_rows)
    windows, output = lagged_inputs(x, some, lags, spacing), y[some]
    share = some.size / rows.size
    counted = 1.0  # thinned rows are initially assumed to be independent
    hyper: Array | None = None
    while True:
        hyper, noise, evidence = search(covariance, windows, output, counted, hyper)
        modelled = _modelled(covariance, hyper, windows, output, lagged_inputs(x, rows, lags, spacing))
        dependence = residual_dependence(y[rows] - modelled, modelled)
        revised = max(1.0, dependence * share)
        if revised < _REFIT * counted:
            return _Chosen(hyper, counted * noise, noise, evidence, dependence)
        counted = revised


def _modelled(covariance: OutputCovariance, hyper: Array, windows: Array, output: Array, others: Array) -> Array:
    """Return the output (m,), up to a constant, for lagged inputs (m, L), by the kernels of these rows (n, L)."""
    z = covariance.between(hyper, windows, windows)
    z[np.diag_indices_from(z)] += 1.0
    solution = linalg.solve(z, np.column_stack([output, np.ones(output.size)]), assume_a="pos", check_finite=False)
    weights = solution[:, 0] - solution[:, 1] * (solution[:, 0].sum() / solution[:, 1].sum())
    return np.concatenate(
        [
            covariance.between(hyper, others[first : first + _BLOCK], windows) @ weights
            for first in range(0, others.shape[0], _BLOCK)
        ]
    )


def _posterior(
    covariance: OutputCovariance,
    chosen: _Chosen,
    windows: Array,
    output: Array,
    all_rows: int,
    warnings: tuple[str, ...],
) -> RegressionKernels:
    """Return the kernels from lagged inputs (n, L) and the output (n,) by one factorisation in place."""
    n, order = output.size, covariance.order
    density = max(1.0, chosen.dependence * n / all_rows) * chosen.noise_variance
    hyper = covariance.rescaled(chosen.hyper, chosen.density / density)
    z = np.empty((n, n), order="F")
    for first in range(0, n, _BLOCK):  # lower triangle only
        z[first:, first : first + _BLOCK] = covariance.between(hyper, windows[first:], windows[first : first + _BLOCK])
    z[np.diag_indices(n)] += 1.0
    factor = linalg.cholesky(z, lower=True, overwrite_a=True, check_finite=False)

    def half(values: Array) -> Array:
        return np.asarray(linalg.solve_triangular(factor, values, lower=True, check_finite=False))

    offset = output.mean()
    by_output, by_ones = half(np.column_stack([output - offset, np.ones(n)])).T
    certainty = float(by_ones @ by_ones)
    constant = float(by_ones @ by_output) / certainty
    weights = linalg.solve_triangular(
        factor, by_output - constant * by_ones, lower=True, trans="T", check_finite=False
    )  # alpha, (n,)

    def std(prior: Array, cross: Array) -> Array:
        """Return the standard deviations of kernel values with prior variances (k,) and covariances (n, k) with the
        rows.
        """
        whitened = half(cross)
        variance = prior - np.einsum("ij,ij->j", whitened, whitened) + (by_ones @ whitened) ** 2 / certainty
        return np.asarray(np.sqrt(density * np.maximum(variance, 0.0)))

    first_lag, smooth, diagonal = covariance.lag_covariances(hyper)
    seen = windows @ first_lag
    kernel2 = kernel2_std = kernel3 = None
    lags = windows.shape[1]
    if order >= 2:
        scales, on_diagonal = covariance.scales(hyper)
        through = windows @ smooth  # (n, L)
        squares = windows**2 @ (on_diagonal[0] * diagonal)
        kernel2 = scales[0] * (through.T @ (weights[:, None] * through))
        kernel2[np.diag_indices(lags)] += squares.T @ weights
        row, column = np.triu_indices(lags)
        if n * n * row.size > _STD_STEPS:
            row = column = np.arange(lags)
        prior = 0.5 * scales[0] * (smooth[row, row] * smooth[column, column] + smooth[row, column] ** 2)
        prior[row == column] += on_diagonal[0] * np.diag(diagonal)
        kernel2_std = np.full((lags, lags), np.nan)
        for first in range(0, row.size, _BLOCK):
            i, j = row[first : first + _BLOCK], column[first : first + _BLOCK]
            cross = scales[0] * through[:, i] * through[:, j]
            cross[:, i == j] += squares[:, i[i == j]]
            kernel2_std[i, j] = kernel2_std[j, i] = std(prior[first : first + _BLOCK], cross)
    if order == 3:
        kernel3 = _third(through, scales[1] * weights)
        each = np.arange(lags)
        kernel3[each, each, each] += (windows**3 @ (on_diagonal[1] * diagonal)).T @ weights
    leverages = np.arange(0, n, max(1, n // _LEVERAGES))
    unit = np.zeros((n, leverages.size))
    unit[leverages, np.arange(leverages.size)] = 1.0
    unit = half(unit)
    unexplained = np.einsum("ij,ij->j", unit, unit) - (by_ones @ unit) ** 2 / certainty
    return RegressionKernels(
        kernel0=float(offset + constant),
        kernel1=seen.T @ weights,
        kernel2=kernel2,
        kernel3=kernel3,
        kernel0_std=float(np.sqrt(density / certainty)),
        kernel1_std=std(np.diag(first_lag), seen),
        kernel2_std=kernel2_std,
        effective_parameters=n * (1.0 - float(np.mean(unexplained))),
        hyperparameters=covariance.named(hyper, density),
        log_evidence=chosen.log_evidence,
        noise_variance=chosen.noise_variance,
        dependence=chosen.dependence,
        rows=n,
        warnings=warnings,
    )


def _third(through: Array, weights: Array) -> Array:
    """Return the sum of weights (n,) times triple products of ``through`` (n, L), (L, L, L), symmetric."""
    lags = through.shape[1]
    row, column = np.triu_indices(lags)
    pairs = np.zeros((lags, row.size))
    for first in range(0, weights.size, _BLOCK):
        some = slice(first, first + _BLOCK)
        pairs += (weights[some, None] * through[some]).T @ (through[some][:, row] * through[some][:, column])
    kernel = np.empty((lags, lags, lags))
    kernel[:, row, column] = pairs
    kernel[:, column, row] = pairs
    return kernel


_SHORTEST_BLOCK = 10
_OFFSETS = 4
"""Number of block offsets over which the result is averaged."""


@dataclass(frozen=True, eq=False)
class VolterraStimulus:
    """An input with its regressors factored; any number of responses to it can be solved for."""

    regressors: VolterraRegressors
    factor: Factor

    def matches(self, x: Array, used: Mask, lags: int, spacing: int, order: int) -> bool:
        """Return whether this is the factor for that input (n,), those rows (n,) and those kernels."""
        mine = self.regressors
        return (
            (mine.lags, mine.spacing, mine.order) == (lags, spacing, order)
            and np.array_equal(mine.used, used)
            and np.array_equal(mine.x, x, equal_nan=True)
        )

    def solve(self, output: Array) -> Array:
        """Return the coefficients (M,) for an output (n,), of which only the rows are used."""
        return self.factor.solve(output[self.regressors.rows])

    def deviations(self, residuals: Array, sample_rate_hz: float) -> Array:
        """Return the standard deviations of the coefficients (M,), from the residuals at the rows (rows,).

        The residual of tissue is coloured and depends on the input. The covariance is the sandwich inv(P'P) S inv(P'P),
        with S from sums of P e over blocks of rows within which the residual is autocorrelated (White 1982), corrected
        for the degrees of freedom of the fit.
        """
        rows, columns = residuals.size, self.regressors.columns
        block = max(_SHORTEST_BLOCK, dependence_samples(residuals, sample_rate_hz))
        block = min(block, max(1, rows // 8))
        total = np.zeros(columns)
        for offset in range(_OFFSETS):
            edges = np.arange(offset * block // _OFFSETS, rows, block)
            if edges[0] > 0:
                edges = np.append(0, edges)
            influence = self.factor.gram_solve(self.regressors.block_sums(residuals, edges))  # (M, blocks)
            total += np.einsum("ij,ij->i", influence, influence) / _OFFSETS
        return np.asarray(np.sqrt(total * rows / max(1, rows - columns)), dtype=np.float64)


def factor_stimulus(x: Array, used: Mask, lags: int, spacing: int = 1, order: int = 2) -> VolterraStimulus:
    """Factor the regressors of an input x (n,) with its mean removed, at the rows of a mask (n,).

    Lags are ``spacing`` samples apart. Every input of a row's memory must have been received.
    """
    regressors = VolterraRegressors(x, used, lags, spacing, order)
    return VolterraStimulus(regressors, factor(regressors.gram(), regressors))


_LARGEST_DIRECT = 1500
"""Largest number of coefficients for which regularised kernels are solved directly; above, kernel regression is used.
"""


@dataclass(frozen=True, eq=False)
class Solved:
    """Kernels per lag with standard deviations of the first two orders, and the effective number of parameters."""

    kernels: Kernels
    kernel1_std: Array | None
    kernel2_std: Array | None
    parameters: float
    details: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def exact_least_squares(stimulus: VolterraStimulus, output: Array, sample_rate_hz: float) -> Solved:
    """Estimate kernels by least squares without constraints (Eqs. 4.2-4.14), for an output (n,).

    ``sample_rate_hz`` is that of the rows.
    """
    regressors = stimulus.regressors
    theta = stimulus.solve(output)
    residuals = output[regressors.rows] - regressors.apply(theta)
    deviations = kernels_of(stimulus.deviations(residuals, sample_rate_hz), regressors.lags, regressors.order)
    return Solved(
        kernels=kernels_of(theta, regressors.lags, regressors.order),
        kernel1_std=deviations.first,
        kernel2_std=deviations.second,
        parameters=float(stimulus.factor.rank),
        details={"condition_number": stimulus.factor.condition},
        warnings=stimulus.factor.warnings,
    )


def regularised_least_squares(regressors: VolterraRegressors, output: Array) -> Solved:
    """Return regularised kernels with a smooth, decaying prior for an output (n,).

    Raises:
        UnusableInputError: too few independent rows to select a prior.
    """
    if regressors.order == 3 or regressors.columns > _LARGEST_DIRECT:
        dual = regression_kernels(
            regressors.x, output, regressors.used, regressors.lags, regressors.spacing, regressors.order
        )
        return Solved(
            kernels=Kernels(dual.kernel0, dual.kernel1, dual.kernel2, dual.kernel3),
            kernel1_std=dual.kernel1_std,
            kernel2_std=dual.kernel2_std,
            parameters=dual.effective_parameters,
            details=_prior_details(dual),
            warnings=dual.warnings,
        )
    y = output[regressors.rows]
    fit = regularised_fit(regressors.normal_equations(regressors.gram(), y), regressors, y)
    theta = fit.coefficients.copy()
    theta[0] += y.mean()
    deviations = kernels_of(fit.std, regressors.lags, regressors.order)
    return Solved(
        kernels=kernels_of(theta, regressors.lags, regressors.order),
        kernel1_std=deviations.first,
        kernel2_std=deviations.second,
        parameters=fit.effective_parameters,
        details=_prior_details(fit),
    )


def laguerre_least_squares(regressors: VolterraRegressors, output: Array) -> Solved:
    """Return the kernels as sums of a few Laguerre functions for an output (n,).

    Raises:
        UnusableInputError: too few rows.
    """
    fit = laguerre_kernels(regressors.x, output, regressors.used, regressors.lags, regressors.spacing, regressors.order)
    return Solved(
        kernels=Kernels(fit.kernel0, fit.kernel1, fit.kernel2, fit.kernel3),
        kernel1_std=fit.kernel1_std,
        kernel2_std=fit.kernel2_std,
        parameters=float(fit.n_parameters),
        details={
            "laguerre_pole": fit.pole,
            "laguerre_functions": float(fit.functions.shape[1]),
            "vaf_left_out_percent": fit.held_out_percent,
        },
        warnings=fit.warnings,
    )


def _prior_details(fit: RegularisedKernels | RegressionKernels) -> dict[str, float]:
    return {
        "effective_parameters": fit.effective_parameters,
        "dependence": fit.dependence,
        "log_evidence": fit.log_evidence,
        "noise_variance": fit.noise_variance,
    } | {f"prior_{name}": value for name, value in fit.hyperparameters.items()}
