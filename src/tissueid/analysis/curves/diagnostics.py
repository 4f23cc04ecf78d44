"""Numbers for figures: spectra of signals, correlations of residuals, thinning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import CONFIDENCE

Array = NDArray[np.float64]

STRETCH_S = 0.5
_WINDOW_S = 0.5
_LEAST_WINDOW = 64
"""Samples of a window where ``_WINDOW_S`` has fewer, as in records of slow machines."""
_SEGMENTS = 4
_SHORTEST_WINDOW = 16
_MOST_WINDOWS, _PIECES = 256, 32
"""Length, in windows, from which as much of a record is averaged, in pieces that are evenly spread."""


@dataclass(frozen=True)
class Prediction:
    """Held-out part of an analysis: measured, and simulated from the input alone.

    Arrays have shape (n,), SI; ``time_s`` counts from the start of the test. NaN where a sample was not received
    or the model cannot know. ``label`` names the engine.
    """

    label: str
    time_s: Array
    input: Array
    measured: Array
    predicted: Array
    sample_rate_hz: float
    output_name: str
    output_unit: str
    memory_samples: int

    @property
    def residual(self) -> Array:
        """Return measured minus predicted, shape (n,)."""
        return self.measured - self.predicted


def held_out_prediction(label: str, analysis: Analysis, start_s: float = 0.0) -> Prediction:
    """Return the held-out part of a free run of the model over its validation record.

    Args:
        label: name of the engine, for the legend.
        analysis: the fitted model and its data.
        start_s: when the record starts within its test, which is the length of the preload.
    """
    record, part = analysis.held_out_record, analysis.held_out
    return Prediction(
        label=label,
        time_s=start_s + record.time[part],
        input=record.input[part],
        measured=record.output[part],
        predicted=analysis.model.simulate(record.input)[part],
        sample_rate_hz=record.sample_rate_hz,
        output_name=record.output_name,
        output_unit=record.output_unit,
        memory_samples=analysis.model.memory_samples,
    )


def readable_stretch(prediction: Prediction, seconds: float = STRETCH_S) -> slice:
    """Return the first stretch of ``seconds`` with the largest number of comparable samples."""
    known = np.isfinite(prediction.residual)
    length = min(known.size, max(2, round(seconds * prediction.sample_rate_hz)))
    count = np.convolve(known, np.ones(length), "valid")
    start = int(np.argmax(count))
    return slice(start, start + length)


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and one-past-last index of every run of True in a mask of shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def power_spectrum(values: Array, sample_rate_hz: float) -> tuple[Array, Array] | None:
    """Return frequencies, Hz, and one-sided power density of a signal (n,), by Welch's method with a Hann window.

    Segments of half a second that overlap by half are averaged, without those that hold a gap, over pieces of a very
    long record. The mean is removed. The window shrinks for a short record. None when nothing is left to average.
    """
    length = min(max(round(_WINDOW_S * sample_rate_hz), _LEAST_WINDOW), values.size // _SEGMENTS)
    if length < _SHORTEST_WINDOW:
        return None
    whole = values.size <= _MOST_WINDOWS * length
    piece = values.size if whole else _MOST_WINDOWS // _PIECES * length
    segments = [
        values[begin + start : begin + start + length]
        for begin in np.linspace(0, values.size - piece, 1 if whole else _PIECES).astype(np.intp)
        for first, end in runs(np.isfinite(values[begin : begin + piece]))
        for start in range(first, end - length + 1, length // 2)
    ]
    if not segments:
        return None
    stacked = np.array(segments)  # (segments, length)
    taper = signal.get_window("hann", length)
    power = np.mean(np.abs(fft.rfft((stacked - stacked.mean()) * taper, axis=1)) ** 2, axis=0)
    density = np.asarray(2.0 * power / (sample_rate_hz * (taper @ taper)), dtype=np.float64)
    return fft.rfftfreq(length, 1.0 / sample_rate_hz), density


def power_edge(frequency_hz: Array, density: Array, share: float = 0.99) -> float:
    """Return the frequency, Hz, below which a share of the power lies; arrays have shape (bins,).

    What counts is the power beyond the median density, which is the sensor's noise where the signal fills less than
    half of the band, and takes as much from every frequency where it fills more. The mean is left out.
    """
    total = np.cumsum(np.maximum(density[1:] - np.median(density), 0.0))
    if total.size == 0 or not total[-1] > 0.0:
        return float(frequency_hz[-1])
    return float(frequency_hz[1:][np.searchsorted(total, share * total[-1])])


def autocorrelation(values: Array, lags: int) -> tuple[Array, float]:
    """Return the normalised autocorrelation at lags 0 .. lags, (lags + 1,), and the half width of its 95 % band.

    The band is that of white noise, 1.96 / sqrt(N), N the number of received samples; NaN are left out of the sums,
    and each lag is divided by the number of pairs that it has.
    """
    correlation, pairs = _pair_means(values, values, lags)
    return correlation / correlation[0], CONFIDENCE / float(np.sqrt(max(pairs[0], 1.0)))


def cross_correlation(u: Array, e: Array, lags: int) -> tuple[Array, Array, float]:
    """Correlate input u (n,) with residual e (n,): return lags (2 lags + 1,), values, half width of the band.

    At a positive lag the input comes first. The band holds 95 % of the values for unrelated signals that each have
    a colour of their own: the variance is sum(rho_u rho_e) / N (Bartlett 1955, Box and Jenkins 1970).
    """
    later, pairs = _pair_means(u, e, lags)
    earlier, _ = _pair_means(e, u, lags)
    reach = max(lags, u.size // 4)
    own_u, _ = _pair_means(u, u, reach)
    own_e, _ = _pair_means(e, e, reach)
    scale = float(np.sqrt(own_u[0] * own_e[0]))
    products = own_u * own_e / scale**2
    variance = max(1e-3, float(products[0] + 2.0 * products[1:].sum())) / max(pairs[0], 1.0)
    values = np.concatenate([earlier[:0:-1], later]) / scale
    return np.arange(-lags, lags + 1, dtype=np.float64), values, CONFIDENCE * float(np.sqrt(variance))


def _pair_means(x: Array, y: Array, lags: int) -> tuple[Array, Array]:
    """Return mean of x[i] y[i + lag] over received pairs, and their number; both (lags + 1,)."""
    known_x, known_y = np.isfinite(x), np.isfinite(y)
    x = np.where(known_x, x - np.mean(x[known_x]), 0.0)
    y = np.where(known_y, y - np.mean(y[known_y]), 0.0)
    length = fft.next_fast_len(x.size + lags, real=True)

    def products(first: Array, second: Array) -> Array:
        spectrum = np.conj(fft.rfft(first, length)) * fft.rfft(second, length)
        return np.asarray(fft.irfft(spectrum, length)[: lags + 1], dtype=np.float64)

    pairs = np.round(products(known_x.astype(np.float64), known_y.astype(np.float64)))
    return products(x, y) / np.maximum(pairs, 1.0), pairs
