"""Analyses that were run, in a file of lines that outlives the window; what is read from it is not trusted."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from platformdirs import user_data_path
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from tissueid.app.views.researcher.task import LONGEST_TEXT, Task
from tissueid.whole_file import private_folder, private_opener, whole_file

ENVIRONMENT = "TISSUEID_ANALYSES"
MOST_ENTRIES = 500
_LONGEST_LINE = 2_000_000
_LONGEST_FILE = 8_000_000
"""What is read of a file, from its end; when it has grown past this it is cut to its latest lines."""


class Entry(BaseModel):
    """One line: when, what was asked for, and the figures that came of it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time: AwareDatetime
    task: Task
    headline: Annotated[str, Field(max_length=LONGEST_TEXT)] = ""


class History:
    """The file. ``add`` may be called from any thread."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or default_path()
        self._lock = threading.Lock()

    def read(self) -> tuple[list[Entry], int]:
        """The latest entries, newest first, and how many lines could not be read. A missing file is an empty one.

        Raises:
            OSError: it is there and cannot be read.
        """
        lines = self._tail()
        entries: list[Entry] = []
        bad = 0
        for line in reversed(lines):
            if len(entries) == MOST_ENTRIES:
                break
            try:
                if len(line) > _LONGEST_LINE:
                    raise ValueError("too long")
                entries.append(Entry.model_validate_json(line))
            except (ValidationError, ValueError, RecursionError):
                bad += 1
        return entries, bad

    def add(self, entry: Entry) -> None:
        """Write an entry at the end.

        Raises:
            OSError: the file cannot be written.
        """
        with self._lock:
            private_folder(self.path.parent)
            line = entry.model_dump_json().encode() + b"\n"
            if self.path.exists() and self.path.stat().st_size + len(line) > _LONGEST_FILE:
                self._replace(self._tail()[-MOST_ENTRIES // 2 :])
            with open(self.path, "ab", opener=private_opener) as file:
                file.write(line if _ends_a_line(self.path) else b"\n" + line)

    def clear(self) -> None:
        """Forget everything.

        Raises:
            OSError: the file cannot be written.
        """
        with self._lock:
            if self.path.exists():
                self._replace(())

    def _replace(self, lines: Iterable[bytes]) -> None:
        with whole_file(self.path) as partial:
            partial.write_bytes(b"".join(line + b"\n" for line in lines))

    def _tail(self) -> list[bytes]:
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                start = max(0, size - _LONGEST_FILE)
                file.seek(start)
                data = file.read(_LONGEST_FILE)
        except FileNotFoundError:
            return []
        lines = data.split(b"\n")
        return [line for line in (lines[1:] if start else lines) if line.strip()]


def _ends_a_line(path: Path) -> bool:
    """Whether what is written next begins a line: a line that was cut off must not spoil the next one too."""
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


def default_path() -> Path:
    """Where the history of this person lies: what ``TISSUEID_ANALYSES`` says, or the user's own folder for data."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else user_data_path("tissueid", appauthor=False) / "analyses.jsonl"


__all__ = ["Entry", "History", "default_path"]
