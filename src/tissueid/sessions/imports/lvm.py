"""LVM, the text files of LabVIEW: a file header, then segments with a header each.

Source: "Specification for the LabVIEW Measurement File (.lvm)", National Instruments.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.sessions.imports.csv import blocks_of, encoding_of, lines_of, numbers, shown
from tissueid.sessions.imports.imported_table import Column, ImportedTable, RowRange
from tissueid.untrusted_input import MAX_COLUMNS

FIRST_LINE = "LabVIEW Measurement"
_END = "***End_of_Header***"
_SPECIAL = "***"
_SEPARATORS = {"tab": "\t", "comma": ",", "semicolon": ";"}
_LONGEST_HEADER = 1000
_CELL = 10
"""Number of characters that a cell counts as: it takes more memory than its text."""


@dataclass
class _Segment:
    """One segment: its header by key, its channels by name, its first row and its number of rows."""

    header: dict[str, list[str]]
    channels: list[str]
    first: int
    rows: int = 0
    is_spaced: bool = False
    """Whether the header has a cell for the times of each channel before that of the next."""
    most_rows: float = math.inf
    """Number of rows after which times start again, where they are not stored."""


@dataclass(frozen=True)
class _Outline:
    separator: str
    decimal: str
    x_columns: str
    segments: list[_Segment] = field(default_factory=list)
    """The segments read so far."""

    def cell(self, column: int) -> int:
        """Return the index in a row of a column of the file."""
        return 2 * column - 1 if self.x_columns == "multi" and column else column

    def stated(self, segment: _Segment, key: str, channel: int) -> str:
        """Return the text of one channel, from 0, in a segment's header; "" if it is missing.

        With a column of times for each channel, the header has a cell for each of them as well.
        """
        values = segment.header.get(key, [])
        index = channel * (2 if segment.is_spaced else 1)
        return values[index] if index < len(values) else ""

    def figure(self, segment: _Segment, key: str, channel: int = 0) -> float | None:
        """Return a number of one channel, from 0, in a segment's header; None if it is missing."""
        value = self.stated(segment, key, channel)
        try:
            return float(numbers([value], self.decimal)[0]) if value else None
        except ValueError as error:
            raise UnusableInputError(
                "import.lvm_value", "its header says {key} {value}: not a number", key=key, value=shown(value)
            ) from error

    def samples(self, segment: _Segment) -> float:
        """Return the largest number of samples of a channel in a segment's header; 0 if it is missing."""
        return max((self.figure(segment, "Samples", k) or 0.0 for k in range(len(segment.channels))), default=0.0)

    def clock(self, segment: _Segment, channel: int) -> tuple[float, float | None]:
        """Return the first time and the step of one channel, s."""
        return self.figure(segment, "X0", channel) or 0.0, self.figure(segment, "Delta_X", channel)


def open_lvm(path: Path) -> ImportedTable:
    """Open an LVM file, without reading its data yet.

    Raises:
        UnusableInputError: it is not an LVM file, or invalid; the message states the place.
    """
    encoding = encoding_of(path)
    outline = _outline(path, encoding)
    first = outline.segments[0]
    for segment in outline.segments[1:]:
        if segment.channels != first.channels:
            raise UnusableInputError(
                "import.lvm_channels",
                "its segments have different channels from row {row} on; export them one by one",
                row=segment.first,
            )
    stored = outline.x_columns != "no"
    dimension = outline.stated(first, "X_Dimension", 0) or "Time"
    by_time = dimension == "Time"
    columns = [Column("X_Value", outline.stated(first, "X_Unit_Label", 0) or ("s" if by_time else dimension))]
    for channel, name in enumerate(first.channels):
        stated = outline.stated(first, "Y_Unit_Label", channel)
        columns.append(Column(name, stated) if stated else Column.headed(name))
    step = outline.figure(first, "Delta_X")
    if not stored and step is None:
        raise UnusableInputError("import.lvm_no_time", "has neither times (X_Columns) nor a step (Delta_X)")
    total = sum(segment.rows for segment in outline.segments)
    notices = []
    for segment in outline.segments:
        said = outline.samples(segment)
        if said > segment.rows:
            notices.append(
                Message(
                    "import.lvm_rows",
                    "the header announces {announced:.0f} rows from row {row} on, but the file has {rows}: "
                    "it may be cut short",
                    announced=said,
                    row=segment.first,
                    rows=segment.rows,
                )
            )

    def load(places: Sequence[int], rows: RowRange) -> tuple[list[NDArray[np.float64]], range]:
        return _load(path, encoding, total, places, rows)

    return ImportedTable(
        "lvm",
        tuple(columns),
        load,
        time=0 if by_time else None,
        step_s=step,
        segments=tuple(segment.first for segment in outline.segments),
        notices=tuple(notices),
    )


