"""A figure on a page: drawn, or with the one line that says why it is not there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure

from tissueid.core_words import said_by_core
from tissueid.errors import UnusableInputError
from tissueid.language import _
from tissueid.reports.style import to_svg


@dataclass(frozen=True)
class FigureBlock:
    """A figure on the page, or in its place the reason why there is none: one of ``svg`` and ``missing`` is ""."""

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
    """A figure before it is put on a page or in a file; without a ``figure``, ``missing`` is the sentence instead."""

    key: str
    heading: str
    alt: str
    caption: str
    figure: Figure | None
    missing: str
    wide: bool

    @property
    def block(self) -> FigureBlock:
        """The figure as the page holds it."""
        svg = "" if self.figure is None else to_svg(self.figure, self.key, self.alt)
        return FigureBlock(self.key, self.heading, self.caption, svg, self.missing, self.wide)


def picture(key: str, heading: str, alt: str, make: Callable[[], tuple[Figure, str]], *, wide: bool = True) -> Picture:
    """Draw, or say why not; ``make`` gives the figure and its caption."""
    try:
        figure, caption = make()
    except UnusableInputError as error:
        return absent(key, heading, said_by_core(str(error)), wide=wide)
    return Picture(key, heading, alt, caption, figure, "", wide)


def absent(key: str, heading: str, reason: str, *, wide: bool = True) -> Picture:
    """What stands in place of a figure: a reason without a full stop."""
    return Picture(key, heading, "", "", None, _("Left out: {reason}.").format(reason=reason), wide)
