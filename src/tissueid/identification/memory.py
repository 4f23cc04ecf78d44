"""Impulse response of an engine: the model, and its length: given, usual for tissue, or estimated from the record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Engine, Model, option
from tissueid.identification.impulse_response import Correlator, convolve_at_rest, toeplitz_solve
from tissueid.identification.preparation import memory_in_samples, part_length, part_mask, typical_samples
from tissueid.identification.second_order import HOLD, Hold
from tissueid.identification.second_order_fit import SecondOrderFit, hold_of
from tissueid.language import marked
from tissueid.records import Record

LONGEST_SAMPLES = 20_000
"""Largest number of lags of a response: its equations take 3 GB."""

_RUNGS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
"""Numbers of lags that are tried, at the sample rate and then at an eighth of it, and so on."""
_SLOWER = 8
_LEAST_SAMPLES_PER_LAG = 8
_NEGLIGIBLE = 1e-4
"""Share of the explained output power that lags may add without being needed."""
_RIDGE = 1e-3
"""Ridge relative to the input power, as in ``lms``."""
_TOO_SHORT = 1.5
"""Ratio of the estimated to the usual memory from which the usual one is too short."""


@dataclass(frozen=True, eq=False)
class FirModel(Model):
    """A linear finite impulse response about an operating point.

    ``impulse_response`` (lags,) is h of Eq. 3.2, output units per input unit and second, at ``lag_s`` (lags,).
    ``second_order`` is the parametric fit.
    """

    impulse_response: Array
    lag_s: Array
    input_mean: float
    output_mean: float
    second_order: SecondOrderFit

    def simulate(self, u: Array) -> Array:
        """Simulate in free run: input (n,), output (n,), at rest at the mean input before the first sample."""
        kernel = self.impulse_response / self.sample_rate_hz
        return self.output_mean + convolve_at_rest(kernel, np.asarray(u, dtype=np.float64) - self.input_mean)


class MemoryEngine(Engine):
    """An engine with an option ``memory``, which comes from the record where it is not given."""

    usual_memory_s: ClassVar[float] = 0.125
    """Memory for tissue, s: force to position at the sample rate of an indenter."""
    memory_margin: ClassVar[float] = 2.0
    """Ratio of the memory for other records to the least one that explains a linear response."""

    memory: float | None = option(
        None,
        marked("Memory"),
        marked("Length of the impulse response, s; from the record if not given"),
        gt=0.0,
        le=1e7,
    )

    hold: Hold = HOLD

    @property
    def memory_s(self) -> float:
        """The memory, s; the usual one if it is not given."""
        return self.usual_memory_s if self.memory is None else self.memory

    def for_record(self, record: Record, fit_part: slice | None) -> Self:
        """Return the specification with the memory and the hold of this record.

        Raises:
            UnusableInputError: the memory has more than ``LONGEST_SAMPLES`` samples.
        """
        memory = self.memory or automatic_memory(record, fit_part, self.usual_memory_s, self.memory_margin)
        samples = memory_in_samples(memory, record.sample_rate_hz)
        if samples > LONGEST_SAMPLES:
            raise UnusableInputError(
                "record.memory_too_long",
                "the memory of {memory:g} s is {samples} samples, and at most {limit} are possible: shorten it, or "
                "import the record at a lower sample rate",
                memory=memory,
                samples=samples,
                limit=LONGEST_SAMPLES,
            )
        hold = hold_of(record, fit_part) if self.hold == "auto" else self.hold
        return self.model_copy(update={"memory": memory, "hold": hold})


def automatic_memory(record: Record, fit_part: slice | None, usual_s: float, margin: float) -> float:
    """Return the length of the impulse response of a record, s.

    It is ``usual_s`` for force to position at the sample rate of an indenter, and for another record at such a rate
    unless its response is longer. Otherwise it is the smallest number of lags that explains the output.

    Args:
        record: the data.
        fit_part: contiguous part of it; None for all.
        usual_s: length for tissue, s.
        margin: ratio of the length to that number of lags.
    """
    rate = record.sample_rate_hz
    usual = typical_samples(usual_s, rate)
    of_tissue = usual == memory_in_samples(usual_s, rate)
    if of_tissue and (record.input_unit, record.output_unit) == ("N", "m"):
        return usual_s
    if part_length(record, fit_part) < _LEAST_SAMPLES_PER_LAG * _RUNGS[0]:
        return usual_s if of_tissue else usual / rate
    complete = part_mask(len(record), fit_part) & np.isfinite(record.input) & np.isfinite(record.output)
    places = np.flatnonzero(complete)
    if places.size < _LEAST_SAMPLES_PER_LAG * _RUNGS[0]:
        return usual_s if of_tissue else usual / rate
    inside = slice(int(places[0]), int(places[-1]) + 1)
    signals = [
        np.where(complete[inside], values[inside] - values[complete].mean(), 0.0)
        for values in (record.input, record.output)
    ]
    if not np.any(np.diff(signals[0])):  # constant: every fit refuses it
        return usual_s if of_tissue else usual / rate
    needed = margin * _needed_lags(signals[0], signals[1])
    if of_tissue and needed <= _TOO_SHORT * usual:
        return usual_s
    return needed / rate


def _needed_lags(x: Array, y: Array) -> int:
    """Return the smallest number of lags that explains the output y (n,), for an input x (n,), both without mean."""
    step = 1
    while True:
        rungs = [lags for lags in _RUNGS if lags * _LEAST_SAMPLES_PER_LAG <= x.size] or [min(_RUNGS[0], x.size)]
        lags = _needed_rung(x, y, rungs)
        if lags < _RUNGS[-2] or x.size < _SLOWER * _LEAST_SAMPLES_PER_LAG * lags // 2:
            return lags * step
        step *= _SLOWER
        size = x.size // _SLOWER * _SLOWER
        x, y = (values[:size].reshape(-1, _SLOWER).mean(axis=1) for values in (x, y))


def _needed_rung(x: Array, y: Array, rungs: list[int]) -> int:
    """Return the smallest of several numbers of lags that explains the output, with Akaike's penalty for each lag."""
    correlator = Correlator(x, rungs[-1])
    column, right, power = correlator.auto(), correlator.cross(y), float(y @ y) / y.size
    column[0] *= 1.0 + _RIDGE
    explained = np.array([float(right[:lags] @ toeplitz_solve(column[:lags], right[:lags])) for lags in rungs])
    chance = 2.0 * max(power - float(explained.max()), 0.0) / y.size
    gain = explained - chance * np.array(rungs)
    enough = gain >= float(gain.max()) - _NEGLIGIBLE * max(float(explained.max()), 0.0)
    return rungs[int(np.argmax(enough))]
