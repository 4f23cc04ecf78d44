"""The results of analyses in a file of lines that outlives the window; what is read from it is not trusted.

Specifications, scores and parameters are kept, curves are not: those are fitted again when they are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.drawn import Drawn
from tissueid.app.views.researcher.looks import PANELS
from tissueid.app.views.researcher.outcome import Outcome, Stamp, stamp_of
from tissueid.app.views.researcher.task import MOST_TESTS, Name, TestRef, Text, Value
from tissueid.identification import FitReport
from tissueid.language import _
from tissueid.records import Estimate
from tissueid.whole_file import open_regular, private_folder, whole_file

NAME = "results.jsonl"
MOST_RESULTS = 5000
_LONGEST_LINE = 500_000
_LONGEST_FILE = 100_000_000
"""Bytes; a result takes some two thousand."""
_Words = Annotated[tuple[Annotated[str, Field(max_length=5000)], ...], Field(max_length=200)]
_Number = float | None


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Report(_Line):
    """A ``FitReport``; what is not finite is None."""

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

    @classmethod
    def of(cls, report: FitReport) -> _Report:
        """Write a report down."""
        plain = {field.name: getattr(report, field.name) for field in fields(report)}
        numbers = {name: _finite(value) for name, value in plain.items() if isinstance(value, float)}
        plain["parameters"] = {name: (_finite(e.value), _finite(e.std)) for name, e in report.parameters.items()}
        plain["details"] = {name: _finite(value) for name, value in report.details.items()}
        return cls(**plain | numbers)

    @property
    def report(self) -> FitReport:
        """The report."""
        plain = {name: getattr(self, name) for name in type(self).model_fields}
        plain["vaf_percent"] = math.nan if self.vaf_percent is None else self.vaf_percent
        plain["parameters"] = {
            name: Estimate(math.nan if value is None else value, std) for name, (value, std) in self.parameters.items()
        }
        plain["details"] = {name: math.nan if value is None else value for name, value in self.details.items()}
        return FitReport(**plain)


class _Result(_Line):
    """An ``Outcome`` without its curves."""

    engine: Name
    options: Annotated[dict[Name, Value], Field(max_length=60)]
    tests: Annotated[tuple[TestRef, ...], Field(min_length=1, max_length=MOST_TESTS)]
    signals: tuple[Name, Name]
    report: _Report | None
    validated_on: Text
    units: Annotated[dict[Name, Annotated[str, Field(max_length=40)]], Field(max_length=40)]
    findings: _Words
    refused: Annotated[str, Field(max_length=5000)]
    stamp: Stamp | None
    recommended: bool

    @classmethod
    def of(cls, outcome: Outcome) -> _Result:
        """Write a result down."""
        return cls(
            engine=outcome.engine,
            options=outcome.options,
            tests=tuple(map(TestRef.of, outcome.tests)),
            signals=outcome.signals,
            report=None if outcome.report is None else _Report.of(outcome.report),
            validated_on=outcome.validated_on,
            units={str(panel): unit for panel, unit in outcome.drawn.units.items()},
            findings=outcome.findings,
            refused=outcome.refused,
            stamp=outcome.stamp,
            recommended=outcome.recommended,
        )

    def outcome(self, stamp: Stamp | None) -> Outcome:
        """The result; ``stamp`` is that of its file now."""
        words = dict.fromkeys(PANELS, _("Kept from an earlier start, without its curves: Refit draws them."))
        units = {panel: self.units[panel] for panel in PANELS if panel in self.units}
        tests: tuple[Chosen, ...] = tuple(test.chosen for test in self.tests)
        return Outcome(
            self.engine,
            dict(self.options),
            tests,
            self.signals,
            None if self.report is None else self.report.report,
            self.validated_on,
            Drawn({}, units, (), words),
            self.findings,
            self.refused,
            self.stamp,
            self.recommended,
            changed=stamp != self.stamp,
        )


@dataclass(frozen=True)
class Kept:
    """What was read: results in the order of the table, and how many lines could not be read."""

    outcomes: tuple[Outcome, ...]
    bad: int


def write_results(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write results, for their owner alone; what cannot be written as it is read is left out.

    Raises:
        OSError: the file cannot be written.
    """
    private_folder(path.parent)
    with whole_file(path) as partial, partial.open("wb") as file:
        for line in _lines(outcomes[-MOST_RESULTS:]):
            file.write(line)


def _lines(outcomes: Sequence[Outcome]) -> Iterator[bytes]:
    size = 0
    for outcome in outcomes:
        try:
            line = _Result.of(outcome).model_dump_json().encode() + b"\n"
        except (ValidationError, ValueError):
            continue
        size += len(line)
        if len(line) <= _LONGEST_LINE and size <= _LONGEST_FILE:
            yield line


def read_results(path: Path) -> Kept:
    """Read results, and look whether their files are as they were. A missing file is an empty one.

    Raises:
        OSError: it is there and cannot be read.
    """
    try:
        with open_regular(path) as file:
            data = file.read(_LONGEST_FILE)
    except FileNotFoundError:
        return Kept((), 0)
    outcomes: list[Outcome] = []
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
    return Kept(tuple(outcomes), bad)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


__all__ = ["MOST_RESULTS", "NAME", "Kept", "read_results", "write_results"]
