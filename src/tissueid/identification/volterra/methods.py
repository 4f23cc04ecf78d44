"""Methods of estimating Volterra kernels, with a common result."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tissueid.identification.base import Array, Mask
from tissueid.identification.correlation import dependence_samples
from tissueid.identification.least_squares import Factor, factor
from tissueid.identification.volterra.kernel_regression import RegressionKernels, regression_kernels
from tissueid.identification.volterra.laguerre import laguerre_kernels
from tissueid.identification.volterra.prior import RegularisedKernels, regularised_fit
from tissueid.identification.volterra.regressors import Kernels, VolterraRegressors, kernels_of

_SHORTEST_BLOCK = 10
_OFFSETS = 4
"""Number of block offsets over which the result is averaged."""


@dataclass(frozen=True, eq=False)
class VolterraStimulus:
    """An input with its regressors factored; any number of responses to it can be solved for."""

    regressors: VolterraRegressors
    gram: Array
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
    gram = regressors.gram()
    return VolterraStimulus(regressors, gram, factor(gram, regressors))


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
        return _by_kernel_regression(regressors, output)
    y = output[regressors.rows]
    found = regularised_fit(regressors.normal_equations(regressors.gram(), y), regressors, y)
    theta = found.coefficients.copy()
    theta[0] += y.mean()
    deviations = kernels_of(found.std, regressors.lags, regressors.order)
    return Solved(
        kernels=kernels_of(theta, regressors.lags, regressors.order),
        kernel1_std=deviations.first,
        kernel2_std=deviations.second,
        parameters=found.effective_parameters,
        details=_prior_details(found),
    )


def laguerre_least_squares(regressors: VolterraRegressors, output: Array) -> Solved:
    """Return the kernels as sums of a few Laguerre functions for an output (n,).

    Raises:
        UnusableInputError: too few rows.
    """
    found = laguerre_kernels(
        regressors.x, output, regressors.used, regressors.lags, regressors.spacing, regressors.order
    )
    return Solved(
        kernels=Kernels(found.kernel0, found.kernel1, found.kernel2, found.kernel3),
        kernel1_std=found.kernel1_std,
        kernel2_std=found.kernel2_std,
        parameters=float(found.n_parameters),
        details={
            "laguerre_pole": found.pole,
            "laguerre_functions": float(found.functions.shape[1]),
            "vaf_left_out_percent": found.held_out_percent,
        },
        warnings=found.warnings,
    )


def _by_kernel_regression(regressors: VolterraRegressors, output: Array) -> Solved:
    found = regression_kernels(
        regressors.x, output, regressors.used, regressors.lags, regressors.spacing, regressors.order
    )
    return Solved(
        kernels=Kernels(found.kernel0, found.kernel1, found.kernel2, found.kernel3),
        kernel1_std=found.kernel1_std,
        kernel2_std=found.kernel2_std,
        parameters=found.effective_parameters,
        details=_prior_details(found),
        warnings=found.warnings,
    )


def _prior_details(found: RegularisedKernels | RegressionKernels) -> dict[str, float]:
    return {
        "effective_parameters": found.effective_parameters,
        "dependence": found.dependence,
        "log_evidence": found.log_evidence,
        "noise_variance": found.noise_variance,
    } | {f"prior_{name}": value for name, value in found.hyperparameters.items()}
