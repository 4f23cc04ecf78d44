"""Polynomial systems whose Volterra kernels are known exactly, by plain convolution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from identification.simulated import Array, changed, generator, noise
from scipy import signal

RATE = 2000.0
LAGS = 24
WARM = 200


@dataclass(frozen=True)
class Known:
    """Input and output (n,), mask of samples with a whole memory (n,), and the kernels per lag."""

    x: Array
    y: Array
    used: np.ndarray
    kernel1: Array
    kernel2: Array
    kernel3: Array


def force(*seed: int, n: int, cutoff_hz: float | None = None) -> Array:
    """Gaussian, of standard deviation one, white or low-passed (Butterworth, order 8), (n,)."""
    x = generator(*seed).standard_normal(n + WARM)
    if cutoff_hz is not None:
        x = signal.sosfilt(signal.butter(8, cutoff_hz, fs=RATE, output="sos"), x)
    return x[WARM:] / np.std(x[WARM:])


def response(lags: int = LAGS, slowness: float = 1.0) -> Array:
    """A damped swing that is over within the lags, (lags,), its absolute values adding up to one."""
    k = np.arange(lags) / slowness
    h = np.exp(-k / 5.0) * np.sin(k / 3.0)
    return h / np.abs(h).sum()


def polynomial(
    *seed: int,
    n: int = 3000,
    lags: int = LAGS,
    spacing: int = 1,
    square: float = 1.8,
    cube: float = 0.0,
    before: bool = False,
    cutoff_hz: float | None = None,
    snr_db: float | None = 20.0,
    colour: float = 0.0,
    slowness: float = 1.0,
) -> Known:
    """z + square z^2 + cube z^3 with z the filtered force; with ``before`` that polynomial comes before the filter."""
    x = force(*seed, n=n, cutoff_hz=cutoff_hz)
    h = response(lags, slowness)
    taps = np.zeros((lags - 1) * spacing + 1)
    taps[::spacing] = h
    powers = np.array([1.0, square, cube])
    if before:
        y = np.convolve(x + square * x**2 + cube * x**3, taps)[:n]
        second, third = np.zeros((lags, lags)), np.zeros((lags, lags, lags))
        each = np.arange(lags)
        second[each, each], third[each, each, each] = square * h, cube * h
    else:
        z = np.convolve(x, taps)[:n]
        y = z[:, None] ** np.arange(1, 4) @ powers
        second, third = square * np.outer(h, h), cube * np.einsum("i,j,k->ijk", h, h, h)
    if snr_db is not None:
        y = y + noise(generator(*seed, 1), y, snr_db, colour)
    used = np.arange(n) >= taps.size - 1
    return Known(x, y + 5.0, used, h, second, third)


def with_gap(known: Known, first: int) -> Known:
    """The same with ten samples missing, and the memory after them not used."""
    gap = np.s_[first : first + 10], np.nan
    used = changed(known.used, (np.s_[first : first + 10 + known.kernel1.size - 1], False))
    return replace(known, x=changed(known.x, gap), y=changed(known.y, gap), used=used)


def covered(fit: Callable[[Known], tuple[Array, ...]], runs: int, *seed: int, **options: Any) -> Array:
    """Shares of the lags of both kernels whose 95 % interval holds them, over records of one kind, (2,).

    ``fit`` returns kernels and standard deviations: first, second, std of the first, std of the second.
    """
    upper = np.triu_indices(LAGS)
    inside = []
    for run in range(runs):
        known = polynomial(*seed, run, **options)
        first, second, first_std, second_std = fit(known)
        near = np.abs(second - known.kernel2) < 1.96 * second_std
        inside.append((np.mean(np.abs(first - known.kernel1) < 1.96 * first_std), near[upper].mean()))
    return np.mean(inside, axis=0)


def matern(at: Array, std: float, decay: float, rate: float) -> Array:
    """Covariance of a decaying smooth curve at some places (n,), (n, n)."""
    reach = rate * np.abs(at[:, None] - at)
    return std**2 * np.exp(-decay * (at[:, None] + at)) * (1.0 + reach) * np.exp(-reach)


def third_order_output(kernel: Array, x: Array, spacing: int) -> Array:
    """Sum over i, j, k of h(i, j, k) x(n - i) x(n - j) x(n - k), with nothing before the first sample, by loops."""
    lags = kernel.shape[0]
    y = np.zeros(x.size)
    for n in range(x.size):
        past = np.array([x[n - k * spacing] if n >= k * spacing else 0.0 for k in range(lags)])
        for i in range(lags):
            for j in range(lags):
                y[n] += past[i] * past[j] * float(kernel[i, j] @ past)
    return y
