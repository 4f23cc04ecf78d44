"""Long-run covariance of sums of autocorrelated terms, for standard errors with coloured residuals."""

from __future__ import annotations

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.correlation import Correlator

DEPENDENCE_TIME_S = 0.05
"""Lag, s, up to which a prewhitened coloured residual is treated as autocorrelated."""

_SIGNIFICANT = 4.0
"""Threshold of the autocorrelation, in standard deviations of white noise, above which a signal is coloured."""

_LARGEST_GAIN = 0.97
"""Bound on the singular values of the prewhitening filter, so that its inverse is stable (Andrews and Monahan 1992)."""


def dependence_samples(residual: Array, sample_rate_hz: float) -> int:
    """Return the number of samples over which a residual (n,) is autocorrelated: 1 for a white residual."""
    longest = max(1, min(round(DEPENDENCE_TIME_S * sample_rate_hz), residual.size // 8))
    correlation = Correlator(residual - residual.mean(), longest).auto()
    white = np.all(np.abs(correlation[1:]) <= _SIGNIFICANT / np.sqrt(residual.size) * correlation[0])
    return 1 if white else longest


def long_run_covariance(terms: Array, block: int) -> Array:
    """Return the covariance (p, p) of the column sums of autocorrelated rows (n, p).

    The rows are prewhitened by a first-order vector autoregression, summed over overlapping blocks of ``block`` rows,
    which is the Bartlett kernel (Newey and West 1987), and recoloured (Andrews and Monahan 1992). The result is
    positive semidefinite. It is widened for the uncertainty of the estimated covariance itself, so that 1.96 standard
    deviations contain 95 % (Kiefer and Vogelsang 2005, for the Bartlett kernel).
    """
    block = max(1, min(block, terms.shape[0] // 8))
    size = np.sqrt(np.mean(terms**2, axis=0))
    size[size == 0.0] = 1.0
    rows = terms / size
    before, after = rows[:-1], rows[1:]
    regression = np.linalg.lstsq(before, after, rcond=1e-10)[0].T  # after = regression @ before + innovation
    left, gains, right = np.linalg.svd(regression)
    regression = (left * np.minimum(gains, _LARGEST_GAIN)) @ right
    colouring = np.linalg.inv(np.eye(size.size) - regression) * size[:, None]
    innovations = _block_covariance(after - before @ regression.T, block)
    share = block / terms.shape[0]
    widening = 1.0 + (2.9694 * share + 0.416 * share**2 - 0.5324 * share**3) / 1.9600
    return np.asarray(widening**2 * colouring @ innovations @ colouring.T, dtype=np.float64)


def _block_covariance(rows: Array, block: int) -> Array:
    n, p = rows.shape
    padded = np.zeros((n + 2 * block - 1, p))
    padded[block : block + n] = rows
    running = np.cumsum(padded, axis=0)
    sums = running[block:] - running[:-block]
    return np.asarray(sums.T @ sums / block, dtype=np.float64)
