"""The data of a plot, independent of the drawing library: curves, surfaces and bars over labelled axes.

Values are in clinical display units (:func:`tissueid.units.display_unit`). Labels are English texts marked for
translation, or messages; they are translated when they are drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.formatting import csv_text, label_and_unit, superscript
from tissueid.language import marked
from tissueid.records import Record
from tissueid.units import display_unit

Array = NDArray[np.float64]
Kind = Literal[
    "line", "dashed", "dotted", "dashdot", "points", "circles", "bars", "level", "position", "spans", "filled"
]
"""How a curve is drawn. A level is a horizontal line at ``y``, a position a vertical one at ``x``. Circles are hollow
points. Bars are points with error bars from ``low`` to ``high``. Spans are shaded from ``x[0]`` to ``x[1]``, from
``x[2]`` to ``x[3]`` and so on. A filled curve is shaded down to zero."""

KINDS: tuple[Kind, ...] = get_args(Kind)[:4]
"""Line styles of several engines, tests or fits in one plot, in their order."""
MARKERS = "osD^vP"
"""Markers of several of them, in their order."""
CONFIDENCE = 1.96
"""Half width, in standard deviations, of an interval that holds 95 % of a normal quantity."""
DEPTHS = 9
"""Number of roles of colours from shallow to deep, "depth-1" to "depth-9"."""
_MOST_POINTS = 3000
"""Largest number of points of a cloud that are drawn."""
_MOST_TICKS = 8
"""Largest number of ticks at whole numbers."""


@dataclass(frozen=True)
class Axis:
    """Quantity and unit of an axis; ``limits`` are None where they follow from the data.

    ``zero`` marks zero of an ordinate by a thin line. ``ticks`` are positions and their texts; "" for a line without.
    """

    label: str = ""
    unit: str = ""
    log: bool = False
    limits: tuple[float, float] | None = None
    reverse: bool = False
    zero: bool = False
    ticks: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve: ``x`` and ``y`` (n,), and an optional band from ``low`` to ``high`` (n,).

    Args:
        x: abscissa; a curve of kind "level" ignores it.
        y: ordinate; a curve of kind "position" ignores it. NaN interrupts a line.
        name: text in the key; "" for none.
        colour: role of the colour: "measured", "model", "muted", another field of a theme, or one of ``depth_roles``.
        kind: how it is drawn.
        low: lower edge of the band.
        high: upper edge of the band.
        band: text of the band in the key; "" for none.
        width: width of a line or size of a point, relative to the usual one.
        opacity: 1 hides what is below, 0 shows nothing.
        marker: shape of points, and of the points of a line that has them, such as "o", "s", "D", "^", "v" or "*".
        across: whether error bars lie along the abscissa, from ``low`` to ``high``, and spans along the ordinate.
    """

    x: Array
    y: Array
    name: str = ""
    colour: str = "measured"
    kind: Kind = "line"
    low: Array | None = None
    high: Array | None = None
    band: str = ""
    width: float = 1.0
    opacity: float = 1.0
    marker: str = ""
    across: bool = False


def banded(
    x: Array,
    y: Array,
    half: Array | None,
    name: str = "",
    colour: str = "measured",
    kind: Kind = "line",
    **look: Any,
) -> Curve:
    """Return a curve with a band of half a width ``half`` (n,) about it; it is closed where that is unknown (NaN).

    Without a band where ``half`` is None; ``look`` are further fields of the curve.
    """
    reach = None if half is None else np.where(np.isfinite(half), half, 0.0)
    low, high = (None, None) if reach is None else (y - reach, y + reach)
    return Curve(x, y, name, colour, kind, low, high, **look)


@dataclass(frozen=True, eq=False)
class Surface:
    """``values`` (rows, columns) over ``x`` (columns,) and ``y`` (rows,), with name and unit.

    Args:
        x: evenly spaced.
        y: evenly spaced, or the middle of each row where ``edges`` (rows + 1,) are the limits of the rows.
        values: shown as colours or as heights.
        name: quantity of the values.
        unit: unit of the values.
        signed: whether the colours differ below and above zero.
        limit: value of the fullest colour; None for the largest.
        edges: limits of the rows, where they are not evenly spaced.
    """

    x: Array
    y: Array
    values: Array
    name: str = ""
    unit: str = ""
    signed: bool = True
    limit: float | None = None
    edges: Array | None = None


