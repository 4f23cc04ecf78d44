"""Registry of figures: each is declared for a class of models and drawn for all classes derived from it.

Reports request the figures of a model and place them in their groups. A figure
declared for :class:`~tissueid.identification.base.Model` itself is drawn for every engine, ours or not.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.analysis.curves.validation import (
    ROLES,
    cloud_plot,
    held_out_prediction,
    horizon_plot,
    prediction_plots,
    residual_test_plot,
)
from tissueid.analysis.fitting import effective_parameters
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number
from tissueid.identification import LineFigure, engine_label, engine_names, get_engine
from tissueid.identification.base import Array, Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.validation.prediction import fit_noise, prediction_curve
from tissueid.identification.validation.residual_tests import ResidualTest, residual_tests
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.plugins import load_plugins
from tissueid.records import Record
from tissueid.reports import captions
from tissueid.reports.page import Picture, picture
from tissueid.reports.plot_renderer import column_figure, depth_panels, draw_plot, row_figure
from tissueid.reports.style import FULL_WIDTH, drawing, new_figure

M_co = TypeVar("M_co", bound=Model, covariant=True)
M = TypeVar("M", bound=Model)

Group = Literal["record", "linear", "nonlinear", "validation"]
"""Subject of a figure: recorded signals, linear dynamics, nonlinearity, or performance on held-out samples."""

Drawn = tuple[Figure, str]
"""A figure and its caption."""


@dataclass(frozen=True, eq=False)
class FigureSubject(Generic[M_co]):
    """A model to be drawn, with what it was fitted to and tried on; ``name`` is its engine's."""

    name: str
    model: M_co
    analysis: Analysis
    surface_position_m: float = math.nan

    @property
    def label(self) -> str:
        """Return the display name of the engine."""
        return engine_label(self.name)

    @property
    def record(self) -> Record:
        """What was fitted, with what came before and after the fitted part."""
        return self.analysis.record

    @property
    def profile(self) -> DepthProfile | None:
        """Mass, damping and stiffness against depth, without an external spring; None for models that hold none."""
        return self.analysis.depth_profile(self.model)

    @property
    def fitted_input(self) -> Array:
        """Input of the fitted part, (n,)."""
        return self.record.input[self.analysis.fit_part]

    @property
    def fitted_output(self) -> Array:
        """Output of the fitted part, (n,)."""
        return self.record.output[self.analysis.fit_part]


@dataclass(frozen=True)
class Declared:
    """A figure that can be drawn of some models; arguments as :func:`figure`."""

    model: type[Model]
    key: str
    heading: str
    alt: str
    group: Group
    wide: bool
    order: int
    standard: str
    short: bool
    applies: Callable[[FigureSubject[Any]], bool]
    draw: Callable[[FigureSubject[Any]], Drawn]

    def picture(self, subject: FigureSubject[Model], prefix: str = "", *, suffix: str = "") -> Picture:
        """Draw it, under a key that begins with ``prefix``, or say why not."""
        make = drawing(self.draw)
        key = "-".join(part for part in (prefix, subject.name, self.key) if part)
        return picture(key, _(self.heading) + suffix, _(self.alt), lambda: make(subject), wide=self.wide)


_declared: dict[tuple[type[Model], str], Declared] = {}


def figure(
    model: type[M],
    key: str,
    heading: str,
    alt: str,
    *,
    group: Group,
    wide: bool = True,
    order: int = 50,
    standard: str = "",
    short: bool = False,
    applies: Callable[[FigureSubject[M]], bool] = lambda _subject: True,
) -> Callable[[Callable[[FigureSubject[M]], Drawn]], Callable[[FigureSubject[M]], Drawn]]:
    """Declare a figure of a class of models; decorates the function that draws it and words its caption.

    The function raises :class:`~tissueid.errors.UnusableInputError` where this record does not hold what it takes;
    the line then stands in place of the figure.

    Args:
        model: the class; the figure is drawn for those that derive from it too.
        key: short name, of lower-case letters, digits and hyphens, one of its kind for the class.
        heading: what stands over it.
        alt: what a screen reader says.
        group: where on a page it belongs.
        wide: whether it takes the full width of the page, or half.
        order: rank in its group, the lowest first.
        standard: name of the engine of the standard report without which the figure is left out; "" for others.
        short: whether it stands in the short section of a further test too.
        applies: whether the figure has any meaning for a model; where it has none nothing is said of it.

    Raises:
        ValueError: the class has a figure of that key already.
    """

    def declare(draw: Callable[[FigureSubject[M]], Drawn]) -> Callable[[FigureSubject[M]], Drawn]:
        made = Declared(model, key, heading, alt, group, wide, order, standard, short, applies, draw)
        held = _declared.setdefault((model, key), made)
        if held is not made and held.draw.__qualname__ != draw.__qualname__:
            raise ValueError(f"two figures of {model.__name__} are called {key!r}")
        return draw

    return declare


