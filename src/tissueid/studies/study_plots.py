"""Plots of a study: means by subject and site, variation, first test, groups, regressions (Figs. 7.2 to 7.6)."""

from __future__ import annotations

import textwrap

import numpy as np
import pandas as pd

from tissueid.analysis.curves.plot import CONFIDENCE, Axis, Bars, Curve, Kind, Plot
from tissueid.formatting import label_and_unit
from tissueid.language import _, marked
from tissueid.messages import Verbatim
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
    for place, site in enumerate(sites):
        groups = table[table["site"] == site].groupby("subject")[name]
        mean, std = groups.mean() * factor, groups.std(ddof=1).fillna(0.0) * factor
        x = np.array([subjects.index(who) + 1.0 for who in mean.index]) + _offset(place, len(sites))
        y, half = mean.to_numpy(), std.to_numpy()
        parts.append(_bars(x, y, half, str(site), place))
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
    for place, level in enumerate(levels):
        x, y, half = [], [], []
        for number, site in enumerate(sites):
            chosen = (means["site"] == site) & (means[factor].astype(str) == level)
            values = means.loc[chosen, name].dropna().to_numpy() * scale
            if len(values):
                x.append(number + 1.0 + _offset(place, len(levels)))
                y.append(values.mean())
                half.append(CONFIDENCE * values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0)
        centre, reach = np.array(y), np.array(half)
        parts.append(_bars(np.array(x), centre, reach, level, place))
    ticks = tuple((k + 1.0, _in_lines(str(site))) for k, site in enumerate(sites))
    return Plot(marked("Groups by site"), Axis("Site", ticks=ticks), axis, tuple(parts))


def regression_plot(means: pd.DataFrame, regressor: str, name: str, rows: pd.DataFrame) -> Plot:
    """Return the subjects at each site against one of their values, with the fitted lines (Fig. 7.6)."""
    axis, scale = parameter_axis(name)
    abscissa, factor = parameter_axis(regressor)
    parts = []
    for place, site in enumerate(sorted(means["site"].unique())):
        own = means[means["site"] == site].dropna(subset=[name, regressor])
        x = own[regressor].to_numpy(float)
        if not x.size:
            continue
        points = x * factor, own[name].to_numpy() * scale
        marker = MARKERS[place % len(MARKERS)]
        parts.append(Curve(*points, Verbatim(str(site)), _colour(place), "points", marker=marker))
        line = rows[(rows["site"] == str(site)) & (rows["parameter"] == name) & (rows["factor"] == regressor)]
        if len(line):
            ends = np.array([x.min(), x.max()])
            fitted = line["intercept"].iloc[0] + line["slope"].iloc[0] * ends
            kind = _LINES[place // len(COLOURS) % len(_LINES)]
            parts.append(Curve(ends * factor, fitted * scale, "", _colour(place), kind))
    return Plot(marked("Regression on a value of the subjects"), abscissa, axis, tuple(parts))


def first_test_plot(table: pd.DataFrame, name: str) -> Plot:
    """Return the mean of the later tests less the first test, of each subject and on average by site (Fig. 7.4)."""
    axis, factor = parameter_axis(name)
    groups: dict[str, np.ndarray] = {}
    for site, tests in table.sort_values("repeat").groupby("site", sort=True):
        found = [
            (values.iloc[1:].mean() - values.iloc[0]) * factor
            for _subject, values in tests.groupby("subject")[name]
            if len(values) > 1
        ]
        groups[str(site)] = np.array(found)
    shown = Axis(axis.label, axis.unit, zero=True)
    return _groups_plot(marked("Later tests less the first"), marked("Site"), shown, groups)


def variation_plot(rows: pd.DataFrame) -> Plot:
    """Return the individual and the population coefficient of variation of each parameter, averaged over the sites."""
    means = rows.groupby("parameter", sort=False)[["individual_cv", "population_cv"]].mean() * 100.0
    places = np.arange(1.0, len(means) + 1.0)
    ticks = tuple(
        (place, _in_lines(_(label_and_unit(str(name))[0])))
        for place, name in zip(places.tolist(), means.index, strict=True)
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
    conditions, sites = ({key[place] for key in groups} for place in (0, 1))
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
        for place, (key, rows) in enumerate(groups):
            c1, c2 = float(rows["c1_m"].mean()), float(rows["c2_per_n"].mean())
            kind = kinds[place // len(COLOURS) % len(kinds)]
            depth = 1e3 * c1 * (1.0 - np.exp(-c2 * force))
            parts.append(Curve(force, depth, Verbatim(str(key)), _colour(place), kind))
    return Plot(
        marked("Static nonlinearity of the mean parameters"),
        Axis(marked("Static force"), "N"),
        Axis(marked("Depth"), "mm"),
        tuple(parts),
    )


def _groups_plot(title: str, label: str, axis: Axis, groups: dict[str, np.ndarray]) -> Plot:
    parts = []
    for place, values in enumerate(groups.values()):
        if not len(values):
            continue
        reach = min(0.18, 0.03 * len(values))
        spread = np.linspace(-reach, reach, len(values)) if len(values) > 1 else np.zeros(1)
        x = place + 1.0 + _POINTS_AT + spread
        parts.append(Curve(x, values, "", "muted", "circles", width=0.8))
        half = values.std(ddof=1) if len(values) > 1 else 0.0
        mean = np.array([values.mean()])
        x = np.array([place + 1.0 + _MEAN_AT])
        parts.append(Curve(x, mean, "", "model", "bars", mean - half, mean + half, width=1.2))
    ticks = tuple((k + 1.0, _in_lines(site)) for k, site in enumerate(groups))
    limits = (0.4, len(groups) + 0.6) if groups else None
    return Plot(title, Axis(label, ticks=ticks, limits=limits), axis, tuple(parts))


def _bars(x: np.ndarray, y: np.ndarray, half: np.ndarray, name: str, place: int) -> Curve:
    marker = MARKERS[place % len(MARKERS)]
    return Curve(x, y, Verbatim(name), _colour(place), "bars", y - half, y + half, marker=marker)


def _in_lines(name: str) -> Verbatim:
    """Return a name in lines of about ``_TICK_LETTERS`` letters, for ticks that stand side by side."""
    return Verbatim("\n".join(textwrap.wrap(name, _TICK_LETTERS, break_long_words=False)))


def _offset(place: int, count: int) -> float:
    return 0.5 * (place / max(count - 1, 1) - 0.5) if count > 1 else 0.0


def _colour(place: int) -> str:
    return COLOURS[place % len(COLOURS)]
