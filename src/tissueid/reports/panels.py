"""Shared parts of figures: depth colours, point clouds."""

from __future__ import annotations

from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap
from numpy.typing import ArrayLike

from tissueid.analysis.curves.diagnostics import Array
from tissueid.reports.style import DASHES, DEPTHS, INK, MUTED, POINTS

_MOST_POINTS = 3000


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
