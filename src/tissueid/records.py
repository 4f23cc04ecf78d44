"""Record: one input and one output on a common clock, the data of every identification engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.stored_values import MaybeNumber, Number

_LARGEST = 1e30
"""Largest plausible magnitude of a signal; its inverse is the smallest. Squares beyond it would overflow."""


@dataclass(frozen=True)
class Record:
    """Input and output of a system, sampled together.

    ``input`` and ``output`` have shape (n,), float64, in the SI units ``input_unit`` and ``output_unit``. NaN marks a
    sample that was not received; infinity counts as one. Such samples are never filled in. ``joints`` are the indices,
    in order, of the separating samples between joined records. ``withheld`` are first sample and end of stretches whose
    outputs are NaN because they are held out for validation.

    Raises:
        UnusableInputError: the lengths differ, the sample rate is not positive, there are no samples, or a magnitude
            is implausible.
    """

    input: NDArray[np.float64]
    output: NDArray[np.float64]
    sample_rate_hz: float
    input_name: str = "force"
    output_name: str = "position"
    input_unit: str = "N"
    output_unit: str = "m"
    joints: tuple[int, ...] = ()
    withheld: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        for name in ("input", "output"):
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 1:
                raise UnusableInputError(
                    "record.dimensions",
                    "the {signal} of a record must have one dimension, not {count}",
                    signal=name,
                    count=values.ndim,
                )
            if np.isinf(values).any():
                values = np.where(np.isinf(values), np.nan, values)
            largest = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
            if largest > _LARGEST or 0.0 < largest < 1.0 / _LARGEST:
                raise UnusableInputError(
                    "record.magnitude",
                    "the {signal} of a record goes to {largest:.3g}: no instrument measures that, check the units",
                    signal=name,
                    largest=largest,
                )
            object.__setattr__(self, name, values)
        if self.input.size != self.output.size:
            raise UnusableInputError(
                "record.lengths",
                "input and output differ in length: {input} and {output} samples",
                input=self.input.size,
                output=self.output.size,
            )
        if self.input.size == 0:
            raise UnusableInputError("record.empty", "the record is empty")
        if not (np.isfinite(self.sample_rate_hz) and self.sample_rate_hz > 0):
            raise UnusableInputError(
                "record.rate", "the sample rate must be positive, not {rate:g}", rate=self.sample_rate_hz
            )

    def __len__(self) -> int:
        return self.input.size

    @property
    def time(self) -> NDArray[np.float64]:
        """Time from the first sample, s, shape (n,)."""
        return np.arange(len(self)) / self.sample_rate_hz

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Whether both input and output were received, shape (n,)."""
        return np.isfinite(self.input) & np.isfinite(self.output)

    def __getitem__(self, part: slice) -> Record:
        """Return a contiguous part of the record."""
        first, end, _ = part.indices(len(self))
        joints = tuple(joint - first for joint in self.joints if first <= joint < end)
        withheld = tuple(
            (max(begin, first) - first, min(stop, end) - first)
            for begin, stop in self.withheld
            if begin < end and stop > first
        )
        return replace(self, input=self.input[part], output=self.output[part], joints=joints, withheld=withheld)


def joined(records: Sequence[Record]) -> Record:
    """Join records into one, so that an engine can fit them together.

    A NaN sample separates two records. No memory, initial state or score of an engine reaches across it, so the
    records share only the estimated parameters.

    Raises:
        UnusableInputError: there are no records, or they differ in sample rate, signals or units.
    """
    if not records:
        raise UnusableInputError("record.none", "there are no records to join")
    first = records[0]
    for other in records[1:]:
        if not np.isclose(other.sample_rate_hz, first.sample_rate_hz, rtol=1e-6, atol=0.0):
            raise UnusableInputError(
                "record.rates_differ",
                "records of {first:g} and {other:g} Hz cannot be fitted together: resample",
                first=first.sample_rate_hz,
                other=other.sample_rate_hz,
            )
        if _signals(other) != _signals(first):
            raise UnusableInputError(
                "record.signals_differ", "records of different signals or units cannot be fitted together"
            )
    gap = np.array([np.nan])
    inputs = [part for record in records for part in (gap, record.input)][1:]
    outputs = [part for record in records for part in (gap, record.output)][1:]
    starts = np.cumsum([0, *(len(record) + 1 for record in records[:-1])])
    joints = [int(start) - 1 for start in starts[1:]]
    joints += [int(start) + joint for start, record in zip(starts, records, strict=True) for joint in record.joints]
    withheld = [
        (int(start) + begin, int(start) + stop)
        for start, record in zip(starts, records, strict=True)
        for begin, stop in record.withheld
    ]
    return replace(
        first,
        input=np.concatenate(inputs),
        output=np.concatenate(outputs),
        joints=tuple(sorted(joints)),
        withheld=tuple(withheld),
    )


def _signals(record: Record) -> tuple[str, str, str, str]:
    return record.input_name, record.output_name, record.input_unit, record.output_unit


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation; ``std`` is None if it is unknown."""

    value: Number
    std: MaybeNumber = None

    def __str__(self) -> str:
        return f"{self.value:.4g}" if self.std is None else f"{self.value:.4g} ± {self.std:.2g}"
