"""Accurate least squares: as stable as Householder QR, and fast if the Gram matrix is cheap.

The Gram matrix P'P of regressors P (rows, p) has the square of their condition number, so that its Cholesky factor
alone loses half of the digits. Iterative refinement with the regressors themselves recovers them (corrected semi-normal
equations, Bjorck 1987), if each correction is much smaller than the one before. That contraction is measured when the
matrix is factored; if it is not sufficient, Householder QR of the explicit matrix is used.

A factor belongs to the regressors and can be used for any number of outputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import finite_runs
from tissueid.messages import Message

_ROWS_AT_ONCE = 2048

_LARGEST_END_SHARE = 0.25
"""Share of rows at the ends of runs above which all products are summed directly."""


@dataclass(frozen=True, eq=False)
class LaggedRegressors:
    """Columns u_k(n - i spacing) of channels ``channels`` (K, n), each at lags i = 0 .. ``lags[k]`` - 1.

    Rows are the samples of the mask ``used`` (n,), for which all lags must have been received; other samples, also NaN,
    are never read. Columns are ordered by channel and then by lag; with ``constant``, a column of ones precedes them.
    The Gram matrix is fastest for long uninterrupted runs of rows.
    """

    channels: Array
    lags: tuple[int, ...]
    spacing: int
    used: Mask
    constant: bool = True

    @property
    def columns(self) -> int:
        """Number of coefficients."""
        return int(self.constant) + sum(self.lags)

    @cached_property
    def runs(self) -> NDArray[np.intp]:
        """First sample and end of each run of rows, shape (runs, 2)."""
        return finite_runs(self.used)

    def split(self, theta: Array) -> tuple[float, tuple[Array, ...]]:
        """Return the constant (0 without one) and the kernel (lags,) of each channel, from coefficients (p,)."""
        kernels = np.split(theta[int(self.constant) :], np.cumsum(self.lags)[:-1])
        return (float(theta[0]) if self.constant else 0.0), tuple(kernels)

    def apply(self, theta: Array) -> Array:
        """Return P theta, (rows,), for theta (p,)."""
        level, kernels = self.split(theta)
        taps = np.zeros((max(self.lags), len(self.lags)))
        for k, kernel in enumerate(kernels):
            taps[: kernel.size, k] = kernel
        parts = []
        lagged = _channels_by_lag(self.lags)
        for first, end in self.runs:
            part = np.full(end - first, level)
            for lag, some in lagged:
                part += taps[lag, some] @ self.channels[some, first - lag * self.spacing : end - lag * self.spacing]
            parts.append(part)
        return np.concatenate(parts) if parts else np.zeros(0)

    def adjoint(self, r: Array) -> Array:
        """Return P'r, (p,), for r (rows,)."""
        taps = np.zeros((max(self.lags), len(self.lags)))
        lagged = _channels_by_lag(self.lags)
        done = 0
        for first, end in self.runs:
            part = r[done : done + end - first]
            done += end - first
            for lag, some in lagged:
                taps[lag, some] += self.channels[some, first - lag * self.spacing : end - lag * self.spacing] @ part
        kernels = [taps[:count, k] for k, count in enumerate(self.lags)]
        return np.concatenate([[r.sum()], *kernels] if self.constant else kernels)

    def matrix(self) -> Array:
        """Return the explicit matrix P, (rows, p)."""
        rows = np.flatnonzero(self.used)
        explicit = np.empty((rows.size, self.columns))
        explicit[:, : int(self.constant)] = 1.0
        column = int(self.constant)
        for channel, count in zip(self.channels, self.lags, strict=True):
            for lag in range(count):
                explicit[:, column] = channel[rows - lag * self.spacing]
                column += 1
        return explicit

    def gram(self, order: NDArray[np.intp] | None = None) -> Array:
        """Return P'P, (p, p), with rows and columns in the given order (p,) of columns, if any."""
        sums = _Sums.of(self)
        total = sums.gram()  # lag by lag
        by_channel = np.lexsort((sums.lag, sums.channel))
        wanted = by_channel if order is None else by_channel[order]
        return np.asarray(np.take(np.take(total, wanted, axis=0), wanted, axis=1), dtype=np.float64)


