"""Panels: single figures on a page, or several on one sheet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure, FigureBase

from tissueid.errors import UnusableInputError
from tissueid.reports.blocks import Picture, picture
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH, drawing, new_figure

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
    for part, row in zip(_parts(figure, heights), rows, strict=True):
        halves = [part] if len(row) == 1 else list(part.subfigures(1, 2, squeeze=False)[0])
        for half, panel in zip(halves, row, strict=False):
            panel.draw(half)
    return figure


def _parts(figure: Figure, heights: Sequence[float]) -> list[FigureBase]:
    return list(figure.subfigures(len(heights), 1, height_ratios=list(heights), squeeze=False)[:, 0])


def _rows(panels: Sequence[Panel]) -> Iterator[list[Panel]]:
    """Yield rows: a wide panel alone, half-width panels in pairs."""
    waiting: list[Panel] = []
    for panel in panels:
        if panel.wide:
            if waiting:
                yield waiting
            waiting = []
            yield [panel]
            continue
        waiting.append(panel)
        if len(waiting) == 2:
            yield waiting
            waiting = []
    if waiting:
        yield waiting
