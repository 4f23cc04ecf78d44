"""Button that exports the selected tests, with a menu of formats and a folder dialog."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QMenu, QPushButton, QWidget

from tissueid.app.context import AppContext
from tissueid.app.views.researcher.background_work import ProgressStrip
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.views.researcher.session_export import EXPORTS, SessionExport
from tissueid.language import _


class ExportButton(QPushButton):
    """Export button; ``chosen`` returns the selected tests."""

    def __init__(
        self,
        context: AppContext,
        strip: ProgressStrip,
        chosen: Callable[[], Sequence[SelectedTest]],
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(_("Export data"), parent)
        self._context = context
        self._strip = strip
        self._chosen = chosen
        self._busy = False
        self.setToolTip(_("The selected tests as files for other programs, a folder a session"))
        self.setMenu(QMenu(self))
        for kind, words in EXPORTS.items():
            self.menu().addAction(f"{_(words)}…", partial(self._choose, kind))
        self.update_enabled(busy=False)

    def update_enabled(self, *, busy: bool) -> None:
        """Enable the button if tests are selected and no job runs."""
        self._busy = busy
        self.setEnabled(not busy and bool(self._chosen()))

    def selection_changed(self) -> None:
        """Update the button after a change of the selection."""
        self.update_enabled(busy=self._busy)

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

    def _export(self, chosen: Sequence[SelectedTest], kind: str, folder: str) -> None:
        if self._context.busy:
            self._context.say(_("Not exported: other work is running. Try again."), problem=True)
            return
        export = SessionExport(chosen, Path(folder), kind, self._context.trail)
        self._strip.watch(export)
        self._context.jobs.do(export.run, self._exported, self._failed)

    def _exported(self, export: SessionExport) -> None:
        self._strip.clear()
        self._context.say(export.words_after, problem=bool(export.problems))

    def _failed(self, words: str) -> None:
        self._strip.clear()
        self._context.say(words, problem=True)


__all__ = ["ExportButton"]