def _channels_by_lag(lags: tuple[int, ...]) -> list[tuple[int, slice | NDArray[np.intp]]]:
    """Return each lag with the channels that have it, as a slice if they are adjacent."""
    counts = np.array(lags)
    groups: list[tuple[int, slice | NDArray[np.intp]]] = []
    for lag in range(int(counts.max(initial=0))):
        there = np.flatnonzero(counts > lag)
        together = there[-1] - there[0] + 1 == there.size
        groups.append((lag, slice(int(there[0]), int(there[-1]) + 1) if together else there))
    return groups


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums of products, with columns ordered by lag and the constant as a channel of one lag.

    ``channel`` and ``lag`` (p,) identify each column, ``starts`` (longest + 1,) is the first column of each lag,
    ``before`` (p,) the column of the same channel one lag earlier.
    """

    regressors: LaggedRegressors
    channel: NDArray[np.intp]
    lag: NDArray[np.intp]
    starts: NDArray[np.intp]
    before: NDArray[np.intp]

    @classmethod
    def of(cls, regressors: LaggedRegressors) -> _Sums:
        counts = np.array([1] * int(regressors.constant) + list(regressors.lags))
        longest = int(counts.max(initial=0))
        channel = np.concatenate([np.flatnonzero(counts > lag) for lag in range(longest)])
        starts = np.concatenate([[0], np.cumsum([np.count_nonzero(counts > lag) for lag in range(longest)])])
        lag = np.repeat(np.arange(longest), np.diff(starts))
        position = np.full((counts.size, longest), -1)
        position[channel, lag] = np.arange(channel.size)
        before = np.where(lag > 0, position[channel, lag - 1], -1)
        return cls(regressors, channel, lag, starts, before)

    def gram(self) -> Array:
        """Return P'P (p, p), with the columns ordered by lag."""
        regressors = self.regressors
        rows = int(np.diff(regressors.runs, axis=1).sum())
        if 2 * regressors.spacing * len(regressors.runs) > _LARGEST_END_SHARE * rows:
            total = np.zeros((self.channel.size, self.channel.size))
            used = np.flatnonzero(regressors.used)
            for first in range(0, rows, _ROWS_AT_ONCE):
                columns = self._columns(used[first : first + _ROWS_AT_ONCE])
                total += columns @ columns.T
            return total
        return self._by_recursion(self._at_lag_zero(), self._end_corrections())

    def _at_lag_zero(self) -> Array:
        """Return the sums over the rows of the products of the columns at lag 0 with all columns, (channels, p)."""
        regressors = self.regressors
        count = int(self.starts[1])
        constant = int(regressors.constant)
        total = np.zeros((count, self.channel.size))
        columns = np.empty((self.channel.size, _ROWS_AT_ONCE))
        lagged = _channels_by_lag(regressors.lags)
        for first, end in regressors.runs:
            for begin in range(first, end, _ROWS_AT_ONCE):
                stop = min(end, begin + _ROWS_AT_ONCE)
                values = columns[:, : stop - begin]
                values[:constant] = 1.0
                for lag, some in lagged:
                    back = lag * regressors.spacing
                    part = slice(self.starts[lag] + (constant if lag == 0 else 0), self.starts[lag + 1])
                    values[part] = regressors.channels[some, begin - back : stop - back]
                total += values[:count] @ values.T
        return total

    def _end_corrections(self) -> Array:
        """Return the change of all products (p, p), due to the ends of the runs, when every column is shifted by one
        more lag.
        """
        runs, spacing = self.regressors.runs, self.regressors.spacing
        entering = [np.arange(first - spacing, min(first, end - spacing)) for first, end in runs]
        leaving = [np.arange(max(first, end - spacing), end) for first, end in runs]
        gained = self._columns(np.concatenate(entering))
        lost = self._columns(np.concatenate(leaving))
        return np.asarray(np.hstack([gained, lost]) @ np.hstack([gained, -lost]).T, dtype=np.float64)

    def _by_recursion(self, first: Array, ends: Array) -> Array:
        """Return all products (p, p) from those with lag 0 (channels, p) and their change per lag (p, p)."""
        total = np.empty_like(ends)
        total[: self.starts[1]] = first
        for lag in range(self.starts.size - 1):
            some = slice(self.starts[lag], self.starts[lag + 1])
            beyond = slice(self.starts[lag + 1], None)
            if lag > 0:
                rows, columns = self.before[some], self.before[self.starts[lag] :]
                earlier = total[rows] + ends[rows]
                total[some, self.starts[lag] :] = np.take(earlier, columns, axis=1)
            total[beyond, some] = total[some, beyond].T
        return total

    def _columns(self, rows: NDArray[np.intp]) -> Array:
        """Return the columns at these samples, (p, rows), zero for samples that do not exist or were not received."""
        regressors = self.regressors
        constant = int(regressors.constant)
        values = np.ones((self.channel.size, rows.size))
        for lag, some in _channels_by_lag(regressors.lags):
            sample = rows - lag * regressors.spacing
            within = (sample >= 0) & (sample < regressors.used.size)
            taken = np.take(regressors.channels[some], np.where(within, sample, 0), axis=1)
            part = slice(self.starts[lag] + (constant if lag == 0 else 0), self.starts[lag + 1])
            values[part] = np.where(within & np.isfinite(taken), taken, 0.0)
        return values