@dataclass(frozen=True, eq=False)
class Bars:
    """Heights (n,) at ``x`` (n,), or under ``names`` (n,); ``error`` (n,) is half an error bar.

    A bar begins at ``base`` (n,), or at 0. Bars ``across`` have their ``x`` along the ordinate.
    """

    x: Array
    height: Array
    width: Array | float = 0.8
    name: str = ""
    colour: str = "measured"
    names: tuple[str, ...] = ()
    error: Array | None = None
    across: bool = False
    opacity: float = 1.0
    base: Array | None = None


@dataclass(frozen=True)
class Mark:
    """A text at ``x``, over the axes or just above the height ``y``. ``align`` is its end that lies there."""

    x: float
    text: str
    y: float | None = None
    align: Literal["left", "right"] = "left"
    colour: str = "muted"


@dataclass(frozen=True, eq=False)
class Plot:
    """Parts over two axes. ``missing`` is the reason if there is nothing to draw, ``note`` explains a band.

    Axes of a ``square`` plot have the same length. ``depths`` is the quantity that colours curves from shallow to deep,
    with its limits; it is drawn as a colour bar.
    """

    title: str
    x: Axis
    y: Axis
    parts: tuple[Curve | Surface | Bars, ...] = ()
    missing: str = ""
    note: str = ""
    square: bool = False
    depths: Axis | None = None
    marks: tuple[Mark, ...] = ()

    @property
    def curves(self) -> tuple[Curve, ...]:
        """The parts that are curves."""
        return tuple(part for part in self.parts if isinstance(part, Curve))

    @property
    def surface(self) -> Surface | None:
        """The first part that is a surface."""
        return next((part for part in self.parts if isinstance(part, Surface)), None)

    def curve(self, name: str) -> Curve:
        """Return the curve of a name.

        Raises:
            KeyError: there is none.
        """
        for curve in self.curves:
            if curve.name == name:
                return curve
        raise KeyError(name)


def plot_or_reason(title: str, x: Axis, y: Axis, make: Callable[[], Plot]) -> Plot:
    """Return what ``make`` returns, or a plot that says why it cannot be made."""
    try:
        return make()
    except UnusableInputError as error:
        return Plot(title, x, y, missing=error.message)


def as_csv(plots: Sequence[Plot]) -> str:
    """Return the numbers of plots as CSV, in English: a row for every point, with plot, name, x, y, low and high."""
    rows: list[tuple[object, ...]]
    rows = [("plot", "name", "x", "x_unit", "y", "y_unit", "low", "high", "value", "value_unit")]
    for plot in plots:
        for part in plot.parts:
            rows += [(str(plot.title), str(part.name), *cells) for cells in _rows_of(part, plot)]
    return csv_text(rows)


def _rows_of(part: Curve | Surface | Bars, plot: Plot) -> list[tuple[object, ...]]:
    ends = plot.x.unit, plot.y.unit
    if isinstance(part, Surface):
        return [
            (x, ends[0], y, ends[1], "", "", float(part.values[row, column]), part.unit)
            for row, y in enumerate(part.y.tolist())
            for column, x in enumerate(part.x.tolist())
        ]
    y = part.height if isinstance(part, Bars) else part.y
    low, high = (None, None) if isinstance(part, Bars) else (part.low, part.high)
    count = max(np.size(part.x), np.size(y))
    columns = [  # spans and levels have values along one axis alone
        [""] * count if v is None or not np.size(v) else np.broadcast_to(v, count).tolist()
        for v in (part.x, y, low, high)
    ]
    return [(x, ends[0], y, ends[1], low, high, "", "") for x, y, low, high in zip(*columns, strict=True)]


