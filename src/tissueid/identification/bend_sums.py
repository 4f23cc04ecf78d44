"""The compiled sums behind the fit of an exponential static nonlinearity: one pass over the samples for all of them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STRAIGHT = 1e-4
"""C2 times the reach of t below which the derivative by C2 is taken from its series."""


# Sums may be taken in any order, which is what lets them be taken four or eight at a time.
@njit(cache=True, fastmath={"reassoc", "contract"})
def bend_sums(
    t: Array, y: Array, fallen: Array, c2: float, reach: float
) -> tuple[float, float, float, float, float, float, float]:
    """Sums over the samples of the bend b = (1 - exp(-C2 t)) / C2 and of its derivative d by C2.

    Args:
        t: shape (n,), within ``reach`` of zero.
        y: shape (n,).
        fallen: exp(-C2 t) - 1, shape (n,).
        c2: C2; zero for a straight line.
        reach: largest absolute value of t.

    Returns:
        The sums of b, b b, b y, d, d d, d b and d y.
    """
    b_sum = b_b = b_y = d_sum = d_d = d_b = d_y = 0.0
    if abs(c2) * reach < _STRAIGHT:
        for n in range(t.size):
            b = t[n] * (1.0 - c2 * t[n] * (0.5 - c2 * t[n] / 6.0))
            d = t[n] * t[n] * (c2 * t[n] / 3.0 - 0.5)
            b_sum += b
            b_b += b * b
            b_y += b * y[n]
            d_sum += d
            d_d += d * d
            d_b += d * b
            d_y += d * y[n]
    else:
        per_c2 = 1.0 / c2
        for n in range(t.size):
            b = -fallen[n] * per_c2
            d = (t[n] * (1.0 + fallen[n]) - b) * per_c2
            b_sum += b
            b_b += b * b
            b_y += b * y[n]
            d_sum += d
            d_d += d * d
            d_b += d * b
            d_y += d * y[n]
    return b_sum, b_b, b_y, d_sum, d_d, d_b, d_y
