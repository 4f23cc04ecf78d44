"""Exports the selected tests: a button with a menu of formats, a dialog for the folder, and the work in a thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QMenu, QPushButton, QWidget

from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.errand import ErrandStrip
from tissueid.app.views.researcher.exporting import EXPORTS, Export
from tissueid.app.views.view import Desk
from tissueid.language import _


class ExportButton(QPushButton):
    """``chosen`` answers which tests are selected when it is pressed."""

    def __init__(
        self, desk: Desk, strip: ErrandStrip, chosen: Callable[[], Sequence[Chosen]], parent: QWidget | None = None
    ) -> None:
        super().__init__(_("Export data"), parent)
        self._desk = desk
        self._strip = strip
        self._chosen = chosen
        self._busy = False
        self.setToolTip(_("The selected tests as files for other programs, a folder a session"))
        self.setMenu(QMenu(self))
        for kind, words in EXPORTS.items():
            self.menu().addAction(f"{_(words)}…", partial(self._choose, kind))
        self.settle(busy=False)

    def settle(self, *, busy: bool) -> None:
        """There must be something to export, and nothing else going on."""
        self._busy = busy
        self.setEnabled(not busy and bool(self._chosen()))

    def selection_changed(self) -> None:
        """Others are selected."""
        self.settle(busy=self._busy)

    def _choose(self, kind: str) -> None:
        chosen = list(self._chosen())
        if not chosen:
            return
        dialog = QFileDialog(self.window(), _("Export into a new folder in"), str(chosen[0].path.parent))
        dialog.setFileMode(QFileDialog.FileMode.Directory)
        dialog.setOption(QFileDialog.Option.ShowDirsOnly)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(partial(self._export, chosen, kind))
        dialog.open()

    def _export(self, chosen: Sequence[Chosen], kind: str, folder: str) -> None:
        if self._desk.busy:
            self._desk.say(_("Nothing is exported: something else goes on. Try again."), problem=True)
            return
        export = Export(chosen, Path(folder), kind, self._desk.trail)
        self._strip.watch(export)
        self._desk.jobs.do(export.run, self._exported, self._failed)

    def _exported(self, export: Export) -> None:
        self._strip.rest()
        self._desk.say(export.words_after, problem=bool(export.problems))

    def _failed(self, words: str) -> None:
        self._strip.rest()
        self._desk.say(words, problem=True)


__all__ = ["ExportButton"]
