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
"""Largest lag in the pairs of lags that are checked; the number of pairs grows with its square."""


@dataclass(frozen=True)
class Bound:
    """Lower bound of the error, a sum of squares over the lags, and the condition that it follows from."""

    error: float
    reason: str


def error_bound(levels: Array, target: Array) -> Bound:
    """Return a lower bound of the error for levels (n,) and a target autocorrelation (lags + 1,); 0 where unknown."""
    return max(_rearrangement_bound(levels, target), _two_valued_bound(levels, target), key=lambda bound: bound.error)


def _rearrangement_bound(levels: Array, target: Array) -> Bound:
    """Return the bound from the rearrangement inequality: the product sum of two orders is least for
    opposite orders.
    """
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
            "at lag {lag} it is {value:.3g}, but the minimum for this distribution is {least:.3g}",
            lag=worst + 1,
            value=float(target[worst + 1]),
            least=least,
        ),
    )


def _two_valued_bound(levels: Array, target: Array) -> Bound:
    """Return the bound for two-valued samples: s r(j) + t r(k) + s t r(j + k) >= -1 with s, t = +-1.

    It holds because two of any three samples of +1 or -1 are equal. With s = t = -1 it is the triangle inequality for 1
    - r, the share of time in which two samples differ: the autocorrelation of a two-valued signal has a corner at lag
    0.
    """
    nothing = Bound(0.0, "")
    low, high = float(np.min(levels)), float(np.max(levels))
    lags = min(target.size - 1, _TRIANGLE_LAGS)
    if lags < 2 or not np.all((levels == low) | (levels == high)) or abs(float(np.mean(levels == low)) - 0.5) > 0.01:
        return nothing
    j, k = np.triu_indices(lags)
    j, k = j + 1, k + 1
    j, k = j[j + k <= lags], k[j + k <= lags]
    # With an odd number of samples one value occurs once more: this bounds the change of the mean and of each product.
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
                    "its values {value:.4g}, {other_value:.4g} and {both_value:.4g} at lags {lag}, {other} and "
                    "{both} are impossible for a two-valued signal",
                    lag=a,
                    other=b,
                    both=a + b,
                    value=float(target[a]),
                    other_value=float(target[b]),
                    both_value=float(target[a + b]),
                ),
            )
    return best
