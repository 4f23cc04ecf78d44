"""What commands print: tables and progress for people on standard error, JSON for scripts."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tissueid.errors import UnusableInputError
from tissueid.sessions import Session
from tissueid.whole_file import open_regular, whole_file
from tissueid.wording import clean

_SPACES = frozenset("\n\u00a0\u202f")
"""Characters that are not printable by name, but that tables and numbers are set with."""


class PlainConsole(Console):
    """A console that prints texts without control characters: names from files must not steer a terminal."""

    def print(self, *objects: Any, **options: Any) -> None:
        """As ``Console.print``; line ends stay."""
        super().print(*(_lines_clean(item) if isinstance(item, str) else item for item in objects), **options)


def _lines_clean(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(mark if mark in _SPACES else clean(mark) for mark in text)


console = PlainConsole(stderr=True, highlight=False)
_BETWEEN_LINES_S = 3.0
_LARGEST_REPORT = 200_000_000


def people_read(json_file: Path | None) -> Console:
    """Where tables go: standard output, unless that is kept for JSON."""
    return console if str(json_file) == "-" else PlainConsole(highlight=False)


def check_output(target: Path | None, begins: tuple[str | bytes, ...]) -> None:
    """Refuse, before any work, a file that cannot be written or that holds something else.

    ``begins`` are the first characters, or bytes, of the kind of file that may be written anew.

    Raises:
        UnusableInputError: no such folder, a folder itself, or a file that is not of that kind.
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
            raise UnusableInputError(f"{target} is there already and holds something else; it is not written over")


def check_report(target: Path | None, session: Session) -> None:
    """Refuse a report file that is there already and is not of this session: a person may have kept it.

    The report of the same session may be written again.

    Raises:
        UnusableInputError: it is the report of something else.
    """
    if target is None or not target.is_file() or target.stat().st_size == 0:
        return
    with target.open("rb") as file:
        if session.session_id and session.session_id.encode() in file.read(_LARGEST_REPORT):
            return
    raise UnusableInputError(f"{target} is there already and is the report of something else: name another file")


def check_new(target: Path | None) -> None:
    """Refuse, before any work, a report of what is measured now that would replace an earlier one.

    Raises:
        UnusableInputError: a file of that name is there already.
    """
    if target is not None and target.is_file() and target.stat().st_size > 0:
        raise UnusableInputError(f"{target} is there already: name another file, or move it away")


def check_different(*targets: Path | None) -> None:
    """Refuse, before any work, one file that is named for two things.

    Raises:
        UnusableInputError: names it.
    """
    named = [target.resolve() for target in targets if target is not None and str(target) != "-"]
    if twice := [target for number, target in enumerate(named) if target in named[:number]]:
        raise UnusableInputError(f"{twice[0]} is named for two things: each needs a file of its own")


def check_json(target: Path | None) -> None:
    """As ``check_output``, for an answer in JSON."""
    check_output(target, ("{", "["))


def write_json(target: Path, value: Any) -> None:
    """Write JSON whole or not at all; ``-`` is standard output. NaN becomes null.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    text = json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
        try:
            getattr(sys.stdout, "deliver", sys.stdout.flush)()
        except OSError as error:
            raise UnusableInputError(f"cannot write the answer to standard output: {error.strerror}") from error
        return
    check_json(target)
    write_text(target, text)


def write_text(target: Path, text: str) -> None:
    """Write a text file whole or not at all.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    try:
        with whole_file(target) as partial:
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
    """Bars by name: call with a description and how much of it is done, 0 to 1.

    Where standard error is no terminal there is a line in their place every few seconds, written out at once.
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
    """A table whose texts are shown as they are, but for control characters: names may look like markup."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row, nothing in it taken for markup or for commands to the terminal."""
        super().add_row(*(escape(_lines_clean(cell)) if isinstance(cell, str) else cell for cell in cells), **options)


def table(title: str, *columns: str) -> PlainTable:
    """An empty table in the house style: first column left, the others right."""
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
