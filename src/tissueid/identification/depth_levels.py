"""Constant levels of a stepped input, with small noise about each (Chen 2010, 3.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage, signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import finite_runs, typical_samples
from tissueid.messages import Message
from tissueid.records import Record

_STEP = 7.0
"""Threshold of a step: change of the running mean, in robust standard deviations of that change."""

_NORMAL_MAD = 1.4826

_MEMORY_S = 0.125
"""Width of the running means, s, by which a record is recognised as a localized test."""
_FEWEST_LEVELS = 3
_LARGEST_NOISE = 0.3
"""Greatest standard deviation of the noise about the levels of a localized test, relative to their range."""
_LEAST_CORRELATION = 0.15
"""Least correlation, at any lag, of output and input within the levels of a localized test.

It distinguishes noise that is played from that of the sensors about bare steps: 0.2 to 0.8 against 0.05 to 0.11.
"""

_CHANCE = 4.0
"""Largest correlation of unrelated noise over all lags, in its standard deviations, 1 / sqrt(n)."""

_RECORD_STEPS = Message(
    "localized.no_levels",
    "the input has no constant levels: record a few levels of force, each several memories long with small noise "
    "about it, or join records about different levels",
)


@dataclass(frozen=True)
class Level:
    """A stretch of a record at one input level: first sample, end, and direction of the step to it, 1 or -1.

    ``direction`` is 0 for the first level of a record. After lost samples it is that of the step which they hide, or of
    the level that they interrupt.
    """

    first: int
    end: int
    direction: int


def find_levels(
    x: Array, used: Mask, memory_samples: int, given: Sequence[float] | None = None, joints: Sequence[int] = ()
) -> tuple[Level, ...]:
    """Return the stretches of constant level in an input.

    The means of one memory before and after each sample are compared; a step is a difference far above the scatter of
    all such differences, estimated from their median. Gaps always separate levels.

    Args:
        x: input (n,), NaN for samples that were not received.
        used: mask (n,) of the samples that may be fitted.
        memory_samples: samples of one memory.
        given: the levels in the unit of the input; each stretch is then assigned to the nearest.
        joints: samples at which records were joined: no step is known across them.

    Raises:
        UnusableInputError: there are fewer than two levels.
    """
    runs = _runs(x, used, memory_samples)
    threshold = _threshold(x, runs, memory_samples)
    if given:
        steps = _steps_to(x, runs, memory_samples, np.sort(given))
    else:
        steps = _steps_found(x, runs, memory_samples, threshold)
    levels: list[Level] = []
    before: float | None = None
    for (first, end), inner in zip(runs, steps, strict=True):
        direction, gap = 0, levels[-1].end if levels else 0
        if any(gap <= joint < first for joint in joints):
            before = None
        for begin, stop in pairwise([first, *inner, end]):
            mean = float(np.mean(x[begin:stop]))
            if before is not None and (begin != first or abs(mean - before) > threshold):
                direction = int(np.sign(mean - before))
            elif before is not None:
                direction = levels[-1].direction  # lost samples within a level
            levels.append(Level(begin, stop, direction))
            before = mean
    if len(levels) < 2:
        raise UnusableInputError(_RECORD_STEPS)
    return tuple(levels)


def is_stepped(x: Array, used: Mask, memory_samples: int) -> bool:
    """Return whether an input (n,) steps from level to level within a run; arguments as :func:`find_levels`."""
    runs = _runs(x, used, memory_samples)
    return any(_steps_found(x, runs, memory_samples, _threshold(x, runs, memory_samples)))


def localized_levels(record: Record) -> tuple[Level, ...]:
    """Return the levels of a localized test: small noise about three or more levels (Chen 2010, 3.4); else none.

    Bare steps, noise over the whole range and records of one level are no localized tests.
    """
    memory = typical_samples(_MEMORY_S, record.sample_rate_hz)
    used = record.valid
    if not used.any() or not is_stepped(record.input, used, memory):
        return ()
    levels = find_levels(record.input, used, memory, joints=record.joints)
    # From half of a level to shortly before its end: without ringing and creep, and without the next step.
    settled = [
        slice((level.first + level.end) // 2, level.end - (level.end - level.first) // 10)
        for level in levels
        if level.end - level.first > 2 * memory
    ]
    settled = [part for part in settled if used[part].sum() > memory // 2]
    if len(settled) < _FEWEST_LEVELS:
        return ()
    span = float(np.ptp([np.mean(record.input[part]) for part in settled]))
    noise = float(np.median([np.std(record.input[part]) for part in settled]))
    related = np.median([_correlation(record[part], memory) / _least_correlation(used[part]) for part in settled])
    return levels if noise <= _LARGEST_NOISE * span and related >= 1.0 else ()


def _least_correlation(used: Mask) -> float:
    """Return the least correlation of output and input at a level whose received samples (n,) are given."""
    return max(_LEAST_CORRELATION, _CHANCE / math.sqrt(max(1, int(used.sum()))))


def _correlation(part: Record, lags: int) -> float:
    """Return the largest correlation of output and input at a lag of 0 to ``lags``, each without its linear trend."""
    both = np.flatnonzero(part.valid)
    u, y = np.zeros(len(part)), np.zeros(len(part))
    for values, whole in ((part.input, u), (part.output, y)):
        whole[both] = values[both] - np.polyval(np.polyfit(both, values[both], 1), both)
    scale = float(np.sqrt((u @ u) * (y @ y)))
    if scale == 0.0:
        return 0.0
    return float(np.max(np.abs(signal.correlate(y, u, method="fft")[u.size - 1 : u.size + lags]))) / scale


def _runs(x: Array, used: Mask, memory_samples: int) -> list[tuple[int, int]]:
    """Return first sample and end of each run of received inputs, from one memory before the first fitted sample on.

    An output that is missing or held out does not interrupt a run.
    """
    received = np.isfinite(x)
    fitted = np.flatnonzero(used)
    if fitted.size:
        received[: max(0, int(fitted[0]) - memory_samples)] = False
        received[int(fitted[-1]) + 1 :] = False
    runs = ((int(first), int(end)) for first, end in finite_runs(received))
    return [(first, end) for first, end in runs if end - first > 2 * memory_samples and used[first:end].any()]


def _threshold(x: Array, runs: list[tuple[int, int]], width: int) -> float:
    """Return the change of the running mean above which the level changes."""
    changes = [_change(x[first:end], width) for first, end in runs]
    return _STEP * _NORMAL_MAD * float(np.median(np.abs(np.concatenate(changes)))) if changes else 0.0


def _steps_found(x: Array, runs: list[tuple[int, int]], width: int, threshold: float) -> list[list[int]]:
    """Return the samples at which the level changes, for each run."""
    changes = [_change(x[first:end], width) for first, end in runs]
    steps = []
    for (first, _), change in zip(runs, changes, strict=True):
        size = np.abs(change)
        highest = ndimage.maximum_filter1d(size, 2 * width + 1)
        peaks = np.flatnonzero((size == highest) & (size > threshold))
        steps.append([first + width + int(peak) for peak in peaks])
    return steps


def _change(x: Array, width: int) -> Array:
    """Return the mean of ``width`` samples from each sample on, minus the mean of ``width`` samples before it."""
    sums = np.concatenate([[0.0], np.cumsum(x - x.mean())])
    means = (sums[width:] - sums[:-width]) / width
    return np.asarray(means[width:] - means[:-width], dtype=np.float64)


def _steps_to(x: Array, runs: list[tuple[int, int]], width: int, levels: Array) -> list[list[int]]:
    steps = []
    for first, end in runs:
        smooth = ndimage.median_filter(x[first:end], width, mode="nearest")
        nearest = np.argmin(np.abs(smooth[:, None] - levels), axis=1)
        steps.append([first + int(step) for step in np.flatnonzero(np.diff(nearest)) + 1])
    return steps
