"""Read the newest lines of the audit log, with checks, and export lines as CSV."""

from __future__ import annotations

import csv
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.atomic_write import atomic_file
from tissueid.audit import LogLine
from tissueid.audit.line import MAX_LINE, fields_of, read_line
from tissueid.errors import UnusableInputError
from tissueid.formatting import cell_text, clean, grouped, plain_text
from tissueid.language import _
from tissueid.messages import Message, translated

MOST_BYTES = 96 * 1024 * 1024
MOST_LINES = 200_000
_LOOK = 500
_LONGEST = 600
COLUMNS = ("number", "time", "role", "who", "what", "subject", "old", "new", "software", "previous", "hash")
"""Of the file for a spreadsheet."""


@dataclass(frozen=True)
class LogPage:
    """The newest lines of a log, newest first. ``remarks`` are what is to be said of the rest."""

    lines: tuple[LogLine, ...] = ()
    remarks: tuple[str, ...] = ()


def read_log(path: Path, cancelled: Callable[[], object], most_bytes: int = MOST_BYTES) -> LogPage:
    """Return the newest lines within a number of bytes. Lines with a wrong hash are counted and left out.

    Raises:
        UnusableInputError: it is no file.
        OSError: it cannot be read.
    """
    if not path.exists():
        return LogPage(
            (), (_("There is no audit log {path}: nothing has been logged yet, or it was moved.").format(path=path),)
        )
    if not path.is_file():
        raise UnusableInputError(
            "audit.not_a_file", "the audit log {path} is not a file: name another with TISSUEID_AUDIT", path=str(path)
        )
    size = path.stat().st_size
    kept: deque[LogLine] = deque(maxlen=MOST_LINES)
    whole = damaged = 0
    with path.open("rb") as file:
        if size > most_bytes:
            file.seek(size - most_bytes)
            file.readline(MAX_LINE)
        while raw := file.readline(MAX_LINE):
            if (whole + damaged) % _LOOK == 0:
                cancelled()
            if (line := read_line(raw.removesuffix(b"\n"))) is None:
                damaged += 1
            else:
                whole += 1
                kept.append(line)
    remarks = []
    if size > most_bytes or whole > MOST_LINES:
        remarks.append(
            _("Only the newest {count} lines are shown; the file holds all of them.").format(count=grouped(len(kept)))
        )
    if damaged:
        one = Message("audit.table.piece", "1 incomplete line is not shown: press Verify for details.")
        several = Message(
            "audit.table.pieces",
            "{count} incomplete lines are not shown: press Verify for details.",
            count=grouped(damaged),
        )
        remarks.append(translated(one if damaged == 1 else several))
    return LogPage(tuple(reversed(kept)), tuple(remarks))


def people_and_sites(lines: Sequence[LogLine]) -> dict[str, str]:
    """Return pseudonyms by session and sites by test, as ``about`` takes them."""
    names = {}
    for line in lines:
        key = {"session.begun": "pseudonym", "test.begun": "site"}.get(str(line.what))
        if key is not None and isinstance(line.new, dict) and isinstance(name := line.new.get(key), str):
            names[str(line.subject)] = name
    return names


def about(line: LogLine, names: Mapping[str, str]) -> str:
    """Return what a line is about: test, site and pseudonym where they are known, else its subject."""
    subject = shown(line.subject)
    if not subject and isinstance(line.new, dict):  # a test whose recording had not begun
        known = [line.new.get("site"), line.new.get("pseudonym")]
    else:
        session, is_test, number = subject.partition(" test ")
        known = [names.get(subject) if is_test else None, names.get(session)]
        if is_test and any(known):
            known.insert(0, _("Test {number}").format(number=number))
    return clean(", ".join(str(item) for item in known if item))[:_LONGEST] or subject


def shown(value: Any) -> str:
    """An old or new value as one line of a table."""
    if value is None:
        return ""
    text = clean(value[: _LONGEST + 1]) if isinstance(value, str) else plain_text(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"


def haystack(line: LogLine) -> str:
    """Return the searchable text of a line."""
    parts = (line.time, line.role, line.who, line.what, line.subject, line.old, line.new)
    return " ".join(str(part) for part in parts if part is not None).casefold()


def write_csv(path: Path, log: Path, lines: Sequence[LogLine], cancelled: Callable[[], object]) -> int:
    """Write lines of ``log``, as they are given, for a spreadsheet, whole or not at all; returns their number.

    What a spreadsheet would take for a formula gets an apostrophe before it.

    Raises:
        UnusableInputError: it cannot be written there, or that is the log itself.
    """
    if path.exists() and log.exists() and path.samefile(log):
        raise UnusableInputError(
            "audit.export_itself", "{path} is the audit log itself: name another file", path=str(path)
        )
    if path.is_dir() or not path.parent.is_dir():
        raise UnusableInputError(
            "audit.export_folder", "{path} is no file in an existing folder: name one", path=str(path)
        )
    try:
        with atomic_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            for number, line in enumerate(lines):
                if number % _LOOK == 0:
                    cancelled()
                fields = fields_of(line)
                table.writerow([_cell(fields[name]) for name in COLUMNS])
    except OSError as error:
        raise UnusableInputError(
            "audit.export_failed",
            "cannot write {path}: {problem}",
            path=str(path),
            problem=error.strerror or str(error),
        ) from error
    return len(lines)


def _cell(value: Any) -> str:
    return "" if value is None else cell_text(clean(value) if isinstance(value, str) else plain_text(value))
