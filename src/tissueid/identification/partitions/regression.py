"""Kernels of a partitioned record by exact least squares, with their joint covariance.

There are two constructions. Along the lags (Chen 2010, Eqs. 5.1-5.4), the cell of each lag's own sample selects the
kernel: the input in each cell is a channel, and a sample passes from kernel to kernel within the memory. At the output,
the cell of the output sample selects the kernel for all lags: each cell is a linear model with an offset.
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
from tissueid.identification.base import Array, Mask
from tissueid.identification.impulse_response import dependence_samples, widening_of_blocks
from tissueid.identification.least_squares import Factor, LaggedRegressors, factor
from tissueid.identification.preparation import finite_runs
from tissueid.identification.volterra.prior import residual_dependence
from tissueid.identification.volterra.regressors import LagGrid
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
        received = np.isfinite(seen)
        depth = np.searchsorted(self.breakpoints[1:-1], np.where(received, seen, 0.0), side="right")
        cells: Cells = np.where(received, depth, UNKNOWN).astype(np.int64)
        if self.directional:
            for first, end in finite_runs(received):
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


_SHORTEST_BLOCK = 12
_QUARTERS = 4

_LEAST_RESIDUAL_SHARE = 0.25
"""Lower bound on the residual degrees of freedom, as a share of the rows."""

_ROWS_AT_ONCE = 4096


@dataclass(frozen=True, eq=False)
class PartitionedKernels:
    """Kernels per sample (cells, lags) and offsets (cells,) for an input minus ``reference``.

    ``kernel_root`` (cells, lags, m) and ``offset_root`` (cells, m) are square roots of the covariance: products summed
    over m. ``modelled`` (n,) is the response in the fitted cells, NaN outside the fitted rows. ``at_output`` is the
    construction; along the lags all offsets are equal.
    """

    kernels: Array
    offsets: Array
    reference: float
    at_output: bool
    kernel_root: Array
    offset_root: Array
    modelled: Array
    condition: float
    parameters: int
    warnings: tuple[str, ...]

    @property
    def kernels_std(self) -> Array:
        """Standard deviations of the kernels, (cells, lags)."""
        return np.asarray(np.sqrt(np.einsum("kjm,kjm->kj", self.kernel_root, self.kernel_root)))


def lagged_regressors(x: Array, cells: Cells, count: int, used: Mask, grid: LagGrid) -> _LaggedRows:
    """Return the regressors P of Eq. 5.1 or 5.3: a constant, then the lagged input of each cell.

    Args:
        x: input (n,) minus its reference.
        cells: cell of each sample (n,).
        count: number of cells.
        used: mask of the rows (n,); input and cell must be known throughout the memory of each.
        grid: the lags.
    """
    return _LaggedRows(np.where(cells == np.arange(count)[:, None], x, 0.0), (grid.lags,) * count, grid.spacing, used)


def solve_along_lags(
    x: Array,
    y: Array,
    reference: float,
    cells: Cells,
    count: int,
    used: Mask,
    grid: LagGrid,
    sample_rate_hz: float,
) -> PartitionedKernels:
    """Return the kernels of Eqs. 5.1-5.4 with one offset for all cells.

    Arguments as :func:`lagged_regressors`, with ``y`` the output (n,) and ``reference`` the input that counts as zero.
    """
    regressors = lagged_regressors(x - reference, cells, count, used, grid)
    solved = factor(regressors.gram(), regressors)
    theta = solved.solve(y[used])
    fitted = regressors.apply(theta)
    modelled = np.full(y.size, np.nan)
    modelled[used] = fitted
    root = _root([(regressors, solved)], [y[used] - fitted], modelled, sample_rate_hz)
    return PartitionedKernels(
        kernels=theta[1:].reshape(count, grid.lags),
        offsets=np.full(count, theta[0]),
        reference=reference,
        at_output=False,
        kernel_root=root[1:].reshape(count, grid.lags, -1),
        offset_root=np.broadcast_to(root[0], (count, root.shape[1])),
        modelled=modelled,
        condition=solved.condition,
        parameters=solved.rank,
        warnings=solved.warnings,
    )


def solve_at_output(
    x: Array, y: Array, reference: float, cells: Cells, count: int, used: Mask, grid: LagGrid, sample_rate_hz: float
) -> PartitionedKernels:
    """Return a linear model with an offset for each cell, fitted to the rows whose output lies in it.

    Arguments as :func:`solve_along_lags`; only the cells of the rows themselves must be known.

    Raises:
        UnusableInputError: a cell has fewer rows than parameters.
    """
    lagged = LaggedRegressors((x - reference)[None], (grid.lags,), grid.spacing, used).matrix()  # (rows, 1 + lags)
    parts: list[tuple[_Rows, Factor]] = []
    thetas, errors = [], []
    modelled = np.full(y.size, np.nan)
    for cell in range(count):
        mine = used & (cells == cell)
        if int(mine.sum()) <= grid.lags:
            raise UnusableInputError(
                "partitions.too_few_in_one",
                "partition {number} of {partitions} has {count} samples, too few for its {parameters} "
                "parameters: take fewer partitions, cut them by equal count, or record longer",
                number=cell + 1,
                partitions=count,
                count=int(mine.sum()),
                parameters=grid.lags + 1,
            )
        regressors = _Rows(lagged[mine[used]], mine)
        solved = factor(regressors.explicit.T @ regressors.explicit, regressors)
        theta = solved.solve(y[mine])
        modelled[mine] = regressors.apply(theta)
        parts.append((regressors, solved))
        thetas.append(theta)
        errors.append(y[mine] - modelled[mine])
    coefficients = np.array(thetas)  # (cells, 1 + lags)
    root = _root(parts, errors, modelled, sample_rate_hz).reshape(count, 1 + grid.lags, -1)
    return PartitionedKernels(
        kernels=coefficients[:, 1:],
        offsets=coefficients[:, 0],
        reference=reference,
        at_output=True,
        kernel_root=root[:, 1:],
        offset_root=root[:, 0],
        modelled=modelled,
        condition=max(solved.condition for _, solved in parts),
        parameters=sum(solved.rank for _, solved in parts),
        warnings=tuple(dict.fromkeys(warning for _, solved in parts for warning in solved.warnings)),
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """Explicit regressors (rows, p) at the samples of a mask ``used`` (n,)."""

    explicit: Array
    used: Mask

    def apply(self, theta: Array) -> Array:
        return self.explicit @ theta

    def adjoint(self, r: Array) -> Array:
        return r @ self.explicit

    def matrix(self) -> Array:
        return self.explicit

    def block_sums(self, error: Array, block: Cells) -> Array:
        """Return the sums of P e over the rows of each block, (p, blocks)."""
        sums = np.zeros((self.explicit.shape[1], int(block[-1]) + 1))
        _add_block_sums(sums, self.explicit, error, block[self.used])
        return sums


class _LaggedRows(LaggedRegressors):
    """Lagged regressors that are too large for one explicit matrix."""

    def block_sums(self, error: Array, block: Cells) -> Array:
        """Return the sums as :meth:`_Rows.block_sums`, computed in blocks of rows."""
        sums = np.zeros((self.columns, int(block[-1]) + 1))
        rows = np.flatnonzero(self.used)
        for first in range(0, rows.size, _ROWS_AT_ONCE):
            some = rows[first : first + _ROWS_AT_ONCE]
            mask = np.zeros_like(self.used)
            mask[some] = True
            explicit = LaggedRegressors(self.channels, self.lags, self.spacing, mask).matrix()
            _add_block_sums(sums, explicit, error[first : first + some.size], block[some])
        return sums


def _add_block_sums(sums: Array, explicit: Array, error: Array, block: Cells) -> None:
    """Add the sums of P e over stretches of equal block (rows,) to the columns of ``sums`` (p, blocks)."""
    if error.size:
        begins = np.flatnonzero(np.diff(block, prepend=-1))
        sums[:, block[begins]] += np.add.reduceat(explicit * error[:, None], begins, axis=0).T


def _root(
    parts: Sequence[tuple[_Rows | _LaggedRows, Factor]],
    errors: Sequence[Array],
    modelled: Array,
    sample_rate_hz: float,
) -> Array:
    """Return a square root (p, m) of the joint covariance of the coefficients of all parts, stacked.

    Sandwich estimate (White 1982) with sums of P e over blocks of time within which residuals are autocorrelated,
    shifted by quarters of a block (the Bartlett kernel), because the residuals of tissue are coloured and depend on the
    input. It is widened for the uncertainty of the covariance itself (Kiefer and Vogelsang 2005), and for the degrees
    of freedom of the fit, each of which counts as many rows as carry the information of an independent one.
    ``modelled`` (n,) is the response at the rows of all parts.
    """
    samples = modelled.size
    residual = np.full(samples, np.nan)
    for (regressors, _), error in zip(parts, errors, strict=True):
        residual[regressors.used] = error
    rows = np.isfinite(residual)
    finite_residual = residual[rows]
    block = max(_SHORTEST_BLOCK, dependence_samples(finite_residual, sample_rate_hz))
    block = max(_QUARTERS, min(block, finite_residual.size // 8))
    widening = widening_of_blocks(block / finite_residual.size)
    dependence = residual_dependence(finite_residual, modelled[rows])
    quarter = np.arange(samples) // max(1, block // _QUARTERS)
    roots = []
    for (regressors, solved), error in zip(parts, errors, strict=True):
        sums = regressors.block_sums(error, quarter)
        padded = np.pad(sums, ((0, 0), (_QUARTERS, _QUARTERS - 1)))
        running = np.cumsum(padded, axis=1)
        blocks = (running[:, _QUARTERS:] - running[:, :-_QUARTERS]) / np.sqrt(_QUARTERS)
        spare = max(error.size - dependence * solved.rank, _LEAST_RESIDUAL_SHARE * error.size)
        roots.append(solved.gram_solve(blocks) * widening * np.sqrt(error.size / spare))
    return np.vstack(roots)
