"""Draw plots on matplotlib axes: for reports in the style of the page, for the window in the colours of a theme.

Every property is set on the artists themselves, so that the window can draw while a report is drawn in another thread,
which changes matplotlib's global settings.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, MultipleLocator
from mpl_toolkits.mplot3d import Axes3D

from tissueid.analysis.curves.plot import Array, Axis, Bars, Curve, Plot, Surface, thin
from tissueid.formatting import clean
from tissueid.messages import translated
from tissueid.reports.style import (
    BLUE,
    DASHES,
    DIVERGING,
    GREEN,
    GRID,
    INK,
    LOST,
    MUTED,
    ORANGE,
    PAPER,
    POINTS,
    RELIEF,
    SEQUENTIAL,
    SERIES,
    frequency_axis,
    log_axis,
)

Units = Callable[[str], tuple[str, float]]
"""Gives the symbol of a unit as it is to be shown, and the factor that converts to it."""


def clinical(unit: str) -> tuple[str, float]:
    """Return a unit as it is."""
    return unit, 1.0


@dataclass(frozen=True)
class Look:
    """Colours of the page and of the roles of curves. ``points`` are those of rasterised points."""

    ink: str = INK
    muted: str = MUTED
    grid: str = GRID
    paper: str = PAPER
    font_size: float = 9.0
    roles: Mapping[str, str] = field(
        default_factory=lambda: {
            "measured": BLUE,
            "model": ORANGE,
            "good": GREEN,
            "poor": LOST,
            "check": SERIES[3],
            "text": INK,
            "muted": MUTED,
        }
    )

    def colour(self, role: str) -> str:
        """Return the colour of a role; a colour of its own stays."""
        return self.roles.get(role, role)


PAGE = Look()
"""The look of reports on white; pages replace its colours by those of their style sheet."""

_RASTER = dict(zip(SERIES, POINTS, strict=True))
_MANY = 400
"""Number of points above which they are rasterised in a vector file."""
_BAND = 0.22
"""Opacity of a band."""
_STEPS = 60
"""Largest number of rows and of columns of a drawn surface."""
_COLUMNS = 900
_STYLES: Mapping[str, Any] = {"line": DASHES[0], "dashed": DASHES[1], "dotted": DASHES[2], "level": DASHES[1]}
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
        _say(axes, translated(plot.missing), look)
    for part in plot.parts:
        if isinstance(part, Curve):
            long += _curve(axes, part, factors, look)
        elif isinstance(part, Bars):
            _bars(axes, part, factors, look)
        elif isinstance(axes, Axes3D):
            _relief(axes, part, factors, units(part.unit)[1])
        else:
            _image(axes, part, factors, units, look)
    if not plot.missing:
        _scale(axes, plot, factors, look)
        axes.set_xlabel(label_of(plot.x, units))
        axes.set_ylabel(label_of(plot.y, units))
    if title and plot.title and plot.title != plot.y.label:
        axes.set_title(translated(plot.title), loc="left")
    if key and not plot.missing and axes.get_legend_handles_labels()[1]:
        axes.legend(loc="best")
    dress(axes, look)
    return long


def draw_plots(
    figure: FigureBase,
    plots: Sequence[Plot],
    look: Look = PAGE,
    *,
    units: Units = clinical,
    title: bool = True,
    key: bool = True,
) -> tuple[list[Axes], list[list[DrawnLine]]]:
    """Draw plots below each other into a figure; those over the same abscissa share its limits and its labels.

    Returns the axes and their long lines, in the order of the plots.
    """
    every: list[Axes] = list(figure.subplots(len(plots), 1, squeeze=False)[:, 0]) if plots else []
    shared = len(plots) > 1 and len({(plot.x.label, plot.x.unit, plot.x.log) for plot in plots}) == 1
    if shared:
        for axes in every[:-1]:
            axes.sharex(every[-1])
    drawn, named = [], set[str]()
    for axes, plot in zip(every, plots, strict=True):
        names = {curve.name for curve in plot.curves if curve.name}
        drawn.append(draw_plot(axes, plot, look, units=units, title=title, key=key and not names <= named))
        named |= names
    if shared and not plots[-1].missing:
        for axes, plot in zip(every[:-1], plots[:-1], strict=True):
            axes.set_xlabel("")
            if not plot.missing:
                axes.tick_params(labelbottom=False)
    figure.align_ylabels()
    return every, drawn


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


def label_of(axis: Axis, units: Units = clinical) -> str:
    """Return quantity and unit of an axis as they are shown."""
    label, unit = translated(axis.label), translated(units(axis.unit)[0])
    return f"{label} ({unit})" if label and unit else label or unit


def dress(axes: Axes, look: Look) -> None:
    """Give axes the colours and sizes of a look; again for another look."""
    small = look.font_size - 0.5
    axes.set_facecolor(look.paper if not isinstance(axes, Axes3D) else "none")
    axes.tick_params(which="both", colors=look.muted, labelcolor=look.ink, labelsize=small, width=0.8)
    if not isinstance(axes, Axes3D):
        for side, spine in axes.spines.items():
            spine.set_color(look.muted)
            spine.set_linewidth(0.8)
            spine.set_visible(side in ("left", "bottom"))
        if axes.images or any(isinstance(one, QuadMesh) for one in axes.collections):
            axes.grid(visible=False)
        elif axes.axison:
            axes.grid(visible=True, color=look.grid, linewidth=0.7)
        axes.set_axisbelow(True)
    titles = [axes.title, getattr(axes, "_left_title", None), getattr(axes, "_right_title", None)]
    labels: list[Any] = [axes.xaxis.label, axes.yaxis.label, *titles]
    if isinstance(axes, Axes3D):
        labels.append(axes.zaxis.label)
        for axis in cast(Any, axes)._axis_map.values():  # there is no public way to colour this grid
            axis._axinfo["grid"].update(color=look.grid, linewidth=0.7)
    for text in labels:
        if isinstance(text, Text):
            text.set(color=look.ink, fontsize=look.font_size)
            text.set_parse_math(False)
    legend = axes.get_legend()
    if legend is not None:
        legend.set_frame_on(False)
        for text in legend.get_texts():
            text.set(color=look.ink, fontsize=small)
            text.set_parse_math(False)


# -- parts --------------------------------------------------------------------------------------------------------


def _curve(axes: Axes, curve: Curve, factors: tuple[float, float], look: Look) -> list[DrawnLine]:
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
        for low, high in x.reshape(-1, 2):
            axes.axvspan(low, high, color=colour, alpha=curve.opacity, linewidth=0.0, zorder=0)
        return []
    if curve.low is not None and curve.high is not None:
        low, high = factors[1] * curve.low, factors[1] * curve.high
        band = translated(curve.band) or None
        axes.fill_between(x, low, high, color=colour, alpha=_BAND * curve.opacity, linewidth=0.0, label=band)
    if curve.kind == "circles":
        axes.plot(x, y, linestyle="none", marker="o", markersize=4.5 * curve.width, markerfacecolor="none", **usual)
        return []
    if curve.kind == "points":
        many = x.size > _MANY
        usual["color"] = _RASTER.get(colour, colour) if many else colour
        size = (2.5 if many else 4.5) * curve.width
        axes.plot(
            x, y, linestyle="none", marker=".", markersize=size, markeredgewidth=0.0, rasterized=many, zorder=2, **usual
        )
        return []
    shown = thin(x, y, _COLUMNS)
    (line,) = axes.plot(*shown, linestyle=_STYLES[curve.kind], linewidth=1.3 * curve.width, zorder=2.5, **usual)
    return [DrawnLine(line, x, y)] if shown[0].size < x.size else []


def _bars(axes: Axes, bars: Bars, factors: tuple[float, float], look: Look) -> None:
    colour, name = look.colour(bars.colour), clean(translated(bars.name)) or None
    x = np.arange(len(bars.names), dtype=np.float64) if bars.names else factors[0] * bars.x
    height, width = factors[1] * bars.height, bars.width if bars.names else factors[0] * np.asarray(bars.width)
    error = None if bars.error is None else factors[1] * bars.error
    usual: dict[str, Any] = {"color": colour, "alpha": bars.opacity, "label": name, "ecolor": look.ink}
    names = [clean(translated(one)) for one in bars.names]
    if bars.across:
        axes.barh(x, height, width, xerr=error, **usual)
        if names:
            axes.set_yticks(x, names)
            axes.invert_yaxis()
    else:
        axes.bar(x, height, width, yerr=error, **usual)
        if names:
            axes.set_xticks(x, names)


def _image(axes: Axes, surface: Surface, factors: tuple[float, float], units: Units, look: Look) -> None:
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
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.95, pad=0.02)
    if bar.solids is not None:
        bar.solids.set_rasterized(True)
    bar.outline.set_visible(False)
    bar.set_label(label_of(Axis(surface.name, unit)), color=look.ink, fontsize=look.font_size)
    bar.ax.tick_params(colors=look.muted, labelcolor=look.ink, labelsize=look.font_size - 0.5)


def _relief(axes: Axes3D, surface: Surface, factors: tuple[float, float], factor: float) -> None:
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


def _say(axes: Axes, text: str, look: Look) -> None:
    axes.set_axis_off()
    words = textwrap.fill(clean(text[:1].upper() + text[1:]), _WRAP)
    axes.text(0.5, 0.5, words, color=look.muted, fontsize=look.font_size, transform=axes.transAxes, ha="center",
              va="center", parse_math=False)  # fmt: skip


def _hold_bands(axes: Axes, plot: Plot, factor: float) -> None:
    """Extend the range to the bands, unless they are much wider than the curves."""
    banded = [curve for curve in plot.curves if curve.low is not None and curve.high is not None]
    every = [np.ravel(curve.y) for curve in plot.curves if curve.kind not in ("position", "spans")]
    values = factor * np.concatenate(every) if every else np.zeros(0)
    values = values[np.isfinite(values) & ((values > 0.0) | (not plot.y.log))]
    if not banded or not values.size:
        return
    edges = factor * np.concatenate([part for curve in banded for part in (curve.low, curve.high) if part is not None])
    edges = edges[np.isfinite(edges)]
    low, high = float(values.min()), float(values.max())
    if plot.y.log:
        axes.set_ylim(max(float(edges.min(initial=low)), 0.5 * low), min(float(edges.max(initial=high)), 2.0 * high))
        return
    reach = float(np.median(np.abs(values)))
    low = max(float(edges.min(initial=low)), low - reach)
    high = min(float(edges.max(initial=high)), high + reach)
    if high > low:
        axes.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))


def _scale(axes: Axes, plot: Plot, factors: tuple[float, float], look: Look) -> None:
    if plot.x.log:
        known = [
            factors[0] * np.asarray(c.x)[np.asarray(c.x) > 0.0] for c in plot.curves if c.kind not in ("level", "spans")
        ]
        ends = plot.x.limits or (
            (min(float(v.min()) for v in known if v.size), max(float(v.max()) for v in known if v.size))
            if any(v.size for v in known)
            else (1.0, 10.0)
        )
        frequency_axis(axes, ends[0], ends[1] if ends[1] > ends[0] else 2.0 * ends[0])
    elif plot.x.limits is not None:
        axes.set_xlim(factors[0] * plot.x.limits[0], factors[0] * plot.x.limits[1])
    if plot.y.limits is not None:
        axes.set_ylim(factors[1] * plot.y.limits[0], factors[1] * plot.y.limits[1])
    else:
        _hold_bands(axes, plot, factors[1])
    if plot.y.log:
        log_axis(axes)
    elif plot.y.unit == "°" and float(np.ptp(axes.get_ylim())) < 450.0:
        axes.yaxis.set_major_locator(MultipleLocator(45.0))
    elif not isinstance(axes, Axes3D) and not any(isinstance(p, Bars) and p.names and p.across for p in plot.parts):
        axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    if plot.y.zero:
        axes.axhline(0.0, color=look.muted, linewidth=0.8, zorder=1.5)
    if plot.x.reverse:
        axes.invert_xaxis()
    if plot.y.reverse and not isinstance(axes, Axes3D):
        axes.invert_yaxis()


__all__ = [
    "PAGE",
    "DrawnLine",
    "Look",
    "Units",
    "clinical",
    "draw_kernel",
    "draw_plot",
    "draw_plots",
    "draw_relief",
    "dress",
    "label_of",
]
