"""The compiled part of the interchange: what a swap of two samples does to every lag, and many swaps tried in a row.

Signals are less their mean, of unit energy, and lie between ``lags`` zeros on either side, so that no index needs a
check; sample i is element i + lags. ``x`` (2, n + 2 lags) has the signal and the signal backwards, so that the samples
before one and those after it are both slices that are read forwards: several are then taken at a time.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

TRIED, ACCEPTED = 0, 1


# Sums may be taken in any order, which is what lets them be taken four or eight at a time.
@njit(cache=True, fastmath={"reassoc", "contract"}, nogil=True)
def _change(x: Array, errors: Array, change: Array, one: int, other: int) -> float:
    """Fill the change (lags,) of the autocorrelation at lags 1, 2, ... and return that of the sum of squared errors.

    Every product of the swapped samples with a neighbour changes by the difference of the two; the product of the two
    with each other, at the lag between them, stays as it is.
    """
    lags, mirrored = errors.size, x.shape[1]
    i, j = one + lags, other + lags
    apart = x[0, j] - x[0, i]
    after_i, before_i = x[0, i + 1 : i + 1 + lags], x[1, mirrored - i : mirrored - i + lags]
    after_j, before_j = x[0, j + 1 : j + 1 + lags], x[1, mirrored - j : mirrored - j + lags]
    gain = 0.0
    for k in range(lags):
        step = apart * (after_i[k] + before_i[k] - after_j[k] - before_j[k])
        change[k] = step
        gain += step * (2.0 * errors[k] + step)
    between = abs(one - other) - 1
    if 0 <= between < lags:
        counted = change[between]
        step = counted - apart * apart
        change[between] = step
        gain += step * (2.0 * errors[between] + step) - counted * (2.0 * errors[between] + counted)
    return gain


@njit(cache=True, nogil=True)
def _accept(x: Array, errors: Array, change: Array, rank: Whole, one: int, other: int) -> None:
    lags = errors.size
    for k in range(lags):
        errors[k] += change[k]
    i, j = one + lags, other + lags
    x[0, i], x[0, j] = x[0, j], x[0, i]
    x[1, x.shape[1] - 1 - i], x[1, x.shape[1] - 1 - j] = x[0, i], x[0, j]
    rank[one], rank[other] = rank[other], rank[one]


@njit(cache=True, nogil=True)
def try_pairs(
    x: Array, errors: Array, change: Array, rank: Whole, pairs: Whole, counts: Whole, error: float, tolerance: float
) -> float:
    """Try to swap each of the pairs (m, 2) of samples, and keep the swaps that lower the error. Returns the error.

    Stops at the tolerance. ``x``, ``errors`` (lags,) of the autocorrelation, ``rank`` (n,) of each
    sample and ``counts`` are kept up to date; ``change`` (lags,) is room to work in.
    """
    for t in range(pairs.shape[0]):
        if error <= tolerance:
            break
        one, other = pairs[t, 0], pairs[t, 1]
        counts[TRIED] += 1
        gain = _change(x, errors, change, one, other)
        if gain < 0.0:
            _accept(x, errors, change, rank, one, other)
            counts[ACCEPTED] += 1
            error += gain
    return error


@njit(cache=True, nogil=True)
def try_chosen(
    x: Array,
    errors: Array,
    change: Array,
    rank: Whole,
    place: Whole,
    levels: Array,
    gradient: Array,
    curvature: float,
    nearby: Array,
    picks: Whole,
    spreads: Array,
    counts: Whole,
    error: float,
    tolerance: float,
) -> float:
    """As :func:`try_pairs`, for a partner of each of the picked samples (m,) that promises most. Returns the error.

    Partners are looked for among the ranks above and below, at distances that double from ``spreads`` (m,), 1 to 2,
    and among the neighbours in time, as many on either side as ``nearby`` has elements. What a swap promises follows
    from the ``gradient`` (n,) of half the error with respect to each sample, which grows old as swaps are made, and
    the mean of the second-order part: ``curvature`` for any two samples, ``nearby`` (r,) for those 1, 2, ... apart.
    Only the swap that promises most is worked out. ``place`` (n,) is where each of the ``levels`` (n,), ascending,
    stands. The first sample stays.
    """
    n = levels.size
    for t in range(picks.size):
        if error <= tolerance:
            break
        one = picks[t]
        r = rank[one]
        promised, other = 0.0, -1
        distance = spreads[t]
        while distance < n:
            for side in (-1, 1):
                s = r + side * int(distance)
                if s < 0 or s >= n or place[s] == 0:
                    continue
                apart = levels[s] - levels[r]
                promise = apart * (2.0 * (gradient[one] - gradient[place[s]]) + curvature * apart)
                if promise < promised:
                    promised, other = promise, place[s]
            distance *= 2.0
        for k in range(nearby.size):
            for neighbour in (one - 1 - k, one + 1 + k):
                if neighbour < 1 or neighbour >= n:
                    continue
                apart = levels[rank[neighbour]] - levels[r]
                promise = apart * (2.0 * (gradient[one] - gradient[neighbour]) + nearby[k] * apart)
                if promise < promised:
                    promised, other = promise, neighbour
        counts[TRIED] += 1
        if other < 0:
            continue
        gain = _change(x, errors, change, one, other)
        if gain < 0.0:
            _accept(x, errors, change, rank, one, other)
            place[rank[one]], place[rank[other]] = one, other
            counts[ACCEPTED] += 1
            error += gain
    return error
