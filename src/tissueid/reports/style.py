"""Style of figures, and their conversion to SVG for pages."""

from __future__ import annotations

import html
import io
import re
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import IO, Any, Literal, ParamSpec, TypeVar

import numpy as np
from matplotlib import style as matplotlib_style
from matplotlib.axes import Axes
from matplotlib.backend_bases import get_registered_canvas_class
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator, ScalarFormatter

from tissueid.formatting import clean, superscript
from tissueid.language import _, decimal

INK = "#24292f"
MUTED = "#6e7781"
GRID = "#e3e6e9"
SHADE = "#f0f1f3"
PAPER = "#ffffff"
BLUE = "#0067b3"
ORANGE = "#c95100"
GREEN = "#00785a"
LOST = "#b3005e"

SERIES = (BLUE, ORANGE, GREEN, "#7a4fa3")
"""Engines in their order of appearance. They differ in lightness too, and each has a line style of its own."""
POINTS = ("#4a94cf", "#dd7a33", "#2fa583", "#9a74c4")
"""The same hues for rasterised points, of middling lightness: a raster does not follow the page from light to dark."""
DASHES = ("-", (0, (5, 1.6)), (0, (1.4, 1.4)), (0, (6, 1.5, 1.2, 1.5)))

DEPTHS = (
    "#22a785",
    "#1f958b",
    "#25838e",
    "#2d718f",
    "#365d8d",
    "#404688",
    "#472f7d",
    "#48186a",
    "#440255",
)
"""From shallow to deep: even steps in lightness towards what stands out most, on light pages and on dark ones."""

_NEGATIVE, _POSITIVE = (0.11, 0.47, 0.78), (0.85, 0.38, 0.05)
DIVERGING = LinearSegmentedColormap.from_list(
    "diverging",
    [(0.0, (*_NEGATIVE, 1.0)), (0.5, (*_NEGATIVE, 0.0)), (0.5, (*_POSITIVE, 0.0)), (1.0, (*_POSITIVE, 1.0))],
    N=512,
)
"""Blue below zero, orange above, and nothing at zero: the page shows through, be it light or dark."""
SEQUENTIAL = LinearSegmentedColormap.from_list("sequential", [(*_NEGATIVE, 0.0), (*_NEGATIVE, 1.0)])
RELIEF = LinearSegmentedColormap.from_list("relief", [_NEGATIVE, (0.66, 0.68, 0.70), _POSITIVE])
"""The same hues for opaque surfaces: the middle is a grey that is visible on light and dark pages."""

FULL_WIDTH = 9.2
HALF_WIDTH = 4.6
"""Inches; a page shows about 100 pixels to the inch, so a 9-point letter is 12 pixels high."""

_CSS_COLOURS = {
    INK: "var(--fig-ink)",
    MUTED: "var(--fig-muted)",
    GRID: "var(--fig-grid)",
    SHADE: "var(--fig-shade)",
    PAPER: "var(--fig-paper)",
    LOST: "var(--fig-lost)",
    **{colour: f"var(--fig-series-{number})" for number, colour in enumerate(SERIES, 1)},
    **{colour: f"var(--fig-depth-{number})" for number, colour in enumerate(DEPTHS, 1)},
}

_STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.facecolor": PAPER,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlecolor": INK,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "text.color": INK,
    "text.parse_math": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 2.4,
    "figure.facecolor": PAPER,
    "figure.constrained_layout.use": True,
    "savefig.facecolor": "auto",
    "svg.fonttype": "none",
    "svg.hashsalt": "tissueid",
    "path.simplify_threshold": 0.2,
}

_LOCK = threading.RLock()
_P = ParamSpec("_P")
_R = TypeVar("_R")


@contextmanager
def _report_style() -> Iterator[None]:
    """Set Matplotlib defaults and the style of the reports, ignoring user settings; restore them afterwards."""
    with _LOCK, matplotlib_style.context(_STYLE, after_reset=True):
        yield


