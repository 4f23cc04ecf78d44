"""An imported file as columns of numbers with headers and units."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Verbatim
from tissueid.sessions.imports.stated_units import (
    NO_UNIT,
    is_a_unit,
    is_clear_suffix,
    split_header,
    split_suffix,
    unit_of,
)
from tissueid.untrusted_input import MAX_SAMPLES

_MOST_LISTED = 20
"""Most columns that a message lists."""
_LONGEST_NAME = 60
"""Most characters of a column name in a message."""
ROWS = Action("import.rows", "@FIRST:LAST", marked("the field Rows"))
RATE = Action("import.rate", "--rate HZ", marked("a sample rate"))
TIME = Action("import.time", "--map time=COLUMN:UNIT", marked("a column of times"))
DECIMAL = Action("import.decimal", "--decimal point or --decimal comma", marked("the list Decimal sign"))
MAP = Action("import.map", "--map ROLE=COLUMN:UNIT", marked("the lists of the columns"))


@dataclass(frozen=True)
class RowRange:
    """A selection of rows like a slice: from 0, ``last`` exclusive, negative indices count from the end."""

    first: int | None = None
    last: int | None = None

    def within(self, total: int) -> range:
        """Return the selected rows of ``total``.

        Raises:
            UnusableInputError: there are no such rows.
        """
        ends = []
        for value, default in ((self.first, 0), (self.last, total)):
            end = default if value is None else value + total if value < 0 else value
            if not 0 <= end <= total:
                raise UnusableInputError(
                    "import.row_beyond", "row {row} is beyond the {rows} rows of the file", row=value, rows=total
                )
            ends.append(end)
        if ends[1] <= ends[0]:
            raise UnusableInputError("import.no_rows", "rows {rows} of {total} are empty", rows=str(self), total=total)
        return range(*ends)

    def of_a_test(self, total: int) -> range:
        """Return the selected rows of ``total``, at most ``MAX_SAMPLES``.

        Raises:
            UnusableInputError: there are no such rows, or too many.
        """
        chosen = self.within(total)
        if len(chosen) > MAX_SAMPLES:
            raise UnusableInputError(
                "import.too_many_rows",
                "has {count} rows; at most {most} make a test: select some ({rows})",
                count=len(chosen),
                most=MAX_SAMPLES,
                rows=ROWS,
            )
        return chosen

    def __str__(self) -> str:
        return f"{'' if self.first is None else self.first}:{'' if self.last is None else self.last}"


@dataclass(frozen=True)
class Column:
    """One column: its ``header`` and the text of the ``unit`` that the file states, "" if it states none.

    ``dated`` is whether its cells are dates or times of day, which are read in s.
    """

    header: str
    unit: str = ""
    dated: bool = False

    @classmethod
    def headed(cls, header: str) -> Column:
        """Return a column whose header may contain its unit."""
        return cls(header.strip(), split_header(header)[1])

    @property
    def name(self) -> str:
        """The header without its unit, and without a suffix that is one."""
        name, stated = split_header(self.header)
        before, suffix = split_suffix(name)
        return before if not stated and suffix and is_a_unit(suffix) else name

    def unit_for(self, role: str, expected: str) -> str:
        """Return the text of the unit that the file states for a role with this SI unit; "" if it states none.

        A suffix counts where it cannot be anything else, or where the name before it is one of the role.
        """
        if self.unit:
            return "" if self.unit in NO_UNIT and expected not in ("", "1") else self.unit
        name, suffix = split_suffix(self.header)
        if not suffix or not (is_clear_suffix(suffix, expected) or (expected and is_named_like(role, name))):
            return ""
        unit = unit_of(suffix, expected)
        return suffix if unit is not None and (not expected or unit.si == expected) else ""


TIME_NAMES = frozenset({"time", "t", "x_value", "timestamp", "zeit", "temps", "tempo", "elapsed", "elapsed time"})
"""Usual names of a column of times."""
NAMED_LIKE = {
    "position": ("pos", "disp", "depth", "weg", "indent", "stroke", "auslenkung", "eindr", "deplacement"),
    "force": ("force", "kraft", "load", "fz", "newton"),
    "voltage": ("volt", "spannung"),
    "current": ("curr", "strom", "amp"),
    "command": ("command", "cmd", "soll"),
    "temperature": ("temp",),
}
"""Parts of the names of columns that indicate each signal, in English, German and French."""


def is_named_like(role: str, name: str) -> bool:
    """Return whether the name of a column is a usual one for a role."""
    name = name.casefold()
    return name in TIME_NAMES if role == "time" else any(part in name for part in NAMED_LIKE.get(role, (role,)))


Loader = Callable[[Sequence[int], RowRange], tuple[list[NDArray[np.float64]], range]]
"""Function of column indices, from 0, and a row selection that returns the columns, each (n,), and the rows."""


@dataclass(frozen=True)
class ImportedTable:
    """An imported file whose columns are known but not yet read.

    ``time`` is the index of the time column by the rules of the format, ``step_s`` the time step that the file states,
    and ``segments`` the first rows of its parts. ``notices`` are for users, one line each.
    """

    format: str
    columns: tuple[Column, ...]
    load: Loader
    time: int | None = None
    step_s: float | None = None
    segments: tuple[int, ...] = ()
    notices: tuple[str, ...] = ()

    def listed(self) -> str:
        """Return a list of the columns in one line."""
        names = [
            f"{k} {c.header[:_LONGEST_NAME]!r}" if c.header else str(k) for k, c in enumerate(self.columns, start=1)
        ]
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        return ", ".join(names[:_MOST_LISTED]) + more

    def column_index(self, wanted: str) -> int:
        """Return the index, from 0, of a column by its header, its name without unit, or its number from 1.

        Raises:
            UnusableInputError: there is none, or more than one.
        """
        folded = wanted.strip().casefold()
        for sought, keys in (
            (wanted, [c.header for c in self.columns]),
            (folded, [c.header.casefold() for c in self.columns]),
            (folded, [c.name.casefold() for c in self.columns]),
        ):
            places = [k for k, key in enumerate(keys) if key and key == sought]
            if len(places) > 1:
                numbers = ", ".join(str(index + 1) for index in places)
                raise UnusableInputError(
                    "import.column_ambiguous",
                    "'{column}' is the name of columns {numbers}: choose one by its number",
                    column=Verbatim(wanted),
                    numbers=numbers,
                )
            if places:
                return places[0]
        if re.fullmatch(r"[0-9]{1,9}", wanted.strip()):
            number = int(wanted)
            if not 1 <= number <= len(self.columns):
                raise UnusableInputError(
                    "import.no_column_number",
                    "there is no column {number}; columns are numbered from 1 to {count}",
                    number=number,
                    count=len(self.columns),
                )
            return number - 1
        raise UnusableInputError(
            "import.no_column",
            "there is no column '{column}'; the columns are: {columns}",
            column=Verbatim(wanted),
            columns=Verbatim(self.listed()),
        )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
