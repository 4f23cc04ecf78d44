"""A fitted partitioned model: kernels by depth, or by depth and direction, and its two ways to be run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.identification.base import Array, Mask, Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.partitions.cells import UNKNOWN, Partitions
from tissueid.identification.partitions.simulation import free_run, scheduled_run
from tissueid.identification.sample_masks import complete_windows
from tissueid.records import Record


@dataclass(frozen=True, eq=False)
class PartitionedModel(Model):
    """y(n) = offset + sum of kernels[cell](lag) times input, the cell chosen by depth (Chen 2010, chapter 5).

    ``kernels`` (cells, lags) with ``kernels_std`` are in output per input and second, at ``lag_s`` (lags,), which lie
    ``lag_spacing`` samples apart; they act on the input less ``reference``. ``offsets`` (cells,) are equal where all
    cells share one. ``direction`` (cells,) is 1 for cells of a rising output, which come first, -1 for those of a
    falling one and 0 where cells have no direction. ``at_output`` says whether the cell of the output's sample chooses
    the kernel for all lags, or at every lag the cell that the output was in then. ``operating_kernels`` (K, lags) of
    depth alone act on the input less its mean: from them come mass, damping and stiffness. A free run begins at
    ``rest_position``.

    ``memory_samples`` is three times the kernels' memory where the model's own past chooses its kernels: so long
    after a gap two runs of one model agree again to rounding.
    """

    partitions: Partitions
    kernels: Array
    kernels_std: Array
    offsets: Array
    lag_s: Array
    lag_spacing: int
    reference: float
    at_output: bool
    input_mean: float
    rest_cell: int
    rest_position: float
    operating_kernels: Array
    local: DepthProfile | None

    @property
    def breakpoints_m(self) -> Array:
        """Where depth is cut, (K + 1,), in the output's unit."""
        return self.partitions.breakpoints

    @property
    def direction(self) -> NDArray[np.int_]:
        """Direction of each cell, (cells,)."""
        return self.partitions.direction

    @property
    def window(self) -> int:
        """Samples from the first lag to the last, both included."""
        return (self.lag_s.size - 1) * self.lag_spacing + 1

    def simulate(self, u: Array) -> Array:
        """Simulate free-run: input (n,) in, output (n,) out, with the model's own output choosing the kernels.

        It is at rest at the mean input of the fit before the first sample. Every answer is a sum of kernels times
        inputs and cannot run away, whatever the cells.
        """
        u = np.asarray(u, dtype=np.float64)
        x = np.concatenate([np.full(self.window - 1, self.input_mean), np.where(np.isfinite(u), u, self.input_mean)])
        output, _ = free_run(
            x - self.reference,
            self.kernels / self._rate,
            self.offsets,
            self.lag_spacing,
            self.at_output,
            self.partitions.breakpoints[1:-1],
            self.partitions.directional,
            self.partitions.pole,
            self.rest_cell,
            self.rest_position,
        )
        output[~_complete_after_rest(np.isfinite(u), self.memory_samples)] = np.nan
        return output

    def simulate_scheduled(self, record: Record) -> Array:
        """Simulate with the measured output choosing the kernels, shape (n,), as the thesis does.

        The output of a sample helps to choose what it is compared with: a figure of merit from this is none for a
        simulation. NaN where the memory holds an input or output that was not received.
        """
        self.check_rate(record)
        cells = self.partitions.cells(record.output)
        known = np.isfinite(record.input) & (cells != UNKNOWN)
        rest = self.window - 1
        x = np.concatenate([np.full(rest, self.input_mean), np.where(known, record.input, self.input_mean)])
        placed = np.concatenate([np.full(rest, self.rest_cell), np.where(known, cells, self.rest_cell)])
        output = scheduled_run(
            x - self.reference,
            placed.astype(np.int64),
            self.kernels / self._rate,
            self.offsets,
            self.lag_spacing,
            self.at_output,
        )
        output[~_complete_after_rest(known, self.window)] = np.nan
        return output

    def depth_profile(self) -> DepthProfile | None:
        """Return the mass, damping and stiffness of each cell; None when the record is not force and position."""
        return self.local

    @property
    def _rate(self) -> float:
        """Lags in a second."""
        return self.sample_rate_hz / self.lag_spacing


def resting(
    kernels: Array, offsets: Array, steady: float, partitions: Partitions, position: float
) -> tuple[int, float]:
    """Return the cell and output that a steady input, less the reference, holds: the cell whose output misses it least.

    Among equals the one nearest to ``position``. ``kernels`` (cells, lags) are per sample.
    """
    outputs = offsets + steady * kernels.sum(axis=1)  # (cells,)
    inner = partitions.breakpoints[1:-1]
    low = np.concatenate([[-np.inf], inner])
    high = np.concatenate([inner, [np.inf]])
    depth = np.arange(outputs.size) % partitions.depths
    miss = np.maximum(np.maximum(low[depth] - outputs, outputs - high[depth]), 0.0)
    tie = 1e-9 * np.abs(outputs - position)
    cell = int(np.argmin(miss + tie))
    return cell, float(outputs[cell])


def _complete_after_rest(known: Mask, length: int) -> Mask:
    """Return the mask (n,) of samples whose window holds no unknown sample; samples before the first count as known."""
    padded = np.concatenate([np.ones(length - 1, dtype=np.bool_), known])
    return complete_windows(padded, length)[length - 1 :]
