"""Times of a record from elsewhere: the sample rate that they keep, or why they keep none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports.table import MAX_ROWS
from tissueid.untrusted import RATES_HZ

Array = NDArray[np.float64]

_JITTER = 0.1
"""Of a sample: times may lie so far off their place by having been rounded. A missing row shows as much more."""
_MOST_MISSING = 0.5
_LONGEST_GAP = 2.5
"""In median steps: resampling does not reach across a longer one."""
_TOLD = 0.001


@dataclass(frozen=True)
class Clock:
    """A steady clock. ``places``, (n,), says which sample each row is; ``samples`` is how many there are in all."""

    rate_hz: float
    places: NDArray[np.int64]
    notices: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Samples from the first row to the last, missing ones included."""
        return int(self.places[-1]) + 1

    def laid_out(self, values: Array) -> Array:
        """Values of the rows, (n,), as samples, (samples,); NaN where a row is missing."""
        if self.samples == values.size:
            return values
        result = np.full(self.samples, np.nan)
        result[self.places] = values
        return result


def steady(rate_hz: float, rows: int) -> Clock:
    """The clock of rows that follow each other without a gap."""
    return Clock(rate_hz, np.arange(rows))


def clock_of(times: Array, step_s: float | None = None, rate_hz: float | None = None) -> Clock:
    """The clock that ``times``, (n,) in s, keep.

    ``step_s`` or ``rate_hz``, where the file states it, wins if the times agree. Rows that are
    missing on an otherwise steady clock leave their samples empty.

    Raises:
        UnusableInputError: times that are missing, run backwards or keep no steady clock.
    """
    steps = _increasing(times)
    median = float(np.median(steps))
    whole = np.round(steps / median)
    if np.max(np.abs(steps / median - whole)) > 2 * _JITTER or whole.min() < 1:
        raise _irregular(steps)
    if whole.sum() + 1 > MAX_ROWS:
        raise UnusableInputError("the times have gaps of more samples than a test can have: choose rows by @FIRST:LAST")
    places = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    since = times - times[0]
    rate = float(places[-1]) / float(since[-1])
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise UnusableInputError(f"the times keep {rate:.4g} Hz; {RATES_HZ[0]:g} to {RATES_HZ[1]:g} Hz can be read")
    off = _furthest(since, places, rate)
    if off > _JITTER:
        raise _irregular(steps)
    missing = int(places[-1]) + 1 - times.size
    if missing > _MOST_MISSING * (places[-1] + 1):
        raise UnusableInputError(
            f"the times leave {missing} of {places[-1] + 1} samples out: choose rows without the gaps by @FIRST:LAST"
        )
    notices = []
    if missing:
        notices.append(f"{missing} samples are missing by the times ({_where(whole)}); they are left empty (NaN)")
    if off > _TOLD:
        notices.append(f"the times lie up to {100 * off:.1f} % of a sample off a steady clock, and were taken for one")
    slack = max(1.05 * off, 1e-6) + 4.0 * rate * float(np.spacing(np.max(np.abs(times))))
    chosen = next((r for r in _round_ones(rate, step_s, rate_hz) if _furthest(since, places, r) <= slack), rate)
    if rate_hz is not None and chosen != rate_hz:
        raise UnusableInputError(f"its times keep {rate:.9g} Hz where it says {rate_hz:.9g} Hz")
    return Clock(chosen, places, tuple(notices))


def resampled(times: Array, values: list[Array], rate_hz: float) -> tuple[list[Array], str]:
    """Values, each (n,), on a steady clock by straight lines between samples, and a notice of what was done.

    Nothing is put into a gap of more than two and a half steps, nor beside a value that is missing.

    Raises:
        UnusableInputError: times that are missing or run backwards, or too many samples.
    """
    steps = _increasing(times)
    span = float(times[-1] - times[0])
    told = float(np.floor(span * rate_hz * (1 + 1e-12))) + 1.0
    if not 2.0 <= told <= MAX_ROWS:
        raise UnusableInputError(f"at {rate_hz:g} Hz that would be {told:.10g} samples; 2 to {MAX_ROWS} make a test")
    count = int(told)
    grid = times[0] + np.arange(count) / rate_hz
    median = float(np.median(steps))
    after = np.clip(np.searchsorted(times, grid, side="right"), 1, times.size - 1)
    in_gap = (steps[after - 1] > _LONGEST_GAP * median) & (grid > times[after - 1]) & (grid < times[after])
    result = []
    for column in values:
        line = np.interp(grid, times, column)
        line[in_gap] = np.nan
        result.append(line)
    notice = (
        f"resampled to {rate_hz:g} Hz by straight lines between {times.size} rows, {1 / median:.4g} Hz in the median"
    )
    if rate_hz < 0.9 / median:
        notice += "; nothing was filtered before: what is faster than half the new rate now shows as something slower"
    if in_gap.any():
        notice += f"; {int(in_gap.sum())} samples in gaps are left empty (NaN)"
    return result, notice


def _increasing(times: Array) -> Array:
    if not np.isfinite(times).all():
        row = int(np.flatnonzero(~np.isfinite(times))[0])
        raise UnusableInputError(f"the time of row {row} is missing: leave it out by @FIRST:LAST, or give --rate")
    steps = np.diff(times)
    if steps.min() <= 0:
        row = int(np.flatnonzero(steps <= 0)[0]) + 1
        how = "stands still" if steps[row - 1] == 0 else "runs backwards"
        raise UnusableInputError(
            f"time {how} at row {row}: choose rows by @FIRST:LAST, or leave the times out and give --rate"
        )
    return steps


def _irregular(steps: Array) -> UnusableInputError:
    return UnusableInputError(
        f"the times are irregular, with steps from {steps.min():.4g} to {steps.max():.4g} s: --resample HZ "
        "interpolates, --rate HZ in place of the times takes the rows for regular"
    )


def _furthest(since: Array, places: NDArray[np.int64], rate: float) -> float:
    """The furthest that a time lies from its place, in samples."""
    return float(np.max(np.abs(since * rate - places)))


def _round_ones(rate: float, step_s: float | None, rate_hz: float | None) -> list[float]:
    """Rates as people choose them, most trusted first."""
    told = [rate_hz] if rate_hz is not None else []
    if step_s is not None and step_s > 0:
        told.append(float(f"{1.0 / step_s:.12g}"))
    for digits in range(2, 10):
        told += [float(f"{rate:.{digits}g}"), 1.0 / float(f"{1.0 / rate:.{digits}g}")]
    return told


def _where(whole: Array) -> str:
    rows = np.flatnonzero(whole > 1)
    first = f"after row {rows[0]}"
    return first if rows.size == 1 else f"{first} and in {rows.size - 1} other places"
