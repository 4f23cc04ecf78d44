"""Compiled loop of recursive least squares (Chen 2010, Eqs. 6.1-6.5).

The covariance V of Eq. 6.4 is symmetric; its upper triangle is stored row by row in one array that fits the
second-level cache. The rank-one update of Eq. 6.4 is stored and applied while the triangle is multiplied by the next
regressor, so that a sample costs one read and one write of the triangle, and V stays symmetric.

With a forgetting factor below 1, Eq. 6.4 divides V by it at every sample, and V grows without bound in directions that
the input does not excite. Here the initial ridge is not forgotten: at each sample, one coefficient in turn regains what
forgetting took from its ridge in a whole round, by one more rank-one update without a product.
"""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of the work array.
COEFFICIENTS, REGRESSOR, PENDING, RIDGE_PENDING, PRODUCT = range(5)
WORK_ROWS = 5

# Scalars.
FORGETTING, RIDGE = 0, 1  # ridge of one coefficient: one over its initial variance
SCALE, WEIGHT, RIDGE_WEIGHT = 2, 3, 4  # V = scale triangle - weight pending pending' - ridge_weight ridge ridge'
RECEIVED, UPDATES = 5, 6  # inputs since the last gap; total updates
SCALARS = 7


def start(taps: int, variance: float, constant: float, forgetting: float) -> tuple[Array, Array, Array]:
    """Return the triangle, work array and scalars of a new identifier.

    Args:
        taps: lags of the response.
        variance: initial variance of every coefficient, for output noise of unit variance.
        constant: the regressor of the offset, after those of the lags.
        forgetting: factor of Eq. 6.3, at most 1.
    """
    count = taps + 1
    triangle = np.zeros(count * (count + 1) // 2)
    triangle[_diagonal(count)] = variance
    work = np.zeros((WORK_ROWS, count))
    work[REGRESSOR, taps] = constant
    scalars = np.zeros(SCALARS)
    scalars[[FORGETTING, RIDGE, SCALE]] = forgetting, 1.0 / variance, 1.0
    return triangle, work, scalars


def covariance(triangle: Array, work: Array, scalars: Array) -> Array:
    """Return V (taps + 1, taps + 1), including the stored update; the state is not changed."""
    count = work.shape[1]
    full = np.zeros((count, count))
    full[np.triu_indices(count)] = scalars[SCALE] * triangle
    full += np.triu(full, 1).T
    for row, weight in ((PENDING, WEIGHT), (RIDGE_PENDING, RIDGE_WEIGHT)):
        full -= scalars[weight] * np.outer(work[row], work[row])
    return full


def _diagonal(count: int) -> NDArray[np.intp]:
    rows = np.arange(count)
    return rows * count - rows * (rows - 1) // 2


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def advance(triangle: Array, work: Array, scalars: Array, u: Array, y: Array, errors: Array) -> None:
    """Add samples u (n,) and y (n,), minus their operating point, and store the prediction errors (n,) before each
    update.

    An error is NaN, and no update is made, if the output or any input in the memory is NaN.
    """
    taps = work.shape[1] - 1
    x = work[REGRESSOR]
    coefficients = work[COEFFICIENTS]
    for n in range(u.size):
        for k in range(taps - 1, 0, -1):
            x[k] = x[k - 1]
        x[0] = u[n]
        scalars[RECEIVED] = scalars[RECEIVED] + 1.0 if isfinite(u[n]) else 0.0
        errors[n] = nan
        if scalars[RECEIVED] < taps or not isfinite(y[n]):
            continue
        known = 0.0
        for k in range(taps + 1):
            known += coefficients[k] * x[k]
        errors[n] = y[n] - known  # Eq. 6.2
        _multiply(triangle, work, scalars)
        _learn(triangle, work, scalars, errors[n])
        scalars[UPDATES] += 1.0


@njit(cache=True, fastmath={"reassoc", "contract"})
def _multiply(triangle: Array, work: Array, scalars: Array) -> None:
    """Apply the stored update, and compute the product of V with the regressor, in one pass.

    Two rows are processed at a time, so that common factors are read once.
    """
    count = work.shape[1]
    scale, weight, ridge_weight = scalars[SCALE], scalars[WEIGHT], scalars[RIDGE_WEIGHT]
    for k in range(count):
        work[PRODUCT, k] = 0.0
    first = 0
    for i in range(0, count - 1, 2):
        rest = count - i - 2
        upper, lower = triangle[first : first + rest + 2], triangle[first + rest + 2 : first + 2 * rest + 3]
        x, pending, ridge, product = work[REGRESSOR, i:], work[PENDING, i:], work[RIDGE_PENDING, i:], work[PRODUCT, i:]
        a, a_ridge, a_x = weight * pending[0], ridge_weight * ridge[0], x[0]
        b, b_ridge, b_x = weight * pending[1], ridge_weight * ridge[1], x[1]
        upper[0] = scale * upper[0] - a * pending[0] - a_ridge * ridge[0]
        upper[1] = scale * upper[1] - a * pending[1] - a_ridge * ridge[1]
        lower[0] = scale * lower[0] - b * pending[1] - b_ridge * ridge[1]
        a_total = upper[0] * a_x + upper[1] * b_x
        b_total = upper[1] * a_x + lower[0] * b_x
        above, below = upper[2:], lower[1:]
        x, pending, ridge, product = x[2:], pending[2:], ridge[2:], product[2:]
        for k in range(rest):
            from_a = scale * above[k] - a * pending[k] - a_ridge * ridge[k]
            from_b = scale * below[k] - b * pending[k] - b_ridge * ridge[k]
            above[k], below[k] = from_a, from_b
            a_total += from_a * x[k]
            b_total += from_b * x[k]
            product[k] += from_a * a_x + from_b * b_x
        work[PRODUCT, i] += a_total
        work[PRODUCT, i + 1] += b_total
        first += 2 * rest + 3
    if count % 2 == 1:
        last = count - 1
        triangle[first] = (
            scale * triangle[first] - weight * work[PENDING, last] ** 2 - ridge_weight * work[RIDGE_PENDING, last] ** 2
        )
        work[PRODUCT, last] += triangle[first] * work[REGRESSOR, last]


# Reordering of sums is allowed, as above.
@njit(cache=True, fastmath={"reassoc", "contract"})
def _learn(triangle: Array, work: Array, scalars: Array, error: float) -> None:
    """Correct the coefficients by the error, and store the update of V."""
    count = work.shape[1]
    coefficients, x, pending, ridge, product = work[0], work[1], work[2], work[3], work[4]
    forgetting = scalars[FORGETTING]
    spread = forgetting
    for k in range(count):
        spread += x[k] * product[k]
    gain = error / spread  # Eqs. 6.3 and 6.5
    for k in range(count):
        coefficients[k] += product[k] * gain
        pending[k] = product[k]
    scalars[SCALE] = 1.0 / forgetting
    scalars[WEIGHT] = 1.0 / (forgetting * spread)  # Eq. 6.4
    if forgetting == 1.0:
        return
    turn = int(scalars[UPDATES]) % count
    place = turn  # index in the triangle: down column ``turn`` to the diagonal, then along its row
    for k in range(count):
        ridge[k] = triangle[place] / forgetting - scalars[WEIGHT] * pending[k] * pending[turn]
        place += count - 1 - k if k < turn else 1
    returned = scalars[RIDGE] * count * (1.0 - forgetting)
    scalars[RIDGE_WEIGHT] = 1.0 / (1.0 / returned + ridge[turn])
    away = coefficients[turn] * scalars[RIDGE_WEIGHT]
    for k in range(count):
        coefficients[k] -= ridge[k] * away
