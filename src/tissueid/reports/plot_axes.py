"""Axes of plots: colours, labels, limits, ticks; and layout of plots below each other in a figure of any size."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.colorbar import Colorbar
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator
from mpl_toolkits.mplot3d import Axes3D

from tissueid.analysis.curves.plot import Axis, Bars, Plot, depth_roles
from tissueid.formatting import clean, superscript
from tissueid.messages import translated
from tissueid.reports.style import (
    BLUE,
    DEPTHS,
    GREEN,
    GRID,
    INK,
    LOST,
    MUTED,
    ORANGE,
    PAPER,
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
        return self.roles.get(role) or _DEPTH_ROLES.get(role, role)


PAGE = Look()
"""The look of reports on white; pages replace its colours by those of their style sheet."""
_DEPTH_ROLES = dict(zip(depth_roles(len(DEPTHS)), DEPTHS, strict=True))
_WRAP = 48
_SMALLEST, _LARGEST = 1e-4, 1e6
"""Numbers on an ordinate below and above which the power of ten stands in its label."""
_TURN_DEGREES = 30.0
_LONGEST_TURNED = 30
"""Number of letters of a turned name that are shown."""
_SMALL_NAMES = 7.0
"""Size of names that do not fit otherwise, in points."""
_BETWEEN_NAMES = 4.0
"""Gap between the names of neighbouring ticks, in points."""


def label_of(axis: Axis, units: Units = clinical) -> str:
    """Return quantity and unit of an axis as they are shown."""
    label, unit = translated(axis.label), translated(units(axis.unit)[0])
    return f"{label} ({unit})" if label and unit else label or unit


def label_with_power(axes: Axes, axis: Axis, units: Units = clinical) -> str:
    """Return the label of an ordinate, with the power of ten of its numbers if these are very small or large.

    Matplotlib would write the power above the axis, where a key or a title is.
    """
    label = label_of(axis, units)
    top = float(np.max(np.abs(axes.get_ylim())))
    if axis.log or axis.ticks or isinstance(axes, Axes3D) or not (0.0 < top < _SMALLEST or _LARGEST <= top < np.inf):
        return label
    exponent = 3 * int(np.floor(np.log10(top) / 3.0))
    power, unit = f"10{superscript(exponent)}", translated(units(axis.unit)[0])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value / 10.0**exponent:.6g}"))
    return f"{translated(axis.label)} ({power} {unit})" if unit else f"{label} ({power})"


def turn_names(axes: Axes, width: float) -> None:
    """Make names along the abscissa smaller, or turn them, where neighbours would touch; ``width`` is in inches."""
    places, labels = axes.get_xticks(), axes.get_xticklabels()
    if len(places) < 2 or len(labels) != len(places):
        return
    dots = float(cast(Figure, axes.get_figure(root=True)).dpi)
    scale = dots * width / abs(float(np.diff(axes.get_xlim())[0]))
    gap = _BETWEEN_NAMES * dots / 72.0
    usual = labels[0].get_fontsize()
    for size in (usual, _SMALL_NAMES):
        axes.tick_params(axis="x", labelsize=size)
        halves = [0.5 * label.get_window_extent().width if label.get_text() else 0.0 for label in labels]
        named = [(scale * float(tick), half) for tick, half in zip(places, halves, strict=True) if half]
        if all(b - a > half_a + half_b + gap for (a, half_a), (b, half_b) in itertools.pairwise(named)):
            return
    names = [clean(textwrap.shorten(label.get_text(), _LONGEST_TURNED, placeholder="…")) for label in labels]
    axes.set_xticks(places, names, rotation=_TURN_DEGREES, ha="right", rotation_mode="anchor", parse_math=False)


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
        if axes.images or any(isinstance(artist, QuadMesh) for artist in axes.collections):
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


def depth_bar(axes: Axes, depths: Axis, units: Units, look: Look) -> None:
    """Add the colour bar of a quantity that colours curves from shallow to deep, between its limits."""
    ends = units(depths.unit)[1] * np.array(depths.limits or (0.0, 1.0))
    norm = BoundaryNorm(np.linspace(ends[0], ends[1], len(DEPTHS) + 1), len(DEPTHS))
    drawn = ScalarMappable(norm, ListedColormap(list(DEPTHS)))  # type: ignore[arg-type]
    bar = axes.figure.colorbar(drawn, ax=axes, pad=0.02, shrink=0.9)
    places, decimals = np.linspace(ends[0], ends[1], 4), 2 if np.ptp(ends) < 10.0 else 0
    bar.set_ticks([float(tick) for tick in places], labels=[f"{tick:.{decimals}f}" for tick in places])
    finish_bar(bar, label_of(depths, units), look)


def finish_bar(bar: Colorbar, label: str, look: Look) -> None:
    """Give a colour bar its label and the colours of a look."""
    bar.outline.set_visible(False)
    bar.set_label(label, color=look.ink, fontsize=look.font_size)
    bar.ax.tick_params(which="both", colors=look.muted, labelcolor=look.ink, labelsize=look.font_size - 0.5)


def say_missing(axes: Axes, text: str, look: Look) -> None:
    """Show a text in place of a plot."""
    axes.set_axis_off()
    wrapped = textwrap.fill(clean(text[:1].upper() + text[1:]), _WRAP)
    axes.text(0.5, 0.5, wrapped, color=look.muted, fontsize=look.font_size, transform=axes.transAxes, ha="center",
              va="center", parse_math=False)  # fmt: skip


def _hold_bands(axes: Axes, plot: Plot, factor: float) -> None:
    """Extend the range to the bands, unless they are much wider than the curves."""
    banded = [curve for curve in plot.curves if curve.low is not None and curve.high is not None]
    if any(curve.kind == "bars" for curve in banded):
        return  # which matplotlib holds
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


def scale_axes(axes: Axes, plot: Plot, factors: tuple[float, float], look: Look) -> None:
    """Give axes the limits, scales and ticks of a plot; ``factors`` convert its units to those of the reader."""
    if plot.x.log:
        positive = [
            factors[0] * np.asarray(c.x)[np.asarray(c.x) > 0.0] for c in plot.curves if c.kind not in ("level", "spans")
        ]
        ends = plot.x.limits or (
            (min(float(v.min()) for v in positive if v.size), max(float(v.max()) for v in positive if v.size))
            if any(v.size for v in positive)
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
    elif not (
        plot.square  # both axes have the same numbers
        or isinstance(axes, Axes3D)
        or any(isinstance(p, Bars) and p.names and p.across for p in plot.parts)
    ):
        axes.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    for along, ticks, factor in ((axes.xaxis, plot.x.ticks, factors[0]), (axes.yaxis, plot.y.ticks, factors[1])):
        if ticks:
            labels = ["\n".join(map(clean, translated(text).split("\n"))) for _, text in ticks]
            along.set_ticks([factor * tick for tick, _ in ticks], labels=labels, parse_math=False)
    if plot.square:
        axes.set_box_aspect(1.0)
    if plot.y.zero:
        axes.axhline(0.0, color=look.muted, linewidth=0.8, zorder=1.5)
    if plot.x.reverse and not axes.xaxis_inverted():
        axes.invert_xaxis()
    if plot.y.reverse and not isinstance(axes, Axes3D) and not axes.yaxis_inverted():
        axes.invert_yaxis()


_GAP = 4.0
"""Space between the parts of a figure on the screen, pixels."""
_MARGINS_IN_SPACE = (0.1, 0.11, 0.97, 0.92)
"""Left, bottom, right and top of axes in space, as shares of the figure."""
_LINES_AROUND = 4.5
"""Height of title, numbers and label of the abscissa, in lines."""
_LINE_OF_KEY = 1.6
"""Height of a line of a key, in heights of its letters."""
_SHARE_OF_KEY = 0.6
"""Share of the height of its axes that a key in one column may take."""
_LETTERS_OF_DECADE = 7.0
"""Width of the labels of a decade at 1, 2 and 5, in heights of letters."""
_DECADES_FOR_FEW = 1.5
"""Number of decades above which labels of decades alone suffice."""
_SHORTEST_LINE = 6
"""Smallest number of letters in a line of a wrapped label."""


def lay_out(figure: Figure) -> None:
    """Make room for the labels of plots below each other; wrap labels of ordinates that are longer than their axes.

    Takes a third of the time of matplotlib's constrained layout.
    """
    every = figure.get_axes()
    for axes, room in _rooms(figure, every):
        _thin_frequencies(axes)
        wrap_label(axes, room)
        _place_key(axes, room)
    width, height = figure.bbox.size
    if not every or min(width, height) < 1.0:
        return
    renderer = cast(Any, figure.canvas).get_renderer()
    if any(isinstance(axes, Axes3D) for axes in every):  # whose labels move with the view
        figure.subplots_adjust(*_MARGINS_IN_SPACE)
        return
    boxes = [axes.get_tightbbox(renderer, for_layout_only=True) or axes.bbox for axes in every]
    inside = [axes.bbox for axes in every]
    left_margin = max(axes.x0 - box.x0 for axes, box in zip(inside, boxes, strict=True))
    right_margin = max(box.x1 - max(bbox.x1 for bbox in inside) for box in boxes)
    rows = [
        (axes, box) for drawn, axes, box in zip(every, inside, boxes, strict=True) if not hasattr(drawn, "_colorbar")
    ]
    above, below = [box.y1 - axes.y1 for axes, box in rows], [axes.y0 - box.y0 for axes, box in rows]
    between = max((low + high for low, high in zip(below[:-1], above[1:], strict=True)), default=0.0) + _GAP
    each = max(1.0, (height - above[0] - below[-1] - 2.0 * _GAP - (len(rows) - 1) * between) / len(rows))
    low, high = (below[-1] + _GAP) / height, 1.0 - (above[0] + _GAP) / height
    start, end = (left_margin + _GAP) / width, 1.0 - (max(right_margin, 0.0) + _GAP) / width
    if low < high and start < end:
        figure.subplots_adjust(start, low, end, high, hspace=between / each)


def _rooms(figure: Figure, every: Sequence[Axes]) -> list[tuple[Axes, float]]:
    """Return all axes, each with the height in pixels that it will have at most."""
    rows = sum(not hasattr(axes, "_colorbar") for axes in every)
    line = figure.dpi / 72.0 * max((float(axes.yaxis.label.get_fontsize()) for axes in every), default=0.0)
    return [(axes, figure.bbox.height / max(rows, 1) - _LINES_AROUND * line) for axes in every]


def _thin_frequencies(axes: Axes) -> None:
    """Label decades only, where labels at 1, 2 and 5 would touch each other."""
    locator = axes.xaxis.get_major_locator()
    if axes.get_xscale() != "log" or not isinstance(locator, LogLocator):
        return
    low, high = sorted(axes.get_xlim())
    decades = max(1e-3, float(np.log10(high / low)))
    letter = cast(Figure, axes.figure).dpi / 72.0 * float(axes.xaxis.label.get_fontsize())
    few = _LETTERS_OF_DECADE * letter > axes.bbox.width / decades and decades >= _DECADES_FOR_FEW
    locator.set_params(subs=(1.0,) if few else (1.0, 2.0, 5.0))


def wrap_label(axes: Axes, room: float) -> None:
    """Break the label of an ordinate that is longer than ``room``, the height of its axes in pixels."""
    label = axes.yaxis.label
    text = label.get_text().replace("\n", " ")
    if text:
        label.set_text(text)
        length = label.get_window_extent().height
        if length > room:
            label.set_text(_broken(text, max(1, int(len(text) * room / length))))


def _place_key(axes: Axes, room: float) -> None:
    """Put a key in one row right of the title, or left of it above long names of rows, where it hides no curve.

    It is inside the axes if it is too wide, in columns if it is tall.
    """
    legend = axes.get_legend()
    if legend is None or isinstance(axes, Axes3D):
        return
    figure = cast(Figure, axes.figure)
    texts, handles = legend.get_texts(), cast(list[Artist], legend.legend_handles)
    names = [text.get_text() for text in texts]
    size, colour = float(texts[0].get_fontsize()), texts[0].get_color()
    usual: dict[str, Any] = {"frameon": False, "fontsize": size, "labelcolor": colour, "handlelength": 1.4}
    usual |= {"columnspacing": 1.0, "handletextpad": 0.5, "borderpad": 0.0}
    above = usual | {"loc": "lower right", "ncols": len(names), "borderaxespad": 0.3}
    legend = axes.legend(handles, names, bbox_to_anchor=(1.0, 1.0), **above)
    key, title = legend.get_window_extent().width, cast(Any, axes)._left_title.get_window_extent().width
    # The margins are not set yet: the axes will be as wide as names and labels of the ordinate leave.
    ordinate = axes.yaxis.get_tightbbox(cast(Any, figure.canvas).get_renderer())
    ordinate_width = 0.0 if ordinate is None else ordinate.width
    if key + title > min(axes.bbox.width, figure.bbox.width - ordinate_width):
        if key <= ordinate_width:
            legend = axes.legend(handles, names, bbox_to_anchor=(-0.05, 1.0), **above)
        else:
            tall = len(names) * _LINE_OF_KEY * size * figure.dpi / 72.0 >= _SHARE_OF_KEY * room
            legend = axes.legend(handles, names, loc="best", ncols=2 if tall else 1, **usual)
    for text in legend.get_texts():
        text.set_parse_math(False)


def _broken(text: str, most: int) -> str:
    """Return a label in lines of at most ``most`` letters, where its words allow it; its unit is not broken."""
    label, bracket, unit = text.partition(" (")
    lines = textwrap.wrap(label, max(most, _SHORTEST_LINE), break_long_words=False)
    if bracket and lines and len(lines[-1]) + 1 + len(f"({unit}") <= most:
        lines[-1] += f" ({unit}"
    elif bracket:
        lines.append(f"({unit}")
    return "\n".join(lines)
