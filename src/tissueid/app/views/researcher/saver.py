"""Asks where a table or a figure is to be saved, and has it written."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

from PySide6.QtCore import QObject, Qt
from PySide6.QtWidgets import QFileDialog, QWidget

from tissueid.app.language import _, marked
from tissueid.app.views.researcher.saving import picture_of, write_bytes, write_table
from tissueid.app.views.view import Desk

_PICTURES = marked("Portable network graphics (*.png);;Scalable vector graphics (*.svg)")


class Saver(QObject):
    """Opens one dialog at a time over its parent; what is written is said in the strip of the window."""

    def __init__(self, desk: Desk, parent: QWidget) -> None:
        super().__init__(parent)
        self._desk = desk
        self._over = parent
        self._rows: Sequence[Sequence[str]] = ()
        self._figure: QWidget | None = None

    def save_table(self, rows: Sequence[Sequence[str]]) -> None:
        """Ask for a file, and write rows into it as CSV."""
        self._rows = rows
        self._ask(_("Save the table of results"), _("Comma-separated values (*.csv)"), "csv", self._write_table)

    def save_figure(self, figure: QWidget) -> None:
        """Ask for a file, and write a widget into it as it stands."""
        self._figure = figure
        self._ask(_("Save the figure"), _(_PICTURES), "png", self._write_figure)

    def _ask(self, title: str, kinds: str, suffix: str, then: Callable[[str], None]) -> None:
        dialog = QFileDialog(self._over, title, str(self._desk.around.folder), kinds)
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setDefaultSuffix(suffix)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(then)
        dialog.open()

    def _write_table(self, path: str) -> None:
        if not self._desk.busy:
            work = functools.partial(write_table, Path(path), self._rows)
            self._desk.jobs.do(work, self._written, self._failed)

    def _write_figure(self, path: str) -> None:
        if self._figure is not None and not self._desk.busy:
            work = functools.partial(write_bytes, Path(path), picture_of(self._figure, Path(path)))
            self._desk.jobs.do(work, self._written, self._failed)

    def _written(self, path: Path) -> None:
        self._desk.say(_("Saved in {path}.").format(path=path))

    def _failed(self, words: str) -> None:
        self._desk.say(words, problem=True)
