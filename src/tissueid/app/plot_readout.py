"""Values of a plot in words and numbers: at the cursor, and for a screen reader."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tissueid.formatting import clean, number
from tissueid.language import _, decimal
from tissueid.messages import translated
from tissueid.units import shown

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot, Surface


def values_at(plot: Plot, x: float, y: float) -> str:
    """Return the values of a plot at a point in the active units; of named rows the name of the nearest."""
    ends = [(x, shown(plot.x.unit)[0]), (y, shown(plot.y.unit)[0])]
    if plot.surface is not None:
        ends.append(_value_at(plot, plot.surface, x, y))
    texts = [f"{decimal(f'{value:.4g}')} {unit}".strip() for value, unit in ends]
    if plot.y.ticks:
        texts[1] = clean(translated(min(plot.y.ticks, key=lambda tick: abs(tick[0] - y))[1]))
    return "   ".join(filter(None, texts))


def unit_of_values(plot: Plot) -> str:
    """Return the unit of what a plot shows: of its surface, of named rows, or of its ordinate."""
    if plot.surface is not None:
        return plot.surface.unit
    return plot.x.unit if plot.y.ticks else plot.y.unit


def extremes(plot: Plot) -> str:
    """Return in words where the surface of a plot has its largest and its smallest value; "" without a surface."""
    surface = plot.surface
    if surface is None or not np.isfinite(surface.values).any():
        return ""
    sentences = []
    for flat_index, text in (
        (np.nanargmax(surface.values), _("Greatest {value} at {x} and {y}.")),
        (np.nanargmin(surface.values), _("Least {value} at {x} and {y}.")),
    ):
        row, column = np.unravel_index(flat_index, surface.values.shape)
        value = _value("", surface.unit, float(surface.values[row, column]))
        x = _value(plot.x.label, plot.x.unit, float(surface.x[column]))
        y = _value(plot.y.label, plot.y.unit, float(surface.y[row]))
        sentences.append(text.format(value=value, x=x, y=y))
    return " ".join(sentences)


def _value(label: str, unit: str, value: float) -> str:
    """Return quantity, value and unit."""
    unit, factor = shown(unit)
    return " ".join(filter(None, [translated(label), number(factor * value, 3), translated(unit)]))


def _value_at(plot: Plot, surface: Surface, x: float, y: float) -> tuple[float, str]:
    """Return the value of the surface of a plot nearest to a point in the active units, and its unit."""
    column = int(np.argmin(np.abs(shown(plot.x.unit)[1] * surface.x - x)))
    row = int(np.argmin(np.abs(shown(plot.y.unit)[1] * surface.y - y)))
    unit, factor = shown(surface.unit)
    return factor * float(surface.values[row, column]), unit


__all__ = ["extremes", "unit_of_values", "values_at"]
