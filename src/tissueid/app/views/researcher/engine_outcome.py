"""Result of an engine on a test, without the record, and the text for its changed options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, GetPydanticSchema, TypeAdapter
from pydantic_core import core_schema

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Curve, Plot
from tissueid.app.user_files import Stamp
from tissueid.app.views.researcher.selected_test import SelectedTest, ShortText, distinguishing_labels, short_label
from tissueid.app.words import sentence
from tissueid.formatting import plain_text
from tissueid.identification import Engine, FitReport, engine_label, engine_names, get_engine
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.stored_values import Name, StoredText, Texts

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
    validated_on: StoredText = ""
    plots: _Plots = field(default_factory=PlotData)
    findings: Texts = ()
    refused: StoredText = ""
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
