"""Periods of a periodic record, and the driven lines of its spectrum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.second_order import Complex
from tissueid.records import Record

Lines = NDArray[np.int_]

_PERIODIC_CORRELATION = 0.9
"""Minimum correlation of an input with itself one period later."""

_EQUAL_CORRELATION = 0.01
"""Largest difference of the correlation between the first repetition and a later one."""

_SHORTEST_OVERLAP = 0.02
"""Minimum overlap of two stretches that are correlated, as a share of the record."""

_DRIVEN_RANGE = 1e-3
_DRIVEN_SHARE = 0.1
"""Minimum power of a driven line, relative to the strongest of all and to the strongest near it."""

_NEIGHBOUR_LINES = 5
"""Number of odd lines to each side that count as near."""

_LARGEST_GAP = 20.0
"""Gap to the next line, in usual gaps, beyond which that line is not part of the stimulus."""


@dataclass(frozen=True, eq=False)
class Periods:
    """Spectra of the whole periods of a record, shape (periods, lines), lines 0 .. period / 2.

    ``input`` and ``output`` are discrete Fourier transforms of ``period`` samples; a linear drift of the period means
    was removed. ``tail`` is the difference (m,) of the output between the last settled samples before the first period
    and the samples one period later: twice the noise power; empty if the record has none.
    """

    period: int
    sample_rate_hz: float
    input: Complex
    output: Complex
    tail: Array


def find_period(u: Array) -> int:
    """Return the period of an input (n,), in samples.

    Raises:
        UnusableInputError: the input is not periodic, or fewer than 1.02 periods were recorded.
    """
    known = np.isfinite(u)
    if not known.any() or np.ptp(u[known]) == 0.0:
        raise UnusableInputError("multisine.constant", "the input does not vary: it has no period")
    x = np.where(known, u - np.mean(u[known]), 0.0)
    n = x.size
    size = fft.next_fast_len(2 * n, real=True)
    auto = fft.irfft(np.abs(fft.rfft(x, size)) ** 2, size)[:n]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    lag = np.arange(n)
    scale = np.sqrt(power[n - lag] * (power[n] - power[lag]))
    alike = np.where(scale > 0.0, auto / np.maximum(scale, 1e-300), 0.0)  # (n,)
    alike[max(2, int(n * (1.0 - _SHORTEST_OVERLAP))) :] = 0.0
    away = np.flatnonzero(alike < 0.5)  # beyond the peak about lag 0, which is broad for a smooth input
    first = int(away[0]) if away.size else n
    best = float(np.max(alike[first:], initial=0.0))
    if best < _PERIODIC_CORRELATION:
        raise UnusableInputError(
            "multisine.no_period", "the input is not periodic: at least two periods of a periodic stimulus are needed"
        )
    rising = np.flatnonzero(alike[first:] >= best - _EQUAL_CORRELATION) + first
    run = rising[: int(np.argmax(np.append(np.diff(rising) > 1, True))) + 1]  # only the first such peak
    return int(run[np.argmax(alike[run])])


def cut_periods(record: Record, period: int, settling: float) -> Periods:
    """Cut the whole periods out of a record, counted from its end; periods with a gap are left out.

    Args:
        record: one realisation of a periodic stimulus.
        period: samples.
        settling: time at the start that is not part of a period, s.

    Raises:
        UnusableInputError: no whole period is left.
    """
    n = len(record)
    count = max(0, (n - round(settling * record.sample_rate_hz)) // period) if period > 1 else 0
    first = n - count * period
    whole = np.array([bool(record.valid[first + k * period :][:period].all()) for k in range(count)])
    if not whole.any():
        raise UnusableInputError(
            "multisine.short",
            "no whole period of {samples} samples remains after {settling:g} s of settling: record longer",
            samples=period,
            settling=settling,
        )
    u = _without_drift(record.input[first:].reshape(count, period)[whole], np.flatnonzero(whole))
    y = _without_drift(record.output[first:].reshape(count, period)[whole], np.flatnonzero(whole))
    before = record.output[first - min(first // 2, period) : first]
    later = record.output[first - before.size + period : first + period]
    tail = before - later
    return Periods(
        period=period,
        sample_rate_hz=record.sample_rate_hz,
        input=fft.rfft(u, axis=1),
        output=fft.rfft(y, axis=1),
        tail=tail[np.isfinite(tail)],
    )


def _without_drift(periods: Array, number: Lines) -> Array:
    """Return the periods (periods, n) minus the straight line through their means.

    A drift adds power to every line, equal in each period, which would be taken for distortion.
    """
    if number.size < 2:
        return periods - float(periods.mean())
    slope, level = (float(c) for c in np.polyfit(number, periods.mean(axis=1), 1))
    n = periods.shape[1]
    inside = (np.arange(n) - (n - 1) / 2) / n
    return np.asarray(periods - level - slope * (number[:, None] + inside), dtype=np.float64)


def find_driven(power: Array) -> Lines:
    """Return the odd lines driven by a stimulus with this line power (lines,).

    The power of a driven line is well above that of the even lines near it, and not far below the strongest odd line
    near it.

    Raises:
        UnusableInputError: no odd line is above the even ones.
    """
    odd = np.arange(1, power.size, 2)
    even = np.arange(2, power.size, 2)
    near = 2 * _NEIGHBOUR_LINES + 1
    if odd.size < near or even.size < near:
        raise UnusableInputError(
            "multisine.short_period",
            "a period of fewer than {samples} samples has too few lines to separate",
            samples=4 * near,
        )
    strongest = np.lib.stride_tricks.sliding_window_view(np.pad(power[odd], _NEIGHBOUR_LINES), near).max(axis=1)
    quiet = np.median(
        np.lib.stride_tricks.sliding_window_view(np.pad(power[even], _NEIGHBOUR_LINES, mode="edge"), near), axis=1
    )
    background = quiet[np.minimum(np.arange(odd.size), quiet.size - 1)]
    driven = (power[odd] > _DRIVEN_SHARE * strongest) & (power[odd] > 10.0 * background)
    driven &= power[odd] > _DRIVEN_RANGE * float(np.max(power[1:]))
    if driven.sum() < 2:
        raise UnusableInputError(
            "multisine.not_odd",
            "the odd lines of the input do not stand out from the even ones: an odd random-phase multisine is needed",
        )
    return _strongest_group(odd[driven], power)


def _strongest_group(lines: Lines, power: Array) -> Lines:
    """Return the group of adjacent lines (k,) with the most power, without distant spurs such as mains interference."""
    gaps = np.diff(lines)
    usual = np.array(
        [float(np.median(gaps[max(0, i - _NEIGHBOUR_LINES) : i])) if i else float(gaps[0]) for i in range(gaps.size)]
    )
    groups = np.split(lines, np.flatnonzero(gaps > _LARGEST_GAP * usual) + 1)
    return np.asarray(max(groups, key=lambda group: float(np.sum(power[group]))), dtype=np.int_)
