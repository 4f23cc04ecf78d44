"""Compiled loops of a partitioned model: each lag uses the kernel of the cell of the output at that time.

With the cells of the measured output there is no feedback. In a free run the cells are those of the simulated output,
found sample by sample. In both cases the output is a finite sum of bounded terms, and therefore stable.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tissueid.identification.base import Array
from tissueid.identification.partitions.cells import Cells

_TIE = 1e-9
"""Penalty that prefers the cell of the previous sample among equals, relative to the partitioned range."""


def scheduled_run(x: Array, cells: Cells, kernels: Array, offsets: Array, spacing: int, at_output: bool) -> Array:
    """Return the response to an input in given cells.

    Args:
        x: input without NaN, minus its reference, shape (memory - 1 + n,): the first samples only fill the memory.
        cells: cell of each of them, not negative.
        kernels: per sample, shape (cells, lags).
        offsets: shape (cells,).
        spacing: samples between lags.
        at_output: the cell of the output sample selects the kernel for all lags, instead of the cell at each lag.

    Returns:
        Output, shape (n,).
    """
    return np.asarray(_scheduled(x, cells, kernels, offsets, spacing, at_output), dtype=np.float64)


def free_run(
    x: Array,
    kernels: Array,
    offsets: Array,
    spacing: int,
    at_output: bool,
    inner: Array,
    directional: bool,
    pole: float,
    rest_cell: int,
    rest_output: float,
) -> tuple[Array, Cells]:
    """Return the response to an input in the cells of the response itself.

    At each sample every cell is tried. The cell whose output lies in its own range is used; if there is none or
    several, the one with the smallest distance, and among equals the previous cell or one adjacent to it.

    Args:
        x: input without NaN, minus its reference, shape (memory - 1 + n,): the first samples only fill the memory, all
            of them in ``rest_cell``.
        kernels: per sample, shape (cells, lags); with directions the cells of an increasing output come first.
        offsets: shape (cells,).
        spacing: samples between lags.
        at_output: as for :func:`scheduled_run`.
        inner: inner breakpoints, (depths - 1,).
        directional: whether cells differ by direction.
        pole: of the first-order low-pass between output and selection.
        rest_cell: cell before the first sample.
        rest_output: output before the first sample.

    Returns:
        Output and cells, both of shape (n,).
    """
    span = float(inner[-1] - inner[0]) if inner.size > 1 else abs(rest_output)
    output, cells = _free(
        x,
        kernels,
        offsets,
        spacing,
        at_output,
        inner,
        directional,
        pole,
        rest_cell,
        rest_output,
        _TIE * max(span, 1e-12),
    )
    return np.asarray(output, dtype=np.float64), np.asarray(cells, dtype=np.int64)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _scheduled(x, cells, kernels, offsets, spacing, at_output):  # type: ignore[no-untyped-def]
    lags = kernels.shape[1]
    warm = (lags - 1) * spacing
    output = np.empty(x.size - warm)
    for n in range(output.size):
        now = cells[n + warm]
        total = offsets[now]
        for lag in range(lags):
            place = n + warm - lag * spacing
            total += kernels[now if at_output else cells[place], lag] * x[place]
        output[n] = total
    return output


@njit(cache=True)  # type: ignore[untyped-decorator]
def _free(x, kernels, offsets, spacing, at_output, inner, directional, pole, rest_cell, rest_output, tie):  # type: ignore[no-untyped-def]
    count, lags = kernels.shape
    depths = inner.size + 1
    warm = (lags - 1) * spacing
    output = np.empty(x.size - warm)
    cells = np.full(x.size, rest_cell)
    seen, last = rest_output, rest_cell
    for n in range(output.size):
        past = 0.0
        if not at_output:
            for lag in range(1, lags):
                place = n + warm - lag * spacing
                past += kernels[cells[place], lag] * x[place]
        best, least, best_seen = -1, np.inf, 0.0
        for cell in range(count):
            value = offsets[cell] + past + kernels[cell, 0] * x[n + warm]
            if at_output:
                for lag in range(1, lags):
                    value += kernels[cell, lag] * x[n + warm - lag * spacing]
            passed = pole * seen + (1.0 - pole) * value
            depth = cell % depths
            miss = 0.0
            if depth > 0:
                miss = max(miss, inner[depth - 1] - passed)
            if depth < depths - 1:
                miss = max(miss, passed - inner[depth])
            if directional:
                miss = max(miss, seen - passed if cell < depths else passed - seen)
            miss += tie * (abs(depth - last % depths) + (0.5 if cell // depths != last // depths else 0.0))
            if miss < least:
                best, least, best_seen = cell, miss, passed
                output[n] = value
        cells[n + warm] = best
        seen, last = best_seen, best
    return output, cells[warm:]
