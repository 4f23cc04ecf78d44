"""Prediction n steps ahead: free-run simulation plus the predictable part of its residual.

``Model.predict`` of an output-error model is its simulation, because such a model has no noise model. Here a noise
model is fitted to the residuals of the fitted samples, so that a short horizon shows how much of the residual is
autocorrelated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Model, check_horizon
from tissueid.identification.preparation import complete_windows, scored_samples
from tissueid.identification.validation import vaf_percent
from tissueid.identification.validation.autoregression import Autoregression, fit_autoregression
from tissueid.identification.validation.scores import NO_SAMPLE, vaf_std_percent
from tissueid.records import Record


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
    steps = _doubling(model.memory_samples) if horizons is None else np.asarray(horizons, dtype=np.int_)
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


def _doubling(memory_samples: int) -> NDArray[np.int_]:
    return np.unique(np.append(2 ** np.arange(max(1, memory_samples).bit_length()), memory_samples)).astype(np.int_)
