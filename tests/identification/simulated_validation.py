"""Systems with known faults, noises and distortions, by plain filters and loops, and a model that is exactly right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from identification.simulated import generator
from numpy.typing import NDArray
from scipy import signal

from tissueid.identification import Engine, FitReport, Model
from tissueid.records import Record

Array = NDArray[np.float64]

RATE = 1000.0
LAGS = 40
KERNEL = np.exp(-np.arange(LAGS) / 8.0) * np.cos(np.arange(LAGS) / 5.0)
"""Per sample."""

WARM = 500


@dataclass(frozen=True, eq=False)
class Fir(Model):
    """A kernel per sample about an operating point."""

    kernel: Array
    input_mean: float
    output_mean: float

    def simulate(self, u: Array) -> Array:
        padded = np.concatenate([np.zeros(self.kernel.size - 1), u - self.input_mean])
        return self.output_mean + np.convolve(padded, self.kernel, "valid")


class PlainFir(Engine):
    """Least squares on the explicit regressor matrix: an engine that costs nearly nothing."""

    name = "plain_fir"
    lags: int = LAGS

    def fit(self, record: Record, fit_part: slice | None = None) -> Fir:
        part = fit_part or slice(0, len(record))
        u_mean, y_mean = np.nanmean(record.input[part]), np.nanmean(record.output[part])
        rows = np.arange(max(part.start, self.lags - 1), part.stop or len(record))
        matrix = (record.input - u_mean)[rows[:, None] - np.arange(self.lags)]
        known = np.isfinite(matrix).all(axis=1) & np.isfinite(record.output[rows])
        matrix, y = matrix[known], record.output[rows[known]] - y_mean
        kernel = np.linalg.solve(
            matrix.T @ matrix + 1e-6 * np.trace(matrix.T @ matrix) / self.lags * np.eye(self.lags), matrix.T @ y
        )
        return fir(kernel, u_mean, y_mean, int(known.sum()))


def fir(kernel: Array, input_mean: float, output_mean: float, n_samples: int, n_parameters: int = LAGS + 1) -> Fir:
    report = FitReport("plain_fir", {}, n_samples, n_parameters, vaf_percent=0.0)
    return Fir(report, RATE, kernel.size, kernel, float(input_mean), float(output_mean))


def force(rng: np.random.Generator, n: int, low_pass: bool) -> Array:
    """Gaussian, unit variance, white or to a fifth of the Nyquist frequency, shape (n + WARM,)."""
    u = rng.standard_normal(n + WARM)
    if low_pass:
        u = signal.sosfilt(signal.butter(6, 100.0, fs=RATE, output="sos"), u)
    return u / np.std(u)


def coloured(rng: np.random.Generator, n: int, pole: float) -> Array:
    """First-order autoregressive noise of unit variance, shape (n,)."""
    e = signal.lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(n + WARM))
    return e[WARM:]


def record(
    *seed: int,
    n: int = 6000,
    low_pass: bool = False,
    pole: float = 0.0,
    noise: float = 0.2,
    even: float = 0.0,
    odd: float = 0.0,
    hammerstein: float = 0.0,
    speed: float = 0.0,
) -> Record:
    """A linear system with unit-variance output, and shares of what a linear model would lack.

    ``even`` and ``odd`` are of its squared and cubed output (Wiener), ``hammerstein`` of the answer to the squared
    input, ``speed`` of the answer to the modulus of the speed.
    """
    rng = generator(*seed)
    u = force(rng, n, low_pass)
    y = signal.lfilter(KERNEL, [1.0], u)
    y = y / np.std(y)
    wrong = even * (y**2 - 1.0) + odd * (y**3 - 3.0 * y)
    if hammerstein:
        wrong = wrong + hammerstein * signal.lfilter(KERNEL, [1.0], u**2 - 1.0)
    if speed:
        v = np.gradient(y)
        wrong = wrong + speed * signal.lfilter([0.1], [1.0, -0.9], np.abs(v) / np.std(v))
    e = coloured(rng, n, pole)
    return Record(u[WARM:] + 2.0, (y + wrong)[WARM:] + noise * e + 7.0, RATE)


PERIOD = 2000
TOP = 400


def grid(*seed: int) -> NDArray[np.int_]:
    """Odd lines up to TOP, one in each four left out at random."""
    rng = generator(*seed)
    odd = np.arange(1, TOP, 2)
    kept = np.ones(odd.size, dtype=bool)
    for first in range(0, odd.size - 3, 4):
        kept[first + rng.integers(4)] = False
    return odd[kept]


def multisine(
    lines: NDArray[np.int_],
    *seed: int,
    periods: int = 4,
    even: float,
    odd: float,
    noise: float = 0.0,
    bent: float = 0.0,
) -> Record:
    """An odd random-phase multisine of unit variance through low-pass, x + even x^2 + odd x^3, low-pass, and noise.

    Three periods go before, so that the answer has settled; the last 200 samples of them are in the record. ``bent``
    distorts the input itself.
    """
    rng = generator(*seed)
    spectrum = np.zeros(PERIOD // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    one = np.fft.irfft(spectrum, PERIOD)
    u = np.tile(one / np.std(one), periods + 3)
    u = u + bent * (u**2 + u**3)
    x = signal.lfilter(*signal.butter(1, 150.0, fs=RATE), u)
    y = signal.lfilter(*signal.butter(1, 200.0, fs=RATE), x + even * x**2 + odd * x**3)
    kept = slice(3 * PERIOD - 200, None)
    return Record(u[kept] + 3.0, y[kept] + noise * coloured(rng, u.size, 0.8)[kept] + 5.0, RATE)
