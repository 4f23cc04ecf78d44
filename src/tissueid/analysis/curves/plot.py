"""The data of a plot, independent of the drawing library: curves, surfaces and bars over labelled axes.

Values are in clinical display units (:func:`tissueid.units.display_unit`). Labels are English texts marked for
translation, or messages; they are translated when they are drawn.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError

Array = NDArray[np.float64]
Kind = Literal["line", "dashed", "dotted", "points", "circles", "level", "position", "spans"]
"""How a curve is drawn. A level is a horizontal line at ``y``, a position a vertical one at ``x``. Circles are hollow
points. Spans are shaded from ``x[0]`` to ``x[1]``, from ``x[2]`` to ``x[3]`` and so on."""

CONFIDENCE = 1.96
"""Half width, in standard deviations, of an interval that holds 95 % of a normal quantity."""


@dataclass(frozen=True)
class Axis:
    """Quantity and unit of an axis; ``limits`` are None where they follow from the data.

    ``zero`` marks zero of an ordinate by a thin line.
    """

    label: str = ""
    unit: str = ""
    log: bool = False
    limits: tuple[float, float] | None = None
    reverse: bool = False
    zero: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve: ``x`` and ``y`` (n,), and an optional band from ``low`` to ``high`` (n,).

    Args:
        x: abscissa; a curve of kind "level" ignores it.
        y: ordinate; a curve of kind "position" ignores it. NaN interrupts a line.
        name: text in the key; "" for none.
        colour: role of the colour: "measured", "model", "muted", or another field of a theme.
        kind: how it is drawn.
        low: lower edge of the band.
        high: upper edge of the band.
        band: text of the band in the key; "" for none.
        width: width of a line or size of a point, relative to the usual one.
        opacity: 1 hides what is below, 0 shows nothing.
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
    """Heights (n,) at ``x`` (n,), or under ``names`` (n,); ``error`` (n,) is half an error bar."""

    x: Array
    height: Array
    width: Array | float = 0.8
    name: str = ""
    colour: str = "measured"
    names: tuple[str, ...] = ()
    error: Array | None = None
    across: bool = False
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Plot:
    """Parts over two axes. ``missing`` is the reason if there is nothing to draw, ``note`` explains a band."""

    title: str
    x: Axis
    y: Axis
    parts: tuple[Curve | Surface | Bars, ...] = ()
    missing: str = ""
    note: str = ""

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
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("plot", "name", "x", "x_unit", "y", "y_unit", "low", "high", "value", "value_unit"))
    for plot in plots:
        for part in plot.parts:
            for cells in _rows_of(part, plot):
                rows.writerow((str(plot.title), str(part.name), *cells))
    return text.getvalue()


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
    columns = [[""] * count if v is None else np.broadcast_to(v, count).tolist() for v in (part.x, y, low, high)]
    return [(x, ends[0], y, ends[1], low, high, "", "") for x, y, low, high in zip(*columns, strict=True)]


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
