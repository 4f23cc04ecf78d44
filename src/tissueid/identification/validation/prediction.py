"""Prediction n steps ahead: free-run simulation plus the predictable part of its residual.

``Model.predict`` of an output-error model is its simulation, because such a model has no noise model. Here a noise
model is fitted to the residuals of the fitted samples, so that a short horizon shows how much of the residual is
autocorrelated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask, Model, check_horizon
from tissueid.identification.impulse_response import lagged_products
from tissueid.identification.preparation import complete_windows, scored_samples
from tissueid.identification.validation import vaf_percent
from tissueid.identification.validation.scores import NO_SAMPLE, vaf_std_percent
from tissueid.records import Record

_LARGEST_ORDER = 60
_ROWS_PER_ORDER = 20
"""Minimum number of samples per order that is tried."""

_LARGEST_POLE = 0.999
"""Largest modulus of a pole; unstable least-squares models are scaled to it."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """e[n] - mean = sum over i of coefficients[i - 1] (e[n - i] - mean) + a white innovation.

    ``coefficients`` has shape (order,), empty for white noise; ``innovation_std`` and ``mean`` are in the unit of the
    signal.
    """

    coefficients: Array
    mean: float
    innovation_std: float
    n_samples: int
    aicc: float

    @property
    def order(self) -> int:
        """Number of past samples in the regression."""
        return int(self.coefficients.size)

    def innovations(self, signal: Array) -> Array:
        """Return the innovations (n,) of a signal (n,); NaN within ``order`` samples of a gap."""
        return self.whiten(signal - self.mean)

    def whiten(self, signal: Array) -> Array:
        """Return a signal (n,) filtered by the whitening filter, shape (n,); NaN where the filter covers an unknown
        sample.
        """
        finite = np.isfinite(signal)
        filtered = np.convolve(np.where(finite, signal, 0.0), np.concatenate([[1.0], -self.coefficients]))
        return np.where(complete_windows(finite, self.order + 1), filtered[: signal.size], np.nan)

    def response(self, length: int) -> Array:
        """Return the response psi (length,) of the signal to one innovation: psi[0] = 1."""
        psi = np.zeros(length)
        for step in range(length):
            past = psi[max(0, step - self.order) : step][::-1]
            psi[step] = 1.0 if step == 0 else float(self.coefficients[: past.size] @ past)
        return psi

    def ahead(self, horizon: int) -> Array:
        """Return the weights (order,) that predict e[n] from e[n - horizon] and before, for a zero-mean e."""
        weights = self.coefficients.copy()
        for _ in range(horizon - 1):
            weights = weights[:1] * self.coefficients + np.append(weights[1:], 0.0)[: self.order]
        return weights

    def error_std(self, horizons: Array) -> Array:
        """Return the standard deviation of the best prediction's error ``horizons`` samples ahead, same shape."""
        steps = np.asarray(horizons, dtype=np.intp)
        spread = np.cumsum(self.response(int(np.max(steps))) ** 2)
        return np.asarray(self.innovation_std * np.sqrt(spread[steps - 1]), dtype=np.float64)


