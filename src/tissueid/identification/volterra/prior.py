"""Regularised Volterra kernels: a Gaussian prior for smooth, decaying kernels, selected by marginal likelihood.

The posterior mean replaces the exact least-squares solution if the input does not excite all lags (Chen 2010, 4.3). The
estimate itself is smooth; it is not filtered afterwards, so that the output is not affected. All computations use the
normal equations; the marginal likelihood and its derivatives cost at most O(M^3) for any number of samples.

The likelihood assumes white noise. The residual of tissue is coloured, and neighbouring rows are not independent; if
they were treated as independent, the marginal likelihood would fit noise. N rows therefore count as N / d, where
``dependence`` d is the ratio of the residual's power density to that of white noise, weighted by the spectrum of the
modelled output.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg, optimize

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.impulse_response import Correlator
from tissueid.identification.volterra.kernel_covariance import FIRST, FirstOrderCovariance, SecondOrderCovariance
from tissueid.identification.volterra.regressors import NormalEquations

ROUGH = 0.25
"""Spatial frequency, cycles per lag, above which :func:`roughness` counts: half the Nyquist frequency of the lags."""

_RANK = 1e-14
"""Pivot of the Gram matrix, with columns scaled to 1, below which it is treated as zero."""

_EXPLAINED = 1e-10
"""Share of the output's power below which the unexplained part is rounding."""

_SEARCHES, _SEARCH_STEPS, _TOLERANCE = 4, 30, 2e-6

_NAMES = (
    "first_std",
    "first_decay",
    "first_rate",
    "second_std",
    "second_decay_along",
    "second_rate_along",
    "second_decay_across",
    "second_rate_across",
)
_SCALES = (0, 3)

_DECAY, _RATE = (1e-3, 2.0), (3e-3, 3.0)
_BOUNDS = (_DECAY, _DECAY, _RATE, _DECAY, _DECAY, _RATE, _DECAY, _RATE)
"""Bounds of decays and correlation rates, per lag; those of the scales are relative to the starting point."""

_SCALE_DOWN, _SCALE_UP = 14.0, 8.0

_LARGEST_STEP = np.log([4.0, 0.5, 2.0, 4.0, 0.5, 2.0, 0.5, 2.0])
"""Largest factor by which priors may become wider and rougher than at the start of a search."""

_LEAST_VARIANCE_RATIO = 0.03
"""Ratio of prior variance to noise variance of a direction below which it is left out of a search."""

_EXPECTED = (100.0, 20.0)
"""Initial ratio of output power to noise power for h1 and h2."""

_REFIT = 1.5
"""Ratio of estimated to assumed dependence above which the kernels are refitted."""

_BLOCKS = 10


class CoefficientMap(Protocol):
    """Interface of regressors that map coefficients (p,) to outputs (rows,)."""

    def apply(self, theta: Array) -> Array:
        """Return P theta."""
        ...


@dataclass(frozen=True, eq=False)
class RegularisedKernels:
    """Posterior of Volterra coefficients, in the order of the normal equations.

    ``coefficients`` and ``std`` have shape (p,); the first, h0, is relative to the mean output and not penalised.
    ``effective_parameters`` is the trace of the hat matrix. ``hyperparameters`` holds prior standard deviations at lag
    0 in the unit of each kernel, decays and correlation rates per lag. ``noise_variance`` is that of the residual,
    ``dependence`` the number of rows per independent row. ``log_evidence`` is the restricted log marginal likelihood of
    the effective number of rows.
    """

    coefficients: Array
    std: Array
    effective_parameters: float
    hyperparameters: dict[str, float]
    log_evidence: float
    noise_variance: float
    dependence: float


