"""Output of commands: tables and progress for people, JSON for programs."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tissueid.atomic_write import atomic_file, open_regular
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.messages import Message
from tissueid.sessions import Session

_SPACES = frozenset("\n\u00a0\u202f")
"""Characters that are not printable by Unicode category, but are used in tables and numbers."""


class PlainConsole(Console):
    """A console that removes control characters: names from files must not control the terminal."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as ``Console.print``; line ends are kept."""
        super().print(*(_lines_clean(item) if isinstance(item, str) else item for item in objects), **options)


def _lines_clean(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(mark if mark in _SPACES else clean(mark) for mark in text)


console = PlainConsole(stderr=True, highlight=False)
_BETWEEN_LINES_S = 3.0
"""Interval of progress lines where standard error is not a terminal."""
_LARGEST_REPORT = 200_000_000
"""Number of bytes of a report that are searched for the id of its session."""


def human_output(json_file: Path | None) -> Console:
    """Return the console for people: standard output, or standard error if JSON goes to standard output."""
    return console if str(json_file) == "-" else PlainConsole(highlight=False)


def check_output(target: Path | None, begins: tuple[str | bytes, ...]) -> None:
    """Check, before any work, that a file can be written and that nothing else is overwritten.

    ``begins`` are the first characters, or bytes, of files that may be overwritten.

    Raises:
        UnusableInputError: the folder is missing, the target is a folder, or it is a file of another kind.
    """
    if target is None or str(target) == "-":
        return
    if target.is_dir():
        raise UnusableInputError(f"{target} is a folder; name a file")
    if not target.parent.is_dir():
        raise UnusableInputError(f"there is no folder {target.parent}")
    if target.exists():
        with open_regular(target) as file:
            head = file.read(512).lstrip()
        known = tuple(text.encode() if isinstance(text, str) else text for text in begins)
        if head and not head.startswith(known):
            raise UnusableInputError(f"{target} already exists and has other content; it is not overwritten")


def check_report(target: Path | None, session: Session) -> None:
    """Check that a report does not overwrite the report of another session.

    The report of the same session may be overwritten.

    Raises:
        UnusableInputError: the file is not a report of this session.
    """
    if target is None or not target.is_file() or target.stat().st_size == 0:
        return
    with target.open("rb") as file:
        if session.session_id and session.session_id.encode() in file.read(_LARGEST_REPORT):
            return
    raise UnusableInputError(f"{target} already exists and is not a report of this session: choose another file name")


def check_new(target: Path | None) -> None:
    """Check, before any work, that the report of a measurement does not overwrite an earlier one.

    Raises:
        UnusableInputError: the file already exists.
    """
    if target is not None and target.is_file() and target.stat().st_size > 0:
        raise UnusableInputError(f"{target} already exists: choose another file name, or move the file")


def check_different(*targets: Path | None) -> None:
    """Check, before any work, that no file is named for two outputs.

    Raises:
        UnusableInputError: two outputs have the same file.
    """
    named = [target.resolve() for target in targets if target is not None and str(target) != "-"]
    if twice := [target for number, target in enumerate(named) if target in named[:number]]:
        raise UnusableInputError(f"{twice[0]} is named for two outputs: each needs its own file")


def check_json(target: Path | None) -> None:
    """Check the target of JSON output as ``check_output`` does."""
    check_output(target, ("{", "["))


def message_json(text: str | None) -> dict[str, Any] | None:
    """Return code, template and values of a text for JSON; None if it has no code."""
    return text.as_dict() if isinstance(text, Message) else None


def messages_json(texts: Iterable[str]) -> list[dict[str, Any] | None]:
    """Return code, template and values of several texts for JSON."""
    return [message_json(text) for text in texts]


def write_json(target: Path, value: Any) -> None:
    """Write JSON atomically; ``-`` is standard output. NaN becomes null.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    text = json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
        try:
            getattr(sys.stdout, "deliver", sys.stdout.flush)()
        except OSError as error:
            raise UnusableInputError(f"cannot write JSON to standard output: {error.strerror}") from error
        return
    check_json(target)
    write_text(target, text)


def write_text(target: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    try:
        with atomic_file(target) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(f"cannot write {target}: {error.strerror}") from error


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def progress_bars() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that shows a progress bar: call it with a description and a fraction from 0 to 1.

    If standard error is not a terminal, it prints a line every few seconds instead.
    """
    if not console.is_terminal:
        yield _lines()
        return
    columns = (TextColumn("{task.description:<34}"), BarColumn(bar_width=32), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        tasks: dict[str, Any] = {}

        def show(description: str, fraction: float) -> None:
            if description not in tasks:
                for task in tasks.values():
                    progress.stop_task(task)
                tasks[description] = progress.add_task(description, total=1.0)
            progress.update(tasks[description], completed=fraction)

        yield show


def _lines() -> Callable[[str, float], None]:
    latest: float | None = None

    def show(description: str, fraction: float) -> None:
        nonlocal latest
        now = time.monotonic()
        if latest is None or now - latest >= _BETWEEN_LINES_S:
            latest = now
            console.print(f"{description}: {fraction:.0%}", markup=False, soft_wrap=True)
            console.file.flush()

    return show


class PlainTable(Table):
    """A table that shows texts literally, without control characters and markup."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row of literal texts."""
        super().add_row(*(escape(_lines_clean(cell)) if isinstance(cell, str) else cell for cell in cells), **options)


def table(title: str, *columns: str) -> PlainTable:
    """Return an empty table: first column left-aligned, the others right-aligned."""
    result = PlainTable(
        title=escape(_lines_clean(title)),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )
    for number, column in enumerate(columns):
        result.add_column(column, justify="left" if number == 0 else "right")
    return result
