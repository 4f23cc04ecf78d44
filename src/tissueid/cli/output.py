"""Output of commands: tables and progress for people, JSON for programs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.messages import Message
from tissueid.procedures.control import COUNTED, Control
from tissueid.procedures.output_files import check_output, json_text, write_text

_Plan = TypeVar("_Plan")
_Result = TypeVar("_Result")
_P = ParamSpec("_P")
_SPACES = frozenset("\n\u00a0\u202f")
"""Characters that are not printable by Unicode category, but are used in tables and numbers."""


class PlainConsole(Console):
    """A console that shows texts literally, without control characters, so that names cannot control the terminal."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as ``Console.print``; line ends are kept."""
        super().print(*(_lines_clean(item) if isinstance(item, str) else item for item in objects), **options)


def _lines_clean(text: str) -> str:
    if text.isprintable():
        return text
    return "".join(mark if mark in _SPACES else clean(mark) for mark in text)


console = PlainConsole(stderr=True)
_BETWEEN_LINES_S = 3.0
"""Interval of progress lines where standard error is not a terminal."""


class Output(PlainConsole):
    """The output of one command: texts and tables for people, and its result as JSON.

        def print_quality(plan: QualityPlan, out: Output) -> None:
            checked = out.run(judge_tests, plan)
            out.print(...)
            out.write_json(...)

    People read standard output, or standard error if JSON goes to standard output.

    Args:
        json_file: target of the JSON; ``-`` is standard output; None if there is none.

    Raises:
        UnusableInputError: the target cannot be written.
    """

    def __init__(self, json_file: Path | None = None) -> None:
        check_output(json_file, ("{", "["))
        self.json_file = json_file
        super().__init__(stderr=self.json_on_stdout)

    @property
    def json_on_stdout(self) -> bool:
        """Whether JSON goes to standard output."""
        return str(self.json_file) == "-"

    def widen(self, width: int) -> None:
        """Set the number of characters of a line where the output is not a terminal."""
        if not self.is_terminal:
            self.width = width

    def print_lines(self, lines: Iterable[str], *, soft_wrap: bool = False) -> None:
        """Print lines; without ``soft_wrap`` they are broken at the width of the output."""
        for line in lines:
            self.print(line, soft_wrap=soft_wrap)

    def print_files(self, **files: Path | None) -> None:
        """Print the files that are given, each after its label."""
        self.print_lines((f"{label}: {path}" for label, path in files.items() if path is not None), soft_wrap=True)

    def run(
        self,
        procedure: Callable[Concatenate[_Plan, Control, _P], _Result],
        plan: _Plan,
        *more: _P.args,
        **named: _P.kwargs,
    ) -> _Result:
        """Run a procedure with its plan, show its progress, and return its result."""
        with progress_bars() as show:
            return procedure(plan, ConsoleControl(show), *more, **named)

    def write_json(self, value: Any) -> None:
        """Write the result as JSON atomically, if it was asked for. NaN becomes null.

        Raises:
            UnusableInputError: the file cannot be written.
        """
        if self.json_file is None:
            return
        text = json_text(value)
        if not self.json_on_stdout:
            check_output(self.json_file, ("{", "["))
            write_text(self.json_file, text)
            return
        sys.stdout.write(text)
        try:
            getattr(sys.stdout, "deliver", sys.stdout.flush)()
        except OSError as error:
            raise UnusableInputError(f"cannot write JSON to standard output: {error.strerror}") from error


def at_terminal() -> bool:
    """Return whether input and messages are those of a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


@contextmanager
def progress_bars() -> Iterator[Callable[[str, float | None], None]]:
    """Yield a function that shows a progress bar: call it with a description and a fraction, as ``Control.progress``.

    If standard error is not a terminal, it prints a line every few seconds instead.
    """
    if not console.is_terminal:
        yield _lines()
        return
    columns = (TextColumn("{task.description:<34}"), BarColumn(bar_width=32), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        tasks: dict[str, Any] = {}

        def show(description: str, fraction: float | None) -> None:
            if description not in tasks:
                for task in tasks.values():
                    progress.stop_task(task)
                tasks[description] = progress.add_task(description, total=None)
            if fraction is not None:
                progress.update(tasks[description], total=1.0, completed=fraction)

        yield show


def _lines() -> Callable[[str, float | None], None]:
    latest: float | None = None

    def show(description: str, fraction: float | None) -> None:
        nonlocal latest
        now = time.monotonic()
        if latest is None or now - latest >= _BETWEEN_LINES_S:
            latest = now
            share = "" if fraction is None else f": {fraction:.0%}"
            console.print(f"{description}{share}", soft_wrap=True)
            console.file.flush()

    return show


class ConsoleControl(Control):
    """Shows the progress of a procedure by ``show``, and its notices on standard error."""

    def __init__(self, show: Callable[[str, float | None], None]) -> None:
        self._show = show

    def progress(self, fraction: float | None, step: str) -> None:
        """Show a progress bar; it stands for the count."""
        inner = step.values.get("step") if isinstance(step, Message) else None
        if isinstance(step, Message) and step.code == COUNTED:
            step = step.values["step"]
        elif isinstance(step, Message) and isinstance(inner, Message) and inner.code == COUNTED:
            step = Message(step.code, step.template, **{**step.values, "step": inner.values["step"]})
        self._show(step, fraction)

    def notice(self, message: str) -> None:
        """Print a notice."""
        console.print(message, soft_wrap=True)


class PlainTable(Table):
    """A table that shows texts literally, without control characters and markup."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row of literal texts."""
        super().add_row(*(_lines_clean(cell) if isinstance(cell, str) else cell for cell in cells), **options)


def table(title: str, *columns: str, rows: Iterable[Iterable[str]] = (), left_aligned: bool = False) -> PlainTable:
    """Return a table: first column left-aligned, the others right-aligned except with ``left_aligned``."""
    result = PlainTable(
        title=_lines_clean(title),
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        padding=(0, 2, 0, 0),
    )
    for number, column in enumerate(columns):
        result.add_column(column, justify="left" if left_aligned or number == 0 else "right")
    for row in rows:
        result.add_row(*row)
    return result
