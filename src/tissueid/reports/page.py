"""What pages consist of: figures with texts, sheets of panels, templates, words for the configuration of a test."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup
from matplotlib.figure import Figure, FigureBase

from tissueid.analysis import Analysis
from tissueid.atomic_write import atomic_file, private_folder
from tissueid.configuration import has_depth, travel_word
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import _, current_language, marked
from tissueid.messages import Message, translated
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH, drawing, new_figure, plain_image, to_svg
from tissueid.sessions import Test


@dataclass(frozen=True)
class FigureBlock:
    """A figure on the page or the reason why it was left out: one of ``svg`` and ``missing`` is ""."""

    key: str
    heading: str
    caption: str
    svg: str
    missing: str
    wide: bool


@dataclass(frozen=True)
class FigureGroup:
    """Figures under one heading."""

    key: str
    heading: str
    figures: tuple[FigureBlock, ...]


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its texts, before it is put on a page or in a file; without a ``figure``, ``missing`` says why."""

    key: str
    heading: str
    alt: str
    caption: str
    figure: Figure | None
    missing: str
    wide: bool

    @property
    def block(self) -> FigureBlock:
        """Return the figure as the page holds it."""
        svg = "" if self.figure is None else to_svg(self.figure, self.key, self.alt)
        return FigureBlock(self.key, self.heading, self.caption, svg, translated(self.missing), self.wide)


def picture(key: str, heading: str, alt: str, make: Callable[[], tuple[Figure, str]], *, wide: bool = True) -> Picture:
    """Return a figure, or the reason why it was left out; ``make`` returns the figure and its caption."""
    try:
        figure, caption = make()
    except UnusableInputError as error:
        return absent(key, heading, error.message, wide=wide)
    return Picture(key, heading, alt, caption, figure, "", wide)


def absent(key: str, heading: str, reason: str, *, wide: bool = True) -> Picture:
    """Return a figure that was left out, for a reason without a full stop."""
    return Picture(key, heading, "", "", None, Message("report.left_out", "Left out: {reason}.", reason=reason), wide)


def write_figures(pictures: Iterable[Picture], folder: Path) -> tuple[Path, ...]:
    """Write every figure as SVG and PNG into a folder, which is made when missing, and return the files.

    Raises:
        OSError: the folder cannot be made or written to.
    """
    forms: tuple[Literal["svg", "png"], ...] = ("svg", "png")
    private_folder(folder)
    written = []
    for drawn in pictures:
        if drawn.figure is not None:
            for form in forms:
                written.append(folder / f"{drawn.key}.{form}")
                with atomic_file(written[-1]) as partial:
                    plain_image(drawn.figure, partial, form)
    return tuple(written)


RESEARCH_LINE = marked("Research use only. Not a medical device; not for diagnosis or treatment.")


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


@cache
def template(name: str, package: str = "tissueid.reports") -> Template:
    """Return the template of a page, of this package or another one. It escapes all values.

    An unknown value raises an error.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("tissueid.reports")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_control_characters,
    )
    environment.filters["svg"] = Markup
    environment.globals |= {"_": _, "translated": translated, "language": current_language}
    return environment.get_template(name)


def _without_control_characters(value: Any) -> Any:
    return clean(value) if type(value) is str else value


_TITLE_HEIGHT = 0.3


@dataclass(frozen=True, eq=False)
class Panel:
    """A drawing for a figure or a part of one.

    ``draw`` raises :class:`~tissueid.errors.UnusableInputError` when there is nothing to draw; the page then shows its
    message in place of the panel. ``height`` is in inches.
    """

    key: str
    heading: str
    alt: str
    caption: str
    draw: Callable[[FigureBase], object]
    wide: bool = True
    height: float = 3.4

    def picture(self) -> Picture:
        """Return the panel as a figure of its own."""
        return picture(self.key, self.heading, self.alt, lambda: (self.figure(), self.caption), wide=self.wide)

    @drawing
    def figure(self) -> Figure:
        """Draw the panel.

        Raises:
            UnusableInputError: there is nothing to draw.
        """
        figure = new_figure(FULL_WIDTH if self.wide else HALF_WIDTH, self.height)
        self.draw(figure)
        return figure


def missing_panel(key: str, heading: str, reason: str) -> Panel:
    """Return a panel that cannot be drawn, for a reason without a full stop."""

    def draw(_: FigureBase) -> None:
        raise UnusableInputError(reason)

    return Panel(key, heading, "", "", draw, wide=False)


@drawing
def draw_sheet(title: str, panels: Sequence[Panel]) -> Figure:
    """Draw all panels that can be drawn on one sheet under a title; consecutive half-width panels share a row.

    Raises:
        UnusableInputError: none of them can be drawn.
    """
    rows = list(_rows([panel for panel in panels if panel.picture().figure is not None]))
    if not rows:
        raise UnusableInputError("report.nothing_to_draw", "there is nothing to draw")
    heights = [max(panel.height for panel in row) for row in rows]
    figure = new_figure(FULL_WIDTH, sum(heights) + _TITLE_HEIGHT)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11.0)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for part, row in zip(parts, rows, strict=True):
        halves = [part] if len(row) == 1 else list(part.subfigures(1, 2, squeeze=False)[0])
        for half, panel in zip(halves, row, strict=False):
            panel.draw(half)
    return figure


def _rows(panels: Sequence[Panel]) -> Iterator[list[Panel]]:
    """Yield rows: a wide panel alone, half-width panels in pairs."""
    for wide, alike in groupby(panels, lambda panel: panel.wide):
        row = list(alike)
        step = 1 if wide else 2
        yield from (row[first : first + step] for first in range(0, len(row), step))


CONFIGURATIONS = (marked("indentation"), marked("extension"), marked("surface"))
"""Names of configurations, as a session has them."""
COUPLINGS = (marked("tape"), marked("adhesive"))
"""What attaches the probe, as a session has it."""
_DEPTH = re.compile(r"\b([Dd])epth(s?)\b")


def surface_of(test: Test) -> float:
    """Where depth is counted from, m; NaN where there is none."""
    return test.surface_position_m if has_depth(test.configuration) else math.nan


def captions_for_configuration(test: Test, pictures: Iterable[Picture]) -> tuple[Picture, ...]:
    """Return pictures whose texts say displacement where the configuration of the test has no depth."""
    if has_depth(test.configuration):
        return tuple(pictures)
    word = travel_word(test.configuration)

    def put(text: str) -> str:
        return _DEPTH.sub(lambda match: (word.capitalize() if match[1] == "D" else word) + match[2], text)

    return tuple(
        replace(
            drawn,
            heading=put(drawn.heading),
            alt=put(drawn.alt),
            caption=put(drawn.caption),
            missing=put(translated(drawn.missing)),
        )
        for drawn in pictures
    )


def spring_line(analyses: Iterable[Analysis]) -> str:
    """That an external spring was subtracted, and which; empty where there was none."""
    spring = max((analysis.external_spring_n_per_m for analysis in analyses), default=0.0)
    if not spring:
        return ""
    return _("The external spring of {spring:g} N/m is subtracted from every stiffness.").format(spring=spring)
