"""Regressors of a Volterra series to third order, and its normal equations (Chen 2010, Eqs. 4.2-4.5 and 4.14).

The coefficients are ordered: h0, then h1 at lags 0 .. L - 1, then the upper triangle of h2 row by row, where
off-diagonal coefficients are twice the kernel because x(n - i) x(n - j) represents two equal terms; then h3 in the same
way for i <= j <= k. Lags are a whole number of samples apart; every sample of the record can be a row.

The product of two lagged inputs is the lagged product x(n) x(n - d): L channels contain all of them. The Gram matrix
therefore costs rows x L x M operations instead of rows x M^2, and P theta and P'r are quadratic forms of the L lagged
inputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, permutations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, ndimage, signal

from tissueid.identification.base import Array, Mask
from tissueid.identification.least_squares import LaggedRegressors
from tissueid.identification.preparation import finite_runs, memory_in_samples
from tissueid.messages import Message

POWER_EDGE = 0.99
"""Share of the input power that must lie below the Nyquist frequency of an automatic grid."""

_SEGMENT = 1024
THESIS_SIGMA = 1.0
WINDOW_RADIUS = 7
"""Standard deviation, in lags, and half width of the filter of the second-order kernel in Chen 2010, C.3.1."""


@dataclass(frozen=True)
class LagGrid:
    """``lags`` lags, ``spacing`` samples apart, the first at zero."""

    lags: int
    spacing: int

    @property
    def memory_samples(self) -> int:
        """Number of samples from the first to the last lag, both included."""
        return (self.lags - 1) * self.spacing + 1


def lag_grid(memory: float, sample_rate_hz: float, spacing: int) -> LagGrid:
    """Return the lags with this spacing over a memory in seconds."""
    return LagGrid(max(1, round(memory_in_samples(memory, sample_rate_hz) / spacing)), spacing)


def automatic_grid(memory: float, x: Array, sample_rate_hz: float) -> LagGrid:
    """Return the grid with the largest spacing that the bandwidth of the input ``x`` (n,), with zero mean, allows.

    The Nyquist frequency of the grid is above ``POWER_EDGE`` of the input power. A finer grid would have coefficients
    that the input does not excite; a coarser one would leave out input samples that change the output.
    """
    frequency, power = input_spectrum(x, sample_rate_hz)
    share = np.cumsum(power)
    edge = float(frequency[np.searchsorted(share, POWER_EDGE * share[-1])]) if share[-1] > 0.0 else sample_rate_hz / 2
    spacing = max(1, int(0.5 * sample_rate_hz / max(edge, 1e-6 * sample_rate_hz)))
    return lag_grid(memory, sample_rate_hz, min(spacing, memory_in_samples(memory, sample_rate_hz)))


def shortened(grid: LagGrid, most_lags: int, sample_rate_hz: float) -> tuple[LagGrid, tuple[str, ...]]:
    """Return a grid of at most ``most_lags`` lags, and a warning if it is shorter than the given one."""
    if grid.lags <= most_lags:
        return grid, ()
    warning = Message(
        "volterra.memory_shortened",
        "the memory was shortened from {wanted:.3g} to {used:.3g} s: with an input of this bandwidth, {lags} lags are "
        "the most that can be estimated; a later response is not part of the kernels",
        wanted=grid.lags * grid.spacing / sample_rate_hz,
        used=most_lags * grid.spacing / sample_rate_hz,
        lags=most_lags,
    )
    return LagGrid(most_lags, grid.spacing), (warning,)


def input_spectrum(x: Array, sample_rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies and power spectrum, (bins,) each, of an input x (n,), averaged over its uninterrupted runs."""
    runs = finite_runs(np.isfinite(x))
    longest = int(np.max(np.diff(runs, axis=1)))
    length = min(_SEGMENT, longest)
    weights, total = 0, np.zeros(length // 2 + 1)
    frequency = fft.rfftfreq(length, 1.0 / sample_rate_hz)
    for first, end in runs:
        if end - first >= length:
            _, power = signal.welch(x[first:end], sample_rate_hz, nperseg=length, detrend=False)
            total += (end - first) * power
            weights += end - first
    return frequency, total / weights


def whiteness(products: Array) -> float:
    """Return the whiteness of an input, from 0 to 1 for white noise, from its mean lagged products (L, L).

    Whiteness is the variance of a linear kernel under a white input of the same power, divided by its variance under
    this input. The variance of a second-order kernel grows with about its inverse square.
    """
    lags = products.shape[0]
    values = linalg.eigvalsh(products)
    if values[0] <= 0.0:
        return 0.0
    return float(lags**2 / (values.sum() * np.sum(1.0 / values)))


def smoothed(kernel2: Array, sigma: float) -> Array:
    """Return a second-order kernel (L, L) after a two-dimensional Gaussian filter that preserves its sum.

    Chen 2010, 4.3.2 with the code of C.3.1: a window of 15 x 15 lags with a standard deviation ``sigma`` of 1 lag. For
    another ``sigma`` the window grows in proportion. The kernel is mirrored at its borders; zeros beyond them, as in
    C.3.1, would halve the values at lag 0.
    """
    radius = max(WINDOW_RADIUS, round(WINDOW_RADIUS * sigma))
    return np.asarray(ndimage.gaussian_filter(kernel2, sigma, mode="reflect", radius=radius), dtype=np.float64)


_ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class NormalEquations:
    """Sufficient statistics of a least-squares fit of kernels.

    ``gram`` (p, p) and ``right`` (p,) are the sums over the rows of products of the regressors with each other, and
    with the output minus its mean over the rows; ``output_power`` is that output's sum of squares. The estimated h0 is
    relative to that mean.
    """

    gram: Array
    right: Array
    output_power: float
    rows: int
    lags: int
    order: int


def coefficient_count(lags: int, order: int) -> int:
    """Return M of Eq. 4.5: the number of distinct coefficients of symmetric kernels of order 0 to ``order``."""
    return sum(math.comb(lags + degree - 1, degree) for degree in range(order + 1))


@dataclass(frozen=True, eq=False)
class Kernels:
    """Symmetric Volterra kernels per lag.

    ``zeroth`` is a number, ``first`` has shape (L,), ``second`` (L, L), ``third`` (L, L, L); None above the order.
    """

    zeroth: float
    first: Array | None = None
    second: Array | None = None
    third: Array | None = None


@dataclass(frozen=True, eq=False)
class VolterraRegressors:
    """Eq. 4.4 for an input ``x`` (n,) with its mean removed, at the rows of a mask ``used`` (n,), orders 0 to 3.

    Every input of a row's memory must have been received.
    """

    x: Array
    used: Mask
    lags: int
    spacing: int
    order: int

    @property
    def columns(self) -> int:
        """M, the number of coefficients."""
        return coefficient_count(self.lags, self.order)

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Indices of the samples that are rows, (rows,)."""
        return np.flatnonzero(self.used)

    @cached_property
    def windows(self) -> Array:
        """Lagged inputs (rows, lags), the latest first."""
        return lagged_inputs(self.x, self.rows, self.lags, self.spacing)

    def apply(self, theta: Array) -> Array:
        """Return P theta, (rows,), for theta (M,)."""
        if self.order == 3:
            by_channel = np.empty(self.columns)
            by_channel[self._column_order] = theta
            return self._lagged.apply(by_channel)
        kernels = kernels_of(theta, self.lags, self.order)
        total = np.full(self.rows.size, kernels.zeroth)
        if kernels.first is not None:
            total += self.windows @ kernels.first
        if kernels.second is not None:
            total += np.einsum("ij,ij->i", self.windows @ kernels.second, self.windows)
        return total

    def adjoint(self, r: Array) -> Array:
        """Return P'r, (M,), for r (rows,)."""
        if self.order < 3:
            return self._sums(r, self.windows)
        chunks = [slice(first, first + _ROWS_AT_ONCE) for first in range(0, r.size, _ROWS_AT_ONCE)]
        return np.asarray(np.sum([self._sums(r[some], self.windows[some]) for some in chunks], axis=0))

    def block_sums(self, r: Array, edges: NDArray[np.intp]) -> Array:
        """Return P'r over each block of rows, (M, blocks), for r (rows,) and the first row of each block."""
        ends = np.append(edges[1:], r.size)
        blocks = [self._sums(r[a:b], self.windows[a:b]) for a, b in zip(edges, ends, strict=True)]
        return np.column_stack(blocks)

    def matrix(self) -> Array:
        """Return the explicit matrix P, (rows, M)."""
        if self.order == 0:
            return np.ones((self.rows.size, 1))
        return self._lagged.matrix()[:, self._column_order]

    def gram(self) -> Array:
        """Return P'P, (M, M), by the shift structure of lagged products."""
        if self.order == 0:
            return np.array([[float(self.rows.size)]])
        return self._lagged.gram(self._column_order)

    def normal_equations(self, gram: Array, y: Array) -> NormalEquations:
        """Return the normal equations for an output y (rows,)."""
        centred = y - y.mean()
        return NormalEquations(gram, self.adjoint(centred), float(centred @ centred), y.size, self.lags, self.order)

    def _sums(self, r: Array, windows: Array) -> Array:
        parts = [np.array([r.sum()])]
        if self.order >= 1:
            parts.append(r @ windows)
        if self.order >= 2:
            weighted = (r[:, None] * windows).T  # (lags, rows)
            parts.append((weighted @ windows)[np.triu_indices(self.lags)])
        if self.order >= 3:
            second, third = np.triu_indices(self.lags)
            products = weighted @ (windows[:, second] * windows[:, third])  # (lags, pairs)
            lag, pair = np.nonzero(np.arange(self.lags)[:, None] <= second)
            parts.append(products[lag, pair])
        return np.concatenate(parts)

    @cached_property
    def _lagged(self) -> LaggedRegressors:
        """The same columns as lags of products of the input with itself and with delayed inputs."""
        n = self.x.size
        channels = [self.x]
        counts = [self.lags]
        for degree in range(2, self.order + 1):
            for delays in combinations_with_replacement(range(self.lags), degree - 1):
                reach = delays[-1] * self.spacing
                product = self.x[reach:].copy()
                for delay in delays:
                    product *= self.x[reach - delay * self.spacing : n - delay * self.spacing]
                channels.append(np.concatenate([np.zeros(reach), product]))
                counts.append(self.lags - delays[-1])
        return LaggedRegressors(np.array(channels), tuple(counts), self.spacing, self.used)

    @cached_property
    def _column_order(self) -> NDArray[np.intp]:
        """Index of each coefficient (M,) in the columns ordered by channel."""
        starts = 1 + np.concatenate([[0], np.cumsum(self._lagged.lags)[:-1]])
        indices = [np.arange(1 + self.lags)]
        channel = 1
        for degree in range(2, self.order + 1):
            lags = np.array(list(combinations_with_replacement(range(self.lags), degree)))  # (columns, degree)
            delays = lags[:, 1:] - lags[:, :1]
            delay_sets = list(combinations_with_replacement(range(self.lags), degree - 1))
            number = {some: channel + k for k, some in enumerate(delay_sets)}
            of = np.array([number[tuple(row)] for row in delays.tolist()])
            indices.append(starts[of] + lags[:, 0])
            channel += len(delay_sets)
        return np.concatenate(indices)


def lagged_inputs(x: Array, rows: NDArray[np.intp], lags: int, spacing: int) -> Array:
    """Return the inputs x(n - i spacing), i = 0 .. lags - 1, for the samples n of ``rows``, (rows, lags)."""
    windows = np.empty((rows.size, lags))
    for lag in range(lags):
        windows[:, lag] = x[rows - lag * spacing]
    return windows


def kernels_of(values: Array, lags: int, order: int) -> Kernels:
    """Return the symmetric kernels of coefficients (M,), each divided by its multiplicity (Eq. 4.14).

    Standard deviations of coefficients give those of the kernels in the same way.
    """
    zeroth, first, second, third = float(values[0]), None, None, None
    done = 1 + lags
    if order >= 1:
        first = values[1:done]
    if order >= 2:
        upper = np.zeros((lags, lags))
        upper[np.triu_indices(lags)] = values[done : done + lags * (lags + 1) // 2]
        second = 0.5 * (upper + upper.T)  # diagonal entries appear in both summands
        done += lags * (lags + 1) // 2
    if order >= 3:
        third = np.zeros((lags, lags, lags))
        ordered = np.array(list(combinations_with_replacement(range(lags), 3)))
        distinct = 1 + np.count_nonzero(np.diff(ordered, axis=1), axis=1)
        shares = values[done:] / np.array([1.0, 3.0, 6.0])[distinct - 1]
        for turned in permutations(range(3)):
            third[tuple(ordered[:, turned].T)] = shares
    return Kernels(zeroth, first, second, third)
