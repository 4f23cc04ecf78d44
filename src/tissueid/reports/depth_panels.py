"""Mass, damping and stiffness against depth, of one engine or of several on the same axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.reports.diagnostics import CONFIDENCE, Array
from tissueid.reports.style import DASHES, FULL_WIDTH, MUTED, SERIES, SHADE, drawing, new_figure

_MARKERS = "osD^vP"
_DENSE = 25
"""A profile with more rows than this is drawn as a curve with a band, one with fewer as points with bars."""
_WIDEST = 1.5
"""Deviations that are larger than this share of the value do not set the limits of a panel."""
_APART = 0.01
"""Share of the depths by which the two directions are moved apart, so that neither hides the other."""
_Series = tuple[str, DepthProfile, NDArray[np.intp]]
"""What gets a colour and a marker of its own: its title, the profile, and which of its rows."""

_QUANTITIES = (
    ("mass", "Mass (g)", 1e3),
    ("damping", "Damping (N·s/m)", 1.0),
    ("stiffness", "Stiffness (N/m)", 1.0),
)
_WAYS = {1: "in", -1: "out"}


@drawing
def depth_panels(
    profiles: Mapping[str, DepthProfile], surface_position_m: float = float("nan"), visited: Array | None = None
) -> Figure:
    """Mass, damping and stiffness against depth with 95 % bars or bands; arguments as :func:`draw_depth_panels`.

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
        figure: what is drawn into.
        profiles: by the name that the legend gives them.
        surface_position_m: where the tissue begins, from which depth is counted; NaN for positions on the actuator.
        visited: output (n,), whose distribution is drawn below; the support of a single profile when None.

    Raises:
        UnusableInputError: no row holds a value.
    """
    known = {name: p for name, p in profiles.items() if np.isfinite(p.stiffness).any() or np.isfinite(p.mass).any()}
    if not known:
        raise UnusableInputError("the record holds mass, damping and stiffness at no depth")
    origin = surface_position_m if np.isfinite(surface_position_m) else 0.0
    every = figure.subplots(2, 3, sharex=True, height_ratios=(3.2, 1.0))
    series = _series(known)
    for axes, (name, label, scale) in zip(every[0], _QUANTITIES, strict=True):
        limits = []
        for place, (title, profile, rows) in enumerate(series):
            limits.append(_draw(axes, place, title, profile, rows, name, scale, origin))
        _limit(axes, np.concatenate(limits))
        axes.set_ylabel(label)
    for axes in every[1]:
        _visits(axes, series, origin, visited)
        axes.set_xlabel("Depth (mm)" if np.isfinite(surface_position_m) else "Position (mm)")
    every[1, 0].set_ylabel("Samples")
    figure.align_ylabels()
    if len(series) > 1:
        handles, labels = every[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=min(6, len(labels)))


def _series(profiles: Mapping[str, DepthProfile]) -> list[_Series]:
    """Every direction of every profile."""
    found = []
    for name, profile in profiles.items():
        for way in (0, 1, -1):
            rows = np.flatnonzero(profile.direction == way)
            if rows.size:
                found.append((f"{name}, {_WAYS[way]}" if way else name, profile, rows))
    return found


def _draw(
    axes: Axes,
    place: int,
    title: str,
    profile: DepthProfile,
    rows: NDArray[np.intp],
    name: str,
    scale: float,
    origin: float,
) -> Array:
    """Draw one series into one panel, and return the values that its limits have to hold."""
    colour = (*SERIES, MUTED)[place % (len(SERIES) + 1)]
    dash, marker = DASHES[place % len(DASHES)], _MARKERS[place % len(_MARKERS)]
    depth = 1e3 * (profile.position[rows] - origin)
    depth = depth + _APART * float(profile.direction[rows[0]]) * float(np.ptp(depth))
    value = scale * getattr(profile, name)[rows]
    half = CONFIDENCE * scale * getattr(profile, f"{name}_std")[rows]
    bars = np.where(np.isfinite(half), half, 0.0)
    if rows.size > _DENSE:
        axes.fill_between(depth, value - bars, value + bars, color=colour, alpha=0.2, linewidth=0.0)
        axes.plot(depth, value, color=colour, linestyle=dash, linewidth=1.6, label=title)
    else:
        low, high = 1e3 * (profile.low[rows] - origin), 1e3 * (profile.high[rows] - origin)
        axes.hlines(value, low, high, color=colour, linewidth=0.8, alpha=0.6)
        axes.errorbar(
            depth, value, bars, color=colour, linestyle="none", marker=marker, markersize=4.5, capsize=2.0, label=title
        )
        axes.plot(depth, value, color=colour, linestyle=dash, linewidth=0.8, alpha=0.6)
    ends = np.where(bars < _WIDEST * np.abs(value), bars, 0.0)
    return np.concatenate([value - ends, value + ends])


def _limit(axes: Axes, values: Array) -> None:
    """Limits that begin at zero, where the values allow it, and that one wild bar does not set."""
    finite = values[np.isfinite(values)]
    if finite.size:
        low, high = min(0.0, float(finite.min())), max(0.0, float(finite.max()))
        axes.set_ylim(1.1 * low, 1.1 * high or 1.0)


def _visits(axes: Axes, series: Sequence[_Series], origin: float, visited: Array | None) -> None:
    """How many samples speak for a depth."""
    if visited is not None:
        seen = 1e3 * (visited[np.isfinite(visited)] - origin)
        axes.hist(seen, bins=50, color=MUTED, alpha=0.5, histtype="stepfilled")
    else:
        for place, (_, profile, rows) in enumerate(series):
            low, high = 1e3 * (profile.low[rows] - origin), 1e3 * (profile.high[rows] - origin)
            colour = SERIES[place % len(SERIES)]
            width = (high - low) / len(series)
            axes.bar(low + place * width, profile.support[rows], width, align="edge", color=colour, alpha=0.5)
    axes.set_facecolor(SHADE)
    axes.locator_params(axis="y", nbins=3)
