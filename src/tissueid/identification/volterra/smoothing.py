"""Lags of a kernel, how white an input is at them, and the filter for kernels that came out rough (Chen 2010, 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft, linalg, signal

from tissueid.identification.base import Array
from tissueid.identification.preparation import memory_in_samples
from tissueid.identification.validation import finite_runs

POWER_EDGE = 0.99
"""Share of the input's power that has to lie under the Nyquist frequency of automatically spaced lags."""

MOST_LAGS = 41
"""Automatic spacing leaves no more lags than this: 903 coefficients to second order."""

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
        """How many samples, the present one included, lie between the first and the last lag."""
        return (self.lags - 1) * self.spacing + 1


def lag_grid(memory: float, sample_rate_hz: float, spacing: int) -> LagGrid:
    """Lags that far apart over a memory in seconds."""
    return LagGrid(max(1, round(memory_in_samples(memory, sample_rate_hz) / spacing)), spacing)


def automatic_grid(memory: float, x: Array, sample_rate_hz: float) -> LagGrid:
    """Lags as far apart as the input ``x`` (n,), its mean removed, allows.

    The spacing is the largest whose Nyquist frequency lies above nearly all of the input's power; a finer one asks for
    what the input cannot tell. Then it is widened as far as the number of lags has to be bounded.
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
    """Frequencies and power spectrum, (bins,) each, of an input x (n,), averaged over its uninterrupted runs."""
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
    """How white an input is at the lags of a kernel, one for a white one, from its mean lagged products (L, L).

    It is what the variance of a linear kernel would be under a white input of the same power, over what it is; that of
    a second-order kernel suffers from a coloured input about as its square.
    """
    lags = products.shape[0]
    values = linalg.eigvalsh(products)
    if values[0] <= 0.0:
        return 0.0
    return float(lags**2 / (values.sum() * np.sum(1.0 / values)))


def smoothed(kernel2: Array, spread: float) -> Array:
    """A second-order kernel (L, L) after a two-dimensional Gaussian low-pass that keeps its sum (Chen 2010, 4.3.2).

    ``spread`` is the full width, at half height, of the filter's Gaussian gain in both directions, in samples of the
    kernel's L-point Fourier transform. The thesis calls its filter "a spread of 15 samples in all directions" and does
    not say of what. A standard deviation of 15 of 41 samples would pass 41 % of the amplitude at the Nyquist frequency
    and leaves the kernels of low-passed tests as rough as they were; a full width of 15 does what its figures show.

    The kernel is mirrored at its borders, where the thesis' transform would join lag 0 to the last lag.
    """
    lags = kernel2.shape[0]
    frequency = 0.5 * np.arange(lags)  # of a cosine transform, in samples of the Fourier transform
    gain = np.exp(-0.5 * (frequency / (_HALF_WIDTH * spread)) ** 2)
    spectrum = fft.dctn(kernel2, norm="ortho") * np.outer(gain, gain)
    return np.asarray(fft.idctn(spectrum, norm="ortho"), dtype=np.float64)
