"""Standard deviation and significance of a variance accounted for, with autocorrelated samples."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtr

from tissueid.identification.base import Array
from tissueid.identification.correlation import Correlator
from tissueid.identification.effective_samples import dependence_samples, long_run_covariance

_FEWEST = 8
"""Samples below which no significance is computed."""

_LEAST = 1e-12
"""Lower bound on the unexplained share of the variance in the t statistic."""


def vaf_std_percent(measured: Array, error: Array, sample_rate_hz: float) -> float:
    """Return the standard deviation of a VAF (Eq. 3.13), percentage points, over similar records.

    ``measured`` and ``error`` have shape (n,) and hold no NaN.
    """
    return 100.0 * ratio_std((error - error.mean()) ** 2, (measured - measured.mean()) ** 2, sample_rate_hz)


def unrelated_p_value(measured: Array, simulated: Array) -> float:
    """Return the one-sided p-value of a simulation against independent simulations; 1 for no fit.

    Both have shape (n,) and no NaN. Their correlation is tested by Student's t with the effective sample size that
    follows from both autocorrelations (Bartlett 1935).
    """
    n = measured.size
    if n < _FEWEST:
        return 1.0
    y, modelled = measured - measured.mean(), simulated - simulated.mean()
    lags = n // 4
    powers = [Correlator(values, lags).auto() for values in (y, modelled)]
    if not (powers[0][0] > 0.0 and powers[1][0] > 0.0):
        return 1.0
    related = (powers[0] / powers[0][0]) * (powers[1] / powers[1][0])  # (lags,)
    independent = n / max(1.0, 1.0 + 2.0 * float(related[1:].sum()))
    correlation = float(y @ modelled) / np.sqrt(float(y @ y) * float(modelled @ modelled))
    if independent <= 2.0 or correlation <= 0.0:
        return 1.0
    freedom = independent - 2.0
    return float(stdtr(freedom, -correlation * np.sqrt(freedom / max(1.0 - correlation**2, _LEAST))))


def ratio_std(power: Array, whole: Array, sample_rate_hz: float) -> float:
    """Return the standard deviation of the ratio of two mean powers, from (n,) each, by the delta method."""
    mean = float(np.mean(whole))
    if not mean > 0.0 or power.size < 2:
        return float("nan")
    ratio = float(np.mean(power)) / mean
    terms = (power - ratio * whole) / mean  # zero mean; its sum over n is the error of the ratio
    block = max(dependence_samples(power, sample_rate_hz), dependence_samples(whole, sample_rate_hz))
    return float(np.sqrt(long_run_covariance(terms[:, None], block)[0, 0])) / power.size
