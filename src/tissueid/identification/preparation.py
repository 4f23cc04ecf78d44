"""From a record to what a fit with a finite memory can use, with one line of refusal where it cannot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.validation import scored_samples
from tissueid.records import Record

SAMPLES_PER_PARAMETER = 3
"""Below this many samples a parameter a fit is warned of (Chen 2010, 3.1.1, test length)."""


@dataclass(frozen=True)
class Prepared:
    """A record looked over for a fit.

    ``part`` is the stretch to fit. ``used`` masks, shape (n,), the outputs that may be fitted: in that part,
    received, and with every input of their memory received. ``input_mean`` is taken over the received samples of the
    part, ``output_mean`` over those too, or with gaps over the used ones.
    """

    record: Record
    part: slice
    used: Mask
    memory_samples: int
    gapless: bool
    input_mean: float
    output_mean: float
    warnings: tuple[str, ...]


def memory_in_samples(memory: float, sample_rate_hz: float) -> int:
    """Return the number of lags that a memory in seconds holds, at least one."""
    return max(1, round(memory * sample_rate_hz))


def prepare(record: Record, fit_part: slice | None, memory: float, n_parameters: int | None = None) -> Prepared:
    """Look a record over: what can be fitted, and whether that is enough.

    Args:
        record: the data.
        fit_part: contiguous part of the record to fit; inputs before it still count as memory.
        memory: seconds.
        n_parameters: parameters of the fit; None for one a lag.

    Raises:
        UnusableInputError: nothing was received, the input or output does not vary, the memory is longer than the
            part, or fewer samples than parameters are left.
    """
    part = slice(*(fit_part or slice(None)).indices(len(record))[:2])
    lags = memory_in_samples(memory, record.sample_rate_hz)
    parameters = lags if n_parameters is None else n_parameters
    input_mean = _mean(record.input[part], f"the input ({record.input_name})")
    output_mean = _mean(record.output[part], f"the output ({record.output_name})")
    length = part.stop - part.start
    if lags > length:
        raise UnusableInputError(
            f"the memory of {memory:g} s is longer than the {length / record.sample_rate_hz:g} s of record to fit"
        )
    used = scored_samples(record, lags, fit_part)
    count = int(used.sum())
    if count < parameters:
        raise UnusableInputError(
            f"{count} usable samples cannot carry {parameters} parameters: record longer, or shorten the memory"
        )
    warnings = []
    if count < SAMPLES_PER_PARAMETER * parameters:
        warnings.append(
            f"{count} usable samples for {parameters} parameters is fewer than {SAMPLES_PER_PARAMETER} each: "
            "record longer, or shorten the memory"
        )
    missing = length - int(record.valid[part].sum())
    lost = missing - len(record[part].joints)
    if lost:
        warnings.append(f"{lost} of {length} samples were not received; they and what depends on them are left out")
    return Prepared(
        record=record,
        part=part,
        used=used,
        memory_samples=lags,
        gapless=missing == 0,
        input_mean=input_mean,
        output_mean=output_mean if missing == 0 else float(np.mean(record.output[used])),
        warnings=tuple(warnings),
    )


def _mean(values: Array, name: str) -> float:
    """Mean of the received values (n,) of a signal that is fit to be identified."""
    received = values[np.isfinite(values)]
    if received.size == 0:
        raise UnusableInputError(f"{name} holds no received sample")
    low, high = float(received.min()), float(received.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        raise UnusableInputError(f"{name} is constant: there is nothing to identify")
    return float(received.mean())
