"""Tasks and results of analyses: result of an engine on a test, overlay of plots, and the files that keep them."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, GetPydanticSchema, TypeAdapter, ValidationError
from pydantic_core import core_schema

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Curve, Plot
from tissueid.app.user_files import Stamp, default_path, stamp_of
from tissueid.app.views.researcher.selected_test import SelectedTest, ShortText, distinguishing_labels, short_label
from tissueid.app.words import sentence
from tissueid.atomic_write import atomic_file, open_regular, private_folder, private_opener
from tissueid.formatting import plain_text
from tissueid.identification import Engine, FitReport, engine_label, engine_names, get_engine
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.stored_values import MessageText, Name, Texts
from tissueid.untrusted_input import json_value

if TYPE_CHECKING:
    from tissueid.analysis.curves.results import Panel
    from tissueid.analysis.split import Selection

Array = NDArray[np.float64]
KERNELS = marked("Kernel image")
OUTPUT = marked("Model output")
DEPTH = marked("Against depth")
PICTURES: Mapping[str, tuple[Panel, ...]] = {
    OUTPUT: ("output", "residual"),
    marked("Impulse response"): ("impulse",),
    marked("Bode diagram"): ("magnitude", "phase", "coherence"),
    marked("Static nonlinearity"): ("nonlinearity",),
    DEPTH: ("mass", "damping", "stiffness"),
    marked("Correlations of the record"): ("input_correlation", "input_to_output"),
    marked("Residual tests"): ("autocorrelation", "cross"),
    KERNELS: (),
}


@dataclass(frozen=True, eq=False)
class PlotData:
    """Plots of one analysis; ``units`` holds the units of the panels that have one."""

    panels: dict[Panel, Plot] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    kernels: tuple[Plot, ...] = ()

    @property
    def empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not self.kernels and not any(plot.parts for plot in self.panels.values())


def overlay(plots: Sequence[Plot], colours: Sequence[str], names: Sequence[str], *, same_data: bool) -> Plot:
    """Return the plots of several results in one.

    Args:
        plots: plots of the same panel; those without curves are left out.
        colours: colour of each result.
        names: name of each result in the key.
        same_data: whether all were fitted to the same data, whose measurement is then drawn once.
    """
    under: list[Curve] = []
    over: list[Curve] = []
    said: set[str] = set()
    for plot, colour, name in zip(plots, colours, names, strict=False):
        named = False
        for curve in plot.curves:
            text = "" if curve.name in said else curve.name
            said.add(curve.name)
            if curve.colour != "measured":
                own = name if not named and not curve.name else text
                named = named or not curve.name
                over.append(replace(curve, colour=colour, name=own))
            elif not same_data:
                under.append(replace(curve, colour=colour, name=text, opacity=0.3, width=2.0))
            elif not under:
                under.append(replace(curve, colour="muted", opacity=0.6, width=2.0))
        if not named:  # the key names every result
            over.append(Curve(np.zeros(0), np.zeros(0), name, colour))
    first = next((plot for plot in plots if plot.parts), None)
    if first is None:
        reasons = dict.fromkeys(sentence(translated(plot.missing)) for plot in plots if plot.missing)
        return replace(plots[0], parts=tuple(over), missing=" ".join(reasons))
    return replace(first, parts=(*under, *over))


MOST_TESTS = 5000

Value = None | bool | int | float | ShortText | Annotated[list[float], Field(max_length=200)]


class _Specification(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Preparation(_Specification):
    """What is done to the signals before a fit, and whether mass and damping of the tissue alone are reported."""

    detrend: bool = False
    low_hz: Annotated[float | None, Field(gt=0.0)] = None
    high_hz: Annotated[float | None, Field(gt=0.0)] = None
    tissue_alone: bool = False

    @property
    def without_actuator(self) -> Preparation:
        """The same for a comparison, which reports no parameters of the tissue alone."""
        return self.model_copy(update={"tissue_alone": False})

    @property
    def changed(self) -> dict[str, Any]:
        """What differs from the defaults, by name."""
        return self.model_dump(exclude_defaults=True)


AS_RECORDED = Preparation()


class AnalysisTask(_Specification):
    """One run. A comparison has several ``engines`` with default options.

    ``together`` fits the tests of one file together; otherwise each is fitted by itself.
    """

    kind: Literal["run", "compare"] = "run"
    engines: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)]
    options: Annotated[dict[Name, Value], Field(max_length=60)] = {}
    input_name: Name = "force"
    output_name: Name = "position"
    preparation: Preparation = AS_RECORDED
    together: bool = False
    tests: Annotated[tuple[SelectedTest, ...], Field(max_length=MOST_TESTS)] = ()

    @property
    def groups(self) -> list[tuple[SelectedTest, ...]]:
        """Groups of tests that are fitted together, in the order of selection."""
        chosen = list(dict.fromkeys(self.tests))
        if not self.together:
            return [(test,) for test in chosen]
        by_file: dict[Path, list[SelectedTest]] = {}
        for test in chosen:
            by_file.setdefault(test.path, []).append(test)
        return [tuple(tests) for tests in by_file.values()]

    def selection(self, group: Sequence[SelectedTest]) -> Selection:
        """Return tests and signals of a group for an analysis or a comparison."""
        first, *others = group
        return {
            "test": first.number,
            "also": [test.number for test in others],
            "input_name": self.input_name,
            "output_name": self.output_name,
            "detrend": self.preparation.detrend,
            "band_hz": (self.preparation.low_hz, self.preparation.high_hz),
        }

    def specification(self) -> Engine:
        """Return the engine with its options.

        Raises:
            UnusableInputError: there is no such engine, or an option is not one that it takes.
        """
        options: dict[str, Any] = dict(self.options)
        return get_engine(self.engines[0]).from_options(options)


_UNITS = TypeAdapter(Annotated[dict[Name, Annotated[str, Field(max_length=40)]], Field(max_length=40)])


def _units_of(plots: PlotData) -> dict[str, str]:
    return {str(panel): unit for panel, unit in plots.units.items()}


def _without_curves(units: object) -> PlotData:
    """Return plots with units, and with the reason why they have no curves."""
    from tissueid.analysis.curves.results import TITLES, missing_plot

    without = marked("From an earlier session, without curves; “Refit” computes them.")
    panels = {panel: missing_plot(panel, without) for panel in TITLES}
    return PlotData(panels, {panel: unit for panel, unit in _UNITS.validate_python(units).items() if panel in panels})


_STORED_PLOTS = core_schema.no_info_plain_validator_function(
    _without_curves, serialization=core_schema.plain_serializer_function_ser_schema(_units_of)
)
_Plots = Annotated[PlotData, GetPydanticSchema(lambda _source, _handler: _STORED_PLOTS)]


@dataclass(frozen=True, eq=False)
class EngineOutcome:
    """Result of an engine on one test, or on several fitted together; ``refused`` is the reason if there is none.

    It is stored without curves.

    ``signals`` names input and output, ``preparation`` says what was done to them. ``stamp`` is that of the file when
    it was fitted; ``changed`` says that the file is another one now. ``recommended`` marks the engine that a comparison
    recommends.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    engine: Name
    options: Annotated[dict[Name, Value], Field(max_length=60)]
    tests: Annotated[tuple[SelectedTest, ...], Field(min_length=1, max_length=MOST_TESTS)]
    signals: tuple[Name, Name]
    report: FitReport | None = None
    validated_on: MessageText = ""
    plots: _Plots = field(default_factory=PlotData)
    findings: Texts = ()
    refused: MessageText = ""
    stamp: Stamp | None = None
    recommended: bool = False
    changed: Annotated[bool, Field(exclude=True)] = False
    preparation: Preparation = AS_RECORDED

    @classmethod
    def of(
        cls,
        analysis: Analysis,
        options: dict[str, Any],
        tests: Sequence[SelectedTest],
        signals: tuple[str, str],
        preparation: Preparation,
    ) -> EngineOutcome:
        """Return the result of an analysis."""
        from tissueid.analysis.curves.kernels import kernel_plots
        from tissueid.analysis.curves.results import panel_units, result_plots

        panels, findings = result_plots(analysis)
        report, record = analysis.model.report, analysis.record
        pictures = PlotData(panels, panel_units(record), kernel_plots(analysis.model, record))
        validated_on = analysis.validated_on
        return cls(
            report.engine,
            options,
            tuple(tests),
            signals,
            report,
            validated_on,
            pictures,
            findings,
            preparation=preparation,
        )

    def bare(self) -> EngineOutcome:
        """Return a copy without curves."""
        without = marked("There are too many results to keep all curves: run this test alone.")
        panels = {panel: replace(plot, parts=(), missing=without) for panel, plot in self.plots.panels.items()}
        return replace(self, plots=PlotData(panels, self.plots.units))

    @property
    def without_curves(self) -> bool:
        """Whether the result was stored without its curves."""
        return self.report is not None and self.plots.empty

    @property
    def key(self) -> tuple[Any, ...]:
        """Identity of a result: a later result with the same key replaces it."""
        tests = tuple((test.path, test.number) for test in self.tests)
        return self.engine, repr(self.options), tests, self.signals, self.preparation

    @property
    def test_label(self) -> str:
        """Date, time and number of the first test, or its label."""
        first = short_label(self.tests[0])
        return (
            first
            if len(self.tests) == 1
            else _("{first} and {count} more").format(first=first, count=len(self.tests) - 1)
        )

    @property
    def label(self) -> str:
        """Engine and tests."""
        return f"{engine_label(self.engine)}, {distinguishing_labels([self.tests])[1][0]}"