def drawing(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorate a function that makes a figure: draw in the style of the reports."""

    @wraps(function)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with _report_style():
            made = function(*args, **kwargs)
            for figure in (made, *args):
                if isinstance(figure, Figure):
                    localise_numbers(figure)
            return made

    return drawn


def localise_numbers(figure: Figure) -> None:
    """Give the numbers of linear axes the decimal mark of the language."""
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if type(axis.get_major_formatter()) is ScalarFormatter and decimal(".") != ".":
            axis.set_major_formatter(_LocalFormatter())


class _LocalFormatter(ScalarFormatter):
    """Numbers with the decimal mark of the language."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return decimal(super().__call__(x, pos))


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size in inches that belongs to no window and no global list."""
    return Figure(figsize=(width, height), dpi=100)


# -- axes -----------------------------------------------------------------------------------------------------


def frequency_axis(axes: Axes, low: float, high: float) -> None:
    """A logarithmic frequency axis, Hz, with ticks at 1, 2 and 5."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _place: decimal(f"{value:g}")))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel(_("Frequency (Hz)"))


def log_axis(axes: Axes) -> None:
    """A logarithmic vertical axis: plain numbers when it spans little, powers of ten when it spans much."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    few = high / low < 1e3
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=8))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: _power_label(value, plain=few)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_locator(NullLocator())


def _power_label(value: float, *, plain: bool) -> str:
    if value <= 0.0:
        return ""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    if plain and -4 <= exponent < 5:
        return decimal(f"{value:g}")
    mantissa = round(value / 10.0**exponent)
    times = "" if mantissa == 1 else f"{mantissa}·"
    return f"{times}10{superscript(exponent)}"


_UNDATED: dict[str, dict[str, None]] = {
    "svg": {"Date": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None},
}
"""What a file says of when and by what it was made: nothing, so that the same figure gives the same file."""


def plain_image(
    figure: Figure, target: IO[bytes] | Path, form: Literal["svg", "png", "pdf"], dots_per_inch: float = 144.0
) -> None:
    """Write the figure for use outside of a page: on white, in colours that need no style sheet.

    Raises:
        OSError: the target cannot be written.
    """
    with _report_style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        _write(figure, target, form, dots_per_inch)


def _write(figure: Figure, target: IO[Any] | Path, form: Literal["svg", "png", "pdf"], dots_per_inch: float) -> None:
    """Write the figure as ``Figure.savefig`` does, which draws it twice: the first time for the layout alone."""
    before, shown_on = figure.dpi, figure.canvas
    figure.set_dpi(dots_per_inch)
    try:
        canvas = get_registered_canvas_class(form)(figure)
        getattr(canvas, f"print_{form}")(target, metadata=_UNDATED[form])
    finally:
        figure.set_dpi(before)
        figure.set_canvas(shown_on)


# -- pages ----------------------------------------------------------------------------------------------------

_CLUTTER = re.compile(r"<metadata>.*?</metadata>|<!--.*?-->|<defs>\s*<style.*?</style>\s*</defs>", re.DOTALL)
_OPENING = re.compile(r'<svg [^>]*?viewBox="([^"]+)"[^>]*>')
_REFERENCE = re.compile(r'(?:url\(|href=")#([\w.-]+)')
_IDENTITY = re.compile(r' id="([\w.-]+)"')
_LONG_NUMBER = re.compile(r"(-?\d+\.\d{2})\d+")
_COORDINATES = re.compile(r' (?:d|x|y|transform)="[^"]*"')
_FONT = re.compile(r"font(?:-family)?: ?([\d.]+px )?'DejaVu Sans'[^;\"]*")


def to_svg(figure: Figure, key: str, alt: str) -> str:
    """The figure as an SVG element for an HTML page.

    Identifiers start with ``key``, so that several figures share a page. Colours become CSS variables
    (``--fig-ink`` and so on) and text stays text in the page's own letters. ``alt`` is what a screen reader says.
    """
    buffer = io.StringIO()
    with _report_style(), warnings.catch_warnings():
        # Letters that Matplotlib's own font lacks are drawn by the reader's browser, which has them.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        _write(figure, buffer, "svg", 144.0)
    text = buffer.getvalue()
    text = _CLUTTER.sub("", text[text.index("<svg") :])
    text = _COORDINATES.sub(lambda match: _LONG_NUMBER.sub(r"\1", match.group()), text)
    text = _FONT.sub(lambda match: f"font-size: {match.group(1).strip()}" if match.group(1) else "", text)
    for colour, variable in _CSS_COLOURS.items():
        text = text.replace(colour, variable)
    used = set(_REFERENCE.findall(text))
    text = _IDENTITY.sub(lambda match: f' id="{key}-{match.group(1)}"' if match.group(1) in used else "", text)
    text = _REFERENCE.sub(lambda match: match.group().replace("#", f"#{key}-"), text)
    label = f'role="img" aria-label="{html.escape(clean(alt))}"'
    return _OPENING.sub(lambda match: f'<svg viewBox="{match.group(1)}" {label}>', text, count=1).strip()
