"""Least squares over the latest seconds: correlations updated with each sample, solved on request."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from scipy import linalg, signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.identification.impulse_response import (
    EXTRA_MEMORY_S,
    RIDGE,
    condition_number,
    factor_input,
    toeplitz_inverse,
    toeplitz_solve,
    with_extra_memory,
)
from tissueid.identification.least_squares import LaggedRegressors
from tissueid.identification.preparation import (
    PreparedRecord,
    checked_samples,
    memory_in_samples,
    prepare,
    typical_samples,
)
from tissueid.records import Record


@njit(cache=True, nogil=True)
def slide(x: Array, y: Array, first: int, end: int, new: int, window: int, gained: Array, lost: Array) -> int:
    """Add the next ``new`` samples to sums over the samples from ``first`` to ``end``; return the new ``first``.

    Args:
        x: inputs, including the new ones.
        y: outputs, including the new ones.
        first: index of the oldest sample in the sums.
        end: index after the newest sample in the sums.
        new: number of samples to add.
        window: largest number of samples in the sums.
        gained: sums of x[n] x[n - k] and y[n] x[n - k] over all n that entered, (2, lags), the longest lag first.
        lost: the same over all n - k that left, lag 0 first.
    """
    lags = gained.shape[1]
    auto_in, cross_in, auto_out, cross_out = gained[0], gained[1], lost[0], lost[1]
    for n in range(end, end + new):
        if n - first == window:
            held = min(lags, n - first)
            x_later, y_later, x_old = x[first : first + held], y[first : first + held], x[first]
            for k in range(held):
                auto_out[k] += x_old * x_later[k]
                cross_out[k] += x_old * y_later[k]
            first += 1
        held = min(lags, n - first + 1)
        x_before, x_new, y_new = x[n + 1 - held : n + 1], x[n], y[n]
        auto_some, cross_some = auto_in[lags - held :], cross_in[lags - held :]
        for k in range(held):
            auto_some[k] += x_new * x_before[k]
            cross_some[k] += y_new * x_before[k]
    return first


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def fade_ends(x: Array, y: Array, fade: Array, faded: int, auto: Array, cross: Array) -> None:
    """Turn sums over a window into those of the tapered signals.

    Args:
        x: inputs of the window (n,), minus their mean.
        y: outputs of the window (n,), minus their mean.
        fade: taper (n,) of both.
        faded: number of samples at each end where the taper is not 1.
        auto: sums of x[n] x[n - k], shape (lags,), changed in place.
        cross: sums of y[n] x[n - k], shape (lags,), changed in place.
    """
    size = x.size
    x_faded, y_faded = x * fade, y * fade
    for k in range(auto.size):
        for low, high in ((0, min(faded, size - k)), (max(faded, size - faded - k), size - k)):
            count = max(0, high - low)
            x_there, xf_there = x[low : low + count], x_faded[low : low + count]
            x_later, xf_later = x[low + k : low + k + count], x_faded[low + k : low + k + count]
            y_later, yf_later = y[low + k : low + k + count], y_faded[low + k : low + k + count]
            auto_change = cross_change = 0.0
            for m in range(count):
                auto_change += xf_there[m] * xf_later[m] - x_there[m] * x_later[m]
                cross_change += xf_there[m] * yf_later[m] - x_there[m] * y_later[m]
            auto[k] += auto_change
            cross[k] += cross_change


_INITIAL_CAPACITY_S = 8.0
"""Initial capacity, s, if the window has no limit."""


@dataclass(frozen=True, eq=False)
class SlidingSolution:
    """Least-squares response over the present window.

    ``kernel`` (lags,) is the response per sample; ``prepared`` is the prepared window. The correlation matrix R
    (estimated, estimated), of a response somewhat longer than ``kernel``, is stored by its first column, as a matrix,
    or by its pseudo-inverse.
    """

    kernel: Array
    prepared: PreparedRecord
    column: Array | None = None
    matrix: Array | None = None
    pseudo_inverse: Array | None = None

    @cached_property
    def inverse(self) -> Array:
        """Inverse of R, shape (estimated, estimated), or its pseudo-inverse; needed for standard deviations."""
        if self.column is not None:
            return toeplitz_inverse(self.column)
        if self.matrix is not None:
            return np.asarray(linalg.inv(self.matrix))
        assert self.pseudo_inverse is not None
        return self.pseudo_inverse


class SlidingLms:
    """Least-squares response over the latest ``window_s`` seconds, or over all samples so far, updated during a test.

    Samples can be added one by one or in batches, with bitwise equal sums. The result equals that of ``lms`` for the
    same window: the Toeplitz solution of tapered correlations if the window has no gap, else sums over complete
    memories. The equations are solved only on request, so that there are no prediction errors.

    Args:
        options: the engine whose results are computed.
        sample_rate_hz: of the samples.
        window_s: length of the window; None for all samples.
        input_unit: unit of the input.
        output_unit: unit of the output.

    Raises:
        UnusableInputError: the sample rate is not positive, or the window is shorter than two memories.
    """

    def __init__(
        self,
        options: Lms,
        sample_rate_hz: float,
        window_s: float | None = None,
        *,
        input_unit: str = "N",
        output_unit: str = "m",
    ) -> None:
        if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
            raise UnusableInputError(
                "record.sample_rate", "the sample rate must be positive, got {rate:g} Hz", rate=sample_rate_hz
            )
        if window_s is not None and not window_s >= 2.0 * options.memory_s:
            raise UnusableInputError(
                "online.short_window",
                "a window of {window:g} s is shorter than two memories of {memory:g} s: lengthen it",
                window=window_s,
                memory=options.memory_s,
            )
        self.options = options
        self.sample_rate_hz = sample_rate_hz
        self.lags = memory_in_samples(options.memory_s, sample_rate_hz)
        self._units = (input_unit, output_unit)
        self._window = None if window_s is None else round(window_s * sample_rate_hz)
        summed = self.lags + typical_samples(EXTRA_MEMORY_S, sample_rate_hz)
        room = 2 * self._window if self._window else round(_INITIAL_CAPACITY_S * sample_rate_hz) + summed
        self._received = np.zeros((2, room))  # input and output as received
        self._counted = np.zeros((2, room))  # minus the first received value of each, 0 for missing samples
        self._first = self._end = self._taken = 0
        self._origin: tuple[float | None, float | None] = (None, None)
        self._gained, self._lost = np.zeros((2, summed)), np.zeros((2, summed))
        self._since_summed = 0
        self._solution: SlidingSolution | None = None

    def update(self, u: float, y: float) -> None:
        """Add one input and one output; NaN if not received."""
        self.batch(np.array([u]), np.array([y]))

    def batch(self, u: Array, y: Array) -> None:
        """Add inputs (n,) and outputs (n,); NaN for samples that were not received.

        Raises:
            UnusableInputError: the two differ in shape.
        """
        u, y = checked_samples(u, y)
        done = 0
        while done < u.size:
            n = u.size - done if self._window is None else min(u.size - done, self._window - self._since_summed)
            self._take(u[done : done + n], y[done : done + n])
            done += n
        self._solution = None if u.size else self._solution

    @property
    def samples(self) -> int:
        """Number of samples added."""
        return self._taken

    @property
    def lag_s(self) -> Array:
        """Times of the lags, s, shape (lags,)."""
        return np.arange(self.lags) / self.sample_rate_hz

    @property
    def impulse_response(self) -> Array:
        """The response over the window, shape (lags,), in output units per input unit and second.

        Raises:
            UnusableInputError: there are too few samples, or nothing varies.
        """
        return self.solve().kernel * self.sample_rate_hz

    def recent(self) -> Record:
        """Return the window as a record.

        Raises:
            UnusableInputError: there are no samples in it.
        """
        u, y = self._received[:, self._first : self._end].copy()
        return Record(u, y, self.sample_rate_hz, input_unit=self._units[0], output_unit=self._units[1])

    def model(self) -> LmsModel:
        """Return the ``lms`` model of the window, scored on it. The sums are not changed.

        Raises:
            UnusableInputError: there are too few samples, or nothing varies.
        """
        return self.options.fit(self.recent())

    def solve(self) -> SlidingSolution:
        """Return the response over the window with the matrix needed for standard deviations.

        Raises:
            UnusableInputError: there are too few samples, or nothing varies.
        """
        if self._solution is None:
            prepared = prepare(self.recent(), None, self.options.memory_s)
            wide = prepared if self.options.taper == 0.0 else with_extra_memory(prepared)
            try:
                if self.options.method == "svd":
                    solution = self._from_dense_matrix(wide)
                elif prepared.gapless:
                    solution = self._from_sums(wide)
                else:
                    solution = self._from_complete_memories(wide)
            except np.linalg.LinAlgError:
                solution = self._from_dense_matrix(wide)
            self._solution = replace(solution, kernel=solution.kernel[: self.lags], prepared=prepared)
        return self._solution

    # -- sums ---------------------------------------------------------------------------------------------

    def _take(self, u: Array, y: Array) -> None:
        self._make_room(u.size)
        new = slice(self._end, self._end + u.size)
        self._received[:, new] = u, y
        origin = []
        for row, values, baseline in zip(self._counted, (u, y), self._origin, strict=True):
            received = np.isfinite(values)
            if baseline is None and received.any():
                baseline = float(values[received][0])
            origin.append(baseline)
            row[new] = np.where(received, values - (baseline or 0.0), 0.0)
        self._origin = (origin[0], origin[1])
        self._first = self._slide(self._first, self._end, u.size)
        self._end += u.size
        self._taken += u.size
        self._since_summed += u.size
        if self._since_summed == self._window:
            # The window has been replaced completely since the last full sum: a new sum removes rounding errors.
            self._gained[:], self._lost[:] = 0.0, 0.0
            self._slide(self._first, self._first, self._end - self._first)
            self._since_summed = 0

    def _slide(self, first: int, end: int, new: int) -> int:
        x, y = self._counted
        window = self._window or x.size
        return int(slide(x, y, first, end, new, window, self._gained, self._lost))

    def _make_room(self, n: int) -> None:
        """Make room for ``n`` samples: move the window to the front of the buffer, or enlarge the buffer if there is no
        limit.
        """
        room = self._received.shape[1]
        if self._end + n <= room:
            return
        held = slice(self._first, self._end)
        size = self._end - self._first
        wanted = room
        while wanted < size + n:
            wanted *= 2
        moved = []
        for rows in (self._received, self._counted):
            target = np.zeros((2, wanted)) if wanted > room else rows
            target[:, :size] = rows[:, held].copy()
            moved.append(target)
        self._received, self._counted = moved
        self._first, self._end = 0, size

    # -- solutions ----------------------------------------------------------------------------------------

    def _from_sums(self, prepared: PreparedRecord) -> SlidingSolution:
        """Return the Toeplitz solution from the sums, corrected for the means of the window and for the taper at its
        ends.

        Raises:
            numpy.linalg.LinAlgError: the input does not excite every lag.
        """
        record, size, lags = prepared.record, len(prepared.record), prepared.memory_samples
        origin_u, origin_y = (value or 0.0 for value in self._origin)
        mean_x, mean_y = prepared.input_mean - origin_u, prepared.output_mean - origin_y
        x, y = self._counted[:, self._first : self._end]
        later_x, later_y = _without_first(x, lags), _without_first(y, lags)
        earlier_x = _without_first(x[::-1], lags)
        pairs = size - np.arange(lags)
        raw_auto, raw_cross = (self._gained[:, ::-1] - self._lost)[:, :lags]
        auto = raw_auto - mean_x * (later_x + earlier_x) + pairs * mean_x * mean_x
        cross = raw_cross - mean_x * later_y - mean_y * earlier_x + pairs * mean_x * mean_y
        taper = self.options.taper
        if taper > 0.0:
            fade = signal.windows.tukey(size, taper)
            faded = min(size // 2, int(np.count_nonzero(fade[: size // 2] < 1.0)) + 1)
            about = record.input - prepared.input_mean, record.output - prepared.output_mean
            fade_ends(*about, fade, faded, auto, cross)
        column = auto / size
        if taper > 0.0:
            column[0] *= 1.0 + RIDGE
        condition_number(column)
        kernel = toeplitz_solve(column, cross / size)
        return SlidingSolution(kernel, prepared, column=column)

    def _from_complete_memories(self, prepared: PreparedRecord) -> SlidingSolution:
        """Return the least-squares solution over the outputs with a complete memory."""
        x = prepared.record.input - prepared.input_mean
        regressors = LaggedRegressors(x[None, :], (prepared.memory_samples,), 1, prepared.used, constant=False)
        count = int(prepared.used.sum())
        gram = regressors.gram() / count
        gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / prepared.memory_samples
        right = regressors.adjoint(prepared.record.output[prepared.used] - prepared.output_mean) / count
        kernel = np.asarray(linalg.solve(gram, right, assume_a="pos"))
        return SlidingSolution(kernel, prepared, matrix=gram)

    def _from_dense_matrix(self, prepared: PreparedRecord) -> SlidingSolution:
        """Return the solution by the dense correlation matrix, on request or if the input does not excite all lags."""
        options = self.options
        solved = factor_input(prepared, pseudo_inverse=True, tolerance=options.tolerance, taper=options.taper)
        return SlidingSolution(solved.kernel(prepared.record.output), prepared, pseudo_inverse=solved.inverse)


def _without_first(values: Array, lags: int) -> Array:
    """Return the sums of values (n,) without the first k of them, for k = 0 .. lags - 1, shape (lags,)."""
    return np.asarray(float(values.sum()) - np.concatenate([[0.0], np.cumsum(values[: lags - 1])]))
