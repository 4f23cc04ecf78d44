"""Import of a test from a file of another program: its format, its date and its signals."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.sessions.file_policy import checked_size, located
from tissueid.sessions.imports.column_mapping import Mapped, doubts, mapped, time_column
from tissueid.sessions.imports.csv import open_csv
from tissueid.sessions.imports.export_attributes import Attributes, attributes_beside
from tissueid.sessions.imports.imported_table import MAP, RATE, ROWS, TIME, ImportedTable, RowRange, sha256_of
from tissueid.sessions.imports.lvm import FIRST_LINE, open_lvm
from tissueid.sessions.imports.mat import HDF5_MARK, MARK, open_mat
from tissueid.sessions.imports.sample_clock import Clock, check_seconds, clock_of, resampled, steady
from tissueid.sessions.model import DATE_NOTE, SIGNAL_UNITS, Test
from tissueid.units import Unit

_SESSIONS = (".h5", ".hdf5", ".hdf")
_RAMP = Message(
    "import.ramp",
    "force and position are ramps and holds: imported as the kind slow_ramp; choose the kind if it is another test",
)


def is_record(path: Path) -> bool:
    """Return whether a file, by its name, must be imported instead of opened as a session."""
    return path.suffix.lower() not in (*_SESSIONS, "")


def open_foreign(path: Path, decimal: str | None = None) -> ImportedTable:
    """Open a file of another program: CSV, MAT or LVM. ``decimal`` is the decimal sign of a CSV file (``open_csv``).

    Raises:
        UnusableInputError: it is missing, or in none of these formats; the message does not name the file.
        OSError: the disk failed, or the file may not be read.
    """
    checked_size(path)
    with path.open("rb") as file:
        head = file.read(520)
    if path.suffix.lower() == ".mat" or head.startswith((MARK, HDF5_MARK)) or head[512:].startswith(HDF5_MARK):
        return open_mat(path)
    if path.suffix.lower() == ".lvm" or head.removeprefix(b"\xef\xbb\xbf").startswith(FIRST_LINE.encode()):
        return open_lvm(path)
    if path.suffix.lower() in (".pkl", ".pickle", ".npy", ".npz", ".joblib"):
        raise UnusableInputError("import.program", "can contain programs, and is not read: save it as CSV or MAT")
    return open_csv(path, decimal)


Origin = Literal["header", "modified"]
_HEAD = 8_192
"""Bytes that contain the date: the first segment of an LVM file, the first 116 bytes of a MAT file."""
_LVM_DATE = re.compile(r"^Date[\t,;](\d{4})[/.-](\d{1,2})[/.-](\d{1,2})", re.MULTILINE)
_LVM_TIME = re.compile(r"^Time[\t,;](\d{1,2}):(\d{2}):(\d{2})", re.MULTILINE)
_MAT = re.compile(r"Created on: \w{3} (\w{3}) +(\d{1,2}) (\d{2}):(\d{2}):(\d{2}) (\d{4})")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


def recording_date(path: Path, file_format: str) -> tuple[str, Origin]:
    """Return the date of a record in UTC, and its origin.

    Headers state the local time of the computer that wrote them; the zone of this computer is assumed.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD).decode("latin-1").replace("\r\n", "\n")
    date = {"lvm": _of_lvm, "mat": _of_mat}.get(file_format, lambda _head: None)(head)
    origin: Origin = "header"
    if date is None:
        date, origin = datetime.fromtimestamp(path.stat().st_mtime), "modified"
    return date.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), origin


def _of_lvm(head: str) -> datetime | None:
    """Return the last date before the rows: that of the first segment, or of the file if the segment has none."""
    head = re.split(r"^X_Value", head, maxsplit=1, flags=re.MULTILINE)[0]
    days, times = _LVM_DATE.findall(head), _LVM_TIME.findall(head)
    if not days:
        return None
    time = times[-1] if times else ("0", "0", "0")
    return _moment(*map(int, (*days[-1], *time)))


def _of_mat(head: str) -> datetime | None:
    match = _MAT.search(head[:116])
    if match is None or match[1] not in _MONTHS:
        return None
    return _moment(int(match[6]), _MONTHS.index(match[1]) + 1, *map(int, match.group(2, 3, 4, 5)))


def _moment(*parts: int) -> datetime | None:
    """Return a date, or None if it is invalid or from a clock that was never set (1904 or 1970)."""
    try:
        date = datetime(*parts)  # type: ignore[arg-type]
    except ValueError:
        return None
    return date if date.year > 1970 else None


_SI = Unit("", "")
_SELECTED = re.compile(r"(?P<path>.+)@(?P<first>-?\d{1,12})?:(?P<last>-?\d{1,12})?", re.DOTALL)


