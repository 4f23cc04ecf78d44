"""Plots of a parameter of many fits: points in groups with the means of the groups, histograms, named rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import Array, Axis, Bars, Curve, Plot

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Centre:
    """Mean of a group at one place, with half its error bar; NaN for none."""

    group: int
    x: float
    y: float
    half: float


def points_plot(
    axes: tuple[Axis, Axis],
    groups: Sequence[tuple[Array, Array]],
    colours: Sequence[str],
    names: Sequence[str],
    centres: Sequence[Centre] = (),
) -> Plot:
    """Return abscissa and ordinate (n,) of each group as points in its colour, and means with error bars over them."""
    parts = [
        Curve(x, y, name, colour, "points", width=1.8, opacity=0.6)
        for (x, y), colour, name in zip(groups, colours, names, strict=False)
        if x.size
    ]
    for place, colour in enumerate(colours):
        own = [centre for centre in centres if centre.group == place]
        if own:
            x, y = np.array([one.x for one in own]), np.array([one.y for one in own])
            half = np.nan_to_num(np.array([one.half for one in own]))
            parts.append(Curve(x, y, "", colour, "bars", y - half, y + half, width=1.1, opacity=0.9))
    return Plot("", *axes, tuple(parts))


def histogram_plot(
    axes: tuple[Axis, Axis], groups: Sequence[Array], edges: Array, colours: Sequence[str], names: Sequence[str]
) -> Plot:
    """Return how many values (n,) of each group lie in the bins between ``edges`` (bins + 1,)."""
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    parts = [
        Bars(middle, np.histogram(values, edges)[0].astype(np.float64), width, name, colour, opacity=0.4)
        for values, colour, name in zip(groups, colours, names, strict=False)
        if values.size
    ]
    return Plot("", *axes, tuple(parts))


def rows_plot(
    title: str, x: Axis, names: Sequence[str], values: Array, std: Array, groups: Sequence[tuple[str, str, Rows]]
) -> Plot:
    """Return values in named rows, the first on top, with error bars of one standard deviation along the abscissa.

    Args:
        title: what stands above.
        x: axis of the values.
        names: name of each row (n,); data of a user are wrapped in ``Verbatim``.
        values: value of each row (n,); NaN for none.
        std: its standard deviation (n,); NaN for none.
        groups: name, role of the colour, and rows (k,) of each group; later groups are drawn larger.
    """
    places = np.arange(len(names), 0.0, -1.0)
    half = np.nan_to_num(std)
    parts = []
    for place, (name, colour, rows) in enumerate(groups):
        own = rows[np.isfinite(values[rows])]
        x_own, reach = values[own], half[own]
        bars = Curve(x_own, places[own], name, colour, "bars", x_own - reach, x_own + reach, across=True)
        parts.append(replace(bars, width=1.2 + 0.5 * place))
    y = Axis(limits=(0.5, len(names) + 0.5), ticks=tuple(zip(places.tolist(), names, strict=True)))
    return Plot(title, x, y, tuple(parts))


__all__ = ["Centre", "histogram_plot", "points_plot", "rows_plot"]
