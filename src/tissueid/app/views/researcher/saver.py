"""Asks where a table or a figure is to be saved, and has it written. What is there is never replaced without asking."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from PySide6.QtCore import QObject, Qt
from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

from tissueid.app.views.researcher.saving import FIGURES, free_name, write_figure, write_table
from tissueid.app.views.view import Desk
from tissueid.language import _, marked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TABLES = {".csv": marked("Comma-separated values (*.csv)")}
Write = Callable[[Path], Path]


class OnPaper(Protocol):
    """A figure that can be drawn; its title makes the name of its file."""

    @property
    def title(self) -> str:
        """What it shows."""

    def draw(self) -> Figure:
        """Draw it, in the thread that writes the file."""


class Saver(QObject):
    """Opens one dialog at a time over its parent; what is written is said in the strip of the window."""

    def __init__(self, desk: Desk, parent: QWidget) -> None:
        super().__init__(parent)
        self._desk = desk
        self._over = parent
        self._write: Write | None = None
        self._path = Path()

    def save_table(self, rows: Sequence[Sequence[str]]) -> None:
        """Ask for a file, and write rows into it as CSV."""
        self._write = functools.partial(write_table, rows=rows)
        self._ask(_("Save the table of results"), _TABLES, _("results"))

    def save_figure(self, figure: OnPaper, folder: Path | None = None) -> None:
        """Ask for a file, and draw a figure into it."""
        self._write = functools.partial(write_figure, draw=figure.draw)
        self._ask(_("Save the figure"), FIGURES, figure.title, folder)

    def _ask(self, title: str, kinds: Mapping[str, str], name: str, folder: Path | None = None) -> None:
        where, endings = folder or self._desk.around.folder, list(kinds)
        words = {_(text): ending for ending, text in kinds.items()}
        dialog = QFileDialog(self._over, title, str(where), ";;".join(words))
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setOption(QFileDialog.Option.DontConfirmOverwrite)  # asked here, the same way on every system
        dialog.setDefaultSuffix(endings[0][1:])
        dialog.selectFile(free_name(where, name, endings[0]))
        dialog.filterSelected.connect(functools.partial(_take_ending, dialog, words))
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(self._chosen)
        dialog.open()

    def _chosen(self, name: str) -> None:
        self._path = Path(name)
        if not self._path.exists():
            self._begin()
            return
        question = QMessageBox(
            QMessageBox.Icon.Warning,
            _("Replace the file?"),
            _("{name} is there already. Replace it?").format(name=self._path.name),
            QMessageBox.StandardButton.Cancel,
            self._over,
        )
        question.setTextFormat(Qt.TextFormat.PlainText)
        replace = question.addButton(_("Replace"), QMessageBox.ButtonRole.DestructiveRole)
        question.setDefaultButton(QMessageBox.StandardButton.Cancel)
        question.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        replace.clicked.connect(self._begin)
        question.open()

    def _begin(self) -> None:
        if self._desk.busy or self._write is None:
            self._desk.say(_("Nothing is saved: something else goes on. Try again."), problem=True)
            return
        self._desk.jobs.do(functools.partial(self._write, self._path), self._written, self._failed)

    def _written(self, path: Path) -> None:
        self._desk.say(_("Saved in {path}.").format(path=path))

    def _failed(self, words: str) -> None:
        self._desk.say(words, problem=True)


def _take_ending(dialog: QFileDialog, words: Mapping[str, str], kind: str) -> None:
    """Give the name that stands in the dialog the ending of the kind that is chosen."""
    ending = words.get(kind, "")
    dialog.setDefaultSuffix(ending[1:])
    for name in dialog.selectedFiles()[:1]:
        path = Path(name)
        if path.suffix.lower() in FIGURES and ending:
            dialog.selectFile(path.with_suffix(ending).name)


__all__ = ["OnPaper", "Saver"]