def depth_roles(count: int) -> list[str]:
    """Return ``count`` roles of colours from shallow to deep; a single one is the deepest."""
    return [f"depth-{1 + round((k if count > 1 else 1) * (DEPTHS - 1) / max(1, count - 1))}" for k in range(count)]


def whole_ticks(first: int, last: int) -> tuple[tuple[float, str], ...]:
    """Return ticks at whole numbers from ``first`` to ``last``, evenly spaced and not too many."""
    step = max(1, -(-(last - first + 1) // _MOST_TICKS))
    return tuple((float(number), str(number)) for number in range(first, last + 1, step))


def cloud(x: Array, y: Array, colour: str = "measured") -> Curve:
    """Return points (n,) as a pale cloud: those that are known, evenly chosen where they are very many."""
    indices = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    some = indices[:: max(1, -(-indices.size // _MOST_POINTS))]
    return Curve(x[some], y[some], "", colour, "points", opacity=0.5)


def histogram(values: Array, edges: Array | int, colour: str, name: str = "", kind: Kind = "filled") -> Curve:
    """Return the probability density of values (n,) over bins: their edges (bins + 1,), or their number."""
    density, edges = np.histogram(values, edges, density=True)
    return Curve(*outline(edges, density), name, colour, kind, opacity=0.4 if kind == "filled" else 1.0)


def outline(edges: Array, heights: Array) -> tuple[Array, Array]:
    """Return the outline (2 bins + 2,) of bars (bins,) between ``edges`` (bins + 1,)."""
    return np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(heights, 2), [0.0]])


def steps(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the corners (2 n - 1,) of a line that holds each value (n,) until the next abscissa."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def thin(x: Array, values: Array, columns: int = 900) -> tuple[Array, Array]:
    """Return minimum and maximum in each of ``columns`` columns, for plots of long records.

    Takes and returns abscissa and values of the same shape, (n,) in and at most (2 columns,) out. A column without
    any received sample is NaN, so that the line is broken there.
    """
    if values.size <= 2 * columns:
        return x, values
    width = -(-values.size // columns)
    padded = np.full(width * -(-values.size // width), np.nan)
    padded[: values.size] = values
    blocks = padded.reshape(-1, width)
    finite = np.isfinite(blocks)
    low = np.where(finite, blocks, np.inf).min(axis=1)
    high = np.where(finite, blocks, -np.inf).max(axis=1)
    pairs = np.column_stack([low, high]).ravel()
    pairs[~np.isfinite(pairs)] = np.nan
    return np.repeat(x[::width], 2), pairs


_LONGEST_LABEL = 40
LAG = Axis(marked("Lag"), "ms")
TIME = Axis(marked("Time"), "s")
FREQUENCY = Axis(marked("Frequency"), "Hz", log=True)


def signal_axis(name: str, si_unit: str, *, reverse: bool = False) -> Axis:
    """Return label and display unit of the axis for a signal or another quantity, given with its SI unit."""
    label = label_and_unit(name)[0]
    label = label if len(label) <= _LONGEST_LABEL else label[:_LONGEST_LABEL] + "…"
    return Axis(label, display_unit(si_unit)[0], reverse=reverse)


def ratio_unit(record: Record, power: int = 1) -> tuple[str, float]:
    """Return the display unit of output over a power of the input, and the factor from SI to it."""
    out_unit, out_scale = display_unit(record.output_unit)
    in_unit, in_scale = display_unit(record.input_unit)
    raised = "" if power == 1 else superscript(power)
    return f"{out_unit or '1'}/{in_unit or '1'}{raised}", out_scale / in_scale**power


def kernel_unit(record: Record, order: int = 1) -> tuple[str, float]:
    """Return the display unit of a kernel of an order, such as mm/(N·s), and the factor from SI to it."""
    unit, scale = ratio_unit(record, order)
    output, _slash, raised = unit.partition("/")
    seconds = "s" if order == 1 else f"s{superscript(order)}"
    return f"{output}/{seconds}" if raised.startswith("1") else f"{output}/({raised}·{seconds})", scale


def is_mechanical(record: Record) -> bool:
    """Return whether the input is a force and the output a position."""
    return (record.input_unit, record.output_unit) == ("N", "m")