def keys_of(outcomes: Sequence[EngineOutcome]) -> tuple[str, list[str]]:
    """Return what outcomes have in common and the name of each in a legend: engine, and what distinguishes its test."""
    common, labels = distinguishing_labels([outcome.tests for outcome in outcomes])
    engines = [engine_label(outcome.engine) for outcome in outcomes]
    if len(outcomes) > 1 and len(set(labels)) == 1:
        return labels[0], engines
    if len(outcomes) > 1 and len(set(engines)) == 1:
        return ", ".join(filter(None, [engines[0], common])), labels
    return common, [", ".join(filter(None, pair)) for pair in zip(engines, labels, strict=True)]


def changed_options(engine: str, options: Mapping[str, object]) -> dict[str, object]:
    """Return the options that differ from the defaults; all of them, where the engine is not installed any more."""
    if engine not in engine_names():
        return dict(options)
    defaults = get_engine(engine)().options()
    return {name: value for name, value in options.items() if value != defaults.get(name, object())}


def variant_of(outcome: EngineOutcome) -> str:
    """Return the engine of a fit and its options that differ from the defaults."""
    changed = changed_options(outcome.engine, outcome.options) | outcome.preparation.changed
    options = plain_text(changed) if changed else _("default options")
    return f"{engine_label(outcome.engine)}, {options}"


MOST_ENTRIES = 500
_LONGEST_HISTORY_LINE = 2_000_000
_LONGEST_HISTORY = 8_000_000
"""What is read of a file, from its end; when it has grown past this it is cut to its latest lines."""


class HistoryEntry(BaseModel):
    """One run: time, task and headline."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time: AwareDatetime
    task: AnalysisTask
    headline: MessageText = ""


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
    """Return a part of a result of version 0.1, which holds messages and texts separately, with both joined."""
    for name, messages in stored.pop("messages", {}).items():
        texts = [stored[name]] if isinstance(stored[name], str) else stored[name]
        pairs = zip(messages, texts, strict=True)
        joined = [text if message is None else message | {"text": text} for message, text in pairs]
        stored[name] = joined[0] if isinstance(stored[name], str) else joined
    return stored
