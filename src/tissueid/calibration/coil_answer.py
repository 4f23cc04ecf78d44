"""How the current, as it is read, answers a step of the held voltage: two lags in a row, of coil and of filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from tissueid.calibration.spline_basis import Array

ANTI_ALIAS_HZ = 2000.0
"""Cut-off of the first-order filters in front of all converters (Chen 2010, 2.3)."""
ANTI_ALIAS_TOLERANCE = 0.05
"""Relative standard deviation of that cut-off: capacitors of 5 %."""
FILTER_S = 1.0 / (2.0 * np.pi * ANTI_ALIAS_HZ)
_LAG_S = (5e-6, 1e-3)
"""Shortest and longest L / R that is looked for."""


@dataclass(frozen=True)
class Lag:
    """L / R, s, with the deviation that noise alone gives it, and that with what is not known of the filters."""

    seconds: float
    noise_s: float
    std_s: float


def unfiltered(readings: Array, rate: float) -> Array:
    """The voltage that was held over each interval, shape (n,), from filtered readings at the ends of them.

    NaN where the reading or the one before it was not received.
    """
    left = float(np.exp(-1.0 / (rate * FILTER_S)))  # of a step, after one interval
    before = np.concatenate([[np.nan], readings[:-1]])
    return np.asarray((readings - left * before) / (1.0 - left))


def find_lag(answers: Sequence[Array], rate: float) -> Lag:
    """L / R by how fast the current follows a step: the increments of all tests against those of two lags in a row."""
    steps = np.array([answer / answer.sum() for answer in answers])  # (tests, lags)
    mean, lags = steps.mean(axis=0), steps.shape[1]

    def found(filter_s: float) -> float:
        def miss(lag: float) -> float:
            return float(np.sum((mean - _increments(lag, filter_s, lags, rate)) ** 2))

        return float(optimize.minimize_scalar(miss, bounds=_LAG_S, method="bounded", options={"xatol": 1e-9}).x)

    seconds, shift = found(FILTER_S), 1e-6
    slope = (_increments(seconds + shift, FILTER_S, lags, rate) - _increments(seconds, FILTER_S, lags, rate)) / shift
    scatter = steps.std(axis=0, ddof=1) / np.sqrt(len(steps)) if len(steps) > 1 else np.zeros(lags)
    noise = float(np.linalg.norm(scatter * slope) / (slope @ slope))
    by_filter = found(FILTER_S * (1.0 + ANTI_ALIAS_TOLERANCE)) - seconds
    return Lag(seconds, noise, float(np.hypot(noise, by_filter)))


def _increments(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """By how much the filtered current rises in each sample interval after a step, relative to all: shape (lags,)."""
    ends = step_answer(np.arange(lags + 1) / rate, lag_s, filter_s)
    increments = np.diff(ends)
    return np.asarray(increments / increments.sum())


def step_answer(time_s: Array, lag_s: float, filter_s: float) -> Array:
    """Answer of two lags in a row to a step of one at 0 s."""
    if abs(lag_s - filter_s) < 1e-3 * filter_s:
        lag_s = filter_s * 1.001
    return np.asarray(
        1.0 - (lag_s * np.exp(-time_s / lag_s) - filter_s * np.exp(-time_s / filter_s)) / (lag_s - filter_s)
    )


def held_equivalent(lag_s: float, filter_s: float, lags: int, rate: float) -> Array:
    """Weights, shape (lags + 2,), by which voltages one sample ahead to ``lags`` behind make an equivalent current.

    Held over each interval, it acts on whatever is smooth as the real current does, which answers to each step within
    the interval: it has the mean over the interval, and the first moment by way of the two neighbours.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    time = (np.arange(lags + 1)[:, None] + 0.5 + 0.5 * nodes) / rate  # (intervals, nodes)
    risen = step_answer(time, lag_s, filter_s)
    mean, moment = 0.5 * risen @ weights, 0.5 * risen @ (0.5 * nodes * weights)
    moment = np.concatenate([[0.0, 0.0], moment, [0.0]])  # from one interval before the step's neighbour on
    level = np.concatenate([[0.0], mean]) + 0.5 * (moment[:-2] - moment[2:])
    return np.diff(level, prepend=0.0)
