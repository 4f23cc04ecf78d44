"""A figure on a page: drawn, or the reason why it was left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, translated
from tissueid.reports.style import to_svg


@dataclass(frozen=True)
class FigureBlock:
    """A figure on the page or the reason why it was left out: one of ``svg`` and ``missing`` is ""."""

    key: str
    heading: str
    caption: str
    svg: str
    missing: str
    wide: bool


@dataclass(frozen=True)
class FigureGroup:
    """Figures under one heading."""

    key: str
    heading: str
    figures: tuple[FigureBlock, ...]


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure with its texts, before it is put on a page or in a file; without a ``figure``, ``missing`` says why."""

    key: str
    heading: str
    alt: str
    caption: str
    figure: Figure | None
    missing: str
    wide: bool

    @property
    def block(self) -> FigureBlock:
        """Return the figure as the page holds it."""
        svg = "" if self.figure is None else to_svg(self.figure, self.key, self.alt)
        return FigureBlock(self.key, self.heading, self.caption, svg, translated(self.missing), self.wide)


def picture(key: str, heading: str, alt: str, make: Callable[[], tuple[Figure, str]], *, wide: bool = True) -> Picture:
    """Return a figure, or the reason why it was left out; ``make`` returns the figure and its caption."""
    try:
        figure, caption = make()
    except UnusableInputError as error:
        return absent(key, heading, error.message, wide=wide)
    return Picture(key, heading, alt, caption, figure, "", wide)


def absent(key: str, heading: str, reason: str, *, wide: bool = True) -> Picture:
    """Return a figure that was left out, for a reason without a full stop."""
    return Picture(key, heading, "", "", None, Message("report.left_out", "Left out: {reason}.", reason=reason), wide)
