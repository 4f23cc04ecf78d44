"""Constant levels of a stepped input, with small noise about each (Chen 2010, 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import finite_runs
from tissueid.messages import Message

_STEP = 7.0
"""Threshold of a step: change of the running mean, in robust standard deviations of that change."""

_NORMAL_MAD = 1.4826

_RECORD_STEPS = Message(
    "localized.no_levels",
    "the input has no constant levels: record a few levels of force, each several memories long with small noise "
    "about it, or join records about different levels",
)


@dataclass(frozen=True)
class Level:
    """A stretch of a record at one input level: first sample, end, and direction of the step to it, 1 or -1.

    ``direction`` is 0 for the first level of an uninterrupted run.
    """

    first: int
    end: int
    direction: int


def find_levels(x: Array, used: Mask, memory_samples: int, given: Sequence[float] | None = None) -> tuple[Level, ...]:
    """Return the stretches of constant level in an input.

    The means of one memory before and after each sample are compared; a step is a difference far above the scatter of
    all such differences, estimated from their median. Gaps always separate levels.

    Args:
        x: input (n,), NaN for samples that were not received.
        used: mask (n,) of the samples that may be fitted.
        memory_samples: samples of one memory.
        given: the levels in the unit of the input; each stretch is then assigned to the nearest.

    Raises:
        UnusableInputError: there are fewer than two levels.
    """
    runs = _runs(x, used, memory_samples)
    steps = _steps_to(x, runs, memory_samples, np.sort(given)) if given else _steps_found(x, runs, memory_samples)
    levels: list[Level] = []
    for (first, end), inner in zip(runs, steps, strict=True):
        edges = [first, *inner, end]
        before: float | None = None
        for begin, stop in pairwise(edges):
            mean = float(np.mean(x[begin:stop]))
            levels.append(Level(begin, stop, 0 if before is None else int(np.sign(mean - before))))
            before = mean
    if len(levels) < 2:
        raise UnusableInputError(_RECORD_STEPS)
    return tuple(levels)


def is_stepped(x: Array, used: Mask, memory_samples: int) -> bool:
    """Return whether an input (n,) steps from level to level within a run; arguments as :func:`find_levels`."""
    return any(_steps_found(x, _runs(x, used, memory_samples), memory_samples))


def _runs(x: Array, used: Mask, memory_samples: int) -> list[tuple[int, int]]:
    received = np.isfinite(x) & _with_memory(used, memory_samples)
    return [(int(first), int(end)) for first, end in finite_runs(received) if end - first > 2 * memory_samples]


def _with_memory(used: Mask, memory_samples: int) -> Mask:
    """Return the mask of the fitted samples and of the memory before each of them."""
    later = np.concatenate([used, np.zeros(memory_samples, dtype=np.bool_)])
    counts = np.cumsum(np.concatenate([[0], later]))
    return np.asarray(counts[memory_samples:][: used.size] > counts[: used.size], dtype=np.bool_)


def _steps_found(x: Array, runs: list[tuple[int, int]], width: int) -> list[list[int]]:
    """Return the samples at which the level changes, for each run."""
    changes = [_change(x[first:end], width) for first, end in runs]
    if not changes:
        return []
    everything = np.abs(np.concatenate(changes))
    threshold = _STEP * _NORMAL_MAD * float(np.median(everything))
    found = []
    for (first, _), change in zip(runs, changes, strict=True):
        size = np.abs(change)
        highest = ndimage.maximum_filter1d(size, 2 * width + 1)
        peaks = np.flatnonzero((size == highest) & (size > threshold))
        found.append([first + width + int(peak) for peak in peaks])
    return found


def _change(x: Array, width: int) -> Array:
    """Return the mean of ``width`` samples from each sample on, minus the mean of ``width`` samples before it."""
    sums = np.concatenate([[0.0], np.cumsum(x - x.mean())])
    means = (sums[width:] - sums[:-width]) / width
    return np.asarray(means[width:] - means[:-width], dtype=np.float64)


def _steps_to(x: Array, runs: list[tuple[int, int]], width: int, levels: Array) -> list[list[int]]:
    found = []
    for first, end in runs:
        smooth = ndimage.median_filter(x[first:end], width, mode="nearest")
        nearest = np.argmin(np.abs(smooth[:, None] - levels), axis=1)
        found.append([first + int(step) for step in np.flatnonzero(np.diff(nearest)) + 1])
    return found
