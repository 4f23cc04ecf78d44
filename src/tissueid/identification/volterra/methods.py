"""Methods of estimating Volterra kernels, with a common result."""

from __future__ import annotations

from dataclasses import dataclass, field

from tissueid.identification.base import Array
from tissueid.identification.volterra.kernel_regression import RegressionKernels, regression_kernels
from tissueid.identification.volterra.laguerre import laguerre_kernels
from tissueid.identification.volterra.prior import RegularisedKernels, regularised_fit
from tissueid.identification.volterra.regressors import Kernels, VolterraRegressors, kernels_of
from tissueid.identification.volterra.stimulus import VolterraStimulus

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
