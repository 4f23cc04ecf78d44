"""A test out of a file from elsewhere, and a session out of such tests."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports.attributes import Attributes, attributes_beside
from tissueid.sessions.imports.clock import Clock, clock_of, resampled, steady
from tissueid.sessions.imports.mapping import Mapped, doubts, mapped, time_column
from tissueid.sessions.imports.opening import open_foreign
from tissueid.sessions.imports.table import ForeignFile, Rows, sha256_of
from tissueid.sessions.imports.units import Unit
from tissueid.sessions.model import SIGNAL_UNITS, Test

_SI = Unit("", "")
_SELECTED = re.compile(r"(?P<path>.+)@(?P<first>-?\d{1,12})?:(?P<last>-?\d{1,12})?", re.DOTALL)


@dataclass(frozen=True)
class Source:
    """A file, and which of its rows."""

    path: Path
    rows: Rows

    @classmethod
    def parsed(cls, text: str) -> Source:
        """FILE or FILE@FIRST:LAST; a file whose very name looks so is taken by its name."""
        match = _SELECTED.fullmatch(text)
        if match is None or Path(text).exists():
            return cls(Path(text), Rows())
        ends = [None if match[end] is None else int(match[end]) for end in ("first", "last")]
        return cls(Path(match["path"]), Rows(*ends))


@dataclass(frozen=True)
class Choices:
    """What is said of a test by whoever imports it; None leaves it to the file, or to what is usual."""

    kind: str | None = None
    site: str | None = None
    configuration: str | None = None
    preload_s: float | None = None
    surface_position_m: float | None = None


@dataclass(frozen=True)
class Imported:
    """A test that was read, where its signals came from, and what has to be said about it."""

    test: Test
    source: Source
    format: str
    rows: range
    columns: tuple[Mapped, ...]
    notices: tuple[str, ...]
    attributes: Attributes | None


def import_test(
    source: Source,
    wanted: dict[str, tuple[str, str]] | None,
    choices: Choices,
    *,
    rate_hz: float | None = None,
    resample_hz: float | None = None,
) -> Imported:
    """Read one test.

    ``wanted`` is column and unit by role; without it, what `tissueid export` wrote beside the file says so.

    Raises:
        UnusableInputError: anything about the file, its columns, units or times that cannot be; names the file.
    """
    try:
        return _import_test(source, wanted, choices, rate_hz, resample_hz)
    except UnusableInputError as error:
        raise UnusableInputError(f"{source.path}: {error}") from error
    except MemoryError as error:
        raise UnusableInputError(
            f"{source.path}: there is not memory enough for it; choose rows by @FIRST:LAST"
        ) from error


def _import_test(
    source: Source,
    wanted: dict[str, tuple[str, str]] | None,
    choices: Choices,
    rate_hz: float | None,
    resample_hz: float | None,
) -> Imported:
    file = open_foreign(source.path)
    attributes = None
    if wanted is None:
        attributes = attributes_beside(source.path)
        if attributes is None:
            raise UnusableInputError(
                f"say what its columns are, such as --map force=COLUMN:UNIT --map position=COLUMN:UNIT; there are: "
                f"{file.listed()}"
            )
        if rate_hz is not None:
            raise UnusableInputError("the attributes beside it say its rate; --rate needs --map")
        columns = _exported_columns(file, attributes)
        notices: list[str] = []
    else:
        columns, notices = mapped(file, wanted)
    time = next((column for column in columns if column.role == "time"), None)
    signals = [column for column in columns if column.role != "time"]
    if time is not None and rate_hz is not None:
        raise UnusableInputError("--rate stands in place of times; leave out one of --rate and --map time")
    if time is None and rate_hz is None and (time := time_column(file, columns)) is not None and wanted is not None:
        notices.append(f"time is {time.header!r}, in {time.unit.symbol}")
    if time is None and rate_hz is None and attributes is None:
        raise UnusableInputError("has no column that is plainly time: --map time=COLUMN:UNIT, or --rate HZ")
    values, rows = _loaded(file, source.rows, signals, time)
    test = _clocked(file, values, signals, time, attributes, rate_hz, resample_hz, notices)
    quiet = (choices.kind or (attributes.test.kind if attributes else "")) == "quiet"
    for column in signals if attributes is None else ():
        notices += doubts(column.role, column.unit, test.signals[column.role], quiet=quiet)
    if attributes is None:
        if not 10.0 <= test.sample_rate_hz <= 1e6:
            notices.append(
                f"the rate is {test.sample_rate_hz:.6g} Hz, which is implausible: is time in the unit it says?"
            )
        test = replace(test, notes=_provenance(source, file, signals, rows))
    else:
        test = attributes.filled(test)
        if rows.start:
            test = replace(test, preload_s=max(0.0, test.preload_s - rows.start / attributes.test.sample_rate_hz))
    told = {f.name: value for f in fields(Choices) if (value := getattr(choices, f.name)) is not None}
    return Imported(
        replace(test, **told), source, file.format, rows, tuple(signals), (*file.notices, *notices), attributes
    )


def _loaded(
    file: ForeignFile, rows: Rows, signals: Sequence[Mapped], time: Mapped | None
) -> tuple[list[NDArray[np.float64]], range]:
    """Columns in SI, time last where there is one."""
    every = [*signals, time] if time is not None else list(signals)
    values, chosen = file.load([column.place for column in every], rows)
    return [column.unit.to_si(each) for column, each in zip(every, values, strict=True)], chosen


def _clocked(
    file: ForeignFile,
    values: list[NDArray[np.float64]],
    signals: Sequence[Mapped],
    time: Mapped | None,
    attributes: Attributes | None,
    rate_hz: float | None,
    resample_hz: float | None,
    notices: list[str],
) -> Test:
    """The samples on a steady clock."""
    told = attributes.test.sample_rate_hz if attributes else rate_hz
    units = {
        column.role: column.unit.si for column in signals if column.role not in SIGNAL_UNITS and column.unit.si != "1"
    }
    rows = values[0].size
    if resample_hz is not None:
        if time is None:
            raise UnusableInputError("--resample needs times: --map time=COLUMN:UNIT")
        values, notice = resampled(values[-1], values[:-1], resample_hz)
        notices.append(notice)
        clock = steady(resample_hz, values[0].size)
    elif time is None or (rows == 1 and told is not None):
        if told is None:
            raise UnusableInputError("has no times and no rate: --rate HZ")
        clock = steady(told, rows)
    elif rows == 1:
        raise UnusableInputError("one row keeps no time: choose more, or give --rate")
    else:
        clock = _clock(file, values[-1], told)
        notices += clock.notices
    arrays = {column.role: clock.laid_out(each) for column, each in zip(signals, values, strict=False)}
    return Test(number=1, kind="stochastic", signals=arrays, sample_rate_hz=clock.rate_hz, units=units)


def _clock(file: ForeignFile, times: NDArray[np.float64], told: float | None) -> Clock:
    try:
        return clock_of(times, file.step_s, told)
    except UnusableInputError as error:
        if len(file.segments) < 2:
            raise
        starts = ", ".join(str(first) for first in file.segments[:12])
        raise UnusableInputError(f"{error} (it has {len(file.segments)} segments, from rows {starts} on)") from error


def _exported_columns(file: ForeignFile, attributes: Attributes) -> list[Mapped]:
    """The columns that an export names, already SI."""
    found = []
    for name, part in attributes.columns.items():
        place = file.place(part.column)
        if part.unit != SIGNAL_UNITS.get(name, part.unit):
            raise UnusableInputError(f"the attributes beside it say {name} in {part.unit}: exports are in SI")
        unit = replace(_SI, symbol=part.unit, si=part.unit)
        found.append(Mapped(name, place, part.column, unit))
    if len([column for column in found if column.role != "time"]) < 2:
        raise UnusableInputError("the attributes beside it name fewer than two signals")
    return found


def _provenance(source: Source, file: ForeignFile, signals: Sequence[Mapped], rows: range) -> dict[str, str | float]:
    """Where the samples came from. Not the name of the file: people name files after people."""
    return {
        "source_format": file.format,
        "source_sha256": sha256_of(source.path),
        "source_rows": f"{rows.start}:{rows.stop}",
        "source_columns": json.dumps({c.role: {"column": c.header, "unit": c.unit.symbol} for c in signals}),
    }