def figures_of(subject: FigureSubject[Model]) -> tuple[Declared, ...]:
    """The figures that can be drawn of a model, in their order; one of a class overrides that of the classes above."""
    _load()
    by_key: dict[str, Declared] = {}
    if subject.name in engine_names():
        for described in get_engine(subject.name).figures:
            by_key[described.key] = _of_engine(subject.name, described)
    for kind in type(subject.model).__mro__:
        for (model, key), declared in _declared.items():
            if model is kind:
                by_key.setdefault(key, declared)
    return tuple(
        sorted(
            (declared for declared in by_key.values() if declared.applies(subject)), key=lambda declared: declared.order
        )
    )


def _of_engine(name: str, described: LineFigure) -> Declared:
    """Return the declaration of a figure that an engine describes by its curves."""

    def draw(subject: FigureSubject[Any]) -> Drawn:
        curves = [
            Curve(curve.x, curve.y, curve.label, ROLES[index % len(ROLES)], "points" if curve.points else "line")
            for index, curve in enumerate(described.curves(subject.model))
        ]
        drawn = column_figure(
            [Plot("", Axis(described.x_label), Axis(described.y_label), tuple(curves))], 4.2, wide=True
        )
        return drawn, translated(described.caption)

    return Declared(
        model=Model,  # type: ignore[type-abstract]
        key=described.key,
        heading=described.heading,
        alt=described.alt,
        group=described.group,
        wide=True,
        order=50,
        standard=name,
        short=False,
        applies=lambda _subject: True,
        draw=draw,
    )


def all_figures() -> tuple[Declared, ...]:
    """Every figure that is declared, by their order."""
    _load()
    return tuple(sorted(_declared.values(), key=lambda declared: declared.order))


@cache
def _load() -> None:
    package = importlib.import_module("tissueid.reports.figures")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    load_plugins("tissueid.figures", "figure", lambda loaded: loaded)


_ANY: type[Model] = Model  # type: ignore[type-abstract]
_STRETCH_S = 0.25
"""Seconds of held-out samples that are drawn one by one; a comparison has one such figure for each engine."""

_SMALL_GAIN = 2.0
"""Points of VAF between one-step prediction and free run up to which the residual counts as uncorrelated."""


@figure(
    _ANY,
    "depth-profile",
    marked("Mass, damping and stiffness against depth"),
    marked(
        "Three panels against depth: mass, damping and stiffness with 95 % bars, and below the samples at each depth."
    ),
    group="nonlinear",
    order=30,
    applies=lambda subject: subject.profile is not None,
)
def depth_profile(subject: FigureSubject[Model]) -> Drawn:
    """Draw mass, damping and stiffness against depth of one engine (Chen 2010, Figs. 5.9 to 5.11)."""
    profile = subject.profile
    if profile is None:
        raise UnusableInputError("report.no_depth", "this model has no parameters against depth")
    text = _(
        "What a small test at each depth would measure, with 95 % bars; below, the number of samples at each depth. "
        "Tissue should stiffen with depth, and damp more; the mass is mostly the instrument’s and should be constant."
    )
    ways = ""
    if np.any(profile.direction):
        ways = _("The way into the tissue and the way out have a colour and a marker each.")
    return depth_panels({subject.label: profile}, subject.surface_position_m), captions.joined(text, ways)


