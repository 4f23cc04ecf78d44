"""Plots of a study: means by subject and site, variation, first test, groups, regressions (Figs. 7.2 to 7.6)."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from tissueid.analysis.curves.plot import CONFIDENCE, FREQUENCY, LAG, Array, Axis, Bars, Curve, Kind, Plot, Surface
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
from tissueid.formatting import label_and_unit
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim
from tissueid.studies.curve_groups import ALL_SITES, GroupCurve
from tissueid.studies.multivariate import KernelComponents
from tissueid.studies.study_table import DEMOGRAPHICS, MATERIAL, NO_CONDITION
from tissueid.units import display_unit

COLOURS = ("measured", "model", "good", "poor", "check", "text")
"""Roles of the colours of sites or groups."""
MARKERS = ("o", "s", "^", "D", "v")
"""Shapes of the points of sites or groups; with the colours they are 30 pairs before one occurs again."""
_LINES: tuple[Kind, ...] = ("line", "dotted")
_MATERIAL_LINES: tuple[Kind, ...] = ("dashed", "dashdot")
"""Kinds of lines of sites and of materials: the second where the colours of the first are used up."""
_LARGEST_FORCE_N = 12.0
_SUBJECT_LETTERS = 46
"""Letters of the names of subjects that fit below a figure of half the width of a page."""
_TICK_LETTERS = 11
_SMALL = {"scaled_damping_s": ("ms", 1e3), "scaled_mass_s2": ("ms²", 1e6)}
"""Units of parameters whose values in SI are small, and their factors from SI."""
_POINTS_AT, _MEAN_AT = -0.12, 0.14
"""Places of the single points and of the mean with its bar, relative to the tick of their group."""


def parameter_axis(name: str) -> tuple[Axis, float]:
    """Return the axis of a parameter in its displayed unit, and the factor from SI."""
    label, unit = label_and_unit(name)
    if name in DEMOGRAPHICS:  # of a person, not of tissue
        return Axis(label, unit), 1.0
    shown, factor = _SMALL.get(name) or display_unit(unit)
    return Axis(label, shown), factor


def subjects_plot(table: pd.DataFrame, name: str) -> Plot:
    """Return mean and standard deviation over the tests of each subject, by site (Fig. 7.2)."""
    axis, factor = parameter_axis(name)
    subjects = sorted(table["subject"].unique())
    sites = sorted(table["site"].unique())
    parts = []
    for index, site in enumerate(sites):
        groups = table[table["site"] == site].groupby("subject")[name]
        mean, std = groups.mean() * factor, groups.std(ddof=1).fillna(0.0) * factor
        x = np.array([subjects.index(who) + 1.0 for who in mean.index]) + _offset(index, len(sites))
        y, half = mean.to_numpy(), std.to_numpy()
        parts.append(_bars(x, y, half, str(site), index))
    letters = sum(len(str(who)) + 1 for who in subjects)
    every = -(-letters // _SUBJECT_LETTERS)
    ticks = tuple((k + 1.0, Verbatim("" if k % every else str(who))) for k, who in enumerate(subjects))
    return Plot(marked("Mean and standard deviation of each subject"), Axis("Subject", ticks=ticks), axis, tuple(parts))


def sites_plot(means: pd.DataFrame, name: str) -> Plot:
    """Return mean and standard deviation over the subjects at each site, with the subjects as points (Fig. 7.3)."""
    axis, factor = parameter_axis(name)
    groups = {str(site): values[name].dropna().to_numpy() * factor for site, values in means.groupby("site", sort=True)}
    return _groups_plot(marked("Subjects by site"), marked("Site"), axis, groups)


def groups_plot(means: pd.DataFrame, factor: str, name: str) -> Plot:
    """Return mean and 95 % interval of each group at each site (Fig. 7.5)."""
    axis, scale = parameter_axis(name)
    sites = sorted(means["site"].unique())
    levels = sorted(means[factor].dropna().astype(str).unique())
    parts = []
    for index, level in enumerate(levels):
        x, y, half = [], [], []
        for number, site in enumerate(sites):
            chosen = (means["site"] == site) & (means[factor].astype(str) == level)
            values = means.loc[chosen, name].dropna().to_numpy() * scale
            if len(values):
                x.append(number + 1.0 + _offset(index, len(levels)))
                y.append(values.mean())
                half.append(CONFIDENCE * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0)
        centre, reach = np.array(y), np.array(half)
        parts.append(_bars(np.array(x), centre, reach, level, index))
    ticks = tuple((k + 1.0, _in_lines(str(site))) for k, site in enumerate(sites))
    return Plot(marked("Groups by site"), Axis("Site", ticks=ticks), axis, tuple(parts))


def regression_plot(means: pd.DataFrame, regressor: str, name: str, rows: pd.DataFrame) -> Plot:
    """Return the subjects at each site against one of their values, with the fitted lines (Fig. 7.6)."""
    axis, scale = parameter_axis(name)
    abscissa, factor = parameter_axis(regressor)
    parts = []
    for index, site in enumerate(sorted(means["site"].unique())):
        own = means[means["site"] == site].dropna(subset=[name, regressor])
        x = own[regressor].to_numpy(float)
        if not x.size:
            continue
        points = x * factor, own[name].to_numpy() * scale
        marker = MARKERS[index % len(MARKERS)]
        parts.append(Curve(*points, Verbatim(str(site)), _colour(index), "points", marker=marker))
        line = rows[(rows["site"] == str(site)) & (rows["parameter"] == name) & (rows["factor"] == regressor)]
        if len(line):
            ends = np.array([x.min(), x.max()])
            fitted = line["intercept"].iloc[0] + line["slope"].iloc[0] * ends
            kind = _LINES[index // len(COLOURS) % len(_LINES)]
            parts.append(Curve(ends * factor, fitted * scale, "", _colour(index), kind))
    return Plot(marked("Regression on a value of the subjects"), abscissa, axis, tuple(parts))


def first_test_plot(table: pd.DataFrame, name: str) -> Plot:
    """Return the mean of the later tests less the first test, of each subject and on average by site (Fig. 7.4)."""
    axis, factor = parameter_axis(name)
    groups: dict[str, np.ndarray] = {}
    for site, tests in table.sort_values("repeat").groupby("site", sort=True):
        changes = [
            (values.iloc[1:].mean() - values.iloc[0]) * factor
            for _subject, values in tests.groupby("subject")[name]
            if len(values) > 1
        ]
        groups[str(site)] = np.array(changes)
    shown = Axis(axis.label, axis.unit, zero=True)
    return _groups_plot(marked("Later tests less the first"), marked("Site"), shown, groups)


def variation_plot(rows: pd.DataFrame) -> Plot:
    """Return the individual and the population coefficient of variation of each parameter, averaged over the sites."""
    means = rows.groupby("parameter", sort=False)[["individual_cv", "population_cv"]].mean() * 100.0
    places = np.arange(1.0, len(means) + 1.0)
    ticks = tuple(
        (position, _in_lines(_(label_and_unit(str(name))[0])))
        for position, name in zip(places.tolist(), means.index, strict=True)
    )
    parts = (
        Bars(places - 0.2, means["individual_cv"].to_numpy(), 0.36, marked("within a subject"), "measured"),
        Bars(places + 0.2, means["population_cv"].to_numpy(), 0.36, marked("between subjects"), "model"),
    )
    axis = Axis(marked("Coefficient of variation"), "%")
    return Plot(marked("Coefficients of variation, mean of the sites"), Axis("", ticks=ticks), axis, parts)


def materials_plot(samples: pd.DataFrame, means: pd.DataFrame, name: str) -> Plot:
    """Return mean and spread of the tests of each material, and of the subjects at each site (Fig. 7.10)."""
    axis, factor = parameter_axis(name)
    groups = {
        str(key): values[name].dropna().to_numpy() * factor for key, values in samples.groupby(MATERIAL, sort=True)
    }
    if name in means:
        for site, values in means.groupby("site", sort=True):
            groups[str(site)] = values[name].dropna().to_numpy() * factor
    return _groups_plot(marked("Materials and sites"), marked("Material or site"), axis, groups)


def conditions_plot(means: pd.DataFrame, before: str, name: str) -> Plot:
    """Return the relative change under each condition of each subject and on average, by site (Figs. 7.21, 7.22)."""
    groups: dict[tuple[str, str], np.ndarray] = {}
    wide = means.pivot_table(index=["site", "subject"], columns="condition", values=name)
    if before in wide:
        for condition in wide.columns.drop(before):
            pairs = wide[[before, condition]].dropna()
            for site, own in pairs.groupby(level="site"):
                change = 100.0 * (own[condition] / own[before] - 1.0)
                groups[str(condition) or _(NO_CONDITION), str(site)] = change.to_numpy()
    conditions, sites = ({key[part] for key in groups} for part in (0, 1))
    label = _("Condition")
    if len(conditions) == 1:  # what all groups share stands in the label
        label, named = f"{label}: {conditions.pop()}", {site: values for (_condition, site), values in groups.items()}
    elif len(sites) == 1:
        label, named = f"{label}, {sites.pop()}", {condition: values for (condition, _site), values in groups.items()}
    else:
        named = {"; ".join(key): values for key, values in groups.items()}
    shown = Axis(label_and_unit(name)[0], "%", zero=True)
    return _groups_plot(marked("Change from the reference"), Verbatim(label), shown, named)


def nonlinearity_plot(means: pd.DataFrame, samples: pd.DataFrame) -> Plot:
    """Return the static nonlinearity C1 (1 - exp(-C2 F)) of the mean parameters of each site and material (Fig. 7.13).

    Args:
        means: one row per subject and site, with ``c1_m`` and ``c2_per_n``.
        samples: one row per test of a material.
    """
    force = np.linspace(0.0, _LARGEST_FORCE_N, 61)
    parts = []
    materials = list(samples.groupby(MATERIAL, sort=True)) if len(samples) else []
    for groups, kinds in ((list(means.groupby("site", sort=True)), _LINES), (materials, _MATERIAL_LINES)):
        for index, (key, rows) in enumerate(groups):
            c1, c2 = float(rows["c1_m"].mean()), float(rows["c2_per_n"].mean())
            kind = kinds[index // len(COLOURS) % len(kinds)]
            depth = 1e3 * c1 * (1.0 - np.exp(-c2 * force))
            parts.append(Curve(force, depth, Verbatim(str(key)), _colour(index), kind))
    return Plot(
        marked("Static nonlinearity of the mean parameters"),
        Axis(marked("Static force"), "N"),
        Axis(marked("Depth"), "mm"),
        tuple(parts),
    )


def _groups_plot(title: str, label: str, axis: Axis, groups: dict[str, np.ndarray]) -> Plot:
    parts = []
    for index, values in enumerate(groups.values()):
        if not len(values):
            continue
        reach = min(0.18, 0.03 * len(values))
        spread = np.linspace(-reach, reach, len(values)) if len(values) > 1 else np.zeros(1)
        x = index + 1.0 + _POINTS_AT + spread
        parts.append(Curve(x, values, "", "muted", "circles", width=0.8))
        half = values.std(ddof=1) if len(values) > 1 else 0.0
        mean = np.array([values.mean()])
        x = np.array([index + 1.0 + _MEAN_AT])
        parts.append(Curve(x, mean, "", "model", "bars", mean - half, mean + half, width=1.2))
    ticks = tuple((k + 1.0, _in_lines(site)) for k, site in enumerate(groups))
    limits = (0.4, len(groups) + 0.6) if groups else None
    return Plot(title, Axis(label, ticks=ticks, limits=limits), axis, tuple(parts))


def _bars(x: np.ndarray, y: np.ndarray, half: np.ndarray, name: str, index: int) -> Curve:
    marker = MARKERS[index % len(MARKERS)]
    return Curve(x, y, Verbatim(name), _colour(index), "bars", y - half, y + half, marker=marker)


def _in_lines(name: str) -> Verbatim:
    """Return a name in lines of about ``_TICK_LETTERS`` letters, for ticks that stand side by side."""
    return Verbatim("\n".join(textwrap.wrap(name, _TICK_LETTERS, break_long_words=False)))


def _offset(index: int, count: int) -> float:
    return 0.5 * (index / max(count - 1, 1) - 0.5) if count > 1 else 0.0


def _colour(index: int) -> str:
    return COLOURS[index % len(COLOURS)]


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
    for curve in curves:
        style: tuple[str, Kind] = ("text", "line")
        if curve.group != ALL_SITES:
            index = named.index(curve.group)
            style = COLOURS[index % (len(COLOURS) - 1)], _KINDS[index % len(_KINDS)]
        at = into * GRIDS[curve.curve].x
        if curve.members is not None:
            rows = np.column_stack([curve.members, np.full(len(curve.members), np.nan)])  # NaN parts the lines
            every = np.tile(np.append(at, np.nan), len(rows))
            parts.append(Curve(every, factor * rows.ravel(), "", style[0], width=0.5, opacity=_PALE))
        finite = np.flatnonzero(np.isfinite(curve.mean))
        some = slice(int(finite[0]), int(finite[-1]) + 1) if finite.size else slice(0, 0)
        mean = factor * curve.mean[some]
        low, high = (np.where(np.isfinite(edge[some]), factor * edge[some], mean) for edge in (curve.low, curve.high))
        if y.log:
            low = np.maximum(low, 0.2 * mean)  # an interval of a few subjects can reach below zero
        dots = "o" if finite.size == 1 else ""
        parts.append(Curve(at[some], mean, name_of(curve), *style, low=low, high=high, marker=dots))
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
        inside = slice(0, int(np.flatnonzero(np.isfinite(np.diag(whole)))[-1]) + 1)
        surface = Surface(lag_ms[inside], lag_ms[inside], factor * whole[inside, inside], "", axis.unit, limit=limit)
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
    return factor * max(float(np.nanmax(np.abs(curve.mean))) for curve in curves)


def component_panels(components: KernelComponents) -> list[Plot]:
    """Return the mean kernel and the principal components, which share the scale of the colours (second order)."""
    titles = [_MEAN, *_component_titles(components)]
    factor = _AXES[components.curve][3]
    limits = [factor * float(np.nanmax(np.abs(rows))) for rows in (components.mean, components.shapes)]
    return [
        surface_plot(components.curve, values, title, limits[min(index, 1)])
        for index, (title, values) in enumerate(zip(titles, (components.mean, *components.shapes), strict=True))
    ]


def component_curves(components: KernelComponents) -> Plot:
    """Return the mean first-order kernel and its change by one standard deviation of each component."""
    x, into, y, factor = _AXES[components.curve]
    at = into * GRIDS[components.curve].x
    finite = np.isfinite(components.mean)
    parts = [Curve(at[finite], factor * components.mean[finite], _MEAN, "text", width=1.3)]
    kinds: tuple[Kind, ...] = ("line", "dashed", "dashdot")
    for index, (title, values) in enumerate(zip(_component_titles(components), components.shapes, strict=True)):
        parts.append(Curve(at[finite], factor * values[finite], title, COLOURS[index], kinds[index % len(kinds)]))
    return Plot(marked("Principal components of the first-order kernel"), x, y, tuple(parts))


def scores_plot(components: KernelComponents) -> Plot:
    """Return the scores of the first two components of each test, by group."""
    second = components.names[min(1, len(components.names) - 1)]
    axes = [
        Axis(Message("plot.score", "Score of component {place}", place=index), "SD", zero=True)
        for index in (1, min(2, len(components.names)))
    ]
    parts = []
    for index, (group, tests) in enumerate(components.scores.groupby("group", sort=True)):
        style = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        x, y = tests["score_1"].to_numpy(), tests[second].to_numpy()
        parts.append(Curve(x, y, Verbatim(str(group)), style[0], "points", marker=style[1]))
    title = marked("Scores of the first two components")
    return Plot(title, axes[0], axes[1], tuple(parts))


def _component_titles(components: KernelComponents) -> list[str]:
    return [
        Message("plot.component", "component {place}, {percent:.0f} %", place=index + 1, percent=100.0 * float(share))
        for index, share in enumerate(components.shares)
    ]