def fit_autoregression(signal: Array, max_order: int | None = None) -> Autoregression:
    """Fit an autoregression to a signal (n,) by least squares, its order selected by AICc (Hurvich and Tsai 1989).

    NaN are gaps; no row of the regression crosses one. Without ``max_order``, orders up to 60 are tried, or up to one
    per 20 known samples.

    Raises:
        UnusableInputError: too few successive samples, or the signal does not vary.
    """
    finite = np.isfinite(signal)
    count = int(finite.sum())
    largest = min(_LARGEST_ORDER, count // _ROWS_PER_ORDER) if max_order is None else max_order
    while max_order is None and largest > 1 and not _has_enough_rows(finite, largest):
        largest -= 1
    if not _has_enough_rows(finite, largest):
        raise UnusableInputError(
            "noise_model.too_few_residuals",
            "{count} residuals have too few without gaps for a noise model of order {order}: record longer, or "
            "lower the order",
            count=int(count),
            order=largest,
        )
    rows = complete_windows(finite, largest + 1)
    mean = float(np.mean(signal[finite]))
    centred = np.where(finite, signal - mean, 0.0)
    if float(np.max(np.abs(centred))) <= 1e-12 * max(abs(mean), 1e-300):
        raise UnusableInputError("noise_model.constant", "the residual does not vary: there is no noise to describe")
    order = _best_order(lagged_products(centred, rows, largest + 1), int(rows.sum()))
    rows = complete_windows(finite, order + 1)
    used = int(rows.sum())
    products = lagged_products(centred, rows, order + 1)
    coefficients = _stabilised(_solve(products))
    gain = np.concatenate([[1.0], -coefficients])
    rss = used * float(gain @ products @ gain)
    return Autoregression(
        coefficients=coefficients,
        mean=mean,
        innovation_std=math.sqrt(rss / max(1, used - order - 1)),
        n_samples=used,
        aicc=_aicc(rss / used, used, order),
    )


def _has_enough_rows(finite: Mask, order: int) -> bool:
    """Return whether there are enough successive known samples for a noise model of this order."""
    return int(complete_windows(finite, order + 1).sum()) >= _ROWS_PER_ORDER * max(1, order)


def _best_order(products: Array, rows: int) -> int:
    """Return the order with the smallest AICc, with all orders scored on the same rows."""
    factor = linalg.cholesky(_with_ridge(products[1:, 1:]), lower=True) if products.shape[0] > 1 else np.zeros((0, 0))
    explained = linalg.solve_triangular(factor, products[1:, 0], lower=True) if factor.size else np.zeros(0)
    powers = products[0, 0] - np.concatenate([[0.0], np.cumsum(explained**2)])
    powers = np.maximum(powers, 1e-14 * products[0, 0])
    return int(np.argmin([_aicc(float(power), rows, order) for order, power in enumerate(powers)]))


def _solve(products: Array) -> Array:
    if products.shape[0] == 1:
        return np.zeros(0)
    return np.asarray(linalg.solve(_with_ridge(products[1:, 1:]), products[1:, 0], assume_a="pos"), dtype=np.float64)


def _with_ridge(products: Array) -> Array:
    """Return the products with a small ridge, for signals without power over most of the band."""
    loaded = products.copy()
    loaded[np.diag_indices_from(loaded)] += 1e-10 * products[0, 0]
    return loaded


def _aicc(power: float, n: int, order: int) -> float:
    k = order + 2  # plus the mean and the innovation variance
    return n * (math.log(2.0 * math.pi * power) + 1.0) + 2.0 * k + 2.0 * k * (k + 1) / max(1, n - k - 1)


def _stabilised(coefficients: Array) -> Array:
    """Return the coefficients (order,) with all poles inside the unit circle."""
    if coefficients.size == 0:
        return coefficients
    fastest = float(np.max(np.abs(np.roots(np.concatenate([[1.0], -coefficients])))))
    if fastest < _LARGEST_POLE:
        return coefficients
    return np.asarray(coefficients * (_LARGEST_POLE / fastest) ** np.arange(1, coefficients.size + 1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PredictionCurve:
    """Accuracy of predictions against the horizon; arrays have shape (horizons,).

    ``error_std`` is the standard deviation of the prediction error, ``expected_error_std`` that expected from the noise
    model, both in the unit of the output. ``free_run_vaf_percent`` is the limit at long horizons.
    """

    horizon: NDArray[np.int_]
    horizon_s: Array
    vaf_percent: Array
    vaf_std_percent: Array
    error_std: Array
    expected_error_std: Array
    free_run_vaf_percent: float
    n_samples: int
    noise_order: int


def fit_noise(
    model: Model, record: Record, fit_part: slice | None = None, max_order: int | None = None
) -> Autoregression:
    """Fit an autoregression to the residuals of a model on the fitted samples.

    Raises:
        UnusableInputError: another sample rate, or too few residuals.
    """
    used = scored_samples(record, model.memory_samples, fit_part)
    return fit_autoregression(np.where(used, model.residuals(record), np.nan), max_order)


def predict_ahead(model: Model, record: Record, horizon: int, noise: Autoregression) -> Array:
    """Predict each output from the input up to now and the output up to ``horizon`` samples ago, shape (n,).

    If a required past residual is unknown, at the start and after a gap, the prediction is the free run plus the mean
    of the noise. NaN where the simulation is NaN.

    Raises:
        UnusableInputError: the horizon is less than one sample, or the record has another sample rate.
    """
    check_horizon(horizon)
    model.check_rate(record)
    simulated = model.simulate(record.input)
    return _ahead(simulated, _known_residual(model, record, simulated), horizon, noise)


def prediction_curve(
    model: Model,
    record: Record,
    noise: Autoregression,
    horizons: Sequence[int] | None = None,
    part: slice | None = None,
) -> PredictionCurve:
    """Score predictions over horizons, in samples, on a part of a record, all on the same samples.

    The default horizons double from one sample to the memory of the model.

    Raises:
        UnusableInputError: a horizon is less than one sample, the rates differ, or no sample is left to score.
    """
    doubled = 2 ** np.arange(max(1, model.memory_samples).bit_length())
    steps = np.unique([*doubled, model.memory_samples]) if horizons is None else np.asarray(horizons, dtype=np.int_)
    if steps.size == 0:
        raise UnusableInputError("prediction.no_horizon", "no prediction horizon is given")
    check_horizon(int(steps.min()))
    model.check_rate(record)
    simulated = model.simulate(record.input)
    residual = _known_residual(model, record, simulated)
    used = scored_samples(record, model.memory_samples, part) & np.isfinite(simulated)
    if int(used.sum()) < 2:
        raise UnusableInputError(NO_SAMPLE)
    measured = record.output[used]
    errors = [measured - _ahead(simulated, residual, int(step), noise)[used] for step in steps]
    vaf = [vaf_percent(measured, measured - error) for error in errors]
    return PredictionCurve(
        horizon=steps,
        horizon_s=steps / record.sample_rate_hz,
        vaf_percent=np.array(vaf),
        vaf_std_percent=np.array([vaf_std_percent(measured, error, record.sample_rate_hz) for error in errors]),
        error_std=np.array([float(np.std(error)) for error in errors]),
        expected_error_std=noise.error_std(steps.astype(np.float64)),
        free_run_vaf_percent=vaf_percent(measured, simulated[used]),
        n_samples=int(used.sum()),
        noise_order=noise.order,
    )


def _known_residual(model: Model, record: Record, simulated: Array) -> Array:
    """Return the residual (n,), NaN where the memory begins before the record, because it is not only noise there."""
    complete = complete_windows(np.isfinite(record.input), model.memory_samples)
    return np.where(complete, record.output - simulated, np.nan)


def _ahead(simulated: Array, residual: Array, horizon: int, noise: Autoregression) -> Array:
    n = simulated.size
    weights = noise.ahead(horizon)
    foretold = np.zeros(n)
    if noise.order and n > horizon:
        full = np.convolve(residual - noise.mean, weights)[: n - horizon]  # NaN spreads over the filter's length
        full[: noise.order - 1] = np.nan
        foretold[horizon:] = np.where(np.isfinite(full), full, 0.0)
    return simulated + noise.mean + foretold
