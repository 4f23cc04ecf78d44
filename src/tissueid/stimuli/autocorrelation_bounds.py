"""Lower bounds of the autocorrelation error that samples of a given distribution can reach in any order.

Both conditions are necessary, not sufficient. They hold for the biased autocorrelation of each record of n samples,
not only on average, so that no rearrangement has an error below the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.messages import Message

Array = NDArray[np.float64]

_TRIANGLE_LAGS = 500
"""Largest lag of the pairs that are checked; their number grows with its square."""


@dataclass(frozen=True)
class Bound:
    """Lower bound of the error, a sum of squares over the lags, and the condition that it follows from."""

    error: float
    reason: str


def least_error(levels: Array, target: Array) -> Bound:
    """Return a lower bound of the error for levels (n,) and a target autocorrelation (lags + 1,); 0 where unknown."""
    return max(_opposed(levels, target), _two_valued(levels, target), key=lambda bound: bound.error)


def _opposed(levels: Array, target: Array) -> Bound:
    """No two copies are more opposed than the ascending and the descending order (the rearrangement inequality)."""
    about = np.sort(levels) - np.mean(levels)
    power = float(about @ about)
    least = float(about @ about[::-1]) / power
    lag = np.arange(1, target.size)
    missing = lag * float(np.max(np.abs(about))) ** 2 / power  # products that the end of the record leaves out
    short = np.maximum(least - missing - target[1:], 0.0)
    worst = int(np.argmax(short))
    return Bound(
        float(short @ short),
        Message(
            "autocorrelation.too_low",
            "at lag {lag} it is {value:.3g}, and samples of this distribution cannot be correlated below {least:.3g}",
            lag=worst + 1,
            value=float(target[worst + 1]),
            least=least,
        ),
    )


def _two_valued(levels: Array, target: Array) -> Bound:
    """Of three samples of +1 or -1 some two are equal: s r(j) + t r(k) + s t r(j + k) is at least -1, s, t = +-1.

    With s = t = -1 it is the triangle inequality for 1 - r, the share of the time in which two samples differ: the
    autocorrelation of a two-valued signal leaves lag 0 with an edge, never with a round top.
    """
    nothing = Bound(0.0, "")
    low, high = float(np.min(levels)), float(np.max(levels))
    lags = min(target.size - 1, _TRIANGLE_LAGS)
    if lags < 2 or not np.all((levels == low) | (levels == high)) or abs(float(np.mean(levels == low)) - 0.5) > 0.01:
        return nothing
    j, k = np.triu_indices(lags)
    j, k = j + 1, k + 1
    j, k = j[j + k <= lags], k[j + k <= lags]
    # a difference of counts by one of an odd number of samples moves the mean, and every product, by at most this
    slack = 4.0 * abs(float(np.mean(levels == low)) - 0.5)
    best = nothing
    for s, t in ((-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)):
        short = -1.0 - (s * target[j] + t * target[k] + s * t * target[j + k]) - slack
        size = np.where(j == k, (s + t) ** 2 + 1.0, 3.0)
        error = np.where(short > 0.0, short, 0.0) ** 2 / size
        worst = int(np.argmax(error))
        if error[worst] > best.error:
            a, b = int(j[worst]), int(k[worst])
            best = Bound(
                float(error[worst]),
                Message(
                    "autocorrelation.two_valued",
                    "at lags {lag}, {other} and {both} it is {value:.4g}, {other_value:.4g} and {both_value:.4g}, and "
                    "of "
                    "three samples with two values some two are equal",
                    lag=a,
                    other=b,
                    both=a + b,
                    value=float(target[a]),
                    other_value=float(target[b]),
                    both_value=float(target[a + b]),
                ),
            )
    return best
