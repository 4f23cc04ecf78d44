"""Variance accounted for and information criteria. Samples that were not received are NaN and are ignored."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def vaf_percent(measured: Array, modelled: Array) -> float:
    """Return the variance accounted for, % (Eq. 3.13), over the samples where both arrays (n,) are finite.

    Negative if the error varies more than the measurement. NaN with fewer than two samples, or if the measurement is
    constant.
    """
    used = np.isfinite(measured) & np.isfinite(modelled)
    if used.sum() < 2:
        return float("nan")
    variance = float(np.var(measured[used]))
    if variance == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.var(measured[used] - modelled[used])) / variance)


def aic(residuals: Array, n_parameters: float) -> float:
    """Return Akaike's information criterion of Gaussian residuals (n,) (Eqs. 3.14-3.15); NaN are ignored."""
    finite = residuals[np.isfinite(residuals)]
    if finite.size == 0:
        return float("nan")
    rss = float(finite @ finite)
    if rss == 0.0:
        return float("-inf")
    return 2.0 * n_parameters + finite.size * (math.log(2.0 * math.pi * rss / finite.size) + 1.0)


def aicc(residuals: Array, n_parameters: float) -> float:
    """Return AIC with the second-order correction for few samples (Eq. 3.16); NaN if n <= k + 1."""
    n = int(np.isfinite(residuals).sum())
    if n <= n_parameters + 1:
        return float("nan")
    return aic(residuals, n_parameters) + 2.0 * n_parameters * (n_parameters + 1) / (n - n_parameters - 1)
