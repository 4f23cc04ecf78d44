"""What commands print: tables and progress for people on standard error, JSON for scripts."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

console = Console(stderr=True, highlight=False)


def write_json(target: Path, value: Any) -> None:
    """Write JSON whole or not at all; ``-`` is standard output. NaN becomes null."""
    text = json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
        return
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


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
    """Bars by name: call with a description and how much of it is done, 0 to 1."""
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


def table(title: str, *columns: str) -> Table:
    """An empty table in the house style: first column left, the others right."""
    result = Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 2, 0, 0)
    )
    for number, column in enumerate(columns):
        result.add_column(column, justify="left" if number == 0 else "right")
    return result
