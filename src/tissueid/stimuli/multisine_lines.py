"""Which lines of a period a multisine drives, how strongly, and where in the period it begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.stimuli.base import Array
from tissueid.stimuli.crest import Lines, peak_ratio, summed


def lines_between(period: int, sample_rate_hz: float, low_hz: float, high_hz: float) -> Lines:
    """Lines 1, 2, ... under half of the ``period`` (samples) whose frequency lies from ``low_hz`` to ``high_hz``."""
    lines = np.arange(1, (period + 1) // 2)
    frequency = np.asarray(lines * sample_rate_hz / period, dtype=np.float64)
    return lines[_inside(frequency, low_hz, high_hz)]


def without_notches(frequency_hz: Array, notches: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """True (n,) where a frequency lies in none of the bands (low, high), Hz, their ends included."""
    kept = np.ones(frequency_hz.size, dtype=bool)
    for low, high in notches:
        kept &= ~_inside(frequency_hz, low, high)
    return kept


def _inside(frequency_hz: Array, low_hz: float, high_hz: float) -> NDArray[np.bool_]:
    """True (n,) from low to high; 0.3 / 0.1 is not quite 3, and a line on the edge counts as inside."""
    slack = 1e-9 * np.abs(frequency_hz)
    return (frequency_hz >= low_hz - slack) & (frequency_hz <= high_hz + slack)


def detection_lines(odd: Lines, group: int, rng: np.random.Generator) -> Lines:
    """One of each ``group`` lines (n,) in their order, at random: those to be left undriven.

    The lowest line of all and the highest stay driven, so that every detection line lies in the driven band; what is
    left over after the last whole group stays driven too.
    """
    chosen = []
    for first in range(0, odd.size - group + 1, group):
        low = 1 if first == 0 else 0
        high = group - 1 if first + group == odd.size else group
        chosen.append(int(odd[first + rng.integers(low, high)]))
    return np.array(chosen, dtype=np.int_)


def butterworth(frequency_hz: Array, cutoff_hz: float, order: int) -> Array:
    """Gain (n,) of a Butterworth low-pass."""
    with np.errstate(over="ignore"):  # a gain too small for a number is 0
        return np.asarray(1.0 / np.sqrt(1.0 + (frequency_hz / cutoff_hz) ** (2 * order)), dtype=np.float64)


def best_of_random(lines: Lines, amplitudes: Array, period: int, draws: int, rng: np.random.Generator) -> Array:
    """Of ``draws`` sets of phases, evenly spread over the circle, the one of the lowest crest factor, (lines,)."""
    sets = [2.0 * np.pi * rng.random(lines.size) for _ in range(draws)]
    return min(sets, key=lambda phases: peak_ratio(lines, amplitudes, phases, period)) if draws > 1 else sets[0]


def played(lines: Lines, amplitudes: Array, phases: Array, period: int, periods: int, settling: int) -> Array:
    """Whole periods after a run-in of ``settling`` samples, shape (settling + periods * period,), joined exactly.

    The period is turned so that the whole begins as near its mean as it can.
    """
    one = summed(lines, amplitudes, phases, period)
    begin = _nearest_to_mean(one, settling, periods)
    return np.take(one, np.arange(begin, begin + settling + periods * period), mode="wrap")


def _nearest_to_mean(one: Array, settling: int, periods: int) -> int:
    """Sample of the period (n,) from which ``settling`` samples and whole periods begin nearest to their mean."""
    n = one.size
    upto = np.concatenate([[0.0], np.cumsum(np.tile(one, 2))])
    over = settling % n
    run_in = upto[over : over + n] - upto[:n] + (settling // n) * upto[n]
    mean = (run_in + periods * upto[n]) / (settling + periods * n)
    return int(np.argmin(np.abs(one - mean)))
