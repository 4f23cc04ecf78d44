"""Results of analyses and their history, in files of JSON lines. Their content is validated when it is read."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import AwareDatetime, BaseModel, ConfigDict, TypeAdapter, ValidationError

from tissueid.app.user_files import Stamp, default_path, stamp_of
from tissueid.app.views.researcher.engine_outcome import AnalysisTask, EngineOutcome
from tissueid.atomic_write import atomic_file, open_regular, private_folder, private_opener
from tissueid.stored_values import StoredText
from tissueid.untrusted_input import json_value

MOST_ENTRIES = 500
_LONGEST_HISTORY_LINE = 2_000_000
_LONGEST_HISTORY = 8_000_000
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

    def __reduce__(self) -> tuple[type[AnalysisHistory], tuple[Path]]:
        return AnalysisHistory, (self.path,)  # for the process of an analysis

    def read(self) -> tuple[list[HistoryEntry], int]:
        """Return the latest entries, newest first, and the number of unreadable lines. A missing file is empty.

        Raises:
            OSError: it is there and cannot be read.
        """
        entries: list[HistoryEntry] = []
        bad = 0
        for line in reversed(self._tail()):
            if len(entries) == MOST_ENTRIES:
                break
            try:
                if len(line) > _LONGEST_HISTORY_LINE:
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
            if self.path.exists() and self.path.stat().st_size + len(line) > _LONGEST_HISTORY:
                self._replace(self._tail()[-MOST_ENTRIES // 2 :])
            with open(self.path, "ab", opener=private_opener) as file:
                file.write(line if _ends_a_line(self.path) else b"\n" + line)

    def _replace(self, lines: Iterable[bytes]) -> None:
        with atomic_file(self.path) as partial:
            partial.write_bytes(b"".join(line + b"\n" for line in lines))

    def _tail(self) -> list[bytes]:
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                start = max(0, size - _LONGEST_HISTORY)
                file.seek(start)
                data = file.read(_LONGEST_HISTORY)
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


NAME = "results.jsonl"
MOST_RESULTS = 5000
_LONGEST_LINE = 500_000
_LONGEST_FILE = 100_000_000
"""Bytes; a result takes some two thousand."""
_OUTCOME = TypeAdapter(EngineOutcome)


@dataclass(frozen=True)
class StoredResults:
    """Results in the order of the table, and the number of unreadable lines."""

    outcomes: tuple[EngineOutcome, ...]
    bad: int


def write_results(path: Path, outcomes: Sequence[EngineOutcome]) -> None:
    """Write results, readable by their owner only; results that would not pass validation are skipped.

    Raises:
        OSError: the file cannot be written.
    """
    private_folder(path.parent)
    with atomic_file(path) as partial, partial.open("wb") as file:
        for line in _lines(outcomes[-MOST_RESULTS:]):
            file.write(line)


def _lines(outcomes: Sequence[EngineOutcome]) -> Iterator[bytes]:
    size = 0
    for outcome in outcomes:
        try:
            line = _OUTCOME.dump_json(outcome, warnings="error")
            _OUTCOME.validate_json(line)
        except ValueError:
            continue
        size += len(line) + 1
        if len(line) < _LONGEST_LINE and size <= _LONGEST_FILE:
            yield line + b"\n"


def read_results(path: Path) -> StoredResults:
    """Read results and check whether their sessions have changed. A missing file is empty.

    Raises:
        OSError: it is there and cannot be read.
    """
    try:
        with open_regular(path) as file:
            data = file.read(_LONGEST_FILE)
    except FileNotFoundError:
        return StoredResults((), 0)
    outcomes: list[EngineOutcome] = []
    stamps: dict[Path, Stamp | None] = {}
    bad = 0
    for line in data.split(b"\n"):
        if not line.strip():
            continue
        try:
            if len(line) > _LONGEST_LINE or len(outcomes) >= MOST_RESULTS:
                raise ValueError("too long")
            outcome = _parsed(line)
        except (ValueError, TypeError, KeyError, AttributeError):
            bad += 1
            continue
        first = outcome.tests[0].path
        if first not in stamps:
            stamps[first] = stamp_of(first)
        outcomes.append(replace(outcome, changed=stamps[first] != outcome.stamp))
    return StoredResults(tuple(outcomes), bad)


def _parsed(line: bytes) -> EngineOutcome:
    stored = json_value(line)
    if isinstance(stored, dict) and "units" in stored:
        report = stored["report"]
        if report is not None:
            pairs = report["parameters"].items()
            estimates = {name: dict(zip(("value", "std"), pair, strict=True)) for name, pair in pairs}
            report = _with_messages(report | {"parameters": estimates})
        stored = _with_messages(stored | {"report": report, "plots": stored.pop("units")})
    return _OUTCOME.validate_python(stored)


def _with_messages(stored: dict[str, Any]) -> dict[str, Any]:
    """Return a part of a result of version 0.1, whose messages stand beside their texts, with the two joined."""
    for name, messages in stored.pop("messages", {}).items():
        texts = [stored[name]] if isinstance(stored[name], str) else stored[name]
        pairs = zip(messages, texts, strict=True)
        joined = [text if message is None else message | {"text": text} for message, text in pairs]
        stored[name] = joined[0] if isinstance(stored[name], str) else joined
    return stored
