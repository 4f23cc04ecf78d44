"""Parts of plots on matplotlib axes: curves, bars, images, surfaces in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D

from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.plot import Array, Axis, Bars, Curve, Mark, Plot, Surface, thin
from tissueid.formatting import clean
from tissueid.identification.depth_profile import DepthProfile
from tissueid.messages import translated
from tissueid.reports.plot_axes import (
    PAGE,
    Look,
    Units,
    clinical,
    depth_bar,
    dress,
    finish_bar,
    label_of,
    label_with_power,
    lay_out,
    say_missing,
    scale_axes,
)
from tissueid.reports.style import (
    DASHES,
    DIVERGING,
    FULL_WIDTH,
    HALF_WIDTH,
    MUTED,
    POINTS,
    RELIEF,
    SEQUENTIAL,
    SERIES,
    SHADE,
    drawing,
    new_figure,
)

_RASTER = dict(zip(SERIES, POINTS, strict=True))
_MANY = 400
"""Number of points above which they are rasterised in a vector file."""
_BAND = 0.22
"""Opacity of a band."""
_STEPS = 60
"""Largest number of rows and of columns of a drawn surface."""
_COLUMNS = 900
_BAR_INSIDE = (1.04, 0.02, 0.05, 0.96)
"""Left, bottom, width and height of a colour bar that moves with its axes, as shares of them."""
_STYLES: Mapping[str, Any] = {
    "line": DASHES[0],
    "dashed": DASHES[1],
    "dotted": DASHES[2],
    "dashdot": DASHES[3],
    "level": DASHES[1],
}
_WRAP = 48


@dataclass(eq=False)
class DrawnLine:
    """A line that holds more points than are drawn; ``show`` redraws what lies between two abscissas."""

    line: Line2D
    x: Array
    y: Array

    def show(self, low: float, high: float, columns: int = _COLUMNS) -> None:
        """Draw at most two points for each column of the part from ``low`` to ``high``."""
        first, last = np.searchsorted(self.x, [low, high])
        part = slice(max(0, int(first) - 1), int(last) + 1)
        self.line.set_data(*thin(self.x[part], self.y[part], columns))


def draw_curve(axes: Axes, curve: Curve, factors: tuple[float, float], look: Look) -> list[DrawnLine]:
    """Draw a curve; return its line if it holds more points than are drawn."""
    colour, name = look.colour(curve.colour), clean(translated(curve.name)) or None
    x, y = factors[0] * np.asarray(curve.x), factors[1] * np.asarray(curve.y)
    usual: dict[str, Any] = {"color": colour, "alpha": curve.opacity, "label": name}
    if curve.kind == "level":
        axes.axhline(float(np.ravel(y)[0]), linestyle=_STYLES["level"], linewidth=curve.width, **usual)
        return []
    if curve.kind == "position":
        axes.axvline(float(np.ravel(x)[0]), linestyle=_STYLES["dotted"], linewidth=1.2 * curve.width, **usual)
        return []
    if curve.kind == "spans":
        shade = axes.axhspan if curve.across else axes.axvspan
        for low, high in (y if curve.across else x).reshape(-1, 2):
            shade(low, high, color=colour, alpha=curve.opacity, linewidth=0.0, zorder=0)
        return []
    if curve.kind == "filled":
        axes.fill(np.append(x, x[[-1, 0]]), np.append(y, [0.0, 0.0]), linewidth=0.0, **usual)
        return []
    if curve.kind == "bars":
        _error_bars(axes, curve, (x, y), factors, usual)
        return []
    if curve.low is not None and curve.high is not None:
        low, high = factors[1] * curve.low, factors[1] * curve.high
        band = translated(curve.band) or None
        axes.fill_between(x, low, high, color=colour, alpha=_BAND * curve.opacity, linewidth=0.0, label=band)
    if curve.kind == "circles":
        marker = curve.marker or "o"
        axes.plot(x, y, linestyle="none", marker=marker, markersize=4.5 * curve.width, markerfacecolor="none", **usual)
        return []
    if curve.kind == "points":
        many = x.size > _MANY and colour in _RASTER  # a raster does not follow the colours of a page
        usual["color"] = _RASTER[colour] if many else colour
        size = (2.5 if many else 4.5) * curve.width
        axes.plot(
            x,
            y,
            linestyle="none",
            marker=curve.marker or ".",
            markersize=size,
            markeredgewidth=0.0,
            rasterized=many,
            zorder=2,
            **usual,
        )
        return []
    shown = thin(x, y, _COLUMNS)
    dots: dict[str, Any] = {"marker": curve.marker, "markersize": 3.5} if curve.marker else {}
    (line,) = axes.plot(*shown, linestyle=_STYLES[curve.kind], linewidth=1.3 * curve.width, zorder=2.5, **usual, **dots)
    return [DrawnLine(line, x, y)] if shown[0].size < x.size else []


def _error_bars(
    axes: Axes, curve: Curve, at: tuple[Array, Array], factors: tuple[float, float], usual: dict[str, Any]
) -> None:
    if curve.low is not None and curve.high is not None:
        along = 0 if curve.across else 1
        ends = factors[along] * curve.low, factors[along] * curve.high
        usual["xerr" if curve.across else "yerr"] = np.abs(np.stack([at[along] - ends[0], ends[1] - at[along]]))
    size = 4.5 * curve.width
    axes.errorbar(*at, linestyle="none", marker=curve.marker or "o", markersize=size, capsize=2.0, zorder=3, **usual)


def draw_mark(axes: Axes, mark: Mark, factors: tuple[float, float], look: Look) -> None:
    """Draw a mark; the limits of the axes are known."""
    above = mark.y is None
    axes.annotate(
        clean(translated(mark.text)),
        (factors[0] * mark.x, 1.0 if mark.y is None else factors[1] * mark.y),
        (3 if mark.align == "left" else -3, 3),
        xycoords=("data", "axes fraction" if above else "data"),
        textcoords="offset points",
        ha=mark.align,
        color=look.colour(mark.colour),
        fontsize=look.font_size - 0.5,
        parse_math=False,
    )


def draw_bars(axes: Axes, bars: Bars, factors: tuple[float, float], look: Look) -> None:
    """Draw bars."""
    if bars.across:
        factors = factors[::-1]
    colour, name = look.colour(bars.colour), clean(translated(bars.name)) or None
    x = np.arange(len(bars.names), dtype=np.float64) if bars.names else factors[0] * bars.x
    height, width = factors[1] * bars.height, bars.width if bars.names else factors[0] * np.asarray(bars.width)
    error = None if bars.error is None else factors[1] * bars.error
    usual: dict[str, Any] = {"color": colour, "alpha": bars.opacity, "label": name, "ecolor": look.ink}
    names = [clean(translated(text)) for text in bars.names]
    base = 0.0 if bars.base is None else factors[1] * bars.base
    if bars.across:
        axes.barh(x, height, width, base, xerr=error, **usual)
        if names:
            axes.set_yticks(x, names)
            if not axes.yaxis_inverted():
                axes.invert_yaxis()
    else:
        axes.bar(x, height, width, base, yerr=error, **usual)
        if names:
            axes.set_xticks(x, names)


def draw_image(axes: Axes, surface: Surface, factors: tuple[float, float], units: Units, look: Look) -> None:
    """Draw a surface as an image with a colour bar."""
    x, y = factors[0] * surface.x, factors[1] * surface.y
    unit, factor = units(surface.unit)
    values = factor * surface.values
    top = factor * surface.limit if surface.limit else _top(values)
    usual: dict[str, Any] = {"cmap": DIVERGING if surface.signed else SEQUENTIAL, "vmax": top}
    usual["vmin"] = -top if surface.signed else 0.0
    drawn: ScalarMappable
    if surface.edges is None:
        extent = (*_edges(x), *_edges(y))
        drawn = axes.imshow(values, origin="lower", extent=extent, aspect="auto", interpolation="nearest", **usual)
    else:
        columns = np.linspace(*_edges(x), x.size + 1)
        drawn = axes.pcolormesh(columns, factors[1] * surface.edges, values, rasterized=True, linewidth=0.0, **usual)
    figure = axes.get_figure(root=True)
    if figure is not None and isinstance(figure.get_layout_engine(), PlaceHolderLayoutEngine):
        # Axes that are placed one by one, as on a page of a PDF: the bar has to move with them.
        bar = axes.figure.colorbar(drawn, cax=axes.inset_axes(_BAR_INSIDE))
    else:
        bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.95, pad=0.02)
    if bar.solids is not None:
        bar.solids.set_rasterized(True)
    finish_bar(bar, label_of(Axis(surface.name, unit)), look)


def draw_surface(axes: Axes3D, surface: Surface, factors: tuple[float, float], factor: float) -> None:
    """Draw a surface in space."""
    rows, columns = (max(1, -(-size // _STEPS)) for size in surface.values.shape)
    some = factor * surface.values[::rows, ::columns]
    across, along = np.meshgrid(factors[0] * surface.x[::columns], factors[1] * surface.y[::rows])
    top = _top(some)
    axes.plot_surface(
        across,
        along,
        some,
        rstride=1,
        cstride=1,
        cmap=RELIEF,
        norm=Normalize(-top, top),
        linewidth=0.15,
        edgecolor=(0.3, 0.3, 0.3, 0.5),
        antialiased=True,
        rasterized=True,
    )
    axes.view_init(elev=32.0, azim=-125.0)
    axes.tick_params(pad=-1.0)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.line.set_color(MUTED)


def _top(values: Array) -> float:
    finite = np.abs(values[np.isfinite(values)])
    return (float(finite.max()) if finite.size else 0.0) or 1.0


def _edges(centres: Array) -> tuple[float, float]:
    """Return where an image with pixels at these evenly spaced centres (k,) begins and ends."""
    half = 0.5 * float(centres[1] - centres[0]) if centres.size > 1 else 0.5
    return float(centres[0]) - half, float(centres[-1]) + half


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

    A column over one abscissa shares its limits, unless they are set and differ, and its labels; neighbours in a row
    share an ordinate that is the same.
    """
    if not rows:
        return [], []
    grid = figure.subplots(len(rows), len(rows[0]), squeeze=False, height_ratios=heights, width_ratios=widths)
    shared = [
        len(rows) > 1
        and len({(plot.x.label, plot.x.unit, plot.x.log) for plot in column}) == 1
        and len({plot.x.limits for plot in column} - {None}) < 2
        for column in zip(*rows, strict=True)
    ]
    for column in grid.T[shared]:
        for axes in column[:-1]:
            axes.sharex(column[-1])
    drawn, named = [], set[str]()
    for line, row in zip(grid, rows, strict=True):
        for index, (axes, plot) in enumerate(zip(line, row, strict=True)):
            names = {curve.name for curve in plot.curves if curve.name}
            same = index > 0 and plot.y == row[index - 1].y
            if same:
                axes.sharey(line[index - 1])
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
    cell: tuple[int, int, int] = (1, 1, 1),
    scale: bool = True,
) -> Axes3D:
    """Draw the surface of a plot in space.

    Args:
        figure: the figure to draw into.
        plot: a plot with a surface.
        look: colours.
        units: units of the reader.
        title: whether the title stands above.
        cell: rows, columns and number of the part of the figure.
        scale: whether the heights have numbers and a label.
    """
    axes = cast(Axes3D, figure.add_subplot(*cell, projection="3d"))
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
    draw_relief(figure, plot, title=False, cell=(1, 2, 2), scale=False)
    return axes


