"""Masks of the samples that a fit or a score can use: received, in a part, and with a complete memory.

Samples that were not received are NaN and are never interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Mask
from tissueid.messages import Message
from tissueid.records import Record


def complete_windows(finite: Mask, length: int) -> Mask:
    """Return the mask (n,) of the samples whose window of ``length`` samples, ending there, is complete and all True.

    If ``finite`` (n,) marks the received inputs, these are the outputs that a model with that memory can simulate.
    """
    missing = np.concatenate([[0], np.cumsum(~finite)])  # (n + 1,)
    complete = np.zeros(finite.size, dtype=np.bool_)
    if finite.size >= length:
        complete[length - 1 :] = missing[length:] == missing[:-length]
    return complete


def finite_runs(finite: Mask) -> NDArray[np.intp]:
    """Return first sample and end of each run of True, shape (runs, 2)."""
    steps = np.diff(np.concatenate([[0], finite.astype(np.int8), [0]]))
    return np.flatnonzero(steps).reshape(-1, 2)


def part_mask(n: int, part: slice | None) -> Mask:
    """Return the mask (n,) of a contiguous part of a record; all True for None.

    Raises:
        UnusableInputError: the part has a step or holds no sample.
    """
    mask = np.ones(n, dtype=np.bool_)
    if part is not None:
        if part.step not in (None, 1):
            raise UnusableInputError(
                Message(
                    "record.not_contiguous",
                    "a part of a record must be contiguous, not every {step} samples",
                    step=part.step,
                )
            )
        mask[:] = False
        mask[part] = True
    if not mask.any():
        raise UnusableInputError(Message("record.empty_part", "the chosen part of the record has no samples"))
    return mask


def scored_samples(record: Record, memory_samples: int, part: slice | None = None) -> Mask:
    """Return the mask (n,) of the outputs in ``part`` that a model with this memory can simulate."""
    return (
        part_mask(len(record), part)
        & np.isfinite(record.output)
        & complete_windows(np.isfinite(record.input), memory_samples)
    )
