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

from matplotlib.figure import Figure

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.analysis.curves.validation import ROLES
from tissueid.identification import LineFigure, engine_label, engine_names, get_engine
from tissueid.identification.base import Array, Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import _
from tissueid.messages import translated
from tissueid.plugins import load_plugins
from tissueid.records import Record
from tissueid.reports.page import Picture, picture
from tissueid.reports.plot_renderer import column_figure
from tissueid.reports.style import drawing

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

    def with_model(self, model: M) -> FigureSubject[M]:
        """Another model of the same record."""
        return FigureSubject(self.name, model, self.analysis, self.surface_position_m)


@dataclass(frozen=True)
class Declared:
    """A figure that can be drawn of some models; arguments as :func:`figure`."""

    model: type[Model]
    key: str
    heading: str
    alt: str
    group: Group
    wide: bool
    place: int
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
    place: int = 50,
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
        place: order in its group.
        standard: name of the engine of the standard report without which the figure is left out; "" for others.
        short: whether it stands in the short section of a further test too.
        applies: whether the figure has any meaning for a model; where it has none nothing is said of it.

    Raises:
        ValueError: the class has a figure of that key already.
    """

    def declare(draw: Callable[[FigureSubject[M]], Drawn]) -> Callable[[FigureSubject[M]], Drawn]:
        made = Declared(model, key, heading, alt, group, wide, place, standard, short, applies, draw)
        held = _declared.setdefault((model, key), made)
        if held is not made and held.draw.__qualname__ != draw.__qualname__:
            raise ValueError(f"two figures of {model.__name__} are called {key!r}")
        return draw

    return declare


def figures_of(subject: FigureSubject[Model]) -> tuple[Declared, ...]:
    """The figures that can be drawn of a model, in their order; one of a class overrides that of the classes above."""
    _load()
    found: dict[str, Declared] = {}
    if subject.name in engine_names():
        for described in get_engine(subject.name).figures:
            found[described.key] = _of_engine(subject.name, described)
    for kind in type(subject.model).__mro__:
        for (model, key), one in _declared.items():
            if model is kind:
                found.setdefault(key, one)
    return tuple(sorted((one for one in found.values() if one.applies(subject)), key=lambda one: one.place))


def _of_engine(name: str, one: LineFigure) -> Declared:
    """Return the declaration of a figure that an engine describes by its curves."""

    def draw(subject: FigureSubject[Any]) -> Drawn:
        curves = [
            Curve(curve.x, curve.y, curve.label, ROLES[place % len(ROLES)], "points" if curve.points else "line")
            for place, curve in enumerate(one.curves(subject.model))
        ]
        drawn = column_figure([Plot("", Axis(one.x_label), Axis(one.y_label), tuple(curves))], 4.2, wide=True)
        return drawn, translated(one.caption)

    return Declared(
        model=Model,  # type: ignore[type-abstract]
        key=one.key,
        heading=one.heading,
        alt=one.alt,
        group=one.group,
        wide=True,
        place=50,
        standard=name,
        short=False,
        applies=lambda _subject: True,
        draw=draw,
    )


def all_figures() -> tuple[Declared, ...]:
    """Every figure that is declared, in the order of place."""
    _load()
    return tuple(sorted(_declared.values(), key=lambda one: one.place))


@cache
def _load() -> None:
    package = importlib.import_module("tissueid.reports.figures")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    load_plugins("tissueid.figures", "figure", lambda loaded: loaded)