def _outline(path: Path, encoding: str) -> _Outline:
    """Return the headers of the whole file, with the number of rows of each segment."""
    outline = _Outline("\t", ".", "one")
    for outline, segment, _, _ in _rows(path, encoding):  # noqa: B007
        segment.rows += 1
    if not outline.segments:
        raise UnusableInputError("import.lvm_empty", "holds no rows")
    return outline


_Row = tuple[_Outline, _Segment, int, list[str]]
"""The outline so far, the segment, the number of the line, and the cells."""


def _rows(path: Path, encoding: str) -> Iterator[_Row]:
    """Yield all rows of data in order; segments are added to the outline on the way."""
    lines = enumerate(lines_of(path, encoding), start=1)
    outline = _file_header(lines)
    header: dict[str, list[str]] | None = None
    segment: _Segment | None = None
    special = in_notes = False
    total = 0
    for number, line in lines:
        if line.startswith(_SPECIAL):
            special = "start" in line.lower() or (special and "end" not in line.lower())
            continue
        cells = [cell.strip() for cell in line.split(outline.separator)]
        in_notes = cells[0] != "Channels" and (
            (in_notes and header is None) or (segment is None and cells[0] == "Notes")
        )
        if special or in_notes or not any(cells):
            segment = None
        elif cells[0] == "Channels":
            header, segment = {"Channels": cells[1:]} | _header(lines, outline.separator), None
        elif header is None:
            raise UnusableInputError(
                "import.lvm_header",
                "line {line}: expected the header of a segment, not {found}",
                line=number,
                found=shown(line),
            )
        elif cells[0] == "X_Value":
            segment = _segment(outline, header, cells, total)
        else:
            segment = segment or _segment(outline, header, [], total)
            if total - segment.first >= segment.most_rows:  # a further trigger, without a header
                segment = _segment(outline, header, [], total)
            total += 1
            yield outline, segment, number, cells


def _segment(outline: _Outline, header: dict[str, list[str]], named: list[str], first: int) -> _Segment:
    stated = header["Channels"][0] if header["Channels"] else ""
    if not (stated.isascii() and stated.isdigit() and len(stated) <= 9 and 0 < int(stated) <= MAX_COLUMNS):
        raise UnusableInputError("import.lvm_channel_count", "a header announces {found} channels", found=shown(stated))
    count = int(stated)
    before = outline.segments[-1].channels if outline.segments else [""] * count
    if named:
        names = named[1 :: 2 if outline.x_columns == "multi" else 1]
        names += [""] * (count - len(names))
    else:  # further rows under the previous headings
        names = before
    cells_of = [header.get(key, []) for key in ("Samples", "X0", "Delta_X", "X_Dimension", "Y_Unit_Label")]
    spaced = outline.x_columns == "multi" and any(any(cells[count:]) for cells in cells_of)
    segment = _Segment(header, names[:count], first, is_spaced=spaced and count > 1)
    if outline.x_columns == "no":
        segment.most_rows = outline.samples(segment) or math.inf
    outline.segments.append(segment)
    return segment


def _file_header(lines: Iterator[tuple[int, str]]) -> _Outline:
    head = next(lines, (1, ""))[1]
    if not head.startswith(FIRST_LINE):
        raise UnusableInputError(
            "import.lvm_not_one",
            "it is not an LVM file: its first line does not begin with '{found}'",
            found=FIRST_LINE,
        )
    after = head[len(FIRST_LINE) :][:1]
    stated = _header(lines, after if after in _SEPARATORS.values() else "")

    def first_value(key: str, default: str) -> str:
        return (stated.get(key) or [default])[0] or default

    separator = _SEPARATORS.get(first_value("Separator", "Tab").lower(), "\t")
    decimal = first_value("Decimal_Separator", ".") if separator != "," else "."
    if decimal not in (".", ","):
        raise UnusableInputError(
            "import.lvm_decimal",
            "its header says Decimal_Separator {found}: neither a point nor a comma",
            found=shown(decimal),
        )
    x_columns = first_value("X_Columns", "One").lower()
    if x_columns not in ("no", "one", "multi"):
        raise UnusableInputError(
            "import.lvm_x_columns", "its header says X_Columns {found}: not No, One or Multi", found=shown(x_columns)
        )
    return _Outline(separator, decimal, x_columns)


