"""Compiled part of the interchange: effect of one swap on all lags, and loops that try many swaps.

Signals have zero mean and unit energy and are padded with ``lags`` zeros on either side, so that indices need no bounds
check; sample i is element i + lags. ``x`` (2, n + 2 lags) holds the signal and its time reversal, so that the samples
before and after a position are both contiguous forward slices, which vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

TRIED, ACCEPTED = 0, 1


# Reassociation of sums allows SIMD instructions.
@njit(cache=True, fastmath={"reassoc", "contract"}, nogil=True)
def _swap_gain(x: Array, errors: Array, change: Array, one: int, other: int) -> float:
    """Fill the change (lags,) of the autocorrelation at lags 1, 2, ... and return the change of the sum of squared
    errors.

    Each product of a swapped sample with a neighbour changes by the difference of the two samples. The product of the
    two samples with each other, at the lag between them, does not change.
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
def _apply_swap(x: Array, errors: Array, change: Array, rank: Integers, one: int, other: int) -> None:
    lags = errors.size
    for k in range(lags):
        errors[k] += change[k]
    i, j = one + lags, other + lags
    x[0, i], x[0, j] = x[0, j], x[0, i]
    x[1, x.shape[1] - 1 - i], x[1, x.shape[1] - 1 - j] = x[0, i], x[0, j]
    rank[one], rank[other] = rank[other], rank[one]


@njit(cache=True, nogil=True)
def try_random_pairs(
    x: Array,
    errors: Array,
    change: Array,
    rank: Integers,
    pairs: Integers,
    counts: Integers,
    error: float,
    tolerance: float,
) -> float:
    """Try to swap given pairs (m, 2) of samples and keep the swaps that lower the error. Return the error.

    Stops at the tolerance. Updates ``x``, the autocorrelation ``errors`` (lags,), the ``rank`` (n,) of each sample and
    ``counts`` in place; ``change`` (lags,) is a work array.
    """
    for t in range(pairs.shape[0]):
        if error <= tolerance:
            break
        one, other = pairs[t, 0], pairs[t, 1]
        counts[TRIED] += 1
        gain = _swap_gain(x, errors, change, one, other)
        if gain < 0.0:
            _apply_swap(x, errors, change, rank, one, other)
            counts[ACCEPTED] += 1
            error += gain
    return error


@njit(cache=True, nogil=True)
def try_guided_pairs(
    x: Array,
    errors: Array,
    change: Array,
    rank: Integers,
    place: Integers,
    levels: Array,
    gradient: Array,
    curvature: float,
    nearby: Array,
    picks: Integers,
    spreads: Array,
    counts: Integers,
    error: float,
    tolerance: float,
) -> float:
    """Try to swap each picked sample (m,) with the partner of the largest predicted improvement. Return the error.

    Candidate partners: samples whose rank differs by distances that double from ``spreads`` (m,), 1 to 2, in both
    directions, and the ``nearby.size`` neighbours in time on either side. The improvement is predicted from the
    ``gradient`` (n,) of half the error with respect to each sample, computed at the start of the sweep, and the mean
    second-order term: ``curvature`` for any two samples, ``nearby`` (r,) for samples 1, 2, ... apart. Only the best
    candidate is evaluated exactly. ``place`` (n,) is the sample index of each of the ascending ``levels`` (n,). The
    first sample is never moved. Updates the same arrays as :func:`try_random_pairs`.
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
        gain = _swap_gain(x, errors, change, one, other)
        if gain < 0.0:
            _apply_swap(x, errors, change, rank, one, other)
            place[rank[one]], place[rank[other]] = one, other
            counts[ACCEPTED] += 1
            error += gain
    return error