@dataclass(frozen=True)
class Source:
    """A file and the selection of its rows."""

    path: Path
    rows: RowRange

    @classmethod
    def parsed(cls, text: str) -> Source:
        """Return the source for FILE or FILE@FIRST:LAST; an existing file with exactly this name takes precedence."""
        match = _SELECTED.fullmatch(text)
        if match is None or Path(text).exists():
            return cls(Path(text), RowRange())
        ends = [None if match[end] is None else int(match[end]) for end in ("first", "last")]
        return cls(Path(match["path"]), RowRange(*ends))


@dataclass(frozen=True)
class Choices:
    """Attributes of a test that the user chooses; None takes them from the file or the defaults."""

    kind: str | None = None
    site: str | None = None
    configuration: str | None = None
    preload_s: float | None = None
    surface_position_m: float | None = None


@dataclass(frozen=True)
class Imported:
    """An imported test, the origin of its signals, and notices."""

    test: Test
    source: Source
    format: str
    rows: range
    columns: tuple[Mapped, ...]
    notices: tuple[str, ...]
    attributes: Attributes | None
    created: str = ""
    """Recording time in UTC, if the file states it; empty for an export, whose attributes state it."""


def import_test(
    source: Source,
    wanted: dict[str, tuple[str, str]] | None,
    choices: Choices,
    *,
    rate_hz: float | None = None,
    resample_hz: float | None = None,
    decimal: str | None = None,
) -> Imported:
    """Read one test.

    ``wanted`` is column and unit by role; without it, the attributes file of ``tissueid export`` is used. ``decimal``
    is the decimal sign of a CSV file, needed only where it could separate thousands.

    Raises:
        UnusableInputError: the file, its columns, units or times cannot be used.
    """
    try:
        return _import_test(source, wanted, choices, rate_hz, resample_hz, decimal)
    except UnusableInputError as error:
        raise UnusableInputError(located(str(source.path), error.message)) from error
    except MemoryError as error:
        raise UnusableInputError(
            "import.memory", "{path}: not enough memory; select rows ({rows})", path=str(source.path), rows=ROWS
        ) from error


def _import_test(
    source: Source,
    wanted: dict[str, tuple[str, str]] | None,
    choices: Choices,
    rate_hz: float | None,
    resample_hz: float | None,
    decimal: str | None,
) -> Imported:
    file = open_foreign(source.path, decimal)
    attributes = None
    created = ""
    if wanted is None:
        attributes = attributes_beside(source.path)
        if attributes is None:
            raise UnusableInputError(
                "import.no_map",
                "choose what its columns are ({action}); the columns are: {columns}",
                action=MAP,
                columns=file.listed(),
            )
        if rate_hz is not None:
            raise UnusableInputError(
                "import.rate_stated", "its attributes file states the rate; a rate needs columns ({action})", action=MAP
            )
        columns = _exported_columns(file, attributes)
        notices: list[str] = []
    else:
        columns, notices = mapped(file, wanted)
    time = next((column for column in columns if column.role == "time"), None)
    signals = [column for column in columns if column.role != "time"]
    if time is not None and rate_hz is not None:
        raise UnusableInputError(
            "import.rate_and_time", "a rate replaces the times: choose either {rate} or {time}", rate=RATE, time=TIME
        )
    if time is None and rate_hz is None and (time := time_column(file, columns)) is not None and wanted is not None:
        notices.append(
            Message(
                "import.time_found",
                "time is '{column}', in {unit}",
                column=Verbatim(time.header),
                unit=time.unit.symbol,
            )
        )
    if time is None and rate_hz is None and attributes is None:
        raise UnusableInputError(
            "import.no_time", "has no column that is clearly time: choose {time} or {rate}", time=TIME, rate=RATE
        )
    values, rows = _loaded(file, source.rows, signals, time)
    test, kept = _clocked(file, values, signals, time, attributes, rate_hz, resample_hz, notices)
    rows = rows[kept]
    quiet = (choices.kind or (attributes.test.kind if attributes else "")) == "quiet"
    for column in signals if attributes is None else ():
        notices += doubts(column.role, column.unit, test.signals[column.role], quiet=quiet)
    if attributes is None:
        if not 10.0 <= test.sample_rate_hz <= 1e6:
            notices.append(
                Message(
                    "import.rate_implausible",
                    "the sample rate is {rate:.6g} Hz, which is implausible: is the unit of time right?",
                    rate=test.sample_rate_hz,
                )
            )
        created, origin = recording_date(source.path, file.format)
        test = replace(test, notes=_provenance(source, file, signals, rows) | {DATE_NOTE: origin})
        if choices.kind is None and _is_ramp(test):
            test = replace(test, kind="slow_ramp")
            notices.append(_RAMP)
    else:
        test = attributes.filled(test)
        if rows.start:
            test = replace(test, preload_s=max(0.0, test.preload_s - rows.start / attributes.test.sample_rate_hz))
    choice_values = {f.name: value for f in fields(Choices) if (value := getattr(choices, f.name)) is not None}
    return Imported(
        replace(test, **choice_values),
        source,
        file.format,
        rows,
        tuple(signals),
        (*file.notices, *notices),
        attributes,
        created,
    )


