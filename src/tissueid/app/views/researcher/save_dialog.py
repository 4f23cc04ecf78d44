"""Dialogs that save a table or figure. A file is replaced only after a question."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, cast

from PySide6.QtCore import QObject, Qt
from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.atomic_write import atomic_file, unused_path
from tissueid.errors import UnusableInputError
from tissueid.formatting import csv_text
from tissueid.language import _, marked
from tissueid.messages import Listing

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
    with atomic_file(path) as partial:
        partial.write_text(csv_text(rows), encoding="utf-8")
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
            "research.figure_kind",
            "{name}: a figure can be saved as {kinds}",
            name=path.name,
            kinds=Listing(tuple(FIGURES)),
        )
    figure = drawing(draw)()
    with atomic_file(path) as partial:
        plain_image(figure, partial, cast(Literal["pdf", "svg", "png"], ending[1:]), _DPI)
    return path


def free_name(folder: Path, title: str, ending: str) -> str:
    """Return an unused file name in ``folder``, made from a title."""
    stem = _AWKWARD.sub("-", title).strip("-._")[:_LONGEST].rstrip("-._") or "tissueid"
    return unused_path(folder / f"{stem}{ending}").name


_TABLES = {".csv": marked("Comma-separated values (*.csv)")}
Write = Callable[[Path], Path]


class SavableFigure(Protocol):
    """A figure that can be saved; its title becomes the file name."""

    @property
    def title(self) -> str:
        """Title of the figure."""

    def draw(self) -> Figure:
        """Draw the figure; called in the thread that writes the file."""


class SaveDialog(QObject):
    """Saves tables and figures through a dialog, and reports the result in the window."""

    def __init__(self, context: AppContext, parent: QWidget) -> None:
        super().__init__(parent)
        self._context = context
        self._over = parent
        self._write: Write | None = None
        self._path = Path()

    def save_table(self, rows: Sequence[Sequence[str]], title: str = "", name: str = "") -> None:
        """Ask for a file, and write rows into it as CSV; ``name`` is its usual name."""
        self._write = functools.partial(write_table, rows=rows)
        self._ask(title or _("Save the table of results"), _TABLES, name or _("results"))

    def save_figure(self, figure: SavableFigure, folder: Path | None = None) -> None:
        """Ask for a file, and draw a figure into it."""
        self._write = functools.partial(write_figure, draw=figure.draw)
        self._ask(_("Save the figure"), FIGURES, figure.title, folder)

    def _ask(self, title: str, kinds: Mapping[str, str], name: str, folder: Path | None = None) -> None:
        where, endings = folder or self._context.services.folder, list(kinds)
        filters = {_(text): ending for ending, text in kinds.items()}
        dialog = build.ask_path(
            self._over,
            title,
            where,
            self._chosen,
            ";;".join(filters),
            save=free_name(where, name, endings[0]),
            option=QFileDialog.Option.DontConfirmOverwrite,  # asked here, the same way on every system
            default_suffix=endings[0][1:],
        )
        dialog.filterSelected.connect(functools.partial(_take_ending, dialog, filters))

    def _chosen(self, path: Path) -> None:
        self._path = path
        if not self._path.exists():
            self._begin()
            return
        question = build.styled(
            QMessageBox(
                QMessageBox.Icon.Warning,
                _("Replace the file?"),
                _("{name} is there already. Replace it?").format(name=self._path.name),
                QMessageBox.StandardButton.Cancel,
                self._over,
            ),
            text_format=Qt.TextFormat.PlainText,
        )
        replace = question.addButton(_("Replace"), QMessageBox.ButtonRole.DestructiveRole)
        question.setDefaultButton(QMessageBox.StandardButton.Cancel)
        question.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        replace.clicked.connect(self._begin)
        question.open()

    def _begin(self) -> None:
        if self._context.busy or self._write is None:
            self._context.say(_("Not saved: other work is running. Try again."), problem=True)
            return
        self._context.jobs.do(functools.partial(self._write, self._path), self._written, self._failed)

    def _written(self, path: Path) -> None:
        self._context.say(_("Saved in {path}.").format(path=path))

    def _failed(self, message: str) -> None:
        self._context.say(message, problem=True)


def _take_ending(dialog: QFileDialog, filters: Mapping[str, str], kind: str) -> None:
    """Set the suffix of the file name to that of the selected filter."""
    ending = filters.get(kind, "")
    dialog.setDefaultSuffix(ending[1:])
    for name in dialog.selectedFiles()[:1]:
        path = Path(name)
        if path.suffix.lower() in FIGURES and ending:
            dialog.selectFile(path.with_suffix(ending).name)
