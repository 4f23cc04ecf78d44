"""CSV and similar files: rows of cells, with any delimiter, optional header, comments and decimal commas."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import islice, product
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions.imports.imported_table import DECIMAL, ROWS, Column, ImportedTable, RowRange
from tissueid.sessions.imports.stated_units import NO_UNIT, is_a_unit, unit_of
from tissueid.untrusted_input import MAX_COLUMNS, MAX_LINE

# -- lines, cells and numbers of text files --------------------------------------------------------------------------

_HEAD = 1 << 16
_LONGEST_SHOWN = 40
_HEAD_CHARACTERS = 500_000
"""Largest number of characters by which a layout is detected: each layout is tried on all of them."""
_BLOCK = 65_536
"""Number of rows converted to numbers at a time."""
_BLOCK_CHARACTERS = 4_000_000
_Row = TypeVar("_Row")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?"),
    ",": re.compile(r"[+-]?(\d+(,\d+)?|,\d+)([eEdD][+-]?\d+)?"),
}
GROUPED = {
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"),
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"),
}
"""Numbers with a sign between thousands, by that sign."""
_DATED = re.compile(r"(\d{4}-\d\d-\d\d[T ])?\d{1,2}:\d\d:\d\d([.,]\d+)?(Z|[+-]\d\d:?\d\d)?")
MISSING = frozenset({"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "missing", "1.#qnan"})
"""Cells without a number, in lower case."""
_BEGIN, _BEGIN_UTC = datetime(2001, 1, 1), datetime(2001, 1, 1, tzinfo=UTC)
_INFINITE = frozenset({"inf", "-inf", "+inf", "infinity", "-infinity"})


def encoding_of(path: Path) -> str:
    """Return the encoding of a text file: by its byte order mark, else UTF-8, else Latin-1.

    Raises:
        UnusableInputError: it is not text.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if head.startswith(b"PK\x03\x04"):
        raise UnusableInputError("import.spreadsheet", "is a spreadsheet or an archive; save the sheet as CSV")
    if _CONTROL.search(head):
        raise UnusableInputError("import.not_text", "is not text, and not a MAT file: CSV, MAT and LVM can be read")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def lines_of(path: Path, encoding: str) -> Iterator[str]:
    """Yield the lines of a text file without line ends.

    Raises:
        UnusableInputError: a line is too long.
    """
    with path.open(encoding=encoding, errors="replace") as file:
        while line := file.readline(MAX_LINE + 1):
            if len(line) > MAX_LINE:
                raise UnusableInputError("import.long_line", "has a line of more than {most} characters", most=MAX_LINE)
            yield line.rstrip("\r\n")


def head_of(lines: Iterable[str], most: int) -> list[str]:
    """Return the first lines, at most ``most``, or fewer if they are long."""
    head, characters = [], 0
    for line in lines:
        head.append(line)
        characters += len(line)
        if len(head) >= most or characters > _HEAD_CHARACTERS:
            break
    return head


def blocks_of(rows: Iterable[_Row], length: Callable[[_Row], int]) -> Iterator[list[_Row]]:
    """Yield rows in blocks that take little memory; ``length`` is that of a row, in characters."""
    block: list[_Row] = []
    characters = 0
    for row in rows:
        block.append(row)
        characters += length(row)
        if len(block) >= _BLOCK or characters > _BLOCK_CHARACTERS:
            yield block
            block, characters = [], 0
    if block:
        yield block


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; a space as delimiter means any white space.

    Raises:
        UnusableInputError: the line cannot be parsed, for example because of a very long quoted cell.
    """
    if delimiter == " ":
        return re.split("[ \t]+", line.strip(" \t"))  # not the spaces that separate thousands
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error as error:
        raise UnusableInputError(
            "import.bad_line", "has a line that cannot be read: {error}", error=str(error)
        ) from error


def is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number with this decimal sign."""
    cell = cell.strip()
    return _NUMBER[decimal].fullmatch(cell) is not None or cell.lower() in _INFINITE


def is_missing(cell: str) -> bool:
    """Return whether a cell marks a missing number."""
    return cell.strip().lower() in MISSING


def is_time(cell: str) -> bool:
    """Return whether a cell is a time by ISO 8601, with or without its date."""
    return ":" in cell and _DATED.fullmatch(cell.strip()) is not None


