"""Parts of plots on matplotlib axes: curves, bars, images, surfaces in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.layout_engine import PlaceHolderLayoutEngine
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d import Axes3D

from tissueid.analysis.curves.plot import Array, Axis, Bars, Curve, Mark, Surface, thin
from tissueid.formatting import clean
from tissueid.messages import translated
from tissueid.reports.plot_axes import Look, Units, finish_bar, label_of
from tissueid.reports.style import DASHES, DIVERGING, MUTED, POINTS, RELIEF, SEQUENTIAL, SERIES

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
    names = [clean(translated(one)) for one in bars.names]
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


__all__ = ["DrawnLine", "draw_bars", "draw_curve", "draw_image", "draw_mark", "draw_surface"]
