"""What a reader of files from elsewhere gives: columns of numbers, and what the file says of them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports.units import name_and_unit

MAX_ROWS = 20_000_000
"""As many as a signal of a session may have."""
MAX_COLUMNS = 10_000
MAX_BYTES = 4_000_000_000
_MOST_LISTED = 20
_LONGEST_NAME = 60


@dataclass(frozen=True)
class Rows:
    """A selection of rows as slices have it: from 0, ``last`` exclusive, negative ones from the end."""

    first: int | None = None
    last: int | None = None

    def within(self, total: int) -> range:
        """The rows that are meant, of so many.

        Raises:
            UnusableInputError: there are no such rows.
        """
        ends = []
        for value, default in ((self.first, 0), (self.last, total)):
            end = default if value is None else value + total if value < 0 else value
            if not 0 <= end <= total:
                raise UnusableInputError(f"row {value} is beyond the {total} rows that there are")
            ends.append(end)
        if ends[1] <= ends[0]:
            raise UnusableInputError(f"there is nothing in rows {self} of {total}")
        return range(*ends)

    def __str__(self) -> str:
        return f"{'' if self.first is None else self.first}:{'' if self.last is None else self.last}"


@dataclass(frozen=True)
class Column:
    """One column: ``header`` as the file has it, and the symbol of its ``unit`` where the file tells it, or ""."""

    header: str
    unit: str = ""

    @classmethod
    def headed(cls, header: str) -> Column:
        """A column whose header may carry its unit."""
        return cls(header.strip(), name_and_unit(header)[1])

    @property
    def name(self) -> str:
        """The header without its unit."""
        return name_and_unit(self.header)[0]


Loader = Callable[[Sequence[int], Rows], tuple[list[NDArray[np.float64]], range]]
"""Columns by their place, from 0, and a selection of rows: the columns, each (n,), and which rows they are."""


@dataclass(frozen=True)
class ForeignFile:
    """A file from elsewhere, looked into but not yet read.

    ``time`` is the place of the column that is time by the rules of the format, ``step_s`` the step that the file
    states, and ``segments`` the first rows of its parts. ``notices`` are for people, one line each.
    """

    format: str
    columns: tuple[Column, ...]
    load: Loader
    time: int | None = None
    step_s: float | None = None
    segments: tuple[int, ...] = ()
    notices: tuple[str, ...] = ()

    def listed(self) -> str:
        """The columns as they are offered to a person, on one line."""
        names = [
            f"{k} {c.header[:_LONGEST_NAME]!r}" if c.header else str(k) for k, c in enumerate(self.columns, start=1)
        ]
        more = f" and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
        return ", ".join(names[:_MOST_LISTED]) + more

    def place(self, wanted: str) -> int:
        """The place, from 0, of a column by its header, its bare name, or its number from 1.

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
                numbers = ", ".join(str(place + 1) for place in places)
                raise UnusableInputError(f"{wanted!r} is the name of columns {numbers}: say which by its number")
            if places:
                return places[0]
        if re.fullmatch(r"[0-9]{1,9}", wanted.strip()):
            number = int(wanted)
            if not 1 <= number <= len(self.columns):
                raise UnusableInputError(
                    f"there is no column {number}; columns are numbered from 1 and there are {len(self.columns)}"
                )
            return number - 1
        raise UnusableInputError(f"there is no column {wanted!r}; there are: {self.listed() or 'none'}")


def checked_size(path: Path) -> int:
    """Bytes of a file that is there and not too large to be read.

    Raises:
        UnusableInputError: it is not there, not a file, empty or too large.
    """
    if path.is_dir():
        raise UnusableInputError("is a folder; name a file")
    if not path.exists():
        raise UnusableInputError("no such file")
    if not path.is_file():
        raise UnusableInputError("is not a plain file")
    size = path.stat().st_size
    if size == 0:
        raise UnusableInputError("is empty")
    if size > MAX_BYTES:
        raise UnusableInputError(f"has {size} bytes; at most {MAX_BYTES} are read")
    return size


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
