"""The diagnoses of this sitting, to compare: session, verdict, stage and effect."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QLabel, QListWidget, QListWidgetItem, QPushButton, QVBoxLayout, QWidget

from tissueid.app.views.gap.diagnosing import Result
from tissueid.app.views.gap.words import STAGE_TITLES, VERDICT_WORDS
from tissueid.language import _
from tissueid.wording import clean

_WIDTH, _LEAST_WIDTH = 196, 120
_MOST = 20
"""Each takes some twenty megabytes."""
_LONGEST = 40


class History(QWidget):
    """The newest first. ``chosen`` says that another one is to be shown."""

    chosen = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setMinimumWidth(_LEAST_WIDTH)
        self.setMaximumWidth(_WIDTH)
        self._results: list[Result] = []
        self.list = QListWidget()
        self.list.setAccessibleName(_("Diagnoses of this sitting, newest first"))
        self.list.setWordWrap(True)
        self.list.setSpacing(2)
        self.list.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.list.currentRowChanged.connect(self._tell)
        self.remove = QPushButton(_("Remove"))
        self.remove.setAccessibleName(_("Remove the chosen diagnosis from the list"))
        self.remove.setToolTip(_("Delete does the same; Ctrl+Z brings it back"))
        self.remove.clicked.connect(self._remove)
        self._removed: tuple[int, Result] | None = None
        for keys, slot in (
            (QKeySequence.StandardKey.Delete, self._remove),
            (QKeySequence.StandardKey.Undo, self._undo),
        ):
            shortcut = QShortcut(QKeySequence(keys), self)
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(slot)
        heading = QLabel(_("Diagnoses"))
        heading.setProperty("role", "heading")
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(6)
        column.addWidget(heading)
        column.addWidget(self.list, 1)
        column.addWidget(self.remove)
        self._tell()

    @property
    def result(self) -> Result | None:
        """The chosen one."""
        row = self.list.currentRow()
        return self._results[row] if 0 <= row < len(self._results) else None

    def add(self, result: Result) -> None:
        """Put a diagnosis on top and choose it; the oldest goes where there are too many."""
        self._put(0, result)

    def _put(self, place: int, result: Result) -> None:
        self._results.insert(place, result)
        words = _words(result)
        item = QListWidgetItem("\n".join(words))
        item.setToolTip(clean(str(result.asked.session)))
        item.setData(Qt.ItemDataRole.AccessibleTextRole, ", ".join(words))
        self.list.blockSignals(True)
        self.list.insertItem(place, item)
        while len(self._results) > _MOST:
            self._results.pop()
            self.list.takeItem(len(self._results))
        self.list.setCurrentRow(min(place, len(self._results) - 1))
        self.list.blockSignals(False)
        self._tell()

    def _remove(self) -> None:
        row = self.list.currentRow()
        if 0 <= row < len(self._results):
            self.list.blockSignals(True)
            self._removed = row, self._results.pop(row)
            self.list.setFocus()  # the button may have nothing more to do; here the keys for the list are heard
            self.list.takeItem(row)
            self.list.blockSignals(False)
            self._tell()

    def _undo(self) -> None:
        """What was removed last comes back to its place."""
        if self._removed is not None:
            (place, result), self._removed = self._removed, None
            self._put(min(place, len(self._results)), result)

    def _tell(self) -> None:
        self.remove.setEnabled(self.result is not None)
        self.chosen.emit()


def _words(result: Result) -> list[str]:
    story = result.story
    words = [clean(result.asked.session.name)[:_LONGEST], _(VERDICT_WORDS[story.verdict])]
    if story.at_fault:
        words[1] += f"  ·  {', '.join(_(STAGE_TITLES[stage]) for stage in story.at_fault)}"
    if story.effect:
        words.append(story.effect[:1].upper() + story.effect[1:])
    if result.twin is not None:
        words.append(_("from twin {name}").format(name=result.twin.name))
    return words
