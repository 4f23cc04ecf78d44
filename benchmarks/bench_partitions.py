"""Kernels of 15 depth partitions of 40 lags (600 parameters) from 4 s: against Eqs. 4.6-4.13 and against lstsq."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import linalg, signal

from benchmarks.base import Comparison
from tissueid.identification.least_squares import factor
from tissueid.identification.partitions.regression import Partitions, lagged_regressors, place_breakpoints
from tissueid.identification.volterra.regressors import LagGrid
from tissueid_lab.thesis import published_algorithms as published

PARTITIONS, LAGS = 15, 40
RATE = 500.0
SAMPLES = 2000


def record(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output (samples,): white force about 3 N through tissue-like dynamics and a static nonlinearity,
    with noise.
    """
    rng = np.random.Generator(np.random.PCG64(1))
    x = 3.0 + rng.standard_normal(samples)
    t = np.arange(LAGS) / RATE
    z = signal.lfilter(np.exp(-80.0 * t) * np.sin(150.0 * t), [1.0], x)
    y = 1.0 - np.exp(-0.5 * z)
    return x, y + 0.01 * np.std(y) * rng.standard_normal(samples)


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    return float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))


def comparisons() -> Iterable[Comparison]:
    for samples, floor in ((SAMPLES, 30.0), (4 * SAMPLES, None)):
        yield from _against_both(samples, floor)


def _against_both(samples: int, floor: float | None) -> Iterable[Comparison]:
    x, y = record(samples)
    breakpoints = place_breakpoints(y, PARTITIONS, "count")
    partitions = Partitions(breakpoints, directional=False, pole=0.0)
    open_ended = np.concatenate([[-np.inf], breakpoints[1:-1], [np.inf]])
    used = np.arange(samples) >= LAGS - 1
    tall = published.construct_partitions(x, y, open_ended, LAGS).T

    def product() -> np.ndarray:
        regressors = lagged_regressors(x, partitions.cells(y), PARTITIONS, used, LagGrid(LAGS, 1))
        return factor(regressors.gram(), regressors).solve(y[used])

    def in_numpy() -> np.ndarray:
        return published.depth_partitions(x, y, open_ended, LAGS)

    def reference() -> np.ndarray:
        return linalg.lstsq(tall, y[used], lapack_driver="gelsd")[0]

    setting = f"{PARTITIONS} partitions x {LAGS} lags, {int(used.sum())} rows"
    few = {"blocks": 2, "runs_in_block": 2}
    yield Comparison("depth partitions", setting, product, in_numpy, difference, 1e-8, floor, **few)
    yield Comparison("depth partitions against lstsq", setting, product, reference, difference, 1e-8, **few)
