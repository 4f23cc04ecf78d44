"""Regressors of lagged channels, and a fast computation of their Gram matrix.

The product of two lagged columns, both shifted by one more lag, is the sum over the same samples except those at the
ends of each uninterrupted run of rows. Only products with columns at lag 0 are therefore summed over all rows, and the
others follow from corrections at the ends: rows x channels x columns operations instead of rows x columns^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import finite_runs

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
        place = int(self.constant)
        for channel, count in zip(self.channels, self.lags, strict=True):
            for lag in range(count):
                explicit[:, place] = channel[rows - lag * self.spacing]
                place += 1
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
    found: list[tuple[int, slice | NDArray[np.intp]]] = []
    for lag in range(int(counts.max(initial=0))):
        there = np.flatnonzero(counts > lag)
        together = there[-1] - there[0] + 1 == there.size
        found.append((lag, slice(int(there[0]), int(there[-1]) + 1) if together else there))
    return found


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
        place = np.full((counts.size, longest), -1)
        place[channel, lag] = np.arange(channel.size)
        before = np.where(lag > 0, place[channel, lag - 1], -1)
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
                    place = slice(self.starts[lag] + (constant if lag == 0 else 0), self.starts[lag + 1])
                    values[place] = regressors.channels[some, begin - back : stop - back]
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
            found = np.take(regressors.channels[some], np.where(within, sample, 0), axis=1)
            place = slice(self.starts[lag] + (constant if lag == 0 else 0), self.starts[lag + 1])
            values[place] = np.where(within & np.isfinite(found), found, 0.0)
        return values
