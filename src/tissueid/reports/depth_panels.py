"""Panels of mass, damping and stiffness against depth, of one engine or of several on the same axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.plot import CONFIDENCE
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports.style import DASHES, FULL_WIDTH, MUTED, SERIES, SHADE, drawing, new_figure

_MARKERS = "osD^vP"
_DENSE = 25
"""Number of rows above which a profile is drawn as a curve with a band, not as points with bars."""
_WIDEST = 1.5
"""Largest ratio of half bar to value for which a bar counts for the limits of a panel."""
_DIRECTION_OFFSET = 0.01
"""Shift of each direction, as a share of the range of depths, so that neither hides the other."""
_Series = tuple[str, DepthProfile, NDArray[np.intp]]
"""A title, a profile, and the indices of its rows: one colour and marker in a panel."""

_QUANTITIES = (
    ("mass", marked("Mass (g)"), 1e3),
    ("damping", marked("Damping (N·s/m)"), 1.0),
    ("stiffness", marked("Stiffness (N/m)"), 1.0),
)
_WAYS = {1: marked("inwards"), -1: marked("outwards")}


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
    known = {name: p for name, p in profiles.items() if np.isfinite(p.stiffness).any() or np.isfinite(p.mass).any()}
    if not known:
        raise UnusableInputError(
            Message("report.no_profile", "mass, damping and stiffness could not be estimated at any depth")
        )
    origin = surface_position_m if np.isfinite(surface_position_m) else 0.0
    every = figure.subplots(2, 3, sharex=True, height_ratios=(3.2, 1.0))
    series = _series(known)
    for axes, (name, label, scale) in zip(every[0], _QUANTITIES, strict=True):
        limits = []
        for place, (title, profile, rows) in enumerate(series):
            limits.append(_draw(axes, place, title, profile, rows, name, scale, origin))
        _limit(axes, np.concatenate(limits))
        axes.set_ylabel(_(label))
    for axes in every[1]:
        _draw_sample_counts(axes, series, origin, visited)
        axes.set_xlabel(_("Depth (mm)") if np.isfinite(surface_position_m) else _("Position (mm)"))
    every[1, 0].set_ylabel(_("Samples"))
    figure.align_ylabels()
    if len(series) > 1:
        handles, labels = every[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=min(6, len(labels)))


def _series(profiles: Mapping[str, DepthProfile]) -> list[_Series]:
    """Return every direction of every profile as a series."""
    found = []
    for name, profile in profiles.items():
        for way in (0, 1, -1):
            rows = np.flatnonzero(profile.direction == way)
            if rows.size:
                found.append((f"{name}, {_(_WAYS[way])}" if way else name, profile, rows))
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
    """Draw one series into one panel, and return the values that its limits must contain."""
    colour = (*SERIES, MUTED)[place % (len(SERIES) + 1)]
    dash, marker = DASHES[place % len(DASHES)], _MARKERS[place % len(_MARKERS)]
    depth = 1e3 * (profile.position[rows] - origin)
    depth = depth + _DIRECTION_OFFSET * float(profile.direction[rows[0]]) * float(np.ptp(depth))
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
    """Set limits that begin at zero where the values allow it."""
    finite = values[np.isfinite(values)]
    if finite.size:
        low, high = min(0.0, float(finite.min())), max(0.0, float(finite.max()))
        axes.set_ylim(1.1 * low, 1.1 * high or 1.0)


def _draw_sample_counts(axes: Axes, series: Sequence[_Series], origin: float, visited: Array | None) -> None:
    """Draw the number of samples at each depth."""
    if visited is not None:
        seen = 1e3 * (visited[np.isfinite(visited)] - origin)
        axes.hist(seen, bins=50, color=MUTED, alpha=0.5, histtype="stepfilled")
    else:
        for place, (_title, profile, rows) in enumerate(series):
            low, high = 1e3 * (profile.low[rows] - origin), 1e3 * (profile.high[rows] - origin)
            colour = SERIES[place % len(SERIES)]
            width = (high - low) / len(series)
            axes.bar(low + place * width, profile.support[rows], width, align="edge", color=colour, alpha=0.5)
    axes.set_facecolor(SHADE)
    axes.locator_params(axis="y", nbins=3)
