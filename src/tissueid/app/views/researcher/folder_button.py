"""Button for the folders that are searched for sessions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFileDialog, QMenu, QPushButton, QWidget

from tissueid.app.views.researcher.tool_tips import plain_tip
from tissueid.formatting import clean
from tissueid.language import _

_LONGEST = 70


class FolderButton(QPushButton):
    """Button with a menu to add and remove folders; ``changed`` is emitted on each change."""

    changed = Signal()

    def __init__(self, paths: Sequence[Path], parent: QWidget | None = None) -> None:
        super().__init__(_("Folders"), parent)
        self.paths = list(paths)
        self.setMenu(QMenu(self))
        self._fill()

    def add(self, path: str) -> None:
        """Add a folder."""
        folder = Path(path)
        if path and folder not in self.paths:
            self.paths.append(folder)
            self._fill()
            self.changed.emit()

    def remove(self, path: Path) -> None:
        """Remove a folder."""
        if path in self.paths:
            self.paths.remove(path)
            self._fill()
            self.changed.emit()

    def _fill(self) -> None:
        menu = self.menu()
        menu.clear()
        menu.addAction(_("Add a folder…"), self._choose)
        menu.addSeparator()
        for path in self.paths:
            text = clean(str(path))
            text = text if len(text) <= _LONGEST else f"…{text[-_LONGEST:]}"
            menu.addAction(_("Remove {path}").format(path=text).replace("&", "&&"), partial(self.remove, path))
        listed = "\n".join(clean(str(path)) for path in self.paths)
        self.setToolTip(plain_tip(f"{_('Sessions are looked for in these folders, and below them:')}\n{listed}"))
        self.setAccessibleName(_("Folders that are looked through: {count}").format(count=len(self.paths)))

    def _choose(self) -> None:
        where = str(self.paths[-1]) if self.paths else ""
        dialog = QFileDialog(self.window(), _("Look for sessions in"), where)
        dialog.setFileMode(QFileDialog.FileMode.Directory)
        dialog.setOption(QFileDialog.Option.ShowDirsOnly)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(self.add)
        dialog.open()


__all__ = ["FolderButton"]