def regularised(
    equations: NormalEquations, dependence: float = 1.0, start: RegularisedKernels | None = None
) -> RegularisedKernels:
    """Return the regularised kernels of first or second order from normal equations.

    Args:
        equations: of an input and output with zero means.
        dependence: number of rows per independent row (:func:`residual_dependence`); 1 for white noise.
        start: result from which the search starts, for example one with another dependence.

    Raises:
        UnusableInputError: the order is not 1 or 2, or there are too few independent rows to select a prior.
    """
    if equations.order not in (1, 2):
        raise UnusableInputError(
            "volterra.prior_order",
            "regularised normal equations are for kernels of order 1 or 2, got {order}",
            order=equations.order,
        )
    if equations.rows / dependence < 10.0:
        raise UnusableInputError(
            "volterra.dependent_rows",
            "{rows} rows that depend on each other over {samples:.0f} samples are too few for kernels: record longer",
            rows=equations.rows,
            samples=dependence,
        )
    evidence = _Evidence(equations, max(1.0, dependence))
    begin = evidence.initial() if start is None else evidence.hyper_of(start)
    return evidence.posterior(evidence.search(begin))


def regularised_fit(equations: NormalEquations, regressors: CoefficientMap, output: Array) -> RegularisedKernels:
    """Return the regularised kernels with the dependence of the rows estimated from their residual.

    Args:
        equations: the normal equations of ``regressors`` and ``output``.
        regressors: map coefficients to outputs.
        output: (rows,).

    Raises:
        UnusableInputError: as :func:`regularised`.
    """
    centred = output - output.mean()
    lags = slice(0, 1 + equations.lags)
    first = NormalEquations(
        equations.gram[lags, lags],
        equations.right[lags],
        equations.output_power,
        equations.rows,
        equations.lags,
        1,
    )
    fit: RegularisedKernels | None = None
    linear = np.zeros(equations.right.size)
    linear[lags] = regularised(first).coefficients
    modelled = regressors.apply(linear)
    dependence = residual_dependence(centred - modelled, modelled)
    for _ in range(3):
        fit = regularised(equations, dependence, fit)
        modelled = regressors.apply(fit.coefficients)
        dependence = residual_dependence(centred - modelled, modelled)
        if 1.0 / _REFIT < dependence / fit.dependence < _REFIT:
            break
    assert fit is not None
    return fit