def seconds(cells: list[str]) -> NDArray[np.float64]:
    """Return times by ISO 8601, with or without their dates, in s from some moment; NaN for missing ones.

    Raises:
        ValueError: a cell is neither a time nor missing; the argument is its index.
    """
    result = np.empty(len(cells))
    for index, cell in enumerate(cells):
        if is_missing(cell):
            result[index] = np.nan
            continue
        if not is_time(cell):
            raise ValueError(index)
        text = cell.strip().replace(",", ".")
        date, _, clock = text.replace(" ", "T").rpartition("T")
        clock = clock if clock[2] == ":" else f"0{clock}"
        try:
            moment = datetime.fromisoformat(f"{date or '2001-01-01'}T{clock}")
        except ValueError:
            raise ValueError(index) from None
        since = moment - (_BEGIN if moment.tzinfo is None else _BEGIN_UTC)
        result[index] = since.days * 86_400 + since.seconds + since.microseconds / 1e6
    return result


def numbers(cells: list[str], decimal: str) -> NDArray[np.float64]:
    """Return cells as numbers, shape (n,); NaN for missing ones.

    Raises:
        ValueError: a cell is neither a number nor missing; the argument is its index.
    """
    if decimal == ".":
        try:
            values = np.array(list(map(float, cells)))
        except ValueError:
            pass
        else:
            if not any("_" in cell for cell in cells):  # Python accepts underscores between digits, data files do not
                return values
    result = np.empty(len(cells))
    for index, cell in enumerate(cells):
        if is_number(cell, decimal):
            result[index] = float(cell.strip().replace(",", ".").replace("d", "e").replace("D", "e"))
        elif is_missing(cell):
            result[index] = np.nan
        else:
            raise ValueError(index)
    return result


def shown(cell: str) -> str:
    """Return a cell as quoted in an error message."""
    return repr(cell.strip()[:_LONGEST_SHOWN])


_LOOKED_AT = 400
"""Number of lines by which the layout is detected."""
_DELIMITERS = ("\t", ";", ",", "|", " ")
_COMMENTS = ("#", "%", "//")
_BRACKETS = re.compile(r"[(\[{]\s*(.*?)\s*[)\]}]")
_DECIMAL_COMMAS = {
    "\t": Message("import.decimal_commas", "read with decimal commas and tabs between the columns"),
    ";": Message("import.decimal_commas", "read with decimal commas and semicolons between the columns"),
    ",": Message("import.decimal_commas", "read with decimal commas and commas between the columns"),
    "|": Message("import.decimal_commas", "read with decimal commas and bars between the columns"),
    " ": Message("import.decimal_commas", "read with decimal commas and spaces between the columns"),
}


@dataclass(frozen=True)
class _Layout:
    """Layout of a file; ``start`` is its first line of data, from 0.

    ``grouping`` is the sign between thousands. ``is_sure`` is whether the first lines tell it from the decimal sign.
    """

    delimiter: str
    decimal: str
    width: int
    start: int
    columns: tuple[Column, ...]
    is_sure: bool = True
    grouping: str = ""


def open_csv(path: Path, decimal: str | None = None) -> ImportedTable:
    """Open a text file of rows, without reading its data yet.

    ``decimal`` is the decimal sign, "." or ",", of a file in which a sign between thousands looks the same.

    Raises:
        UnusableInputError: it is not text, or has no rows of two or more cells with numbers.
    """
    encoding = encoding_of(path)
    layout = _layout(head_of(lines_of(path, encoding), _LOOKED_AT), decimal)

    def load(places: Sequence[int], rows: RowRange) -> tuple[list[NDArray[np.float64]], range]:
        return _load(path, encoding, layout, places, rows)

    notices = []
    if layout.decimal == ",":
        notices.append(_DECIMAL_COMMAS[layout.delimiter])
    return ImportedTable("csv", layout.columns, load, notices=tuple(notices))


# -- layout ---------------------------------------------------------------------------------------------------


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(_COMMENTS)