def _is_ramp(test: Test) -> bool:
    """Return whether force and position are a few ramps and holds, so that no stochastic test is imported."""
    if not {"force", "position"} <= set(test.signals):
        return False
    from tissueid.identification.ramp_stiffness import is_slow, ramp_stiffness  # takes half a second to import

    try:
        record = test.record()
    except UnusableInputError:  # values that no instrument measures: an analysis refuses them
        return False
    signals = [signal[record.valid] for signal in (record.input, record.output)] if record.valid.any() else []
    return bool(signals) and all(map(is_slow, signals)) and bool(ramp_stiffness(record))


def _loaded(
    file: ImportedTable, rows: RowRange, signals: Sequence[Mapped], time: Mapped | None
) -> tuple[list[NDArray[np.float64]], range]:
    """Return the columns in SI, time last, and the selected rows."""
    every = [*signals, time] if time is not None else list(signals)
    values, chosen = file.load([column.index for column in every], rows)
    return [column.unit.to_si(each) for column, each in zip(every, values, strict=True)], chosen


def _clocked(
    file: ImportedTable,
    values: list[NDArray[np.float64]],
    signals: Sequence[Mapped],
    time: Mapped | None,
    attributes: Attributes | None,
    rate_hz: float | None,
    resample_hz: float | None,
    notices: list[str],
) -> tuple[Test, slice]:
    """Return a test with samples at a constant rate, and the rows that it consists of."""
    stated_hz = attributes.test.sample_rate_hz if attributes else rate_hz
    units = {
        column.role: column.unit.si for column in signals if column.role not in SIGNAL_UNITS and column.unit.si != "1"
    }
    rows = values[0].size
    if time is not None and time.is_assumed:
        check_seconds(values[-1])
    if resample_hz is not None:
        if time is None:
            raise UnusableInputError("--resample needs times: --map time=COLUMN:UNIT")
        values, added = resampled(values[-1], values[:-1], resample_hz)
        notices += added
        clock = steady(resample_hz, values[0].size)
    elif time is None or (rows == 1 and stated_hz is not None):
        if stated_hz is None:
            raise UnusableInputError("import.no_rate", "has neither times nor a rate: choose {rate}", rate=RATE)
        clock = steady(stated_hz, rows)
    elif rows == 1:
        raise UnusableInputError(
            "import.one_row", "one row gives no sample rate: select more rows, or choose {rate}", rate=RATE
        )
    else:
        clock = _clock(file, values[-1], stated_hz)
        notices += clock.notices
    arrays = {column.role: clock.laid_out(each) for column, each in zip(signals, values, strict=False)}
    return Test(number=1, kind="stochastic", signals=arrays, sample_rate_hz=clock.rate_hz, units=units), clock.kept


def _clock(file: ImportedTable, times: NDArray[np.float64], stated_hz: float | None) -> Clock:
    try:
        return clock_of(times, file.step_s, stated_hz)
    except UnusableInputError as error:
        if len(file.segments) < 2:
            raise
        starts = ", ".join(str(first) for first in file.segments[:12])
        raise UnusableInputError(
            "import.segments",
            "{reason} (it has {count} segments, which start at rows {rows})",
            reason=error.message,
            count=len(file.segments),
            rows=starts,
        ) from error


def _exported_columns(file: ImportedTable, attributes: Attributes) -> list[Mapped]:
    """Return the columns of an export, which are in SI."""
    columns = []
    for name, part in attributes.columns.items():
        index = file.column_index(part.column)
        if part.unit != SIGNAL_UNITS.get(name, part.unit):
            raise UnusableInputError(
                "import.not_si",
                "its attributes file says {signal} in {unit}: exports are in SI",
                signal=name,
                unit=part.unit,
            )
        unit = replace(_SI, symbol=part.unit, si=part.unit)
        columns.append(Mapped(name, index, part.column, unit))
    if len([column for column in columns if column.role != "time"]) < 2:
        raise UnusableInputError("import.few_signals", "its attributes file names fewer than two signals")
    return columns


def _provenance(source: Source, file: ImportedTable, signals: Sequence[Mapped], rows: range) -> dict[str, str | float]:
    """Return the origin of the samples, without the name of the file, which may be that of a person."""
    return {
        "source_format": file.format,
        "source_sha256": sha256_of(source.path),
        "source_rows": f"{rows.start}:{rows.stop}",
        "source_columns": json.dumps({c.role: {"column": c.header, "unit": c.unit.symbol} for c in signals}),
    }
