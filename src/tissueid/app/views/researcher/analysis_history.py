"""History of analyses in a file with one JSON line per run. Its content is validated when it is read."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable
from pathlib import Path

from pydantic import AwareDatetime, BaseModel, ConfigDict, ValidationError

from tissueid.app.stored_text import StoredText
from tissueid.app.user_data import default_path
from tissueid.app.views.researcher.analysis_task import AnalysisTask
from tissueid.atomic_write import atomic_file, private_folder, private_opener

MOST_ENTRIES = 500
_LONGEST_LINE = 2_000_000
_LONGEST_FILE = 8_000_000
"""What is read of a file, from its end; when it has grown past this it is cut to its latest lines."""


class HistoryEntry(BaseModel):
    """One run: time, task and headline."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time: AwareDatetime
    task: AnalysisTask
    headline: StoredText = ""


class AnalysisHistory:
    """The history file. ``add`` is thread-safe."""

    def __init__(self, path: Path | None = None) -> None:
        self.path = path or default_path()
        self._lock = threading.Lock()

    def read(self) -> tuple[list[HistoryEntry], int]:
        """Return the latest entries, newest first, and the number of unreadable lines. A missing file is empty.

        Raises:
            OSError: it is there and cannot be read.
        """
        lines = self._tail()
        entries: list[HistoryEntry] = []
        bad = 0
        for line in reversed(lines):
            if len(entries) == MOST_ENTRIES:
                break
            try:
                if len(line) > _LONGEST_LINE:
                    raise ValueError("too long")
                entries.append(HistoryEntry.model_validate_json(line))
            except (ValidationError, ValueError, RecursionError):
                bad += 1
        return entries, bad

    def add(self, entry: HistoryEntry) -> None:
        """Append an entry.

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
        """Remove all entries.

        Raises:
            OSError: the file cannot be written.
        """
        with self._lock:
            if self.path.exists():
                self._replace(())

    def _replace(self, lines: Iterable[bytes]) -> None:
        with atomic_file(self.path) as partial:
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
    """Return whether the file is empty or ends with a newline."""
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


__all__ = ["AnalysisHistory", "HistoryEntry", "default_path"]
