"""Results of analyses and their history, in files of JSON lines. Their content is validated when it is read."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from tissueid.app.user_files import Stamp, StoredText, default_path, stamp_of
from tissueid.app.views.researcher.analysis_task import (
    AS_RECORDED,
    MOST_TESTS,
    AnalysisTask,
    Name,
    Preparation,
    TestRef,
    Text,
    Value,
)
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.plot_data import PlotData
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.atomic_write import atomic_file, open_regular, private_folder, private_opener
from tissueid.identification import FitReport
from tissueid.language import marked
from tissueid.messages import message_from, stored
from tissueid.records import Estimate

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
        lines = self._tail()
        entries: list[HistoryEntry] = []
        bad = 0
        for line in reversed(lines):
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
_Words = Annotated[tuple[Annotated[str, Field(max_length=5000)], ...], Field(max_length=200)]
_Messages = Annotated[
    dict[str, Annotated[tuple[dict[str, Any] | None, ...], Field(max_length=200)]], Field(max_length=8)
]
"""Code, template and values of texts by the name of their field, next to the texts; None for plain text."""
_Number = float | None


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Report(_Line):
    """The stored form of a ``FitReport``; values that are not finite are None."""

    engine: Name
    options: Annotated[dict[Name, Any], Field(max_length=60)]
    n_samples: Annotated[int, Field(ge=0)]
    n_parameters: Annotated[int, Field(ge=0)]
    vaf_percent: _Number
    vaf_validation_percent: _Number
    validation_p_value: _Number
    vaf_scheduled_percent: _Number
    aic: _Number
    aicc: _Number
    parameters: Annotated[dict[Name, tuple[_Number, _Number]], Field(max_length=200)]
    seconds: _Number
    warnings: _Words
    findings: _Words
    details: Annotated[dict[Name, _Number], Field(max_length=200)]
    model: Name | Literal[""] = ""
    messages: _Messages = {}

    @classmethod
    def of(cls, report: FitReport) -> _Report:
        """Return the stored form of a report."""
        plain = {field.name: getattr(report, field.name) for field in fields(report)}
        numbers = {name: _finite(value) for name, value in plain.items() if isinstance(value, float)}
        plain["parameters"] = {name: (_finite(e.value), _finite(e.std)) for name, e in report.parameters.items()}
        plain["details"] = {name: _finite(value) for name, value in report.details.items()}
        plain["messages"] = _stored(warnings=report.warnings, findings=report.findings)
        return cls(**plain | numbers)

    @property
    def report(self) -> FitReport:
        """The report."""
        plain = {name: getattr(self, name) for name in type(self).model_fields if name != "messages"}
        plain |= {name: _restored(self.messages, name, plain[name]) for name in ("warnings", "findings")}
        plain["vaf_percent"] = math.nan if self.vaf_percent is None else self.vaf_percent
        plain["parameters"] = {
            name: Estimate(math.nan if value is None else value, std) for name, (value, std) in self.parameters.items()
        }
        plain["details"] = {name: math.nan if value is None else value for name, value in self.details.items()}
        return FitReport(**plain)


class _Result(_Line):
    """The stored form of an ``EngineOutcome``, without curves."""

    engine: Name
    options: Annotated[dict[Name, Value], Field(max_length=60)]
    tests: Annotated[tuple[TestRef, ...], Field(min_length=1, max_length=MOST_TESTS)]
    signals: tuple[Name, Name]
    preparation: Preparation = AS_RECORDED
    report: _Report | None
    validated_on: Text
    units: Annotated[dict[Name, Annotated[str, Field(max_length=40)]], Field(max_length=40)]
    findings: _Words
    refused: Annotated[str, Field(max_length=5000)]
    stamp: Stamp | None
    recommended: bool
    messages: _Messages = {}

    @classmethod
    def of(cls, outcome: EngineOutcome) -> _Result:
        """Return the stored form of a result."""
        return cls(
            engine=outcome.engine,
            options=outcome.options,
            tests=tuple(map(TestRef.of, outcome.tests)),
            signals=outcome.signals,
            preparation=outcome.preparation,
            report=None if outcome.report is None else _Report.of(outcome.report),
            validated_on=outcome.validated_on,
            units={str(panel): unit for panel, unit in outcome.plots.units.items()},
            findings=outcome.findings,
            refused=outcome.refused,
            stamp=outcome.stamp,
            recommended=outcome.recommended,
            messages=_stored(
                validated_on=(outcome.validated_on,), findings=outcome.findings, refused=(outcome.refused,)
            ),
        )

    def outcome(self, stamp: Stamp | None) -> EngineOutcome:
        """Return the result; ``stamp`` is the current one of its file."""
        from tissueid.analysis.curves.results import TITLES, missing_plot

        without = marked("From an earlier session, without curves; “Refit” computes them.")
        panels = {panel: missing_plot(panel, without) for panel in TITLES}
        units = {str(panel): self.units[panel] for panel in panels if panel in self.units}
        tests: tuple[SelectedTest, ...] = tuple(test.chosen for test in self.tests)
        return EngineOutcome(
            self.engine,
            dict(self.options),
            tests,
            self.signals,
            None if self.report is None else self.report.report,
            _restored(self.messages, "validated_on", (self.validated_on,))[0],
            PlotData(panels, units),
            _restored(self.messages, "findings", self.findings),
            _restored(self.messages, "refused", (self.refused,))[0],
            self.stamp,
            self.recommended,
            changed=stamp != self.stamp,
            preparation=self.preparation,
        )


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
            line = _Result.of(outcome).model_dump_json().encode() + b"\n"
        except (ValidationError, ValueError):
            continue
        size += len(line)
        if len(line) <= _LONGEST_LINE and size <= _LONGEST_FILE:
            yield line


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
    stamps: dict[str, Stamp | None] = {}
    bad = 0
    for line in data.split(b"\n"):
        if not line.strip():
            continue
        try:
            if len(line) > _LONGEST_LINE or len(outcomes) >= MOST_RESULTS:
                raise ValueError("too long")
            result = _Result.model_validate_json(line)
        except (ValidationError, ValueError, RecursionError):
            bad += 1
            continue
        first = result.tests[0].path
        if first not in stamps:
            stamps[first] = stamp_of(Path(first))
        outcomes.append(result.outcome(stamps[first]))
    return StoredResults(tuple(outcomes), bad)


def _stored(**texts: Sequence[str]) -> dict[str, tuple[dict[str, Any] | None, ...]]:
    """Return code, template and values of texts, by the name of their field."""
    return {name: tuple(map(stored, values)) for name, values in texts.items()}


def _restored(messages: Mapping[str, Sequence[Any]], name: str, texts: Sequence[str]) -> tuple[str, ...]:
    """Return the texts of a field as the messages that were stored with them; a text without one stays as it is."""
    found = messages.get(name, ())
    if len(found) != len(texts):
        return tuple(texts)
    return tuple(message_from(message, text) for message, text in zip(found, texts, strict=True))


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
