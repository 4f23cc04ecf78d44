"""Alternating least squares of Narendra and Gallman in numpy, with Bai's over-parametrised start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hammerstein(u: Array, y: Array, lags: int, degree: int, passes: int) -> tuple[Array, Array]:
    """Return the kernel (lags,) with a sum of one, and f at 50 inputs relative to its value at the mean.

    Dense least squares on the lagged powers of the standardised input: over-parametrised and split by the singular
    value decomposition, then alternately for each stage.
    """
    mean, spread = float(u.mean()), float(u.std())
    x = (u - mean) / spread
    windows = [np.lib.stride_tricks.sliding_window_view(x**power, lags)[:, ::-1] for power in range(1, degree + 1)]
    target = y[lags - 1 :]
    ones = np.ones((target.size, 1))
    free = np.linalg.lstsq(np.hstack([*windows, ones]), target, rcond=1e-4)[0][:-1].reshape(degree, lags)
    powers = np.linalg.svd(free)[0][:, 0]
    kernel = np.zeros(lags)
    for _ in range(passes):
        driven = sum(weight * window for weight, window in zip(powers, windows, strict=True))
        kernel = np.linalg.lstsq(np.hstack([driven, ones]), target, rcond=1e-4)[0][:-1]
        powers = np.linalg.lstsq(np.column_stack([*(window @ kernel for window in windows), ones]), target, rcond=None)[
            0
        ][:-1]
    gain = kernel.sum()
    grid = (np.quantile(u, np.linspace(0.01, 0.99, 50)) - mean) / spread
    curve = gain * sum(weight * grid**power for power, weight in enumerate(powers, start=1))
    return kernel / gain, np.asarray(curve)
