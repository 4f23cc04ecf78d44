"""Layout of plots below each other in a figure of any size: margins, wrapped labels, place of the key."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from mpl_toolkits.mplot3d import Axes3D

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
    left = max(axes.x0 - box.x0 for axes, box in zip(inside, boxes, strict=True))
    right = max(box.x1 - max(one.x1 for one in inside) for box in boxes)
    rows = [(axes, box) for one, axes, box in zip(every, inside, boxes, strict=True) if not hasattr(one, "_colorbar")]
    above, below = [box.y1 - axes.y1 for axes, box in rows], [axes.y0 - box.y0 for axes, box in rows]
    between = max((low + high for low, high in zip(below[:-1], above[1:], strict=True)), default=0.0) + _GAP
    each = max(1.0, (height - above[0] - below[-1] - 2.0 * _GAP - (len(rows) - 1) * between) / len(rows))
    low, high = (below[-1] + _GAP) / height, 1.0 - (above[0] + _GAP) / height
    start, end = (left + _GAP) / width, 1.0 - (max(right, 0.0) + _GAP) / width
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
    left = 0.0 if ordinate is None else ordinate.width
    if key + title > min(axes.bbox.width, figure.bbox.width - left):
        if key <= left:
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


__all__ = ["lay_out", "wrap_label"]
