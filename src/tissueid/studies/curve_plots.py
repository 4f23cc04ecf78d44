"""Plots of the mean curves of groups, of kernels, and of their principal components (Figs. 7.11 to 7.21)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.plot import FREQUENCY, LAG, Array, Axis, Curve, Kind, Plot, Surface
from tissueid.analysis.curves.samples import (
    DAMPING,
    GRIDS,
    KERNEL1,
    KERNEL2,
    LAGS,
    MAGNITUDE,
    MASS,
    NONLINEARITY,
    PARTITIONS,
    PHASE,
    STIFFNESS,
)
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim
from tissueid.studies.curve_groups import ALL_SITES, GroupCurve
from tissueid.studies.kernel_components import KernelComponents
from tissueid.studies.study_plots import COLOURS, MARKERS
from tissueid.studies.study_table import NO_CONDITION

_DEPTH = Axis(marked("Depth"), "mm")
_FORCE = Axis(marked("Force after the linear stage"), "N")
_AXES = {
    MAGNITUDE: (FREQUENCY, 1.0, Axis(marked("Magnitude"), "mm/N", log=True), 1e3),
    PHASE: (FREQUENCY, 1.0, Axis(marked("Phase"), "°"), 1.0),
    MASS: (_DEPTH, 1e3, Axis(marked("Mass"), "g"), 1e3),
    DAMPING: (_DEPTH, 1e3, Axis(marked("Damping"), "N·s/m"), 1.0),
    STIFFNESS: (_DEPTH, 1e3, Axis(marked("Stiffness"), "N/m"), 1.0),
    NONLINEARITY: (_FORCE, 1.0, Axis(marked("Depth"), "mm"), 1e3),
    KERNEL1: (LAG, 1e3, Axis(marked("First-order kernel"), "mm/(N·s)", zero=True), 1e3),
    KERNEL2: (LAG, 1e3, Axis(marked("Second-order kernel"), "mm/(N²·s²)"), 1e3),
    PARTITIONS: (LAG, 1e3, Axis(marked("Kernel"), "mm/(N·s)"), 1e3),
}
"""Axis and factor from SI of the abscissa and of the values of each curve."""
_PALE = 0.55
"""Opacity of the curves of single subjects."""
_WAYS = {1: marked("inwards"), -1: marked("outwards")}
_KINDS: tuple[Kind, ...] = ("line", "dashed", "dashdot", "dotted")
"""Kinds of lines of the groups, in turn: lines that lie over each other stay visible."""
_MEAN = marked("mean kernel")


def curve_plot(curves: Sequence[GroupCurve], groups: Sequence[str]) -> Plot:
    """Return the mean curves of groups with their 95 % intervals as bands, one line a group.

    Args:
        curves: of one name and direction; changes are in percent.
        groups: all groups of the figures that have the same key; they determine the colours.
    """
    x, into, y, factor = _AXES[curves[0].curve]
    if curves[0].by == "change":
        y, factor = Axis(Message("plot.change", "Change: {name}", name=y.label), "%", zero=True), 1.0
    parts = []
    named = [group for group in groups if group != ALL_SITES]
    for one in curves:
        style: tuple[str, Kind] = ("text", "line")
        if one.group != ALL_SITES:
            place = named.index(one.group)
            style = COLOURS[place % (len(COLOURS) - 1)], _KINDS[place % len(_KINDS)]
        at = into * GRIDS[one.curve].x
        if one.members is not None:
            rows = np.column_stack([one.members, np.full(len(one.members), np.nan)])  # NaN parts the lines
            every = np.tile(np.append(at, np.nan), len(rows))
            parts.append(Curve(every, factor * rows.ravel(), "", style[0], width=0.5, opacity=_PALE))
        known = np.flatnonzero(np.isfinite(one.mean))
        some = slice(int(known[0]), int(known[-1]) + 1) if known.size else slice(0, 0)
        mean = factor * one.mean[some]
        low, high = (np.where(np.isfinite(edge[some]), factor * edge[some], mean) for edge in (one.low, one.high))
        if y.log:
            low = np.maximum(low, 0.2 * mean)  # an interval of a few subjects can reach below zero
        dots = "o" if known.size == 1 else ""
        parts.append(Curve(at[some], mean, name_of(one), *style, low=low, high=high, marker=dots))
    return Plot(title_of(curves[0], groups), x, y, tuple(parts))


def title_of(curve: GroupCurve, groups: Sequence[str]) -> str:
    """Return the quantity of a curve with its direction, and the group where there is only one: it needs no key."""
    title = _AXES[curve.curve][2].label
    if way := _WAYS.get(curve.direction):
        title = Message("plot.direction", "{name}, {direction}", name=title, direction=way)
    return title if len(groups) > 1 else Message("plot.of_group", "{name}: {group}", name=title, group=name_of(curve))


def name_of(curve: GroupCurve) -> str:
    """Return the name of a group for the key."""
    if curve.group == ALL_SITES:
        return marked("subjects, all sites")
    *where, last = curve.group.split("; ")
    return Verbatim(
        "; ".join([*where, _(NO_CONDITION)]) if curve.by == "condition" and last == NO_CONDITION else curve.group
    )


def kernel_panel(curve: GroupCurve, limit: float) -> Plot:
    """Return the mean kernel of a group over two lags, or over lag and depth, with the VAF in the title.

    Args:
        curve: the kernel.
        limit: value of the fullest colour, in the unit that is shown.
    """
    title = Message("overlay.with_vaf", "{name}, VAF {percent:.1f} %", name=name_of(curve), percent=curve.vaf_percent)
    return surface_plot(curve.curve, curve.mean, title if np.isfinite(curve.vaf_percent) else name_of(curve), limit)


def surface_plot(name: str, values: Array, title: str, limit: float | None = None) -> Plot:
    """Return values (n,) on the grid of a kernel of second order, or by depth, as a plot with a surface."""
    grid, (x, into, axis, factor) = GRIDS[name], _AXES[name]
    lag_ms = into * np.unique(grid.x)[:LAGS]
    if name == KERNEL2:
        first, second = np.triu_indices(LAGS)
        whole = np.full((LAGS, LAGS), np.nan)
        whole[first, second] = whole[second, first] = values
        known = slice(0, int(np.flatnonzero(np.isfinite(np.diag(whole)))[-1]) + 1)
        surface = Surface(lag_ms[known], lag_ms[known], factor * whole[known, known], "", axis.unit, limit=limit)
        ends = Axis(marked("First lag"), "ms"), Axis(marked("Second lag"), "ms")
        return Plot(title, *ends, (surface,), square=True)
    rows = values.reshape(-1, LAGS)
    depth_mm = 1e3 * np.asarray(grid.y).reshape(-1, LAGS)[:, 0]
    known_rows = np.flatnonzero(np.isfinite(rows[:, 0]))
    some = slice(int(known_rows[0]), int(known_rows[-1]) + 1)
    surface = Surface(lag_ms, depth_mm[some], factor * rows[some], "", axis.unit, limit=limit)
    return Plot(title, x, replace(_DEPTH, reverse=True), (surface,))


def shared_limit(curves: Sequence[GroupCurve]) -> float:
    """Return the largest magnitude of kernels in the unit that is shown: the scale of their colours."""
    factor = _AXES[curves[0].curve][3]
    return factor * max(float(np.nanmax(np.abs(one.mean))) for one in curves)


def component_panels(found: KernelComponents) -> list[Plot]:
    """Return the mean kernel and the principal components, which share the scale of the colours (second order)."""
    titles = [_MEAN, *_component_titles(found)]
    factor = _AXES[found.curve][3]
    limits = [factor * float(np.nanmax(np.abs(rows))) for rows in (found.mean, found.shapes)]
    return [
        surface_plot(found.curve, values, title, limits[min(place, 1)])
        for place, (title, values) in enumerate(zip(titles, (found.mean, *found.shapes), strict=True))
    ]


def component_curves(found: KernelComponents) -> Plot:
    """Return the mean first-order kernel and its change by one standard deviation of each component."""
    x, into, y, factor = _AXES[found.curve]
    at = into * GRIDS[found.curve].x
    known = np.isfinite(found.mean)
    parts = [Curve(at[known], factor * found.mean[known], _MEAN, "text", width=1.3)]
    kinds: tuple[Kind, ...] = ("line", "dashed", "dashdot")
    for place, (title, values) in enumerate(zip(_component_titles(found), found.shapes, strict=True)):
        parts.append(Curve(at[known], factor * values[known], title, COLOURS[place], kinds[place % len(kinds)]))
    return Plot(marked("Principal components of the first-order kernel"), x, y, tuple(parts))


def scores_plot(found: KernelComponents) -> Plot:
    """Return the scores of the first two components of each test, by group."""
    second = found.names[min(1, len(found.names) - 1)]
    axes = [
        Axis(Message("plot.score", "Score of component {place}", place=place), "SD", zero=True)
        for place in (1, min(2, len(found.names)))
    ]
    parts = []
    for place, (group, tests) in enumerate(found.scores.groupby("group", sort=True)):
        style = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
        x, y = tests["score_1"].to_numpy(), tests[second].to_numpy()
        parts.append(Curve(x, y, Verbatim(str(group)), style[0], "points", marker=style[1]))
    title = marked("Scores of the first two components")
    return Plot(title, axes[0], axes[1], tuple(parts))


def _component_titles(found: KernelComponents) -> list[str]:
    return [
        Message("plot.component", "component {place}, {percent:.0f} %", place=place + 1, percent=100.0 * float(share))
        for place, share in enumerate(found.shares)
    ]


__all__ = [
    "component_curves",
    "component_panels",
    "curve_plot",
    "kernel_panel",
    "name_of",
    "scores_plot",
    "shared_limit",
    "surface_plot",
    "title_of",
]
