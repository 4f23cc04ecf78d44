"""Grid of lags of a kernel, whiteness of the input, and smoothing of second-order kernels (Chen 2010, 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg, signal

from tissueid.identification.base import Array
from tissueid.identification.preparation import finite_runs, memory_in_samples

POWER_EDGE = 0.99
"""Share of the input power that must lie below the Nyquist frequency of an automatic grid."""

MOST_LAGS = 41
"""Maximum number of lags of an automatic grid: 903 coefficients up to second order."""

_SEGMENT = 1024
_HALF_WIDTH = 0.5 / np.sqrt(2.0 * np.log(2.0))
"""Standard deviation of a Gaussian of full width one at half its height."""


@dataclass(frozen=True)
class LagGrid:
    """``lags`` lags, ``spacing`` samples apart, the first at zero."""

    lags: int
    spacing: int

    @property
    def memory_samples(self) -> int:
        """Number of samples from the first to the last lag, both included."""
        return (self.lags - 1) * self.spacing + 1


def lag_grid(memory: float, sample_rate_hz: float, spacing: int) -> LagGrid:
    """Return the lags with this spacing over a memory in seconds."""
    return LagGrid(max(1, round(memory_in_samples(memory, sample_rate_hz) / spacing)), spacing)


def automatic_grid(memory: float, x: Array, sample_rate_hz: float) -> LagGrid:
    """Return the grid with the largest spacing that the bandwidth of the input ``x`` (n,), with zero mean, allows.

    The Nyquist frequency of the grid is above ``POWER_EDGE`` of the input power. A finer grid would have coefficients
    that the input does not excite. The spacing is increased further if the grid would exceed ``MOST_LAGS``.
    """
    frequency, power = input_spectrum(x, sample_rate_hz)
    share = np.cumsum(power)
    edge = float(frequency[np.searchsorted(share, POWER_EDGE * share[-1])]) if share[-1] > 0.0 else sample_rate_hz / 2
    spacing = max(1, int(0.5 * sample_rate_hz / max(edge, 1e-6 * sample_rate_hz)))
    spacing = min(spacing, memory_in_samples(memory, sample_rate_hz))
    while lag_grid(memory, sample_rate_hz, spacing).lags > MOST_LAGS:
        spacing += 1
    return lag_grid(memory, sample_rate_hz, spacing)


def input_spectrum(x: Array, sample_rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies and power spectrum, (bins,) each, of an input x (n,), averaged over its uninterrupted runs."""
    runs = finite_runs(np.isfinite(x))
    longest = int(np.max(np.diff(runs, axis=1)))
    length = min(_SEGMENT, longest)
    weights, total = 0, np.zeros(length // 2 + 1)
    frequency = fft.rfftfreq(length, 1.0 / sample_rate_hz)
    for first, end in runs:
        if end - first >= length:
            _, power = signal.welch(x[first:end], sample_rate_hz, nperseg=length, detrend=False)
            total += (end - first) * power
            weights += end - first
    return frequency, total / weights


def whiteness(products: Array) -> float:
    """Return the whiteness of an input, from 0 to 1 for white noise, from its mean lagged products (L, L).

    Whiteness is the variance of a linear kernel under a white input of the same power, divided by its variance under
    this input. The variance of a second-order kernel grows with about its inverse square.
    """
    lags = products.shape[0]
    values = linalg.eigvalsh(products)
    if values[0] <= 0.0:
        return 0.0
    return float(lags**2 / (values.sum() * np.sum(1.0 / values)))


def smoothed(kernel2: Array, spread: float) -> Array:
    """Return a second-order kernel (L, L) after a 2-D Gaussian low-pass that preserves its sum (Chen 2010, 4.3.2).

    ``spread`` is the full width at half maximum of the filter's Gaussian gain in both directions, in samples of the
    kernel's L-point Fourier transform. The thesis specifies "a spread of 15 samples in all directions" without naming
    the quantity. A standard deviation of 15 of 41 samples would pass 41 % of the amplitude at the Nyquist frequency and
    leave the kernels of low-passed tests rough; a full width of 15 reproduces the figures of the thesis. The kernel is
    mirrored at its borders; a plain Fourier transform would mix lag 0 with the last lag.
    """
    lags = kernel2.shape[0]
    frequency = 0.5 * np.arange(lags)  # of a cosine transform, in samples of the Fourier transform
    gain = np.exp(-0.5 * (frequency / (_HALF_WIDTH * spread)) ** 2)
    spectrum = fft.dctn(kernel2, norm="ortho") * np.outer(gain, gain)
    return np.asarray(fft.idctn(spectrum, norm="ortho"), dtype=np.float64)
