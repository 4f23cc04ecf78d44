"""Tree view of the sessions, with a filter by search words, subject, site and kind."""

from __future__ import annotations

from collections.abc import Iterator

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QSortFilterProxyModel, Qt, Signal
from PySide6.QtGui import QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QAbstractItemView, QTreeView, QWidget

from tissueid.app.views.researcher.session_model import (
    CONFIGURATION,
    DATE,
    DURATION,
    FILE,
    ITEM,
    KIND,
    SORT,
    TESTS,
    WORDS,
    SessionModel,
)
from tissueid.app.views.researcher.session_search import SessionEntry, TestEntry
from tissueid.language import _


class SessionFilter(QSortFilterProxyModel):
    """A session is shown when one of its tests is; a file that is no session while nothing but words are asked for."""

    def __init__(self, model: SessionModel, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._words: tuple[str, ...] = ()
        self._subject = self._site = self._kind = ""
        self.setSourceModel(model)
        self.setSortRole(SORT)
        self.sort(DATE, Qt.SortOrder.DescendingOrder)

    def ask(self, words: str, subject: str, site: str, kind: str) -> None:
        """Set the search words and filters; "" is no filter."""
        asked = tuple(words.casefold().split()), subject, site, kind
        if asked != (self._words, self._subject, self._site, self._kind):
            self._words, self._subject, self._site, self._kind = asked
            self.invalidateFilter()

    def filterAcceptsRow(self, row: int, parent: QModelIndex | QPersistentModelIndex) -> bool:  # noqa: N802
        """Return whether a row is shown."""
        model = self.sourceModel()
        index = model.index(row, DATE, parent)
        item = model.data(index, ITEM)
        if isinstance(item, TestEntry):
            return self._wants(model.data(parent, ITEM), item, model.data(index, WORDS))
        if not isinstance(item, SessionEntry):
            return False
        if not item.tests:
            bare = not (self._site or self._kind) and self._subject in ("", item.pseudonym)
            return bare and self._has_words(model.data(index, WORDS))
        tests = range(model.rowCount(index))
        return any(
            self._wants(item, test, model.data(model.index(place, DATE, index), WORDS))
            for place, test in zip(tests, item.tests, strict=True)
        )

    def shown(self) -> Iterator[tuple[QModelIndex, SessionEntry]]:
        """Yield the shown files in order, with their indices."""
        for row in range(self.rowCount()):
            index = self.index(row, DATE)
            yield index, self.data(index, ITEM)

    def _wants(self, entry: SessionEntry, test: TestEntry, words: str) -> bool:
        return (
            self._subject in ("", entry.pseudonym)
            and self._site in ("", test.site)
            and self._kind in ("", test.kind)
            and self._has_words(words)
        )

    def _has_words(self, words: str) -> bool:
        return all(word in words for word in self._words)


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