@figure(
    _ANY,
    "prediction",
    marked("Measured and predicted"),
    marked("Measured output as dots with the simulation of the model as a line, and the residual below."),
    group="validation",
    order=10,
)
def prediction(subject: FigureSubject[Model]) -> Drawn:
    """Draw a stretch of held-out samples (Chen 2010, Figs. 3.10, 4.7 and 5.5a)."""
    run = held_out_prediction(subject.label, subject.analysis)
    drawn = column_figure(prediction_plots([run], _STRETCH_S), 4.2, wide=True, heights=(2.2, 1.0), over=True)
    return drawn, captions.prediction({subject.name: subject.analysis})


@figure(
    _ANY,
    "scatter",
    marked("Measured against predicted"),
    marked(
        "Cloud of measured against predicted output with its mean as a curve, and the diagonal of perfect agreement."
    ),
    group="validation",
    wide=False,
    order=12,
)
def scatter(subject: FigureSubject[Model]) -> Drawn:
    """Draw all held-out samples (Chen 2010, Figs. 4.10 and 5.5b)."""
    run = held_out_prediction(subject.label, subject.analysis)
    drawn = row_figure([cloud_plot(run.predicted, run.measured, run.output_unit, x="predicted")], 3.9)
    return drawn, captions.scatter([run])


@figure(
    _ANY,
    "residual-tests",
    marked("Residual tests"),
    marked("Ten small panels: correlations of the residual over lags with bands, each with its verdict."),
    group="validation",
    order=14,
)
def residuals(subject: FigureSubject[Model]) -> Drawn:
    """Draw the tests of the held-out residual, each with its bands and verdict."""
    analysis = subject.analysis
    results = residual_tests(subject.model, analysis.held_out_record, analysis.held_out)
    drawn = new_figure(FULL_WIDTH, 3.9)
    every = drawn.subplots(2, -(-len(results.tests) // 2))
    for axes, test in zip(every.flat, results.tests, strict=False):
        _test_panel(axes, test)
    for axes in every[-1]:
        axes.set_xlabel(_("Lag (ms)"))
    for axes in every[:, 0]:
        axes.set_ylabel(_("Correlation"))
    text = _(
        "Correlations of the held-out residual with signals that it should not depend on. Shaded: exceeded by one lag "
        "by chance in 5 % of cases; dashed: exceeded by any lag in 5 % of cases. ✓ passed, ✕ failed."
    )
    return drawn, captions.joined(text, captions.findings(results.findings))


def _test_panel(axes: Axes, test: ResidualTest) -> None:
    """Draw one test, with its verdict as the title."""
    plot = residual_test_plot(test)
    title = translated(plot.title)
    if not plot.parts or test.p_value is None:
        axes.set_title(f"– {title}")
        axes.set_axis_off()
        return
    draw_plot(axes, plot, title=False)
    axes.set_xlabel("")
    axes.locator_params(nbins=4)
    chance = "p < 0.001" if test.p_value < 1e-3 else f"p = {number(test.p_value, 2)}"
    axes.set_title(f"{'✓' if test.passed else '✕'} {title}\n{chance}", fontsize=8.5)


@figure(
    _ANY,
    "horizon",
    marked("Prediction by horizon"),
    marked("Variance accounted for against prediction horizon, falling to the level of the free run."),
    group="validation",
    wide=False,
    order=13,
)
def horizon(subject: FigureSubject[Model]) -> Drawn:
    """Draw the score of n-step prediction on the held-out part, with that of the free run."""
    analysis, model = subject.analysis, subject.model
    noise = fit_noise(model, analysis.record, analysis.fit_part)
    curve = prediction_curve(model, analysis.held_out_record, noise, part=analysis.held_out)
    drawn, free = column_figure([horizon_plot(curve)], 3.3), curve.free_run_vaf_percent
    text = _(
        "The prediction uses the whole input, and the output up to the horizon. At short horizons past errors of the "
        "model predict the next ones; at long horizons only the simulation remains, with {free} %."
    ).format(free=fixed(free, 1))
    points = float(curve.vaf_percent[0]) - free
    gain = _("The two differ little: the residual is nearly uncorrelated in time.")
    if points > _SMALL_GAIN:
        gain = _(
            "The difference of {points} points is slow errors: dynamics that {count} parameters do not describe."
        ).format(points=fixed(points, 1), count=fixed(effective_parameters(model.report), 0))
    return drawn, captions.joined(text, gain)