def _layout(lines: list[str], decimal_sign: str | None) -> _Layout:
    data_lines = [line for line in lines if line.strip() and not _is_comment(line)]
    best, layout = 0.0, None
    for delimiter, decimal in product(_DELIMITERS, (".", ",")):
        score, width = _score([cells_of(line, delimiter) for line in data_lines], decimal)
        if score > best:
            best, layout = score, (delimiter, decimal, width)
    if layout is None:
        raise UnusableInputError(
            "import.no_columns", "holds no rows of two or more columns with numbers in its first lines"
        )
    delimiter, decimal, width = layout
    if width > MAX_COLUMNS:
        raise UnusableInputError(
            "import.too_many_columns", "has {columns} columns; at most {most} are read", columns=width, most=MAX_COLUMNS
        )
    start = _first_row(lines, delimiter, decimal, width)
    rows = [row for line in lines[start:] if len(row := cells_of(line, delimiter)) == width]
    columns = [
        replace(column, dated=_is_dated([row[index] for row in rows]))
        for index, column in enumerate(_columns(lines[:start], delimiter, width, lines[start:]))
    ]
    if decimal_sign is not None:
        return _Layout(
            delimiter, decimal_sign, width, start, tuple(columns), grouping="," if decimal_sign == "." else "."
        )
    is_sure = any(_shows(cell.strip(), decimal) for row in rows for cell in row)
    return _Layout(delimiter, decimal, width, start, tuple(columns), is_sure)


def _shows(cell: str, decimal: str) -> bool:
    """Return whether a cell shows that this is the decimal sign, and not a sign between thousands."""
    return decimal in cell and is_number(cell, decimal) and not GROUPED[decimal].fullmatch(cell)


def _is_dated(cells: list[str]) -> bool:
    """Return whether the cells are dates with times, or times of day."""
    texts = [cell for cell in cells if not is_missing(cell)]
    return bool(texts) and all(map(is_time, texts))


def _score(rows: list[list[str]], decimal: str) -> tuple[float, int]:
    """Return the score of a layout: numbers minus texts, over the rows of the most common width; and that width."""
    different = [Counter(cells) for cells in rows]  # equal cells of a row, of which there may be many, count once
    widths = Counter(row.total() for row in different if any(is_number(cell, decimal) for cell in row))
    del widths[1]
    if not widths:
        return 0.0, 0
    width = max(widths, key=lambda each: widths[each])  # the first of equally common widths
    score = 0.0
    for row in different:
        if row.total() == width:
            numeric = sum(count for cell, count in row.items() if is_number(cell, decimal))
            texts = width - numeric - sum(count for cell, count in row.items() if is_missing(cell) or is_time(cell))
            score += max(0.0, numeric - 0.9 * texts)
    return score, width


def _first_row(lines: list[str], delimiter: str, decimal: str, width: int) -> int:
    split = [[] if not line.strip() or _is_comment(line) else cells_of(line, delimiter) for line in lines]
    rows = [cells for cells in split if len(cells) == width]
    numeric = [
        index for index in range(width) if 2 * sum(is_number(cells[index], decimal) for cells in rows) >= len(rows)
    ]
    for number, cells in enumerate(split):
        if len(cells) != width:
            continue
        is_numeric = [is_number(cells[index], decimal) for index in numeric]
        if any(is_numeric) and all(f or is_missing(cells[p]) for f, p in zip(is_numeric, numeric, strict=True)):
            return number
    raise UnusableInputError(
        "import.no_numeric_row", "the first lines hold no row of numbers: it is not a table of data"
    )


def _columns(above: list[str], delimiter: str, width: int, below: list[str]) -> tuple[Column, ...]:
    """Return names and units from the lines above the data: a header, optionally followed by a line of units."""
    heads = []
    for line in above:
        text = line.strip().lstrip("#%/").strip() if _is_comment(line) else line
        cells = [cell.strip() for cell in cells_of(text, delimiter)]
        if len(cells) == width - 1 and all(not c[-1].strip() for c in (cells_of(b, delimiter) for b in below[:3]) if c):
            cells.append("")  # rows end with a delimiter and the header does not
        if len(cells) == width:
            heads.append(cells)
    if not heads:
        return tuple(Column("") for _ in range(width))
    units = [_BRACKETS.sub(r"\1", cell) for cell in heads[-1]]
    if len(heads) > 1 and _are_units(heads[-1]):
        return tuple(_under(name, unit) for name, unit in zip(heads[-2], units, strict=True))
    return tuple(Column.headed(name) for name in heads[-1])


