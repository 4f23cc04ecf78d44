"""Grid of lags of a kernel, whiteness of the input, and smoothing of second-order kernels (Chen 2010, 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg, ndimage, signal

from tissueid.identification.base import Array
from tissueid.identification.preparation import finite_runs, memory_in_samples
from tissueid.messages import Message

POWER_EDGE = 0.99
"""Share of the input power that must lie below the Nyquist frequency of an automatic grid."""

_SEGMENT = 1024
THESIS_SIGMA = 1.0
WINDOW_RADIUS = 7
"""Standard deviation, in lags, and half width of the filter of the second-order kernel in Chen 2010, C.3.1."""


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
    that the input does not excite; a coarser one would leave out input samples that change the output.
    """
    frequency, power = input_spectrum(x, sample_rate_hz)
    share = np.cumsum(power)
    edge = float(frequency[np.searchsorted(share, POWER_EDGE * share[-1])]) if share[-1] > 0.0 else sample_rate_hz / 2
    spacing = max(1, int(0.5 * sample_rate_hz / max(edge, 1e-6 * sample_rate_hz)))
    return lag_grid(memory, sample_rate_hz, min(spacing, memory_in_samples(memory, sample_rate_hz)))


def shortened(grid: LagGrid, most_lags: int, sample_rate_hz: float) -> tuple[LagGrid, tuple[str, ...]]:
    """Return a grid of at most ``most_lags`` lags, and a warning if it is shorter than the given one."""
    if grid.lags <= most_lags:
        return grid, ()
    warning = Message(
        "volterra.memory_shortened",
        "the memory was shortened from {wanted:.3g} to {used:.3g} s: with an input of this bandwidth, {lags} lags are "
        "the most that can be estimated; a later response is not part of the kernels",
        wanted=grid.lags * grid.spacing / sample_rate_hz,
        used=most_lags * grid.spacing / sample_rate_hz,
        lags=most_lags,
    )
    return LagGrid(most_lags, grid.spacing), (warning,)


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


def smoothed(kernel2: Array, sigma: float) -> Array:
    """Return a second-order kernel (L, L) after a two-dimensional Gaussian filter that preserves its sum.

    Chen 2010, 4.3.2 with the code of C.3.1: a window of 15 x 15 lags with a standard deviation ``sigma`` of 1 lag. For
    another ``sigma`` the window grows in proportion. The kernel is mirrored at its borders; zeros beyond them, as in
    C.3.1, would halve the values at lag 0.
    """
    radius = max(WINDOW_RADIUS, round(WINDOW_RADIUS * sigma))
    return np.asarray(ndimage.gaussian_filter(kernel2, sigma, mode="reflect", radius=radius), dtype=np.float64)
