"""Preparation of a record for a fit with finite memory: usable samples, means and warnings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
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


def complete_after_rest(finite: Mask, length: int) -> Mask:
    """Return the mask (n,) of samples whose last ``length`` samples are known, where all were before the first one."""
    padded = np.concatenate([np.ones(length - 1, dtype=np.bool_), finite])
    return complete_windows(padded, length)[length - 1 :]


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
                "record.not_contiguous",
                "a part of a record must be contiguous, not every {step} samples",
                step=part.step,
            )
        mask[:] = False
        mask[part] = True
    if not mask.any():
        raise UnusableInputError("record.empty_part", "the chosen part of the record has no samples")
    return mask


def part_length(record: Record, part: slice | None) -> int:
    """Return the number of samples of a part of a record; of all of it for None."""
    return len(range(*(part or slice(None)).indices(len(record))))


def scored_samples(record: Record, memory_samples: int, part: slice | None = None) -> Mask:
    """Return the mask (n,) of the outputs in ``part`` that a model with this memory can simulate."""
    return (
        part_mask(len(record), part)
        & np.isfinite(record.output)
        & complete_windows(np.isfinite(record.input), memory_samples)
    )


_FILTER_ORDER = 4


def detrended(record: Record) -> Record:
    """Return a record without the linear trends of input and output (Chen 2010, C.2.2). Means and gaps are kept.

    The trend of the input is removed too, because the output contains the response to it.
    """
    t = np.arange(len(record)) / record.sample_rate_hz

    def level(values: Array) -> Array:
        finite = np.isfinite(values)
        if int(finite.sum()) < 3:
            return values
        away = t - t[finite].mean()
        return np.asarray(values - float(away[finite] @ values[finite] / (away[finite] @ away[finite])) * away)

    return replace(record, input=level(record.input), output=level(record.output))


def band_filtered(record: Record, low_hz: float | None, high_hz: float | None) -> Record:
    """Return a record of which input and output are limited to a band (Chen 2010, C.2.3).

    Butterworth filter of order 4, forwards and backwards, so that the linear relation of input and output is unchanged;
    that of a nonlinear system is not. The means are kept. Each uninterrupted run is filtered on its own; runs too short
    for the filter are discarded.

    Args:
        record: input and output.
        low_hz: lower edge of the band; None to keep all lower frequencies.
        high_hz: upper edge; None to keep all higher frequencies.

    Raises:
        UnusableInputError: the edges are not in order between 0 and half the sample rate, or no run is long enough.
    """
    nyquist = 0.5 * record.sample_rate_hz
    edges = [edge for edge in (low_hz, high_hz) if edge is not None]
    if not edges:
        return record
    if not (np.all(np.diff(edges) > 0.0) and edges[0] > 0.0 and edges[-1] < nyquist):
        raise UnusableInputError(
            "record.band",
            "the edges of the band must rise and lie between 0 and {nyquist:g} Hz, got {edges}",
            nyquist=nyquist,
            edges=", ".join(f"{edge:g}" for edge in edges),
        )
    kind = "bandpass" if len(edges) == 2 else "highpass" if high_hz is None else "lowpass"
    sections = signal.butter(_FILTER_ORDER, edges if len(edges) == 2 else edges[0], kind, fs=2 * nyquist, output="sos")
    padding = min(len(record) // 4, round(record.sample_rate_hz / edges[0]))
    filtered = {}
    finite = np.isfinite(record.input) & np.isfinite(record.output)
    for name in ("input", "output"):
        values = getattr(record, name)
        passed = np.full(values.size, np.nan)
        mean = float(values[finite].mean()) if finite.any() else 0.0
        for first, end in finite_runs(finite):
            if end - first > max(padding, 3 * (2 * len(sections) + 1)):
                passed[first:end] = mean + signal.sosfiltfilt(sections, values[first:end] - mean, padlen=padding)
        filtered[name] = passed
    if not np.any(np.isfinite(filtered["input"])):
        raise UnusableInputError(
            "record.band_too_short", "no uninterrupted part of the record is long enough for the band filter"
        )
    return replace(record, input=filtered["input"], output=filtered["output"])


SAMPLES_PER_PARAMETER = 3
"""Samples per parameter below which a fit gets a warning (Chen 2010, 3.1.1, test length)."""


@dataclass(frozen=True)
class PreparedRecord:
    """A record prepared for a fit.

    ``part`` is the part to fit. ``used`` (n,) marks the outputs that can be fitted: in that part, received, and with
    all inputs of their memory received. ``input_mean`` is the mean of the received samples of the part, and so is
    ``output_mean`` in a record without gaps; with gaps it is the mean of the used samples.
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
    """Return the number of lags of a memory in seconds, at least one."""
    return max(1, round(memory * sample_rate_hz))


