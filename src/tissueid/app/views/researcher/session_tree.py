"""Tree view of the sessions, with a filter by search words, subject, site and kind."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QPoint, QSortFilterProxyModel, Qt, Signal
from PySide6.QtGui import QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QAbstractItemView, QApplication, QMenu, QTreeView, QWidget

from tissueid.app import build
from tissueid.app.views.researcher.session_model import (
    CONFIGURATION,
    DATE,
    DURATION,
    FILE,
    ITEM,
    KIND,
    QUALITY,
    SORT,
    TESTS,
    VERDICT_WORDS,
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
_WIDTHS = (138, 60, 98, 66, 46, 84, 70, 100, 180)
"""Widths of the columns until a person changes them, pixels."""
_CELL = 14
"""Width of a cell next to its text, pixels."""
_WIDEST = 2000


class SessionTree(QTreeView):
    """List of sessions; ``opened`` carries the index of a double click or of Return."""

    opened = Signal(QModelIndex)

    def __init__(self, shown: SessionFilter, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._shown = shown
        self._empty = ""
        self._widths = list(_WIDTHS)
        verdict = max(map(self.fontMetrics().horizontalAdvance, map(_, VERDICT_WORDS.values())))
        self._widths[QUALITY] = max(_WIDTHS[QUALITY], verdict + _CELL)
        self._unwanted: set[int] = set()
        self.setModel(shown)
        build.styled(
            self,
            name=_("Sessions and their tests"),
            tip=_("Return or a double click opens a session; Shift and Ctrl select several"),
            selection_mode=QAbstractItemView.SelectionMode.ExtendedSelection,
            selection_behavior=QAbstractItemView.SelectionBehavior.SelectRows,
            edit_triggers=QAbstractItemView.EditTrigger.NoEditTriggers,
            uniform_row_heights=True,
        )
        self.setStyleSheet("QTreeView::item { padding: 2px 0px; }")
        build.styled(
            self,
            sorting_enabled=True,
            expands_on_double_click=False,
            tab_key_navigation=False,
            text_elide_mode=Qt.TextElideMode.ElideRight,
        )
        self.header().setStretchLastSection(True)
        self.header().setSectionsMovable(True)
        self.header().setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
        self.header().customContextMenuRequested.connect(self._offer_columns)
        self.header().sectionResized.connect(self._take_width)
        self.header().setToolTip(_("The menu chooses the columns; where there is no room, some are hidden"))
        self.sortByColumn(shown.sortColumn(), shown.sortOrder())
        self.doubleClicked.connect(self.opened)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Hide the columns that do not fit, the least important first."""
        super().resizeEvent(event)
        self.fold()

    def fold(self) -> None:
        """Hide columns until the others fit; hidden columns are still searched."""
        wanted = [column for column in range(self.header().count()) if column not in self._unwanted]
        needed, hidden = sum(self._widths[column] for column in wanted), set(self._unwanted)
        for column in (column for column in _FOLDED if column in wanted):
            if needed > self.viewport().width():
                needed -= self._widths[column]
                hidden.add(column)
        for column, width in enumerate(self._widths):
            if self.isColumnHidden(column) != (column in hidden):
                self.setColumnHidden(column, column in hidden)
                if column not in hidden:
                    self.header().resizeSection(column, width)

    def widths(self) -> list[str]:
        """Return the widths of the columns as texts; those of columns that are not wanted are negative."""
        return [str(-width if column in self._unwanted else width) for column, width in enumerate(self._widths)]

    def restore(self, widths: Sequence[str]) -> None:
        """Restore what ``widths`` returned; anything else is ignored."""
        if len(widths) == len(_WIDTHS) and all(text.removeprefix("-").isdecimal() for text in widths):
            self._widths = [min(max(abs(int(text)), 20), _WIDEST) for text in widths]
            self._unwanted = {column for column, text in enumerate(widths) if text.startswith("-")} - {DATE}
        for column, width in enumerate(self._widths):
            self.header().resizeSection(column, width)
        self.fold()

    def _take_width(self, column: int, _before: int, width: int) -> None:
        # Only what a person drags: the last column is stretched, and takes the room of hidden ones.
        if QApplication.mouseButtons() & Qt.MouseButton.LeftButton and width:
            self._widths[column] = width

    def columns_menu(self) -> QMenu:
        """Return the menu of the header, with an entry for each column that can be hidden."""
        menu = build.styled(QMenu(self), attribute=Qt.WidgetAttribute.WA_DeleteOnClose)
        for column in range(1, self.header().count()):
            title = str(self.model().headerData(column, Qt.Orientation.Horizontal))
            action = menu.addAction(title, functools.partial(self._want, column))
            action.setCheckable(True)
            action.setChecked(column not in self._unwanted)
        return menu

    def _offer_columns(self, place: QPoint) -> None:
        self.columns_menu().popup(self.header().mapToGlobal(place))

    def _want(self, column: int) -> None:
        self._unwanted ^= {column}
        self.fold()

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