def _header(lines: Iterator[tuple[int, str]], separator: str) -> dict[str, list[str]]:
    """Return keys and values up to the end of a header; without a ``separator``, that of each line is detected."""
    stated: dict[str, list[str]] = {}
    for _, (_, line) in zip(range(_LONGEST_HEADER), lines, strict=False):
        if line.startswith(_END):
            return stated
        between = separator or next((mark for mark in _SEPARATORS.values() if mark in line), "\t")
        key, *values = (cell.strip() for cell in line.split(between))
        stated[key] = values
    raise UnusableInputError(
        "import.lvm_truncated", "has a header without {found}: truncated, or not an LVM file", found=_END
    )


def _load(
    path: Path, encoding: str, total: int, places: Sequence[int], rows: RowRange
) -> tuple[list[NDArray[np.float64]], range]:
    chosen = rows.of_a_test(total)
    blocks: list[list[NDArray[np.float64]]] = []
    lines = islice(_rows(path, encoding), chosen.start, chosen.stop)
    row = chosen.start
    channels = [column - 1 for column in places if column]
    checked: _Segment | None = None
    for block in blocks_of(lines, lambda line: _CELL * len(line[3])):
        for outline, segment, _, _ in block:
            if segment is not checked:
                _check_clocks(outline, segment, channels)
                checked = segment
        blocks.append([_column(block, row, column, channels) for column in places])
        row += len(block)
    return [np.concatenate(parts) for parts in zip(*blocks, strict=True)], chosen


def _check_clocks(outline: _Outline, segment: _Segment, channels: Sequence[int]) -> None:
    """Check that channels, from 0, of one table of rows have the same times.

    Raises:
        UnusableInputError: they have not.
    """
    if outline.x_columns == "multi" or (outline.x_columns == "one" and (outline.figure(segment, "Samples") or 0) <= 1):
        return
    clocks = {outline.clock(segment, channel): segment.channels[channel] for channel in channels}
    if len(clocks) > 1:
        (first, (_, step)), (second, (_, further)) = [(name, clock) for clock, name in clocks.items()][:2]
        raise UnusableInputError(
            "import.lvm_clocks",
            "'{one}' and '{other}' have different times (X0 and Delta_X; steps {step:g} and {further:g} s): import "
            "channels of one step",
            one=Verbatim(first),
            other=Verbatim(second),
            step=step or 0.0,
            further=further or 0.0,
        )


def _column(block: list[_Row], row: int, index: int, channels: Sequence[int]) -> NDArray[np.float64]:
    outline = block[0][0]
    if index == 0 and outline.x_columns == "no":
        channel = channels[0] if channels else 0
        return np.array([_time(outline, segment, row + k, channel) for k, (_, segment, _, _) in enumerate(block)])
    at = outline.cell(index)
    column = []
    for _, _, number, cells in block:
        if len(cells) <= at:
            raise UnusableInputError(
                "import.lvm_cells",
                "line {line} has {cells} cells; column {column} is missing",
                line=number,
                cells=len(cells),
                column=index + 1,
            )
        if outline.x_columns == "multi" and index and cells[at - 1] != cells[0]:
            raise UnusableInputError(
                "import.lvm_own_times",
                "line {line}: the channels have different times; export them one by one",
                line=number,
            )
        column.append(cells[at])
    try:
        return numbers(column, outline.decimal)
    except ValueError as error:
        bad = int(error.args[0])
        raise UnusableInputError(
            "import.lvm_not_a_number",
            "line {line}, column {column}: {found} is not a number",
            line=block[bad][2],
            column=index + 1,
            found=shown(column[bad]),
        ) from error


def _time(outline: _Outline, segment: _Segment, row: int, channel: int) -> float:
    start, step = outline.clock(segment, channel)
    if step is None:
        raise UnusableInputError("import.lvm_no_step", "the header before row {row} has no Delta_X", row=segment.first)
    return start + step * (row - segment.first)