Route = Literal["semi-normal", "householder"]

_CONDITION = 1e7
"""Condition number of the scaled regressors above which QR is used without trying the Gram matrix."""

_CONTRACTION = 1e-2
"""Largest accepted share of an error that remains after one correction; above it QR is used."""

_PRECISION = float(np.finfo(np.float64).eps)
_TRIALS = 2


class Regressors(Protocol):
    """A matrix P (rows, p) given by its products; it need not be stored explicitly."""

    def apply(self, theta: Array) -> Array:
        """Return P theta, (rows,), for theta (p,)."""

    def adjoint(self, r: Array) -> Array:
        """Return P'r, (p,), for r (rows,)."""

    def matrix(self) -> Array:
        """Return the explicit matrix P, (rows, p); only called if QR is used."""


class _Solver(Protocol):
    """Least squares in scaled coefficients, by either method."""

    def solve(self, y: Array) -> Array: ...

    def half_inverse(self) -> Array:
        """Return W (p, rank) with W W' the (pseudo-)inverse of the scaled Gram matrix."""

    def gram_solve(self, right: Array) -> Array: ...


@dataclass(frozen=True, eq=False)
class Factor:
    """Factored regressors.

    ``condition`` is the estimated condition number of the regressors with all columns scaled to length 1,
    ``contraction`` the share of an error that remains after one correction (zero for QR, which needs none), ``rank``
    the rank of the regressors. If it is less than p, the minimum-norm solution in scaled coefficients is returned, and
    ``warnings`` reports it.
    """

    rank: int
    condition: float
    contraction: float
    route: Route
    warnings: tuple[str, ...]
    scale: Array
    solver: _Solver

    def solve(self, y: Array) -> Array:
        """Return the coefficients (p,) with the least sum of squares of y - P theta, for an output y (rows,)."""
        return self.scale * self.solver.solve(y)

    def gram_solve(self, right: Array) -> Array:
        """Return the inverse of P'P, or its pseudo-inverse, times (p,) or (p, m)."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return scale * self.solver.gram_solve(scale * right)

    def inverse(self) -> Array:
        """Return the (pseudo-)inverse of P'P, (p, p): the covariance of theta for white noise of unit variance."""
        half = self.scale[:, None] * self.solver.half_inverse()
        return np.asarray(half @ half.T, dtype=np.float64)


def factor(gram: Array, regressors: Regressors) -> Factor:
    """Factor regressors P from their Gram matrix P'P (p, p), or from P itself if that matrix is not accurate enough.

    ``gram`` may have rounding errors of a few units in the last place, relative to the product of the lengths of two
    columns; they are corrected.
    """
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    if np.all(length > 0.0):
        scaled = gram * np.outer(scale, scale)
        semi_normal = _semi_normal(scaled, regressors, scale)
        if semi_normal is not None:
            return semi_normal
    return _householder(regressors, scale)


@dataclass(frozen=True, eq=False)
class _SemiNormal:
    regressors: Regressors
    scale: Array
    upper: Array  # R (p, p) with R'R the scaled Gram matrix
    corrections: int

    def solve(self, y: Array) -> Array:
        theta = self.gram_solve(self.scale * self.regressors.adjoint(y))
        for _ in range(self.corrections):
            residual = y - self.regressors.apply(self.scale * theta)
            theta = theta + self.gram_solve(self.scale * self.regressors.adjoint(residual))
        return theta

    def gram_solve(self, right: Array) -> Array:
        return np.asarray(linalg.cho_solve((self.upper, False), right, check_finite=False), dtype=np.float64)

    def half_inverse(self) -> Array:
        return _triangular_inverse(self.upper)


