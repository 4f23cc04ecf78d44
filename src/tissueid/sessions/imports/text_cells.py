"""Lines, cells and numbers of text files."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.untrusted_input import MAX_LINE

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
    for place, cell in enumerate(cells):
        if is_missing(cell):
            result[place] = np.nan
            continue
        if not is_time(cell):
            raise ValueError(place)
        text = cell.strip().replace(",", ".")
        date, _, clock = text.replace(" ", "T").rpartition("T")
        clock = clock if clock[2] == ":" else f"0{clock}"
        try:
            moment = datetime.fromisoformat(f"{date or '2001-01-01'}T{clock}")
        except ValueError:
            raise ValueError(place) from None
        since = moment - (_BEGIN if moment.tzinfo is None else _BEGIN_UTC)
        result[place] = since.days * 86_400 + since.seconds + since.microseconds / 1e6
    return result


def numbers(cells: list[str], decimal: str) -> NDArray[np.float64]:
    """Return cells as numbers, shape (n,); NaN for missing ones.

    Raises:
        ValueError: a cell is neither a number nor missing; the argument is its index.
    """
    if decimal == ".":
        try:
            found = np.array(list(map(float, cells)))
        except ValueError:
            pass
        else:
            if not any("_" in cell for cell in cells):  # Python accepts underscores between digits, data files do not
                return found
    result = np.empty(len(cells))
    for place, cell in enumerate(cells):
        if is_number(cell, decimal):
            result[place] = float(cell.strip().replace(",", ".").replace("d", "e").replace("D", "e"))
        elif is_missing(cell):
            result[place] = np.nan
        else:
            raise ValueError(place)
    return result


def shown(cell: str) -> str:
    """Return a cell as quoted in an error message."""
    return repr(cell.strip()[:_LONGEST_SHOWN])
