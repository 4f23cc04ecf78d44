"""Highest VAF that a model can reach, from repeats of a test.

Two tests with the same command differ by components that no model of the tissue predicts: sensor noise, movement of the
patient, spontaneous changes of the tissue. Their variance is the floor of the simulation error, and therefore bounds
the VAF.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.impulse_response import convolve_at_rest, factor_input, with_extra_memory
from tissueid.identification.preparation import memory_in_samples, part_mask, prepare
from tissueid.identification.validation.scores import ratio_std
from tissueid.messages import Listing, Message
from tissueid.records import Estimate, Record

Lags = NDArray[np.int_]

_TAPER = 0.05

_BLOCK_S = 0.25
"""Length of the aligned stretches, s."""

_EQUAL_MISFIT = 1.5
"""Ratio to the smallest misfit up to which a shift counts as equally good."""

_LARGEST_MISFIT = 0.5
"""Misfit, relative to the variance of the input, above which two stretches belong to different commands."""


@dataclass(frozen=True, eq=False)
class Ceiling:
    """The highest VAF that a model could reach on repeated tests.

    ``vaf_percent`` is for a model with the actual input: the linear response to the differences of the input between
    repeats is subtracted. ``vaf_same_input_percent`` counts those differences as noise. ``noise_rms`` is the noise
    floor of the output and ``output_rms`` its standard deviation, in the unit of the output.
    ``input_difference_percent`` is the rms difference of the input between repeats, relative to the rms of the input.
    ``shifts`` (repeats,) is the initial lag of each behind the first, in samples. ``noise`` (repeats, n) is the
    remaining difference of each repeat, NaN if unknown, scaled to the noise of one repeat.
    """

    vaf_percent: Estimate
    vaf_same_input_percent: Estimate
    noise_rms: Estimate
    output_rms: float
    input_difference_percent: float
    repeats: int
    n_samples: int
    shifts: tuple[int, ...]
    noise: Array
    findings: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    """Repeats that were not used, with the reason."""

    def explained_percent(self, vaf_percent: float) -> float:
        """Return the share of the explainable variance that a model of this VAF explains."""
        return 100.0 * vaf_percent / self.vaf_percent.value


def ceiling(records: Sequence[Record], part: slice | None = None, memory: float = 0.125) -> Ceiling:
    """Estimate the noise floor and the highest VAF from two or more repeats of one command.

    If the repeats differ slowly, because the tissue relaxes or the patient moves, a model fitted to one of them may
    exceed the ceiling on that one: the ceiling is for a model that depends only on the input.

    Args:
        records: the repeats. Stretches of them are shifted by whole samples to align their inputs.
        part: contiguous part to compare, on the samples of the first record.
        memory: of the linear response to differences of the input, s.

    Raises:
        UnusableInputError: fewer than two records, different sample rates, inputs that do not match, or too few common
            samples.
    """
    if len(records) < 2:
        raise UnusableInputError("ceiling.too_few_repeats", "a noise floor needs at least two repeats of one command")
    rate = records[0].sample_rate_hz
    if any(not np.isclose(record.sample_rate_hz, rate, rtol=1e-6, atol=0.0) for record in records):
        raise UnusableInputError(
            "ceiling.sample_rates", "repeats with different sample rates cannot be compared: resample them"
        )
    lags = memory_in_samples(memory, rate)
    block = max(2, min(round(_BLOCK_S * rate), len(records[0]) // 4))
    shifts = [_shifts(records[0].input, record.input, min(lags, block), block) for record in records]
    u, y = _aligned(records, shifts, block)  # (repeats, n)
    together = Record(u.mean(axis=0), y.mean(axis=0), rate)
    prepared = prepare(together, part, memory)
    used = prepared.used & part_mask(u.shape[1], part)
    solved = factor_input(with_extra_memory(prepared), taper=_TAPER)
    kernel = solved.kernel(together.output)[: prepared.memory_samples]

    difference = y - together.output
    answer = np.array([convolve_at_rest(kernel, row) for row in u - together.input])
    floor = _floor(np.where(used, difference - answer, np.nan))
    raw = _floor(np.where(used, difference, np.nan))
    output = y[:, used] - y[:, used].mean(axis=1, keepdims=True)
    power = np.mean(output**2, axis=0)
    centred = u[:, used] - u[:, used].mean(axis=1, keepdims=True)
    input_difference = float(np.sqrt(np.mean(_floor(np.where(used, u - together.input, np.nan))[:, used] ** 2)))
    difference_percent = 100.0 * input_difference / float(np.sqrt(np.mean(centred**2)))
    best = _ceiling(floor[:, used], power, rate)
    noise_power = np.mean(floor[:, used] ** 2, axis=0)
    noise_rms = float(np.sqrt(np.mean(noise_power)))
    spread = ratio_std(noise_power, np.ones(noise_power.size), rate)
    findings: list[str] = [
        Message(
            "ceiling.best",
            "no model is expected to exceed {percent:.1f} ± {std:.1f} % on these repeats",
            percent=best.value,
            std=best.std or 0.0,
        )
    ]
    for number, shift in enumerate(shifts[1:], start=2):
        changes = np.flatnonzero(np.diff(shift))
        if changes.size:
            places = tuple(
                Message(
                    "ceiling.jump",
                    "{samples} at {seconds:.2f} s",
                    samples=f"{shift[c + 1] - shift[c]:+d}",
                    seconds=(c + 1) * block / rate,
                )
                for c in changes
            )
            findings.append(
                Message(
                    "ceiling.lost_samples",
                    "repeat {number} is shifted against the first by lost samples that are not marked: {places}",
                    number=number,
                    places=Listing(places),
                )
            )
    return Ceiling(
        vaf_percent=best,
        vaf_same_input_percent=_ceiling(raw[:, used], power, rate),
        noise_rms=Estimate(noise_rms, spread / (2.0 * noise_rms) if noise_rms > 0.0 else 0.0),
        output_rms=float(np.sqrt(np.mean(power))),
        input_difference_percent=difference_percent,
        repeats=len(records),
        n_samples=int(used.sum()),
        shifts=tuple(int(shift[0]) for shift in shifts),
        noise=floor,
        findings=tuple(findings),
    )


def _floor(difference: Array) -> Array:
    """Return zero-mean differences (repeats, n) from the mean of all, scaled to the noise of one repeat."""
    repeats = difference.shape[0]
    centred = difference - np.nanmean(difference, axis=1, keepdims=True)
    return np.asarray(centred * np.sqrt(repeats / (repeats - 1)), dtype=np.float64)


def _ceiling(floor: Array, power: Array, rate: float) -> Estimate:
    """Return the ceiling from noise (repeats, n) and the mean output power (n,)."""
    noise = np.mean(floor**2, axis=0)
    value = 100.0 * (1.0 - float(np.mean(noise)) / float(np.mean(power)))
    return Estimate(value, 100.0 * ratio_std(noise, power, rate))


def _shifts(first: Array, other: Array, most: int, block: int) -> Lags:
    """Return the lag in samples of the other input (m,) behind the first (n,), shape (blocks,), block by block.

    A block keeps the shift of the one before it if that fits about as well, for example in a preload, where nothing
    moves.
    """
    shifts = []
    last = 0
    alike = False
    reach = np.pad(other, (most, most + max(0, first.size - other.size)), constant_values=np.nan)
    for start in range(0, first.size - block + 1, block):
        stretch = first[start : start + block]
        around = reach[start : start + block + 2 * most]
        distance = np.lib.stride_tricks.sliding_window_view(around, block) - stretch  # (2 most + 1, block)
        finite = np.isfinite(distance)
        enough = finite.sum(axis=1) >= block // 2
        if enough.any():
            squares = np.sum(np.where(finite, distance, 0.0) ** 2, axis=1) / np.maximum(1, finite.sum(axis=1))
            squares[~enough] = np.inf
            near = np.flatnonzero(squares <= _EQUAL_MISFIT * np.min(squares)) - most
            last = int(near[np.argmin(np.abs(near - last))])
            alike |= bool(np.min(squares) < _LARGEST_MISFIT * np.nanvar(stretch))
        shifts.append(last)
    if not alike:
        raise UnusableInputError(
            "ceiling.different_inputs", "the inputs of the repeats differ: choose tests of one command"
        )
    return np.array(shifts, dtype=np.int_)


def _aligned(records: Sequence[Record], shifts: Sequence[Lags], block: int) -> tuple[Array, Array]:
    """Return inputs and outputs (repeats, n) on the samples of the first record; NaN where any is missing."""
    n = len(records[0])
    signals = np.full((2, len(records), n), np.nan)
    for row, (record, shift) in enumerate(zip(records, shifts, strict=True)):
        of_sample = np.concatenate([np.repeat(shift, block), np.full(n - shift.size * block, shift[-1])])
        source = np.arange(n) + of_sample
        inside = (source >= 0) & (source < len(record))
        for change in np.flatnonzero(np.diff(shift)):  # the exact place of the change within two blocks is unknown
            inside[change * block : (change + 2) * block] = False
        signals[0, row, inside] = record.input[source[inside]]
        signals[1, row, inside] = record.output[source[inside]]
    signals[:, :, ~np.isfinite(signals).all(axis=(0, 1))] = np.nan
    return signals[0], signals[1]
