"""Bode diagram of an impulse response, with confidence bands from the covariance of its lags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Model
from tissueid.identification.preparation import prepare
from tissueid.identification.second_order import Complex
from tissueid.identification.validation.autoregression import fit_autoregression
from tissueid.identification.validation.residual_scores import kernel_error
from tissueid.messages import Message
from tissueid.records import Record


@dataclass(frozen=True, eq=False)
class FrequencyBand:
    """A frequency response with standard deviations; all arrays have shape (frequencies,).

    ``magnitude_std`` and ``phase_std_rad`` are the standard deviations along and perpendicular to the response, to
    first order; that of the phase is infinite if the magnitude is zero. If ``magnitude_std`` is comparable to the
    magnitude, neither distribution is Gaussian.
    """

    frequency_hz: Array
    response: Complex
    magnitude: Array
    magnitude_std: Array
    phase_rad: Array
    phase_std_rad: Array


def frequency_response_band(kernel: Array, spread: Array, lag_s: Array, frequency_hz: Array) -> FrequencyBand:
    """Return the frequency response of an impulse response, with its standard deviations.

    Args:
        kernel: (lags,), output per input and second.
        spread: covariance (lags, lags) of the kernel, or standard deviations (lags,), which assume independent lags.
            The errors of a kernel estimated from low-pass input are negatively correlated between neighbours; bands
            from standard deviations are then far too wide.
        lag_s: (lags,), evenly spaced, s.
        frequency_hz: (frequencies,).

    Raises:
        UnusableInputError: shapes that do not match, or fewer than two lags.
    """
    lags = kernel.size
    if lags < 2 or lag_s.shape != (lags,) or spread.shape not in ((lags,), (lags, lags)):
        raise UnusableInputError(
            Message(
                "frequency_band.arguments",
                "a frequency response needs a kernel of at least two lags and standard deviations of the same size",
            )
        )
    step = float(lag_s[1] - lag_s[0])
    turn = np.exp(-2j * np.pi * np.outer(frequency_hz, lag_s)) * step  # (frequencies, lags)
    response = turn @ kernel
    magnitude = np.abs(response)
    known = magnitude > 0.0
    towards = np.where(known, response.conj() / np.where(known, magnitude, 1.0), 1.0)
    turned = towards[:, None] * turn  # real part: along the response; imaginary part: perpendicular to it
    variance = [_quadratic(part, spread) for part in (turned.real, turned.imag)]
    along, across = (np.sqrt(np.maximum(v, 0.0)) for v in variance)
    return FrequencyBand(
        frequency_hz=np.asarray(frequency_hz, dtype=np.float64),
        response=response,
        magnitude=magnitude,
        magnitude_std=along,
        phase_rad=np.unwrap(np.angle(response)),
        phase_std_rad=np.where(known, across / np.where(known, magnitude, 1.0), np.inf),
    )


def linear_kernel_covariance(model: Model, record: Record, fit_part: slice | None = None) -> Array:
    """Return the covariance (lags, lags) of a linear kernel fitted to this part of a record, output per input and
    second.

    For models with a least-squares kernel, such as ``lms``. The noise spectrum is that of an autoregression of the
    residuals, because a smoothed spectrum is biased at single frequencies.

    Raises:
        UnusableInputError: another sample rate, or a record that is not sufficient for the fit or the noise model.
    """
    prepared = prepare(record, fit_part, model.memory_samples / record.sample_rate_hz)
    count = int(prepared.used.sum())
    noise = fit_autoregression(np.where(prepared.used, model.residuals(record), np.nan))
    error = kernel_error(record.input[prepared.part], noise, model.memory_samples, count, 1)
    taken = count / max(1, count - model.memory_samples)  # the fit reduces the variance of the residual
    return error.covariance * taken * record.sample_rate_hz**2


def _quadratic(rows: Array, spread: Array) -> Array:
    """Return the variance (k,) of weighted sums (k, lags) over lags with this covariance or deviations."""
    if spread.ndim == 1:
        return np.asarray(rows**2 @ spread**2, dtype=np.float64)
    return np.asarray(np.einsum("ij,ij->i", rows @ spread, rows), dtype=np.float64)
