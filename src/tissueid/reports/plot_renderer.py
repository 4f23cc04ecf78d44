"""Draw plots on matplotlib axes: for reports in the style of the page, for the window in the colours of a theme."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from mpl_toolkits.mplot3d import Axes3D

from tissueid.analysis.curves.plot import Axis, Bars, Curve, Plot
from tissueid.messages import translated
from tissueid.reports.plot_axes import (
    PAGE,
    Look,
    Units,
    clinical,
    depth_bar,
    dress,
    label_of,
    label_with_power,
    say_missing,
    scale_axes,
)
from tissueid.reports.plot_layout import lay_out
from tissueid.reports.plot_parts import DrawnLine, draw_bars, draw_curve, draw_image, draw_mark, draw_surface
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH, drawing, new_figure

_LETTERS_PER_INCH = 13.0
_HANDLE_LETTERS = 7
"""Letters of a key that fit in an inch, and the width of a line or point before each name, in letters."""


def draw_plot(
    axes: Axes, plot: Plot, look: Look = PAGE, *, units: Units = clinical, title: bool = True, key: bool = True
) -> list[DrawnLine]:
    """Draw a plot; return its long lines, of which only as many points are drawn as are visible.

    Args:
        axes: empty axes; three-dimensional ones show a surface in space, others as an image.
        plot: what to draw.
        look: colours.
        units: units of the reader.
        title: whether the title stands above the axes.
        key: whether named curves get a key.
    """
    long: list[DrawnLine] = []
    factors = units(plot.x.unit)[1], units(plot.y.unit)[1]
    if plot.missing:
        say_missing(axes, translated(plot.missing), look)
    for part in plot.parts:
        if isinstance(part, Curve):
            long += draw_curve(axes, part, factors, look)
        elif isinstance(part, Bars):
            draw_bars(axes, part, factors, look)
        elif isinstance(axes, Axes3D):
            draw_surface(axes, part, factors, units(part.unit)[1])
        else:
            draw_image(axes, part, factors, units, look)
    if not plot.missing:
        scale_axes(axes, plot, factors, look)
        axes.set_xlabel(label_of(plot.x, units))
        axes.set_ylabel(label_with_power(axes, plot.y, units))
        for mark in plot.marks:
            draw_mark(axes, mark, factors, look)
    if title and plot.title and plot.title != plot.y.label:
        axes.set_title(translated(plot.title), loc="left")
    if key and not plot.missing and axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best")
    dress(axes, look)
    if plot.depths is not None:
        depth_bar(axes, plot.depths, units, look)
    return long


def draw_plots(
    figure: FigureBase,
    plots: Sequence[Plot],
    look: Look = PAGE,
    *,
    units: Units = clinical,
    title: bool = True,
    key: bool = True,
    heights: Sequence[float] | None = None,
) -> tuple[list[Axes], list[list[DrawnLine]]]:
    """Draw plots below each other into a figure; those over the same abscissa share its limits and its labels.

    Returns the axes and their long lines, in the order of the plots. ``heights`` are relative; None for the same.
    """
    return draw_grid(figure, [[plot] for plot in plots], look, units=units, title=title, key=key, heights=heights)


def draw_row(
    figure: FigureBase, plots: Sequence[Plot], *, widths: Sequence[float] | None = None, key: bool = True
) -> list[Axes]:
    """Draw plots next to each other; those with the same ordinate share its limits and its labels. Return the axes.

    Args:
        figure: the figure to draw into.
        plots: from left to right.
        widths: relative widths; None for the same.
        key: whether named curves get a key, the first time that they occur.
    """
    return draw_grid(figure, [plots], widths=widths, key=key)[0]


def draw_grid(
    figure: FigureBase,
    rows: Sequence[Sequence[Plot]],
    look: Look = PAGE,
    *,
    units: Units = clinical,
    title: bool = True,
    key: bool = True,
    heights: Sequence[float] | None = None,
    widths: Sequence[float] | None = None,
) -> tuple[list[Axes], list[list[DrawnLine]]]:
    """Draw rows of plots. Return the axes and their long lines, row by row; arguments as :func:`draw_plots`.

    A column over one abscissa shares its limits and its labels; neighbours in a row share an ordinate that is the same.
    """
    if not rows:
        return [], []
    grid = figure.subplots(len(rows), len(rows[0]), squeeze=False, height_ratios=heights, width_ratios=widths)
    shared = [
        len(rows) > 1 and len({(plot.x.label, plot.x.unit, plot.x.log) for plot in column}) == 1
        for column in zip(*rows, strict=True)
    ]
    for column in grid.T[shared]:
        for axes in column[:-1]:
            axes.sharex(column[-1])
    drawn, named = [], set[str]()
    for line, row in zip(grid, rows, strict=True):
        for place, (axes, plot) in enumerate(zip(line, row, strict=True)):
            names = {curve.name for curve in plot.curves if curve.name}
            same = place > 0 and plot.y == row[place - 1].y
            if same:
                axes.sharey(line[place - 1])
            drawn.append(draw_plot(axes, plot, look, units=units, title=title, key=key and not names <= named))
            named |= names
            if same:
                axes.tick_params(labelleft=False)
                axes.set_ylabel("")
    for line, row in zip(grid[:-1], rows[:-1], strict=True):
        for axes, plot, last, over_it in zip(line, row, rows[-1], shared, strict=True):
            if over_it and not last.missing:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=bool(plot.missing))
    if not any(plot.square for row in rows for plot in row):  # which are narrower than their places
        figure.align_ylabels()
    return list(grid.flat), drawn


@drawing
def row_figure(
    plots: Sequence[Plot], height: float, *, widths: Sequence[float] | None = None, over: bool = False
) -> Figure:
    """Return a figure of plots next to each other, as :func:`draw_row`; a single one takes half of the width.

    ``height`` is in inches; ``over`` puts the key over the whole figure.
    """
    figure = new_figure(FULL_WIDTH if len(plots) > 1 else HALF_WIDTH, height)
    every = draw_row(figure, plots, widths=widths, key=not over)
    if over:
        key_over(figure, every[0])
    return figure


@drawing
def column_figure(
    plots: Sequence[Plot],
    height: float,
    *,
    wide: bool = False,
    heights: Sequence[float] | None = None,
    over: bool = False,
) -> Figure:
    """Return a figure of plots below each other, as :func:`draw_plots`, of the full or of half the width.

    ``height`` is in inches; ``over`` puts the key over the whole figure.
    """
    figure = new_figure(FULL_WIDTH if wide else HALF_WIDTH, height)
    every, _long = draw_plots(figure, plots, key=not over, heights=heights)
    if over:
        key_over(figure, every[0])
    return figure


def key_over(figure: FigureBase, axes: Axes) -> None:
    """Put the key of axes over the whole figure, if it has several entries."""
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > 1:
        room = int(_LETTERS_PER_INCH * axes.get_figure(root=True).get_figwidth())  # type: ignore[union-attr]
        columns = max(1, min(6, len(labels), room // (_HANDLE_LETTERS + max(map(len, labels)))))
        figure.legend(handles, labels, loc="outside upper left", ncols=columns)


def draw_relief(
    figure: Figure,
    plot: Plot,
    look: Look = PAGE,
    *,
    units: Units = clinical,
    title: bool = True,
    place: tuple[int, int, int] = (1, 1, 1),
    scale: bool = True,
) -> Axes3D:
    """Draw the surface of a plot in space.

    Args:
        figure: the figure to draw into.
        plot: a plot with a surface.
        look: colours.
        units: units of the reader.
        title: whether the title stands above.
        place: rows, columns and number of the part of the figure.
        scale: whether the heights have numbers and a label.
    """
    axes = cast(Axes3D, figure.add_subplot(*place, projection="3d"))
    draw_plot(axes, plot, look, units=units, title=title)
    surface = plot.surface
    if not scale:
        axes.set_zticklabels([])
    elif surface is not None:
        axes.set_zlabel(label_of(Axis(surface.name, surface.unit), units))
        dress(axes, look)
    return axes


def draw_kernel(figure: Figure, plot: Plot) -> Axes:
    """Draw a surface as an image, and in space to its right; return the axes of the image."""
    axes = figure.add_subplot(1, 2, 1)
    draw_plot(axes, plot, title=False)
    draw_relief(figure, plot, title=False, place=(1, 2, 2), scale=False)
    return axes


def load_fonts() -> None:
    """Draw a small plot, so that fonts and colours are loaded before the first one is shown."""
    figure = Figure(figsize=(2.0, 1.5))
    canvas = FigureCanvasAgg(figure)
    draw_plots(figure, [Plot("A", Axis("A"), Axis("A", zero=True), (Curve(np.arange(3.0), np.arange(3.0), "A"),))])
    lay_out(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
