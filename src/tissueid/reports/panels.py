"""Shared parts of figures: images, surfaces, depth colours, point clouds."""

from __future__ import annotations

from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import ArrayLike

from tissueid.reports.diagnostics import Array
from tissueid.reports.style import DASHES, DEPTHS, DIVERGING, INK, MUTED, POINTS, RELIEF, SEQUENTIAL

_MOST_POINTS = 3000
_SURFACE_STEPS = 60


def _edges(centres: Array) -> tuple[float, float]:
    """Where an image with pixels at these evenly spaced centres (k,) begins and ends."""
    half = 0.5 * float(centres[1] - centres[0]) if centres.size > 1 else 0.5
    return float(centres[0]) - half, float(centres[-1]) + half


def image(
    axes: Axes, x: Array, y: Array, values: Array, label: str, *, signed: bool = True, limit: float | None = None
) -> None:
    """An image of values (y, x) at evenly spaced centres, with a colour bar.

    Signed values are blue below zero and orange above it; the page shows through at zero. ``limit`` is the value of
    the fullest colour, the largest by default.
    """
    finite = np.abs(values[np.isfinite(values)])
    top = limit or (float(finite.max()) if finite.size else 0.0) or 1.0
    axes.grid(visible=False)
    drawn = axes.imshow(
        values,
        origin="lower",
        extent=(*_edges(x), *_edges(y)),
        aspect="auto",
        cmap=DIVERGING if signed else SEQUENTIAL,
        vmin=-top if signed else 0.0,
        vmax=top,
        interpolation="nearest",
    )
    _value_bar(axes, drawn, label)


def uneven_image(axes: Axes, x: Array, edges: Array, values: Array, label: str) -> None:
    """An image of values (rows, x) whose rows lie between edges (rows + 1,) that need not be evenly spaced."""
    finite = np.abs(values[np.isfinite(values)])
    top = (float(finite.max()) if finite.size else 0.0) or 1.0
    axes.grid(visible=False)
    half = 0.5 * float(x[1] - x[0]) if x.size > 1 else 0.5
    across = np.append(x - half, x[-1] + half)
    drawn = axes.pcolormesh(across, edges, values, cmap=DIVERGING, vmin=-top, vmax=top, rasterized=True, linewidth=0.0)
    _value_bar(axes, drawn, label)


def _value_bar(axes: Axes, drawn: ScalarMappable, label: str) -> None:
    """A colour bar for the values of an image."""
    bar = axes.figure.colorbar(drawn, ax=axes, shrink=0.95, pad=0.02)
    if bar.solids is not None:
        bar.solids.set_rasterized(True)
    bar.outline.set_visible(False)
    bar.set_label(label)


def surface(figure: Figure, place: tuple[int, int, int], x: Array, y: Array, values: Array) -> Axes3D:
    """Draw a surface of values (y, x) over x and y, seen from above.

    The caller labels the axes; the values have the colour scale of the corresponding image.
    """
    axes = cast(Axes3D, figure.add_subplot(*place, projection="3d"))
    rows = max(1, -(-y.size // _SURFACE_STEPS))
    columns = max(1, -(-x.size // _SURFACE_STEPS))
    some = values[::rows, ::columns]
    top = float(np.nanmax(np.abs(some))) or 1.0
    across, along = np.meshgrid(x[::columns], y[::rows])
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
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.line.set_color(MUTED)
    axes.tick_params(labelsize=8.5, pad=-1.0)
    axes.set_zticklabels([])
    axes.set_facecolor("none")
    return axes


def depth_colours(count: int) -> list[str]:
    """Return ``count`` colours from shallow to deep."""
    if count == 1:
        return [DEPTHS[-1]]
    return [DEPTHS[round(k * (len(DEPTHS) - 1) / (count - 1))] for k in range(count)]


def depth_bar(axes: Axes, low: float, high: float, label: str) -> None:
    """Add a colour bar of depth."""
    bounds = np.linspace(low, high, len(DEPTHS) + 1)
    norm = BoundaryNorm(bounds, len(DEPTHS))
    bar = axes.figure.colorbar(
        ScalarMappable(norm, cast(Colormap, ListedColormap(list(DEPTHS)))), ax=axes, pad=0.02, shrink=0.9
    )
    bar.set_ticks([float(v) for v in np.linspace(low, high, 4)])
    bar.ax.set_yticklabels([f"{v:.2f}" if high - low < 10.0 else f"{v:.0f}" for v in np.linspace(low, high, 4)])
    bar.outline.set_visible(False)
    bar.set_label(label)


def cloud(axes: Axes, x: Array, y: Array, colour: str = POINTS[0]) -> None:
    """Draw a cloud of points (n,), thinned and rasterised, without NaN."""
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    some = known[:: max(1, -(-known.size // _MOST_POINTS))]
    axes.plot(
        x[some],
        y[some],
        color=colour,
        linestyle="none",
        marker=".",
        markersize=2.5,
        markeredgewidth=0.0,
        alpha=0.5,
        rasterized=True,
    )


def markers(axes: Axes, x: ArrayLike, y: ArrayLike, *, label: str, colour: str, marker: str) -> None:
    """Draw a small number of separate points, such as the lines of a multisine."""
    axes.plot(x, y, color=colour, linestyle="none", marker=marker, markersize=3.5, markeredgewidth=0.0, label=label)


def residual_cloud(axes: Axes, modelled: Array, measured: Array, colour: str) -> None:
    """Draw a cloud of measured against modelled output, (n,) each, and its mean curve."""
    cloud(axes, modelled, measured, colour)
    if np.isfinite(modelled + measured).sum() > 100:
        axes.plot(*running_mean(modelled, measured), color=INK, linewidth=1.6)


def running_mean(x: Array, y: Array, bins: int = 24) -> tuple[Array, Array]:
    """Return mean x and mean y in bins of x with equal counts, (k,) each: the curve through a cloud."""
    known = np.isfinite(x) & np.isfinite(y)
    order = np.argsort(x[known])
    parts = [part for part in np.array_split(order, bins) if part.size]
    across, along = x[known], y[known]
    return np.array([across[p].mean() for p in parts]), np.array([along[p].mean() for p in parts])


def diagonal(axes: Axes, low: float, high: float, label: str | None = None) -> None:
    """Draw the diagonal of agreement, with equal axis limits."""
    margin = 0.06 * (high - low) or 1e-6
    axes.plot([low, high], [low, high], color=MUTED, linewidth=1.0, linestyle=DASHES[1], label=label)
    axes.set_xlim(low - margin, high + margin)
    axes.set_ylim(low - margin, high + margin)
    axes.set_box_aspect(1.0)