_SLOWEST_HZ, _FASTEST_HZ = 500.0, 10_000.0
"""Sample rates of an indenter; at others a time that is typical of tissue means nothing."""


def typical_samples(seconds: float, sample_rate_hz: float) -> int:
    """Return a time that is typical of tissue as a number of samples, at least one.

    At sample rates that no indenter has, it is the number of samples at the nearest rate that one has: the dynamics of
    another system are not those of tissue, but a record is sampled in proportion to them.
    """
    return memory_in_samples(seconds, min(max(sample_rate_hz, _SLOWEST_HZ), _FASTEST_HZ))


def checked_samples(u: Array, y: Array) -> tuple[Array, Array]:
    """Return inputs (n,) and outputs (n,) as numbers.

    Raises:
        UnusableInputError: the two differ in shape.
    """
    u, y = np.asarray(u, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if u.ndim != 1 or u.shape != y.shape:
        raise UnusableInputError(
            "online.lengths",
            "inputs and outputs must have the same length, got {inputs} and {outputs}",
            inputs=int(u.size),
            outputs=int(y.size),
        )
    return u, y


def prepare(record: Record, fit_part: slice | None, memory: float, n_parameters: int | None = None) -> PreparedRecord:
    """Select the samples that can be fitted, and check that there are enough.

    Args:
        record: the data.
        fit_part: contiguous part of the record to fit; inputs before it still count as memory.
        memory: seconds.
        n_parameters: parameters of the fit; None for one per lag.

    Raises:
        UnusableInputError: nothing was received, the input or output does not vary, the memory is longer than the part,
            or there are fewer samples than parameters.
    """
    part = slice(*(fit_part or slice(None)).indices(len(record))[:2])
    lags = memory_in_samples(memory, record.sample_rate_hz)
    parameters = lags if n_parameters is None else n_parameters
    which_input = Message("record.input", "the input ({name})", name=record.input_name)
    which_output = Message("record.output", "the output ({name})", name=record.output_name)
    input_mean = _mean(record.input[part], which_input)
    output_mean = _mean(record.output[part], which_output)
    length = part.stop - part.start
    if lags > length:
        raise UnusableInputError(
            "record.shorter_than_memory",
            "the memory of {memory:g} s is longer than the {seconds:g} s of record to fit",
            memory=memory,
            seconds=length / record.sample_rate_hz,
        )
    used = scored_samples(record, lags, fit_part)
    count = int(used.sum())
    if count < parameters:
        raise UnusableInputError(
            "record.too_few_samples",
            "{count} usable samples are too few for {parameters} parameters: record longer, or shorten the memory",
            count=count,
            parameters=parameters,
        )
    warnings: list[str] = []
    if count < SAMPLES_PER_PARAMETER * parameters:
        warnings.append(
            Message(
                "record.few_samples",
                "{count} usable samples for {parameters} parameters are fewer than {fewest} for each: record longer, "
                "or shorten the memory",
                count=count,
                parameters=parameters,
                fewest=SAMPLES_PER_PARAMETER,
            )
        )
    missing = length - int(record.valid[part].sum())
    kept_back = sum(int(np.isfinite(record.input[part][a:b]).sum()) for a, b in record[part].withheld)
    lost = missing - kept_back - sum(part.start <= joint < part.stop for joint in record.joints)
    if lost:
        warnings.append(
            Message(
                "record.lost_samples",
                "{lost} of {length} samples were not received; outputs that depend on them are not fitted",
                lost=lost,
                length=length,
            )
        )
    return PreparedRecord(
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
    """Return the mean of the received values (n,). Raise if there are none, or if they do not vary."""
    received = values[np.isfinite(values)]
    if received.size == 0:
        raise UnusableInputError("record.no_sample", "{signal} has no received sample", signal=name)
    low, high = float(received.min()), float(received.max())
    if high - low <= 1e-12 * max(abs(low), abs(high)):
        raise UnusableInputError("record.constant", "{signal} is constant: there is nothing to identify", signal=name)
    return float(received.mean())