def _semi_normal(scaled: Array, regressors: Regressors, scale: Array) -> Factor | None:
    """Return the factor by the scaled Gram matrix (p, p); None if it is not accurate enough."""
    norm = float(np.max(np.abs(scaled).sum(axis=0)))
    try:
        upper = linalg.cholesky(scaled, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        return None
    reciprocal, _ = linalg.lapack.dpocon(upper, norm)
    if reciprocal < _CONDITION**-2:
        return None
    once = _SemiNormal(regressors, scale, upper, 1)
    contraction = _contraction(once)
    if contraction > _CONTRACTION:
        return None
    solves = math.ceil(math.log(_PRECISION) / math.log(max(contraction, _PRECISION)))
    corrections = max(1, solves - 1)  # the first solution counts as one
    solver = _SemiNormal(regressors, scale, upper, corrections)
    return Factor(scale.size, float(reciprocal) ** -0.5, contraction, "semi-normal", (), scale, solver)


def _contraction(solver: _SemiNormal) -> float:
    """Return the share of a coefficient error that remains after a correction: norm of I - inv(R'R) P'P, by power
    iteration.

    The iteration starts near the weakest direction of the regressors, which is corrected worst.
    """
    error = np.where(np.arange(solver.scale.size) % 2 == 0, 1.0, -1.0)
    for _ in range(_TRIALS):
        error = solver.gram_solve(error / float(np.linalg.norm(error)))
    contraction = 0.0
    for _ in range(_TRIALS):
        size = float(np.linalg.norm(error))
        if size == 0.0:
            break
        error = error / size
        seen = solver.scale * solver.regressors.adjoint(solver.regressors.apply(solver.scale * error))
        error = error - solver.gram_solve(seen)
        contraction = max(contraction, float(np.linalg.norm(error)))
    return contraction


@dataclass(frozen=True, eq=False)
class _Householder:
    """P S = Q1 R1 with reflectors kept, R1 = Q2 R2 with pivots, and for a rank below p, R2 = L Q3'."""

    reflectors: Array  # (rows, p), as LAPACK leaves them
    weights: Array  # (p,)
    small: Array  # Q2 (p, rank)
    triangle: Array  # R2 (rank, rank), or L' when the rank is below p
    row_space: Array | None  # Q3 (p, rank), None at full rank
    pivots: NDArray[np.intp]

    def solve(self, y: Array) -> Array:
        column = np.asfortranarray(y[:, None])
        turned, _, _ = linalg.lapack.dormqr("L", "T", self.reflectors, self.weights, column, 64)
        right = self.small.T @ turned[: self.small.shape[0], 0]
        theta = np.empty(self.pivots.size)
        if self.row_space is None:
            theta[self.pivots] = linalg.solve_triangular(self.triangle, right, check_finite=False)
        else:
            theta[self.pivots] = self.row_space @ linalg.solve_triangular(
                self.triangle, right, trans="T", check_finite=False
            )
        return theta

    def gram_solve(self, right: Array) -> Array:
        half = self.half_inverse()
        return np.asarray(half @ (half.T @ right), dtype=np.float64)

    def half_inverse(self) -> Array:
        inverse = _triangular_inverse(self.triangle)  # (rank, rank)
        half = np.empty((self.pivots.size, inverse.shape[0]))
        half[self.pivots] = inverse if self.row_space is None else self.row_space @ inverse.T
        return half


def _householder(regressors: Regressors, scale: Array) -> Factor:
    """Return the factor by QR of the explicit matrix.

    The tall matrix is factored without pivoting, mostly in blocked operations, and its small triangle with pivoting.
    """
    p = scale.size
    explicit = np.asfortranarray(regressors.matrix() * scale)  # (rows, p)
    largest = max(explicit.shape)
    (reflectors, weights), first = linalg.qr(explicit, mode="raw", overwrite_a=True, check_finite=False)
    small, second, pivots = linalg.qr(np.triu(first[:p]), mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(second))
    rank = int(np.count_nonzero(size > _PRECISION * largest * size[0])) if size.size else 0
    warnings: tuple[str, ...] = ()
    row_space = None
    triangle = second[:rank, :rank]
    if rank < p:
        row_space, triangle = linalg.qr(second[:rank].T, mode="economic", check_finite=False)
        warnings = (
            Message(
                "least_squares.rank",
                "the input does not excite every combination of lags: only {rank} of {coefficients} coefficients are "
                "determined, and the solution of smallest norm is given",
                rank=rank,
                coefficients=p,
            ),
        )
    reciprocal, _ = linalg.lapack.dtrcon(triangle) if rank else (0.0, 0)
    condition = 1.0 / float(reciprocal) if rank == p and reciprocal > 0.0 else math.inf
    solver = _Householder(reflectors, weights, small[:, :rank], triangle, row_space, pivots)
    return Factor(rank, condition, 0.0, "householder", warnings, scale, solver)


def _triangular_inverse(upper: Array) -> Array:
    inverse, _ = linalg.lapack.dtrtri(upper)
    return np.asarray(np.triu(inverse), dtype=np.float64)
