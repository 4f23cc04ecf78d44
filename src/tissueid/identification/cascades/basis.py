"""Linear blocks of a cascade as sums of a few smooth functions of the lag.

A force without power above 200 Hz says nothing of single lags at 2 kHz; a cascade with hundreds of free lags in each
linear blocks could not be distinguished. Here an impulse response is a cubic spline of the lag: its knots stand
as close as the input's band allows where the response begins, and less close where it decays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, interpolate, signal

from tissueid.identification.base import Array

_POWER = 0.999
"""Share of the input's power below its band edge."""

_DENSE = 0.1
"""Share of the memory over which the knots keep their closest spacing."""

_GROWTH = 8.0
"""Spacing of the knots at the end of the memory, relative to the closest spacing."""


def band_edge(x: Array, sample_rate_hz: float) -> float:
    """Return the frequency, Hz, below which 99.9 % of the power of x (n,) lies; missing samples of x are 0."""
    power = np.abs(fft.rfft((x - x.mean()) * signal.windows.hann(x.size))) ** 2  # the ends hold every frequency
    running = np.cumsum(power)
    bin_of_edge = int(np.searchsorted(running, _POWER * running[-1]))
    return bin_of_edge * sample_rate_hz / x.size


def lag_basis(lags: int, spacing: float) -> Array:
    """Return cubic B-splines over the lags, shape (lags, q), q <= lags; ``spacing`` of the first knots is in samples.

    With as many functions as lags there is no smoothness left to ask for, and the lags themselves are returned.
    """
    spacing = max(1.0, spacing)
    last = lags - 1.0
    knots = [0.0]
    while knots[-1] < last:
        lag = knots[-1]
        knots.append(lag + spacing * (1.0 + _GROWTH * max(0.0, lag / max(last, 1.0) - _DENSE)))
    inner = np.array(knots[1:-1])
    if inner.size and last - inner[-1] < 0.5 * spacing:
        inner = inner[:-1]
    if inner.size + 4 >= lags:
        return np.eye(lags)
    padded = np.concatenate([[0.0] * 4, inner, [last] * 4])
    return np.asarray(interpolate.BSpline.design_matrix(np.arange(lags), padded, 3).toarray(), dtype=np.float64)


class LagBank:
    """Convolutions of signals (n,) with every function of a basis (lags, q), at rest before the first sample."""

    def __init__(self, basis: Array, n: int) -> None:
        self.basis = basis
        self._n = n
        self._length = fft.next_fast_len(n + basis.shape[0] - 1, real=True)
        self._spectra: NDArray[np.complex128] = fft.rfft(basis.T, self._length)  # (q, bins)

    @property
    def size(self) -> int:
        """How many functions there are."""
        return int(self.basis.shape[1])

    def rows(self, driven: Array) -> Array:
        """Return each function convolved with a signal (n,), shape (q, n)."""
        spectrum = fft.rfft(driven, self._length)
        return np.asarray(fft.irfft(self._spectra * spectrum, self._length)[:, : self._n], dtype=np.float64)

    def apply(self, weights: Array, signals: Array) -> Array:
        """Convolve signals, shape (..., n), with the kernel that the weights (q,) make; the same shape."""
        kernel = fft.rfft(self.basis @ weights, self._length)
        return np.asarray(fft.irfft(fft.rfft(signals, self._length) * kernel, self._length)[..., : self._n])

    def nearest(self, kernel: Array) -> Array:
        """Return the weights (q,) of the kernel (lags,) that comes closest in the sense of least squares."""
        return np.asarray(np.linalg.lstsq(self.basis, kernel, rcond=None)[0], dtype=np.float64)
