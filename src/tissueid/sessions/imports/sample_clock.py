"""Sample rate of an imported record, from its times."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message
from tissueid.sessions.imports.imported_table import RATE, ROWS, TIME
from tissueid.untrusted_input import MAX_SAMPLES, RATES_HZ

Array = NDArray[np.float64]

_JITTER = 0.1
"""Largest deviation of a time by rounding, in samples; a missing row deviates more."""
_MOST_MISSING = 0.5
_LONGEST_GAP = 2.5
"""Longest gap, in median steps, that resampling interpolates."""
_REPORTED_JITTER = 0.001
_LEAST_ROWS = 10
"""Fewest rows of which one at an end may be left out."""
_CLOCK_SECONDS = 1e11
"""Times above it are not in s: they would be after the year 5000, counted from 1970."""
_SPREADSHEET_DAYS = (20_000.0, 80_000.0)
"""Dates of spreadsheets from 1954 to 2119, as days."""


@dataclass(frozen=True)
class Clock:
    """A constant sample rate. ``places``, (n,), is the sample number of each row."""

    rate_hz: float
    places: NDArray[np.int64]
    notices: tuple[str, ...] = ()
    kept: slice = field(default_factory=lambda: slice(None))
    """The rows that belong to the clock, where a first or last one does not."""

    @property
    def samples(self) -> int:
        """Number of samples from the first row to the last, including missing ones."""
        return int(self.places[-1]) + 1

    def laid_out(self, values: Array) -> Array:
        """Return the values of all rows, (n,), as samples, (samples,); NaN for missing rows."""
        values = values[self.kept]
        if self.samples == values.size:
            return values
        result = np.full(self.samples, np.nan)
        result[self.places] = values
        return result


def steady(rate_hz: float, rows: int) -> Clock:
    """Return the clock of rows without gaps."""
    return Clock(rate_hz, np.arange(rows))


def clock_of(times: Array, step_s: float | None = None, rate_hz: float | None = None) -> Clock:
    """Return the clock of ``times``, (n,), s, as ``_clock_of``, without a first or last row that alone is irregular.

    Machines add a row at the moment of the start or the stop.

    Raises:
        UnusableInputError: times are missing, decreasing or irregular.
    """
    try:
        return _clock_of(times, step_s, rate_hz)
    except UnusableInputError as error:
        if error.code not in ("import.irregular", "import.time_stands_still") or times.size < _LEAST_ROWS:
            raise
        for kept in (slice(0, -1), slice(1, None), slice(1, -1)):
            with contextlib.suppress(UnusableInputError):
                clock = _clock_of(times[kept], step_s, rate_hz)
                return replace(clock, kept=kept, notices=(*clock.notices, *_left_out(times, kept)))
        raise


def _left_out(times: Array, kept: slice) -> list[Message]:
    steps = np.diff(times)
    return [
        Message(
            "import.odd_row",
            "row {row} is left out: its time is {odd:.4g} s from its neighbour, where others are {usual:.4g} s apart",
            row=int(np.arange(times.size)[end]),
            odd=float(steps[end]),
            usual=float(np.median(steps)),
        )
        for end, is_out in ((0, kept.start == 1), (-1, kept.stop == -1))
        if is_out
    ]


def _clock_of(times: Array, step_s: float | None = None, rate_hz: float | None = None) -> Clock:
    """Return the clock of ``times``, (n,), s.

    ``step_s`` or ``rate_hz``, if the file states it, is used if the times agree. Missing rows leave their samples
    empty.

    Raises:
        UnusableInputError: times are missing, decreasing or irregular.
    """
    steps = _increasing(times)
    median = float(np.median(steps))
    whole = np.round(steps / median)
    if np.max(np.abs(steps / median - whole)) > 2 * _JITTER or whole.min() < 1:
        raise _irregular(steps)
    if whole.sum() + 1 > MAX_SAMPLES:
        raise UnusableInputError(
            "import.gaps", "the times have gaps of more samples than a test can have: select rows ({rows})", rows=ROWS
        )
    places = np.concatenate([[0], np.cumsum(whole)]).astype(np.int64)
    since = times - times[0]
    rate = float(places[-1]) / float(since[-1])
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise UnusableInputError(
            "import.sample_rate",
            "the times have a rate of {rate:.4g} Hz; {low:g} to {high:g} Hz can be read",
            rate=rate,
            low=RATES_HZ[0],
            high=RATES_HZ[1],
        )
    off = _furthest(since, places, rate)
    if off > _JITTER:
        raise _irregular(steps)
    missing = int(places[-1]) + 1 - times.size
    if missing > _MOST_MISSING * (places[-1] + 1):
        raise UnusableInputError(
            "import.missing",
            "the times leave out {missing} of {samples} samples: select rows without the gaps ({rows})",
            missing=missing,
            samples=int(places[-1]) + 1,
            rows=ROWS,
        )
    notices = []
    if missing:
        notices.append(
            Message(
                "import.samples_missing",
                "{missing} samples are missing by the times ({where}); they are left empty (NaN)",
                missing=missing,
                where=_where(whole),
            )
        )
    if off > _REPORTED_JITTER:
        notices.append(
            Message(
                "import.jitter",
                "the times deviate by up to {percent:.1f} % of a sample from a constant rate, which is assumed",
                percent=100 * off,
            )
        )
    slack = max(1.05 * off, 1e-6) + 4.0 * rate * float(np.spacing(np.max(np.abs(times))))
    chosen = next((r for r in _round_ones(rate, step_s, rate_hz) if _furthest(since, places, r) <= slack), rate)
    if rate_hz is not None and chosen != rate_hz:
        raise UnusableInputError(
            "import.rate_differs",
            "its times have a rate of {rate:.9g} Hz where it states {stated:.9g} Hz",
            rate=rate,
            stated=rate_hz,
        )
    return Clock(chosen, places, tuple(notices))


def check_seconds(times: Array) -> None:
    """Check that ``times``, (n,), whose unit is not stated, can be in s.

    Raises:
        UnusableInputError: they are more likely the ms of a computer's clock or the days of a spreadsheet.
    """
    first, last = float(times[0]), float(times[-1])
    low, high = _SPREADSHEET_DAYS
    if abs(first) > _CLOCK_SECONDS or (low < first < high and last - first < 1.0):
        raise UnusableInputError(
            "import.time_unit",
            "its times start at {first:.10g} and do not state their unit: choose it ({time})",
            first=first,
            time=TIME,
        )


def resampled(times: Array, values: list[Array], rate_hz: float) -> tuple[list[Array], list[str]]:
    """Interpolate values, each (n,), linearly to a constant rate; return them and notices.

    Gaps of more than 2.5 steps and intervals next to a missing value stay empty.

    Raises:
        UnusableInputError: times are missing or decreasing, or there would be too many samples.
    """
    steps = _increasing(times)
    span = float(times[-1] - times[0])
    size = float(np.floor(span * rate_hz * (1 + 1e-12))) + 1.0
    if not 2.0 <= size <= MAX_SAMPLES:
        raise UnusableInputError(
            "import.resampled_size",
            "at {rate:g} Hz there would be {samples:.10g} samples; a test has 2 to {most}",
            rate=rate_hz,
            samples=size,
            most=MAX_SAMPLES,
        )
    count = int(size)
    grid = times[0] + np.arange(count) / rate_hz
    median = float(np.median(steps))
    after = np.clip(np.searchsorted(times, grid, side="right"), 1, times.size - 1)
    in_gap = (steps[after - 1] > _LONGEST_GAP * median) & (grid > times[after - 1]) & (grid < times[after])
    result = []
    for column in values:
        line = np.interp(grid, times, column)
        line[in_gap] = np.nan
        result.append(line)
    notices: list[str] = [
        Message(
            "import.resampled",
            "resampled to {rate:g} Hz by linear interpolation between {rows} rows (median rate {median:.4g} Hz)",
            rate=rate_hz,
            rows=int(times.size),
            median=1 / median,
        )
    ]
    if rate_hz < 0.9 / median:
        notices.append(
            Message(
                "import.aliasing",
                "resampled without a filter: frequencies above half the new rate appear as lower ones (aliasing)",
            )
        )
    if in_gap.any():
        notices.append(
            Message("import.gaps_empty", "{samples} samples in gaps are left empty (NaN)", samples=int(in_gap.sum()))
        )
    return result, notices


def _increasing(times: Array) -> Array:
    if not np.isfinite(times).all():
        row = int(np.flatnonzero(~np.isfinite(times))[0])
        raise UnusableInputError(
            "import.time_missing",
            "the time of row {row} is missing: leave it out ({rows}), or choose {rate}",
            row=row,
            rows=ROWS,
            rate=RATE,
        )
    steps = np.diff(times)
    if steps.min() <= 0:
        row = int(np.flatnonzero(steps <= 0)[0]) + 1
        if steps[row - 1] == 0:
            raise UnusableInputError(
                "import.time_stands_still",
                "time stands still at row {row}: select rows ({rows}), or choose {rate} in place of the times",
                row=row,
                rows=ROWS,
                rate=RATE,
            )
        raise UnusableInputError(
            "import.time_runs_backwards",
            "time runs backwards at row {row}: select rows ({rows}), or choose {rate} in place of the times",
            row=row,
            rows=ROWS,
            rate=RATE,
        )
    return steps


def _irregular(steps: Array) -> UnusableInputError:
    return UnusableInputError(
        "import.irregular",
        "the times are irregular, with steps from {least:.4g} to {most:.4g} s: choose {resample}, or {rate} in "
        "place of the times",
        least=float(steps.min()),
        most=float(steps.max()),
        resample=Action("import.resample", "--resample HZ", marked("interpolation (on the command line)")),
        rate=RATE,
    )


def _furthest(since: Array, places: NDArray[np.int64], rate: float) -> float:
    """Return the largest deviation of a time from its sample, in samples."""
    return float(np.max(np.abs(since * rate - places)))


def _round_ones(rate: float, step_s: float | None, rate_hz: float | None) -> list[float]:
    """Return round rates near ``rate``, stated ones first."""
    candidates = [rate_hz] if rate_hz is not None else []
    if step_s is not None and step_s > 0:
        candidates.append(float(f"{1.0 / step_s:.12g}"))
    for digits in range(2, 10):
        candidates += [float(f"{rate:.{digits}g}"), 1.0 / float(f"{1.0 / rate:.{digits}g}")]
    return candidates


def _where(whole: Array) -> Message:
    rows = np.flatnonzero(whole > 1)
    row = int(rows[0])
    if rows.size == 1:
        return Message("import.after_row", "after row {row}", row=row)
    return Message(
        "import.after_rows", "after row {row} and in {others} other places", row=row, others=int(rows.size) - 1
    )
