"""Bode diagram of an impulse response, with bands from the covariance of its lags."""

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

    ``magnitude_std`` and ``phase_std_rad`` are the spread along the response and across it, to first order; the phase's
    is infinite where the magnitude is nil. Where a deviation of the magnitude comes near the magnitude itself, neither
    is Gaussian any more.
    """

    frequency_hz: Array
    response: Complex
    magnitude: Array
    magnitude_std: Array
    phase_rad: Array
    phase_std_rad: Array


def frequency_response_band(kernel: Array, spread: Array, lag_s: Array, frequency_hz: Array) -> FrequencyBand:
    """Return the frequency response of an impulse response, and how far it may be off.

    Args:
        kernel: (lags,), output per input and second.
        spread: covariance (lags, lags) of the kernel, or standard deviations (lags,), which take the lags to be
            unrelated. Those of a kernel from a low-pass input are not: neighbours err in opposite directions, and bands
            from deviations alone are then far too wide.
        lag_s: (lags,), evenly spaced seconds.
        frequency_hz: (frequencies,).

    Raises:
        UnusableInputError: shapes that do not belong together, or fewer than two lags.
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
    turned = towards[:, None] * turn  # along the response in the real part, across it in the imaginary
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
    """Covariance (lags, lags) of a linear kernel that was fitted to this part of a record, output per input and second.

    For models whose kernel is the least-squares one, as that of ``lms``. The colour of the noise is taken from an
    autoregression of the residuals: a Bode diagram looks at single frequencies, where a smoothed spectrum errs.

    Raises:
        UnusableInputError: another sample rate, or a record that cannot carry the fit or the noise model.
    """
    prepared = prepare(record, fit_part, model.memory_samples / record.sample_rate_hz)
    count = int(prepared.used.sum())
    noise = fit_autoregression(np.where(prepared.used, model.residuals(record), np.nan))
    error = kernel_error(record.input[prepared.part], noise, model.memory_samples, count, 1)
    taken = count / max(1, count - model.memory_samples)  # the fit took its share of the noise
    return error.covariance * taken * record.sample_rate_hz**2


def _quadratic(rows: Array, spread: Array) -> Array:
    """Return the variance (k,) of each row's sum (k, lags) over lags of this covariance or these deviations."""
    if spread.ndim == 1:
        return np.asarray(rows**2 @ spread**2, dtype=np.float64)
    return np.asarray(np.einsum("ij,ij->i", rows @ spread, rows), dtype=np.float64)
