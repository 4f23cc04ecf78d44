"""Compiled loop of adaptive least squares (Chen 2010, Eqs. 6.6-6.8).

The step is the change factor of the thesis, or a share of the full correction: divided by the energy of the regressor,
it is independent of units and input power. Divergence is detected from the errors; the response is then reset to an
earlier one, and adaptation stops.
"""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of the work array.
RESPONSE, REGRESSOR, GOOD, OLDER = range(4)  # GOOD: last response with small errors; OLDER: the one a memory before
WORK_ROWS = 4

# Scalars.
STEP, FLOOR = 0, 1  # the step is divided by regressor energy plus floor, if the floor is not negative
RECEIVED, UPDATES = 2, 3  # inputs since the last gap; total updates
ERROR_POWER, OUTPUT_POWER = 4, 5  # running means over one memory
LARGEST_POWER = 6  # largest output power so far
DIVERGED = 7  # number of the update at which the response diverged, 0 before
CENTRED, INPUT_MEAN, INPUTS, OUTPUT_MEAN, OUTPUTS = (
    8,
    9,
    10,
    11,
    12,
)  # whether running means are subtracted; the means and their counts
SCALARS = 13

RUNAWAY = 100.0
"""Ratio of error power over a memory to the largest output power above which the response has diverged.

The errors of a zero response have the power of the output.
"""


def start(taps: int, step: float, floor: float, centred: bool) -> tuple[Array, Array]:
    """Return the work array and scalars of a new identifier.

    Args:
        taps: lags of the response.
        step: of the adaptation.
        floor: added to the energy that the step is divided by; negative for a step that is not normalised.
        centred: subtract running means; off for samples without their means.
    """
    scalars = np.zeros(SCALARS)
    scalars[[STEP, FLOOR, CENTRED]] = step, floor, float(centred)
    return np.zeros((WORK_ROWS, taps)), scalars


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def advance(
    work: Array,
    scalars: Array,
    sums: Array,
    counts: Array,
    edges: Array,
    u: Array,
    y: Array,
    errors: Array,
) -> None:
    """Add samples u (n,) and y (n,), minus their operating point, and store the prediction errors (n,) before each
    update.

    An error is NaN, and no update is made, if the output or any input in the memory is NaN. Each response is added to
    the row of ``sums`` (levels, taps) selected by the output among the ``edges`` (levels - 1,); ``counts`` (levels, 2)
    holds the number of those samples and the sum of their outputs.
    """
    taps = work.shape[1]
    response, x, good, older = work[RESPONSE], work[REGRESSOR], work[GOOD], work[OLDER]
    for n in range(u.size):
        for k in range(taps - 1, 0, -1):
            x[k] = x[k - 1]
        x[0] = u[n]
        scalars[RECEIVED] = scalars[RECEIVED] + 1.0 if isfinite(u[n]) else 0.0
        errors[n] = nan
        if scalars[CENTRED] > 0.0:
            if isfinite(u[n]):
                scalars[INPUTS] += 1.0
                scalars[INPUT_MEAN] += (u[n] - scalars[INPUT_MEAN]) / scalars[INPUTS]
            if isfinite(y[n]):
                scalars[OUTPUTS] += 1.0
                scalars[OUTPUT_MEAN] += (y[n] - scalars[OUTPUT_MEAN]) / scalars[OUTPUTS]
        if scalars[RECEIVED] < taps or not isfinite(y[n]):
            continue
        middle, output = scalars[INPUT_MEAN], y[n] - scalars[OUTPUT_MEAN]
        predicted = 0.0
        energy = 0.0
        for k in range(taps):
            predicted += response[k] * (x[k] - middle)
            energy += (x[k] - middle) ** 2
        error = output - predicted  # Eq. 6.7
        errors[n] = error
        scalars[UPDATES] += 1.0
        if scalars[DIVERGED] == 0.0:
            share = 1.0 / min(float(taps), scalars[UPDATES])
            scalars[ERROR_POWER] += share * (error * error - scalars[ERROR_POWER])
            scalars[OUTPUT_POWER] += share * (output * output - scalars[OUTPUT_POWER])
            scalars[LARGEST_POWER] = max(scalars[LARGEST_POWER], scalars[OUTPUT_POWER])
            if not scalars[ERROR_POWER] <= RUNAWAY * scalars[LARGEST_POWER]:
                scalars[DIVERGED] = scalars[UPDATES]
                for k in range(taps):
                    response[k] = older[k]  # ``good`` may have begun to diverge
            else:
                gain = scalars[STEP] * error
                if scalars[FLOOR] >= 0.0:
                    gain /= max(energy + scalars[FLOOR], 1e-300)
                for k in range(taps):
                    response[k] += gain * (x[k] - middle)  # Eq. 6.8
                if scalars[UPDATES] % taps == 0.0 and scalars[ERROR_POWER] <= scalars[LARGEST_POWER]:
                    for k in range(taps):
                        older[k] = good[k]
                        good[k] = response[k]
        level = 0
        while level < edges.size and y[n] > edges[level]:
            level += 1
        counts[level, 0] += 1.0
        counts[level, 1] += y[n]
        total = sums[level]
        for k in range(taps):
            total[k] += response[k]
