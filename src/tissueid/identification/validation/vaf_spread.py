"""How far a variance accounted for may be off: its standard deviation, neighbouring samples being related."""

from __future__ import annotations

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.dependence import dependence_samples, long_run_covariance


def vaf_std_percent(measured: Array, error: Array, sample_rate_hz: float) -> float:
    """Standard deviation of a VAF (Eq. 3.13), in percentage points, over other stretches of record like this one.

    ``measured`` and ``error`` have shape (n,) and hold no NaN.
    """
    return 100.0 * ratio_std((error - error.mean()) ** 2, (measured - measured.mean()) ** 2, sample_rate_hz)


def ratio_std(power: Array, whole: Array, sample_rate_hz: float) -> float:
    """Standard deviation of the ratio of the means of two powers (n,), by the delta method; NaN for no power."""
    mean = float(np.mean(whole))
    if not mean > 0.0 or power.size < 2:
        return float("nan")
    ratio = float(np.mean(power)) / mean
    terms = (power - ratio * whole) / mean  # its mean is nil, and its sum over n is the ratio's error
    block = max(dependence_samples(power, sample_rate_hz), dependence_samples(whole, sample_rate_hz))
    return float(np.sqrt(long_run_covariance(terms[:, None], block)[0, 0])) / power.size
