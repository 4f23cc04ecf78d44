"""Tree view of the sessions."""

from __future__ import annotations

from PySide6.QtCore import QModelIndex, Qt, Signal
from PySide6.QtGui import QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QAbstractItemView, QTreeView, QWidget

from tissueid.app.views.researcher.session_filter import SessionFilter
from tissueid.app.views.researcher.session_model import CONFIGURATION, DURATION, FILE, KIND, TESTS
from tissueid.language import _

_FOLDED = (FILE, CONFIGURATION, KIND, DURATION, TESTS)
"""Columns that are hidden where there is no room, in this order."""
_UNKNOWN = 90
"""Pixels for a column that was hidden when its width was asked for."""


class SessionTree(QTreeView):
    """List of sessions; ``opened`` carries the index of a double click or of Return."""

    opened = Signal(QModelIndex)

    def __init__(self, shown: SessionFilter, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._shown = shown
        self._empty = ""
        self._widths: dict[int, int] = {}
        self.setModel(shown)
        self.setAccessibleName(_("Sessions and their tests"))
        self.setToolTip(_("Return or a double click opens a session; Shift and Ctrl select several"))
        self.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setUniformRowHeights(True)
        self.setSortingEnabled(True)
        self.setExpandsOnDoubleClick(False)
        self.setTabKeyNavigation(False)
        self.setTextElideMode(Qt.TextElideMode.ElideRight)
        self.header().setStretchLastSection(True)
        self.header().setSectionsMovable(True)
        self.sortByColumn(shown.sortColumn(), shown.sortOrder())
        self.doubleClicked.connect(self.opened)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Hide the columns that do not fit, the least important first."""
        super().resizeEvent(event)
        self.fold()

    def fold(self) -> None:
        """Hide columns until the others fit; hidden columns are still searched."""
        header, room = self.header(), self.viewport().width()
        for column in range(header.count()):  # once: later the last one shown is stretched
            self._widths.setdefault(column, header.sectionSize(column) or _UNKNOWN)
        needed = sum(self._widths.values())
        for column in _FOLDED:
            hidden = needed > room
            needed -= self._widths.get(column, 0) if hidden else 0
            if self.isColumnHidden(column) != hidden:
                self.setColumnHidden(column, hidden)

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Open on Return on every platform."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.isAutoRepeat():
            if self.currentIndex().isValid():
                self.opened.emit(self.currentIndex())
            return
        super().keyPressEvent(event)

    def say_empty(self, words: str) -> None:
        """Set the text of the empty list."""
        self._empty = words
        self.viewport().update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """Draw the list, or the text of the empty list."""
        super().paintEvent(event)
        if self._empty and not self._shown.rowCount():
            painter = QPainter(self.viewport())
            painter.setPen(self.palette().placeholderText().color())
            painter.drawText(self.viewport().rect(), Qt.AlignmentFlag.AlignCenter, self._empty)

    def span_problems(self) -> None:
        """Let the text of an unreadable file span all columns."""
        for index, entry in self._shown.shown():
            if entry.problem and not self.isFirstColumnSpanned(index.row(), QModelIndex()):
                self.setFirstColumnSpanned(index.row(), QModelIndex(), True)


__all__ = ["SessionTree"]
