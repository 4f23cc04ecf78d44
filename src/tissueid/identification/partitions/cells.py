"""Partitions of depth and direction, and the cell of each sample (Chen 2010, Eqs. 5.1 and 5.3).

A cell is a range of depth, with directions a range of depth passed in one direction. Every sample with a received
output belongs to one cell. The outer cells are unbounded, so that motion beyond the fitted range has a cell too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.preparation import finite_runs
from tissueid.language import marked

Cells = NDArray[np.int64]
Breakpoints = Literal["count", "width"]
_BREAKPOINTS = (marked("count"), marked("width"))
"""Choices of the option as a form shows them, for translation."""

UNKNOWN = -1
"""Cell of a sample whose output was not received."""


@dataclass(frozen=True, eq=False)
class Partitions:
    """Breakpoints of depth and the filter of the output that selects a cell.

    ``breakpoints`` (K + 1,) increase; the first and the last are the ends of the fitted motion. With ``directional``
    there are 2 K cells, those of an increasing output first. ``pole`` is that of the causal first-order low-pass of the
    output before selection, 0 for none.
    """

    breakpoints: Array
    directional: bool
    pole: float

    @property
    def depths(self) -> int:
        """K, the number of depth ranges."""
        return self.breakpoints.size - 1

    @property
    def count(self) -> int:
        """The number of cells: K, or 2 K with directions."""
        return self.depths * (2 if self.directional else 1)

    @property
    def direction(self) -> NDArray[np.int_]:
        """Direction of each cell, shape (cells,): 1 for an increasing output, -1 for a decreasing one, 0 for both."""
        if not self.directional:
            return np.zeros(self.depths, dtype=np.int_)
        return np.repeat(np.array([1, -1], dtype=np.int_), self.depths)

    def filtered(self, output: Array) -> Array:
        """Return the low-passed output (n,) that selects the cell; the filter restarts after every gap."""
        if self.pole == 0.0:
            return output
        passed = np.full(output.size, np.nan)
        for first, end in finite_runs(np.isfinite(output)):
            start = np.array([self.pole * output[first]])
            passed[first:end] = signal.lfilter([1.0 - self.pole], [1.0, -self.pole], output[first:end], zi=start)[0]
        return passed

    def cells(self, output: Array) -> Cells:
        """Return the cell of each sample of an output (n,), shape (n,); :data:`UNKNOWN` for samples that were not
        received.

        A constant output keeps its direction; the first sample after a gap counts as increasing.
        """
        seen = self.filtered(output)
        known = np.isfinite(seen)
        place = np.searchsorted(self.breakpoints[1:-1], np.where(known, seen, 0.0), side="right")
        cells: Cells = np.where(known, place, UNKNOWN).astype(np.int64)
        if self.directional:
            for first, end in finite_runs(known):
                cells[first:end] += self.depths * _falling(seen[first:end])
        return cells


def place_breakpoints(output: Array, count: int, method: Breakpoints, given: Sequence[float] | None = None) -> Array:
    """Return the K + 1 breakpoints of the partitions of an output (n,); NaN is ignored (Chen 2010, 5.1).

    Args:
        output: signal that selects the cells, on the samples to fit.
        count: number of partitions.
        method: equal counts of samples, or equal widths.
        given: inner breakpoints, increasing, in the unit of the output; they replace ``count`` and ``method``.

    Raises:
        UnusableInputError: breakpoints that do not increase within the motion, or an output with too few distinct
            values.
    """
    seen = output[np.isfinite(output)]
    low, high = float(seen.min()), float(seen.max())
    if given is not None:
        points = np.array([low, *given, high])
    elif method == "width":
        points = np.linspace(low, high, count + 1)
    else:
        points = np.quantile(seen, np.linspace(0.0, 1.0, count + 1))
    if not np.all(np.diff(points) > 0.0):
        raise UnusableInputError(
            "partitions.bad_breakpoints",
            "the breakpoints must rise and lie within the motion, from {low:.6g} to {high:.6g}: {advice}",
            low=low,
            high=high,
            advice=marked("give others") if given is not None else marked("take fewer partitions"),
        )
    return np.asarray(points, dtype=np.float64)


def low_pass_pole(cutoff_hz: float | None, sample_rate_hz: float) -> float:
    """Return the pole of the first-order low-pass with that cutoff; 0 (no filter) for None."""
    return 0.0 if cutoff_hz is None else math.exp(-2.0 * math.pi * cutoff_hz / sample_rate_hz)


def _falling(seen: Array) -> NDArray[np.bool_]:
    """Return the mask (n,) of the samples at which an uninterrupted signal (n,) decreases."""
    steps = np.sign(np.diff(seen, prepend=seen[0]))
    steps[0] = 1.0
    latest = np.maximum.accumulate(np.where(steps != 0.0, np.arange(seen.size), 0))
    return np.asarray(steps[latest] < 0.0)