def load_fonts() -> None:
    """Draw a small plot, so that fonts and colours are loaded before the first one is shown."""
    figure = Figure(figsize=(2.0, 1.5))
    canvas = FigureCanvasAgg(figure)
    draw_plots(figure, [Plot("A", Axis("A"), Axis("A", zero=True), (Curve(np.arange(3.0), np.arange(3.0), "A"),))])
    lay_out(figure)
    canvas.draw()  # type: ignore[no-untyped-call]


@drawing
def depth_panels(
    profiles: Mapping[str, DepthProfile], surface_position_m: float = float("nan"), visited: Array | None = None
) -> Figure:
    """Return a figure of the depth panels; arguments as :func:`draw_depth_panels`.

    Raises:
        UnusableInputError: no row holds a value.
    """
    figure = new_figure(FULL_WIDTH, 4.3)
    draw_depth_panels(figure, profiles, surface_position_m, visited)
    return figure


def draw_depth_panels(
    figure: FigureBase,
    profiles: Mapping[str, DepthProfile],
    surface_position_m: float = float("nan"),
    visited: Array | None = None,
) -> None:
    """Draw mass, damping and stiffness against depth with 95 % bars or bands (Chen 2010, Figs. 5.9 to 5.11).

    Args:
        figure: the figure to draw into.
        profiles: profiles by legend label.
        surface_position_m: origin of depth, m; NaN to show positions on the actuator.
        visited: output (n,), m, whose distribution is drawn below; None for the support of the profiles.

    Raises:
        UnusableInputError: no row holds a value.
    """
    *quantities, samples = profile_plots(profiles, surface_position_m, visited)
    key_over(figure, draw_over_samples(figure, quantities, samples)[0])


def draw_over_samples(figure: FigureBase, plots: Sequence[Plot], samples: Plot, *, key: bool = False) -> list[Axes]:
    """Draw plots next to each other and the number of samples below each; return the axes of the plots.

    Args:
        figure: the figure to draw into.
        plots: plots over the same abscissa as ``samples``.
        samples: bars of the number of samples.
        key: whether plots with several named curves get a key.
    """
    grid = np.atleast_2d(figure.subplots(2, len(plots), sharex=True, height_ratios=(3.2, 1.0)))
    for axes, plot in zip(grid[0], plots, strict=True):
        draw_plot(axes, plot, key=key and sum(bool(curve.name) for curve in plot.curves) > 1)
        axes.set_xlabel("")
    for axes in grid[1]:
        draw_plot(axes, samples)
        axes.set_facecolor(SHADE)
        axes.locator_params(axis="y", nbins=3)
        axes.set_ylabel("" if axes is not grid[1, 0] else axes.get_ylabel())
    figure.align_ylabels()
    return list(grid[0])
