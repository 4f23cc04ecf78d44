"""The compiled part of adaptive least squares (Chen 2010, Eqs. 6.6-6.8): one sample, two passes over the memory.

The step is the thesis' change factor, or that share of a full correction: one over the energy of the regressor, which
makes it free of units and of the input's power. A response that runs away is noticed by its own errors, put back to
where it last did well, and left there.
"""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rows of the work array.
RESPONSE, REGRESSOR, GOOD, OLDER = range(4)  # a response that did well, and one a memory older
WORK_ROWS = 4

# Scalars.
STEP, FLOOR = 0, 1  # the step is divided by the regressor's energy and the floor; not at all when that is negative
RECEIVED, UPDATES = 2, 3  # inputs since the last gap; updates ever
ERROR_POWER, OUTPUT_POWER = 4, 5  # running means over the memory
LARGEST_POWER = 6  # of the output, so far
DIVERGED = 7  # the update at which the response ran away, 0 while it has not
CENTRED, INPUT_MEAN, INPUTS, OUTPUT_MEAN, OUTPUTS = 8, 9, 10, 11, 12  # whether means are taken as they come; so far
SCALARS = 13

RUNAWAY = 100.0
"""Power of the errors, over a memory, in that of the largest outputs, from which the response has run away.

No response at all errs by the power of the output.
"""


def start(taps: int, step: float, floor: float, centred: bool) -> tuple[Array, Array]:
    """Work array and scalars of a fresh identifier.

    Args:
        taps: lags of the response.
        step: of the adaptation.
        floor: added to the energy that the step is divided by; negative for a step that is not normalised.
        centred: take off the means of all that was received so far; off when the samples come without their means.
    """
    scalars = np.zeros(SCALARS)
    scalars[[STEP, FLOOR, CENTRED]] = step, floor, float(centred)
    return np.zeros((WORK_ROWS, taps)), scalars


# Sums may be taken in any order, which is what lets them be taken four or eight at a time.
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
    """Take samples u (n,) and y (n,), less their operating point, and fill the errors (n,) before each update.

    An error is NaN, and nothing is learnt, where the output is NaN or the memory holds an input that is. Each response
    is added to the row of ``sums`` (levels, taps) that the output's place among the ``edges`` (levels - 1,) names;
    ``counts`` (levels, 2) counts those samples and adds up their outputs.
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
        known = 0.0
        energy = 0.0
        for k in range(taps):
            known += response[k] * (x[k] - middle)
            energy += (x[k] - middle) ** 2
        error = output - known  # Eq. 6.7
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
                    response[k] = older[k]  # the other may have begun to run
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
