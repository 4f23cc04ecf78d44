"""The list of sessions as people see it."""

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
    """``opened`` carries the place that was double-clicked, or where Return was pressed."""

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
        """Fold the columns away that there is no room for, the least important first."""
        super().resizeEvent(event)
        self.fold()

    def fold(self) -> None:
        """Hide columns until the others fit, and show them again where there is room; they stay searched."""
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
        """Return opens, wherever a system has other habits."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.isAutoRepeat():
            if self.currentIndex().isValid():
                self.opened.emit(self.currentIndex())
            return
        super().keyPressEvent(event)

    def say_empty(self, words: str) -> None:
        """What stands in the list while it is empty."""
        self._empty = words
        self.viewport().update()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        """The list, or why there is none."""
        super().paintEvent(event)
        if self._empty and not self._shown.rowCount():
            painter = QPainter(self.viewport())
            painter.setPen(self.palette().placeholderText().color())
            painter.drawText(self.viewport().rect(), Qt.AlignmentFlag.AlignCenter, self._empty)

    def span_problems(self) -> None:
        """A file that is no session has one long cell: its name and what is wrong with it."""
        for index, entry in self._shown.shown():
            if entry.problem and not self.isFirstColumnSpanned(index.row(), QModelIndex()):
                self.setFirstColumnSpanned(index.row(), QModelIndex(), True)


__all__ = ["SessionTree"]