def residual_dependence(residual: Array, modelled: Array) -> float:
    """Return the number of rows per independent row, at least 1.

    The mean of the residual's power spectrum, weighted by that of the modelled output, over its plain mean; both
    (rows,). Spectra are smoothed by a Bartlett window over a tenth of the rows.
    """
    longest = max(1, residual.size // _BLOCKS)
    correlations = []
    for signal in (residual, modelled):
        correlation = Correlator(signal - signal.mean(), longest).auto()
        if correlation[0] <= 0.0:
            return 1.0
        correlations.append(correlation / correlation[0])
    weight = 1.0 - np.arange(longest) / longest
    return max(1.0, 2.0 * float(np.sum(weight * correlations[0] * correlations[1])) - 1.0)


def roughness(kernel2: Array) -> float:
    """Return the share of the Fourier energy of h2 (L, L) above ``ROUGH`` cycles per lag in any direction."""
    energy = np.abs(np.fft.fft2(kernel2)) ** 2
    frequency = np.fft.fftfreq(kernel2.shape[0])
    total = float(energy.sum())
    return float(energy[np.hypot(frequency[:, None], frequency) > ROUGH].sum()) / total if total > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class _DataTerms:
    """Information in the samples: ``root`` B (M, rank) with B B' the Gram matrix, and the output (rank,)."""

    root: Array
    output: Array


class _Evidence:
    """Marginal likelihood of the hyperparameters, with the noise profiled and the constant integrated out.

    All quantities refer to kernels, not coefficients: off-diagonal coefficients of h2 are twice the kernel. Covariances
    are relative to d sigma^2, so that the common scale cancels and d only enters through the number of rows.
    """

    def __init__(self, equations: NormalEquations, dependence: float) -> None:
        lags = self._lags = equations.lags
        row, column = np.triu_indices(lags)
        self._share = np.ones(lags)
        if equations.order == 2:
            self._share = np.concatenate([self._share, np.where(row == column, 1.0, 2.0)])
        self._second = SecondOrderCovariance(lags) if equations.order == 2 else None
        self._first = FirstOrderCovariance(lags)
        self._rows, self.dependence = equations.rows, dependence
        self._independent = equations.rows / dependence - 1.0
        sums = equations.gram[0, 1:] * self._share
        self._means = sums / equations.rows
        gram = equations.gram[1:, 1:] * np.outer(self._share, self._share)
        self._gram = gram - np.outer(sums, self._means)  # about the mean: the constant is free
        right = (equations.right[1:] - equations.right[0] * equations.gram[0, 1:] / equations.rows) * self._share
        self._right_mean = equations.right[0] / equations.rows
        self._power = equations.output_power - equations.right[0] * self._right_mean
        size = np.sqrt(np.maximum(np.diag(self._gram), np.finfo(float).tiny))
        factor, pivots, rank, _ = linalg.lapack.dpstrf(self._gram / np.outer(size, size), tol=_RANK, lower=1)
        factor, pivots = np.tril(factor)[:, :rank], pivots - 1
        root = np.empty_like(factor)
        root[pivots] = factor
        output = linalg.solve_triangular(factor[:rank], (right / size)[pivots[:rank]], lower=True, check_finite=False)
        self._data = _DataTerms(root * size[:, None], output)

    def initial(self) -> Array:
        """Return initial hyperparameters: kernels decay within the memory and explain most of the output."""
        lags = self._lags
        decay, rate = min(4.0 / lags, 1.0), min(6.0 / lags, 1.0)
        power = np.diag(self._gram)
        fading = np.exp(-2.0 * decay * np.arange(lags))
        hyper = [_EXPECTED[0] * self._independent / float(power[:lags] @ fading), decay, rate]
        if self._second is not None:
            fading = fading[np.triu_indices(lags)[1]]
            scale = _EXPECTED[1] * self._independent / float(power[lags:] @ fading)
            hyper += [scale, 0.5 * decay, rate, 0.5 * decay, rate]
        return np.asarray(np.log(hyper), dtype=np.float64)

    def hyper_of(self, fit: RegularisedKernels) -> Array:
        """Return the hyperparameters of a result in the scaling of this search."""
        hyper = np.array(list(fit.hyperparameters.values()))
        scales = [k for k in _SCALES if k < hyper.size]
        hyper[scales] = hyper[scales] ** 2 / (fit.dependence * fit.noise_variance)
        return np.asarray(np.log(hyper), dtype=np.float64)

    def search(self, begin: Array) -> Array:
        """Return the hyperparameters (3,) or (8,) with the greatest marginal likelihood near a starting point.

        The search is restricted to directions that matter for a prior wider and rougher than the start (typically a
        quarter of all), and restarts from its result if it exceeded that range.
        """
        bounds = [(float(np.log(low)), float(np.log(high))) for low, high in _BOUNDS[: begin.size]]
        middle = self.initial()
        for k in _SCALES:
            if k < begin.size:
                bounds[k] = (middle[k] - _SCALE_DOWN, middle[k] + _SCALE_UP)
        low, high = np.array(bounds).T
        hyper = np.clip(begin, low, high)
        for _ in range(_SEARCHES):
            reach = hyper + _LARGEST_STEP[: hyper.size]
            minimum = optimize.minimize(
                self._deviance,
                hyper,
                args=(self._informative_directions(reach),),
                jac=True,
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": _SEARCH_STEPS, "ftol": _TOLERANCE},
            )
            hyper = np.asarray(minimum.x, dtype=np.float64)
            if np.all((hyper - reach) * _LARGEST_STEP[: hyper.size] <= 0.0):
                break
        return hyper

    def _informative_directions(self, hyper: Array) -> _DataTerms:
        """Return the normal equations without directions in which a prior is stronger than the data."""
        data = self._data
        worth, directions = linalg.eigh(data.root.T @ self._prior_times(hyper, data.root), check_finite=False)
        kept = directions[:, worth > _LEAST_VARIANCE_RATIO]
        return _DataTerms(data.root @ kept, data.output @ kept)

    def _deviance(self, hyper: Array, data: _DataTerms) -> tuple[float, Array]:
        """Return minus the log marginal likelihood, up to a constant, and its derivatives."""
        lags, root = self._lags, data.root
        try:
            factor, weights = _solve(data, self._prior_times(hyper, data.root))
        except linalg.LinAlgError:  # the step was too long: the noise vanishes
            return 1e3 * self._independent, np.zeros(hyper.size)
        power = self._unexplained(data, weights)
        value = 0.5 * self._independent * np.log(power / self._power) + float(np.sum(np.log(np.diag(factor))))
        half = linalg.solve_triangular(factor, root.T, lower=True, check_finite=False)  # (rank, M)
        step = np.sqrt(self._independent / power) * (root @ weights)
        slopes = self._first.slopes(hyper[:FIRST], _product(half[:, :lags], step[:lags]))
        if self._second is not None:
            more = self._second.slopes(hyper[FIRST:], _product(half[:, lags:], step[lags:]))
            slopes = np.concatenate([slopes, more])
        return float(value), 0.5 * slopes

    def posterior(self, hyper: Array) -> RegularisedKernels:
        """Return the posterior mean, standard deviations and related results for given hyperparameters."""
        spread = self._prior_times(hyper, self._data.root)  # K B, (M, rank)
        factor, weights = _solve(self._data, spread)
        power = self._unexplained(self._data, weights)
        noise = power / (self.dependence * self._independent)
        density = self.dependence * noise
        kernels = spread @ weights
        whitened = linalg.solve_triangular(factor, spread.T, lower=True, check_finite=False)
        prior = self._prior_variance(hyper)
        variance = np.maximum(prior - np.einsum("ij,ij->j", whitened, whitened), 0.0)
        whitened_mean = whitened @ self._means
        mean_variance = 1.0 / self._rows + float(self._means @ self._prior_times(hyper, self._means[:, None])[:, 0])
        mean_variance -= float(whitened_mean @ whitened_mean)
        half = linalg.solve_triangular(factor, np.eye(factor.shape[0]), lower=True, check_finite=False)
        logarithms = float(np.sum(np.log(np.diag(factor))))
        evidence = -0.5 * self._independent * (np.log(2.0 * np.pi * noise) + 1.0) - logarithms
        values = np.exp(hyper)
        for k in _SCALES:
            if k < values.size:
                values[k] = np.sqrt(values[k] * density)
        return RegularisedKernels(
            coefficients=np.concatenate([[self._right_mean - self._means @ kernels], kernels * self._share]),
            std=np.sqrt(density * np.concatenate([[max(mean_variance, 0.0)], variance * self._share**2])),
            effective_parameters=1.0 + factor.shape[0] - float(np.sum(half**2)),
            hyperparameters=dict(zip(_NAMES, values.tolist(), strict=False)),
            log_evidence=float(evidence),
            noise_variance=noise,
            dependence=self.dependence,
        )

    def _prior_times(self, hyper: Array, values: Array) -> Array:
        """Return the prior covariance times values (M, k)."""
        lags = self._lags
        first = self._first.matrix(hyper[:FIRST]) @ values[:lags]
        if self._second is None:
            return first
        return np.concatenate([first, self._second.matrix(hyper[FIRST:]) @ values[lags:]])

    def _prior_variance(self, hyper: Array) -> Array:
        first = np.diag(self._first.matrix(hyper[:FIRST]))
        if self._second is None:
            return first
        return np.concatenate([first, self._second.variance(hyper[FIRST:])])

    def _unexplained(self, data: _DataTerms, weights: Array) -> float:
        power = self._power - float(data.output @ (data.output - weights))
        return float(max(power, _EXPLAINED * self._power))


def _solve(data: _DataTerms, spread: Array) -> tuple[Array, Array]:
    """Return the Cholesky factor (rank, rank) of I + B' K B, and the weights (rank,) that turn K B into kernels."""
    inner = data.root.T @ spread
    inner[np.diag_indices_from(inner)] += 1.0
    factor = linalg.cholesky(inner, lower=True, overwrite_a=True, check_finite=False)
    return factor, linalg.cho_solve((factor, True), data.output, check_finite=False)


def _product(half: Array, step: Array) -> Array:
    """Return half' half - step step', symmetric (p, p): the weight of a change of the covariance."""
    product = half.T @ half
    product -= np.outer(step, step)
    return np.asarray(product, dtype=np.float64)