def _are_units(cells: list[str]) -> bool:
    """Return whether a row under the names states units: each in brackets, or at least half of them known."""
    texts = [cell for cell in cells if cell and cell not in NO_UNIT]
    recognised = sum(is_a_unit(_BRACKETS.sub(r"\1", text)) for text in texts)
    return bool(texts) and (all(_BRACKETS.fullmatch(text) for text in texts) or 2 * recognised >= len(texts))


def _under(name: str, unit: str) -> Column:
    """Return a column with the unit of the row under its name; another unit in the name makes it unknown."""
    headed = Column.headed(name)
    same = not unit or not headed.unit or unit_of(unit) == unit_of(headed.unit)
    return Column(name, (unit or headed.unit) if same else f"{headed.unit}, {unit}")


# -- reading --------------------------------------------------------------------------------------------------


def _data_lines(path: Path, encoding: str, start: int) -> Iterator[tuple[int, str]]:
    """Yield number, from 1, and text of every line of data; blank lines and comments are skipped."""
    for number, line in enumerate(lines_of(path, encoding), start=1):
        if number > start and line.strip() and not _is_comment(line):
            yield number, line


def _load(
    path: Path, encoding: str, layout: _Layout, places: Sequence[int], rows: RowRange
) -> tuple[list[NDArray[np.float64]], range]:
    total = sum(1 for _ in _data_lines(path, encoding, layout.start))
    chosen = rows.of_a_test(total)
    lines = islice(_data_lines(path, encoding, layout.start), chosen.start, chosen.stop)
    blocks: list[list[NDArray[np.float64]]] = []
    for block in blocks_of(lines, lambda line: len(line[1])):
        cells: list[list[str]] = [[] for _ in places]
        for number, line in block:
            row = cells_of(line, layout.delimiter)
            if len(row) != layout.width:
                raise UnusableInputError(
                    "import.cells",
                    "line {line} has {cells} cells where others have {others}; leave rows out ({rows})",
                    line=number,
                    cells=len(row),
                    others=layout.width,
                    rows=ROWS,
                )
            for column, index in zip(cells, places, strict=True):
                column.append(row[index])
        blocks.append([_numbers(column, block, layout, index) for column, index in zip(cells, places, strict=True)])
    return [np.concatenate(parts) for parts in zip(*blocks, strict=True)], chosen


def _numbers(cells: list[str], block: list[tuple[int, str]], layout: _Layout, column: int) -> NDArray[np.float64]:
    try:
        if layout.columns[column].dated:
            return seconds(cells)
        if layout.grouping:
            sign = layout.grouping
            cells = [cell.replace(sign, "") if GROUPED[sign].fullmatch(cell.strip()) else cell for cell in cells]
        elif not layout.is_sure:
            _check_grouping(cells, block, layout, column)
        return numbers(cells, layout.decimal)
    except ValueError as error:
        bad = int(error.args[0])
        if not layout.grouping and any(pattern.fullmatch(cells[bad].strip()) for pattern in GROUPED.values()):
            raise _thousands(block[bad][0], column, cells[bad]) from error
        raise UnusableInputError(
            "import.not_a_number",
            "line {line}, column {column}: {found} is not a number; leave rows out ({rows})",
            line=block[bad][0],
            column=column + 1,
            found=shown(cells[bad]),
            rows=ROWS,
        ) from error


def _thousands(line: int, column: int, cell: str) -> UnusableInputError:
    return UnusableInputError(
        "import.thousands",
        "line {line}, column {column}: {found} can be a number of thousands or one with decimals: choose its decimal "
        "sign ({action})",
        line=line,
        column=column + 1,
        found=shown(cell),
        action=DECIMAL,
    )


def _check_grouping(cells: list[str], block: list[tuple[int, str]], layout: _Layout, column: int) -> None:
    """Check that the decimal sign of a column cannot be a sign between thousands.

    Raises:
        UnusableInputError: it can: three digits follow each, as in 1,545. A point is doubted only next to cells without
            one, because numbers of three decimals all have it.
    """
    sign = layout.decimal
    having = [row for row, cell in enumerate(cells) if sign in cell]
    if not having or (sign == "." and len(having) == len(cells)):
        return
    if any(re.match(r"\s*[+-]?\d{4}", cell) for cell in cells):
        return
    if all(GROUPED[sign].fullmatch(cells[each].strip()) for each in having):
        raise _thousands(block[having[0]][0], column, cells[having[0]])
