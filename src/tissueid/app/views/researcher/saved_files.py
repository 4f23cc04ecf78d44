"""Write tables and figures atomically."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Listing, Message

if TYPE_CHECKING:  # matplotlib is imported when the first figure is drawn
    from matplotlib.figure import Figure

FIGURES = {
    ".pdf": marked("PDF drawing (*.pdf)"),
    ".svg": marked("SVG drawing (*.svg)"),
    ".png": marked("PNG picture, 300 dpi (*.png)"),
}
_DPI = 300.0
_LONGEST = 80
_AWKWARD = re.compile(r"[^\w.-]+")


def write_table(path: Path, rows: Sequence[Sequence[str]]) -> Path:
    """Write rows as CSV; return the path.

    Raises:
        OSError: the file cannot be written.
    """
    with atomic_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
    return path


def write_figure(path: Path, draw: Callable[[], Figure]) -> Path:
    """Draw a figure on white into a PDF, SVG or PNG file (300 dpi), by its suffix; return the path.

    Raises:
        UnusableInputError: another ending.
        OSError: the file cannot be written.
    """
    from tissueid.reports.style import drawing, plain_image

    ending = path.suffix.lower()
    if ending not in FIGURES:
        raise UnusableInputError(
            Message(
                "research.figure_kind",
                "{name}: a figure can be saved as {kinds}",
                name=path.name,
                kinds=Listing(tuple(FIGURES)),
            )
        )
    figure = drawing(draw)()
    with atomic_file(path) as partial:
        plain_image(figure, partial, cast(Literal["pdf", "svg", "png"], ending[1:]), _DPI)
    return path


def free_name(folder: Path, title: str, ending: str) -> str:
    """Return an unused file name in ``folder``, made from a title."""
    stem = _AWKWARD.sub("-", title).strip("-._")[:_LONGEST].rstrip("-._") or "tissueid"
    name, number = f"{stem}{ending}", 2
    while (folder / name).exists():
        name, number = f"{stem}-{number}{ending}", number + 1
    return name


__all__ = ["FIGURES", "free_name", "write_figure", "write_table"]
