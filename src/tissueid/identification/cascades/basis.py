"""Impulse responses of a cascade's linear blocks as sums of a few cubic B-splines of the lag.

At 2 kHz, an input without power above 200 Hz does not determine single lags, so hundreds of free lags per block could
not be estimated. The knots are as close as the band of the input allows at short lags, and wider apart where the
response decays.
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
    """Return the frequency, Hz, below which 99.9 % of the power of x (n,) lies; missing samples of x must be replaced
    by 0.
    """
    power = (
        np.abs(fft.rfft((x - x.mean()) * signal.windows.hann(x.size))) ** 2
    )  # step at the ends of the record would spread over all frequencies
    running = np.cumsum(power)
    bin_of_edge = int(np.searchsorted(running, _POWER * running[-1]))
    return bin_of_edge * sample_rate_hz / x.size


def lag_basis(lags: int, spacing: float) -> Array:
    """Return cubic B-splines over the lags, shape (lags, q), q <= lags; ``spacing`` of the first knots is in samples.

    If the splines would be as many as the lags, the identity is returned: one function per lag.
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
        """Number of basis functions q."""
        return int(self.basis.shape[1])

    def rows(self, driven: Array) -> Array:
        """Return each basis function convolved with a signal (n,), shape (q, n)."""
        spectrum = fft.rfft(driven, self._length)
        return np.asarray(fft.irfft(self._spectra * spectrum, self._length)[:, : self._n], dtype=np.float64)

    def apply(self, weights: Array, signals: Array) -> Array:
        """Return signals, shape (..., n), convolved with the kernel of the weights (q,); the same shape."""
        kernel = fft.rfft(self.basis @ weights, self._length)
        return np.asarray(fft.irfft(fft.rfft(signals, self._length) * kernel, self._length)[..., : self._n])

    def nearest(self, kernel: Array) -> Array:
        """Return the least-squares weights (q,) that approximate a kernel (lags,)."""
        return np.asarray(np.linalg.lstsq(self.basis, kernel, rcond=None)[0], dtype=np.float64)
