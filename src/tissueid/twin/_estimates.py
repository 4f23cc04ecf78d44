"""Estimates from recorded signals that provide starting values of effects. Private."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import optimize

FloatArray = NDArray[np.float64]

SETTLING_S = 0.3
"""Excluded time at the start of a test, s: the probe moves to its equilibrium."""
_WINDOWS = (0, 1, 2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512)
"""Edges of windows in the past, samples; the means in the windows represent the memory of coil and mechanics."""


def unexplained(signals: Mapping[str, FloatArray], name: str, sample_rate_hz: float) -> FloatArray:
    """Return the residual of a recorded signal, shape (n,); 0 where samples are missing and during settling.

    The prediction of the baseline is subtracted if the signals include it. Otherwise a regression is subtracted: on the
    past of the command (for the voltage) or of the voltage (for the others), and on its square and cube.
    """
    recorded = np.asarray(signals[name], np.float64)
    valid = np.isfinite(recorded)
    valid[: min(round(SETTLING_S * sample_rate_hz), recorded.size // 2)] = False
    residual = np.zeros(recorded.size)
    if valid.sum() < 100:
        return residual
    predicted = signals.get(f"predicted_{name}")
    if predicted is not None and np.isfinite(predicted[valid]).all():
        residual[valid] = recorded[valid] - predicted[valid]
    else:
        cause = np.asarray(signals["command" if name == "voltage" else "voltage"], np.float64)
        features = _features(np.where(np.isfinite(cause), cause, 0.0))
        used, mean = features[valid], float(recorded[valid].mean())
        # A small ridge, for commands that do not change.
        squares = used.T @ used + 1e-8 * used.shape[0] * np.eye(used.shape[1])
        residual[valid] = recorded[valid] - mean - used @ np.linalg.solve(squares, used.T @ (recorded[valid] - mean))
    residual[valid] -= residual[valid].mean()
    return residual


def _features(cause: FloatArray) -> FloatArray:
    """Return means of a signal over windows of its past, with their squares and cubes, shape (n, features), scaled."""
    scaled = (cause - cause.mean()) / max(float(cause.std()), 1e-6)
    past = np.concatenate((np.full(_WINDOWS[-1], scaled[0]), scaled))
    sums = np.concatenate(([0.0], np.cumsum(past)))
    ends = np.arange(cause.size) + _WINDOWS[-1] + 1
    means = [(sums[ends - a] - sums[ends - b]) / (b - a) for a, b in pairwise(_WINDOWS)]
    return np.stack([np.ones(cause.size), *means, *(m * m for m in means), *(m * m * m for m in means)], axis=1)


def waves(angle: FloatArray, harmonics: Iterable[int]) -> FloatArray:
    """Return cosine and sine of each harmonic of an angle, shape (n,), as columns: shape (n, 2 harmonics)."""
    return np.stack([wave(h * angle) for h in harmonics for wave in (np.cos, np.sin)], axis=1)


def fitted(residual: FloatArray, columns: FloatArray, orders: FloatArray) -> tuple[float, FloatArray]:
    """Return the sum of squares that waves, shape (n, waves), and a constant explain, and the amplitudes of the waves.

    A small ridge bounds the amplitudes of slow waves that the record is too short to separate. It grows with the
    harmonic (``orders``), so that a wave without harmonics is not fitted at a fraction of its frequency.
    """
    product, weights = _solved(residual, columns, orders)
    return float(product @ weights), weights[:-1]


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _solved(residual: FloatArray, columns: FloatArray, orders: FloatArray) -> tuple[FloatArray, FloatArray]:
    # Products of waves and constant with the signal, and their amplitudes.
    waves = orders.size
    product = np.empty(waves + 1)
    squares = np.empty((waves + 1, waves + 1))
    product[:waves] = columns.T @ residual
    product[waves] = residual.sum()
    squares[:waves, :waves] = columns.T @ columns
    for k in range(waves):
        squares[k, waves] = squares[waves, k] = columns[:, k].sum()
        squares[k, k] += 1e-3 * residual.size * orders[k] ** 2
    squares[waves, waves] = residual.size
    return product, np.linalg.solve(squares, product).astype(np.float64)


def line(
    residual: FloatArray, time: FloatArray, harmonics: Sequence[int], low_hz: float, high_hz: float
) -> tuple[float, FloatArray]:
    """Return the fundamental frequency that explains most, Hz, and the amplitudes of its harmonics
    (cosine, sine, ...).
    """
    if time.size < 2 or not residual.any():
        return 0.5 * (low_hz + high_hz), np.zeros(2 * len(harmonics))
    orders = np.repeat(np.asarray(harmonics, np.float64), 2)

    def at(frequency: float) -> tuple[float, FloatArray]:
        return fitted(residual, waves(2.0 * np.pi * frequency * time, harmonics), orders)

    spacing = 0.2 / max(float(np.ptp(time)) * harmonics[-1], 1e-3)
    grid = np.linspace(low_hz, high_hz, max(round((high_hz - low_hz) / spacing), 8))
    best = float(grid[np.argmax([at(frequency)[0] for frequency in grid])])
    around = (max(best - 1.5 * spacing, low_hz), min(best + 1.5 * spacing, high_hz))
    optimum = optimize.minimize_scalar(lambda frequency: -at(float(frequency))[0], bounds=around, method="bounded")
    return float(optimum.x), at(float(optimum.x))[1]
