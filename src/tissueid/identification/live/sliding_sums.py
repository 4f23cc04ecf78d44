"""Compiled updates of the sliding correlations (Chen 2010, Eqs. 3.2-3.5) by entering and leaving samples.

A lagged sum of products over a window gains the products of the entering sample with those before it, and loses those
of the leaving sample with those after it: two passes over the lags per sample for any window. Gains and losses are
summed separately, each in memory order, which allows vector instructions.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def slide(x: Array, y: Array, first: int, end: int, new: int, window: int, gained: Array, lost: Array) -> int:
    """Add the next ``new`` samples to sums over the samples from ``first`` to ``end``; return the new ``first``.

    Args:
        x: inputs, including the new ones.
        y: outputs, including the new ones.
        first: index of the oldest sample in the sums.
        end: index after the newest sample in the sums.
        new: number of samples to add.
        window: largest number of samples in the sums.
        gained: sums of x[n] x[n - k] and y[n] x[n - k] over all n that entered, (2, lags), the longest lag first.
        lost: the same over all n - k that left, lag 0 first.
    """
    lags = gained.shape[1]
    auto_in, cross_in, auto_out, cross_out = gained[0], gained[1], lost[0], lost[1]
    for n in range(end, end + new):
        if n - first == window:
            held = min(lags, n - first)
            x_later, y_later, x_old = x[first : first + held], y[first : first + held], x[first]
            for k in range(held):
                auto_out[k] += x_old * x_later[k]
                cross_out[k] += x_old * y_later[k]
            first += 1
        held = min(lags, n - first + 1)
        x_before, x_new, y_new = x[n + 1 - held : n + 1], x[n], y[n]
        auto_some, cross_some = auto_in[lags - held :], cross_in[lags - held :]
        for k in range(held):
            auto_some[k] += x_new * x_before[k]
            cross_some[k] += y_new * x_before[k]
    return first


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def fade_ends(x: Array, y: Array, fade: Array, faded: int, auto: Array, cross: Array) -> None:
    """Turn sums over a window into those of the tapered signals.

    Args:
        x: inputs of the window (n,), minus their mean.
        y: outputs of the window (n,), minus their mean.
        fade: taper (n,) of both.
        faded: number of samples at each end where the taper is not 1.
        auto: sums of x[n] x[n - k], shape (lags,), changed in place.
        cross: sums of y[n] x[n - k], shape (lags,), changed in place.
    """
    size = x.size
    x_faded, y_faded = x * fade, y * fade
    for k in range(auto.size):
        for low, high in ((0, min(faded, size - k)), (max(faded, size - faded - k), size - k)):
            count = max(0, high - low)
            x_there, xf_there = x[low : low + count], x_faded[low : low + count]
            x_later, xf_later = x[low + k : low + k + count], x_faded[low + k : low + k + count]
            y_later, yf_later = y[low + k : low + k + count], y_faded[low + k : low + k + count]
            auto_change = cross_change = 0.0
            for m in range(count):
                auto_change += xf_there[m] * xf_later[m] - x_there[m] * x_later[m]
                cross_change += xf_there[m] * yf_later[m] - x_there[m] * y_later[m]
            auto[k] += auto_change
            cross[k] += cross_change
