"""Identification during a test: common parts of recursive and adaptive engines (Chen 2010, 6.2).

An online engine is a specification whose ``fit`` returns a frozen model, like any other. In addition, ``start`` returns
an identifier, which is updated sample by sample. Reading its results does not change it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Model
from tissueid.identification.memory import FirModel, MemoryEngine
from tissueid.identification.preparation import (
    PreparedRecord,
    checked_samples,
    memory_in_samples,
    prepare,
    typical_samples,
)
from tissueid.records import Record

RECENT_S = 10.0
"""Length of the latest samples that an identifier keeps, s; its model is scored on them."""

SNAPSHOTS = 400
"""Largest number of responses in a trajectory. When it is reached, every other one is dropped."""


@dataclass(frozen=True, eq=False)
class OnlineModel(FirModel):
    """A linear finite impulse response and its trajectory.

    ``trajectory`` (t, lags) holds the responses at the times ``trajectory_s`` (t,), when the output was
    ``trajectory_position`` (t,); t is at most 400.
    """

    trajectory: Array
    trajectory_s: Array
    trajectory_position: Array


class Identifier(ABC):
    """A response that is updated with each sample; single samples and batches give bitwise equal results.

    A sample whose output is NaN is not used, nor is any sample whose memory contains an input that was not received.
    Signals are relative to the operating point, by default the first received sample of each.
    """

    def __init__(
        self,
        options: OnlineEngine,
        sample_rate_hz: float,
        operating_point: tuple[float | None, float | None],
        units: tuple[str, str],
        first_sample: int,
    ) -> None:
        self.options = options
        self.sample_rate_hz = sample_rate_hz
        self.lags = lags = lags_of(options, sample_rate_hz)
        self._means = operating_point
        self._units = units
        self._taken = first_sample
        self._keep = max(4 * lags, round(RECENT_S * sample_rate_hz))
        self._recent = np.zeros((3, 2 * self._keep))  # input and output minus the operating point, and errors
        self._held = 0
        self._trajectory = np.zeros((SNAPSHOTS, lags))
        self._times = np.zeros((2, SNAPSHOTS))  # time, s, and output of each snapshot
        self._snapshots = 0
        self._stride = 1
        self._sums = np.zeros(5)  # count; sums of errors, squared errors, outputs, squared outputs

    @abstractmethod
    def _advance(self, u: Array, y: Array, errors: Array) -> None:
        """Add samples (n,), minus their operating point, and store the prediction errors (n,)."""

    @abstractmethod
    def _response(self) -> Array:
        """Return the present response per sample, shape (lags,); a view."""

    def model(self) -> Model:
        """Return the present model, scored on the latest ten seconds. The identifier is not changed.

        Raises:
            UnusableInputError: there are too few samples for a score.
        """
        return self.options.model_of(self, prepare(self.recent(), None, self.lags / self.sample_rate_hz))

    def update(self, u: float, y: float) -> float:
        """Add one input and one output, and return the prediction error before the update.

        NaN if there is no prediction or no output.
        """
        index = self._next_index(1)
        if self._means[0] is None or self._means[1] is None:
            self._set_operating_point(np.array([u]), np.array([y]))
        self._put(index, u, y)
        return self._step(index, 1)

    def batch(self, u: Array, y: Array) -> Array:
        """Add inputs (n,) and outputs (n,), and return the prediction errors (n,) before each update.

        Raises:
            UnusableInputError: the two differ in shape.
        """
        u, y = checked_samples(u, y)
        self._set_operating_point(u, y)
        errors = np.empty(u.size)
        done = 0
        while done < u.size:
            n = min(u.size - done, self._keep, self._stride - self._taken % self._stride)
            index = self._next_index(n)
            self._put(slice(index, index + n), u[done : done + n], y[done : done + n])
            self._step(index, n)
            errors[done : done + n] = self._recent[2, index : index + n]
            done += n
        return errors

    @property
    def impulse_response(self) -> Array:
        """The present response, shape (lags,), in output units per input unit and second; a copy."""
        return self._response() * self.sample_rate_hz

    @property
    def lag_s(self) -> Array:
        """Times of the lags, s, shape (lags,)."""
        return np.arange(self.lags) / self.sample_rate_hz

    @property
    def samples(self) -> int:
        """Number of samples added."""
        return self._taken

    @property
    def input_mean(self) -> float:
        """Operating point of the input; 0 before the first received sample."""
        return self._means[0] or 0.0

    @property
    def output_mean(self) -> float:
        """Operating point of the output; 0 before the first received sample."""
        return self._means[1] or 0.0

    @property
    def tracking_vaf_percent(self) -> float:
        """Variance accounted for by the one-step predictions, each before its update (Eq. 3.13).

        This is not a free run: the response that predicts a sample has been updated with all outputs before it.
        """
        samples, errors, error_squares, outputs, output_squares = self._sums.tolist()
        varied = output_squares - outputs**2 / samples if samples else 0.0
        return 100.0 * (1.0 - (error_squares - errors**2 / samples) / varied) if varied > 0.0 else math.nan

    @property
    def trajectory(self) -> tuple[Array, Array, Array]:
        """Responses (t, lags), in the unit of the impulse response, their times (t,), s, and the outputs (t,)."""
        t = self._snapshots
        return self._trajectory[:t] * self.sample_rate_hz, self._times[0, :t].copy(), self._times[1, :t].copy()

    def recent(self) -> Record:
        """Return the latest samples that are kept, as a record.

        Raises:
            UnusableInputError: there are none.
        """
        held = slice(max(0, self._held - self._keep), self._held)
        return Record(
            self._recent[0, held] + self.input_mean,
            self._recent[1, held] + self.output_mean,
            self.sample_rate_hz,
            input_unit=self._units[0],
            output_unit=self._units[1],
        )

    def _set_operating_point(self, u: Array, y: Array) -> None:
        """Set an unknown operating point to the first received sample."""
        means = []
        for mean, values in zip(self._means, (u, y), strict=True):
            received = values[np.isfinite(values)] if mean is None else values[:0]
            means.append(float(received[0]) if received.size else mean)
        self._means = (means[0], means[1])

    def _next_index(self, n: int) -> int:
        """Return the index for the next n samples; move the latest samples to the front of a full buffer."""
        if self._held + n > self._recent.shape[1]:
            self._recent[:, : self._keep] = self._recent[:, self._held - self._keep : self._held].copy()
            self._held = self._keep
        return self._held

    def _put(self, index: int | slice, u: float | Array, y: float | Array) -> None:
        self._recent[0, index] = u - self.input_mean
        self._recent[1, index] = y - self.output_mean

    def _step(self, index: int, n: int) -> float:
        """Update with the n samples at ``index``, which end at or before a snapshot; return the last error."""
        some = slice(index, index + n)
        errors = self._recent[2, some]
        self._advance(self._recent[0, some], self._recent[1, some], errors)
        self._held += n
        self._taken += n
        last = float(errors[-1])
        if n == 1:
            if not math.isnan(last):
                y = float(self._recent[1, index])
                self._sums += (1.0, last, last * last, y, y * y)
        else:
            used = np.isfinite(errors)
            e, y_used = errors[used], self._recent[1, some][used]
            self._sums += np.array([e.size, e.sum(), e @ e, y_used.sum(), y_used @ y_used])
        if self._taken % self._stride == 0 and not math.isnan(last):
            self._store_snapshot(float(self._recent[1, index + n - 1]))
        return last

    def _store_snapshot(self, y: float) -> None:
        if self._snapshots == SNAPSHOTS:
            self._stride *= 2
            kept = np.round(self._times[0] * self.sample_rate_hz + 1.0) % self._stride == 0.0
            self._snapshots = int(np.count_nonzero(kept))
            self._trajectory[: self._snapshots] = self._trajectory[kept]
            self._times[:, : self._snapshots] = self._times[:, kept]
            if self._taken % self._stride:
                return
        self._trajectory[self._snapshots] = self._response()
        self._times[:, self._snapshots] = (self._taken - 1) / self.sample_rate_hz, y + self.output_mean
        self._snapshots += 1


class OnlineEngine(MemoryEngine):
    """An engine that also runs sample by sample: ``start`` returns the identifier, ``fit`` runs it over a record.

    ``identifier`` is the class of the identifier.
    """

    identifier: ClassVar[Callable[..., Any]]

    def start(
        self,
        sample_rate_hz: float,
        *,
        input_std: float = 1.0,
        input_mean: float | None = None,
        output_mean: float | None = None,
        input_unit: str = "N",
        output_unit: str = "m",
    ) -> Any:
        """Return an identifier of the class ``identifier`` without any data.

        Args:
            sample_rate_hz: of the samples.
            input_std: expected standard deviation of the input, in its unit; its order of magnitude is sufficient.
            input_mean: operating point of the input; None for the first received sample.
            output_mean: operating point of the output; None for the first received sample.
            input_unit: unit of the input.
            output_unit: unit of the output.

        Raises:
            UnusableInputError: the sample rate is not positive.
        """
        units = (input_unit, output_unit)
        return self.identifier(self, sample_rate_hz, input_std, (input_mean, output_mean), units)

    def run(self, prepared: PreparedRecord, **state: Any) -> Any:
        """Return the identifier after the fitted part of a record; ``state`` is passed to its class."""
        record = prepared.record
        input_std = float(np.nanstd(record.input[prepared.part]))
        means = (prepared.input_mean, prepared.output_mean)
        begin = max(0, int(prepared.part.start) - prepared.memory_samples + 1)
        identifier = self.identifier(self, record.sample_rate_hz, input_std, means, begin=begin, **state)
        y = record.output[begin : prepared.part.stop].copy()
        y[: prepared.part.start - begin] = np.nan  # before the fitted part only the inputs are used
        identifier.batch(record.input[begin : prepared.part.stop], y)
        return identifier

    @abstractmethod
    def model_of(self, identifier: Any, prepared: PreparedRecord) -> OnlineModel:
        """Return the model of an identifier, scored on a prepared record."""


def lags_of(engine: OnlineEngine, sample_rate_hz: float) -> int:
    """Return the number of lags in an engine's memory at a sample rate.

    Raises:
        UnusableInputError: the sample rate is not positive.
    """
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
        raise UnusableInputError(
            "record.sample_rate", "the sample rate must be positive, got {rate:g} Hz", rate=sample_rate_hz
        )
    if engine.memory is None:
        return typical_samples(engine.usual_memory_s, sample_rate_hz)
    return memory_in_samples(engine.memory, sample_rate_hz)
