"""The sessions as a model and as a tree, with a filter by search words, subject, site and kind."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path

from PySide6.QtCore import (
    QAbstractItemModel,
    QModelIndex,
    QObject,
    QPersistentModelIndex,
    QPoint,
    QSortFilterProxyModel,
    Qt,
    Signal,
)
from PySide6.QtGui import QColor, QKeyEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QAbstractItemView, QApplication, QMenu, QTreeView, QWidget

from tissueid.app import build
from tissueid.app.theme import appearance
from tissueid.app.views.researcher.session_search import VERDICTS, SessionEntry, TestEntry
from tissueid.app.widgets import plain_tip
from tissueid.formatting import clean, fixed, subject_text
from tissueid.language import _, marked
from tissueid.messages import MISSING

COLUMNS = (
    marked("Date"),
    marked("Subject"),
    marked("Site"),
    marked("Quality"),
    marked("Tests"),
    marked("Kind"),
    marked("Duration"),
    marked("Configuration"),
    marked("File"),
)
DATE, SUBJECT, SITE, QUALITY, TESTS, KIND, DURATION, CONFIGURATION, FILE = range(len(COLUMNS))
SORT = Qt.ItemDataRole.UserRole
"""What a column is sorted by."""
WORDS = Qt.ItemDataRole.UserRole + 1
"""All that a row says, folded for searching; of a test with what its session says."""
ITEM = Qt.ItemDataRole.UserRole + 2
"""The row's :class:`Entry` or :class:`TestEntry` itself."""

Index = QModelIndex | QPersistentModelIndex
_ROOT = QModelIndex()
_VALUES = (marked("aborted"), marked("recovered"), marked("stochastic"))
"""Values of attributes that are shown translated; others are shown as they are in the file."""
VERDICT_WORDS = {"": MISSING, "good": marked("Good"), "look": marked("Look"), "repeat": marked("Repeat")}
_VERDICT_COLOURS = {"good": "good", "look": "check", "repeat": "poor"}
_NUMBERS = (TESTS, DURATION)
_MOST_NAMED = 3


class SessionModel(QAbstractItemModel):
    """Rows of files in the order in which they were found. An index's id is 0 for a file, 1 + its row for a test."""

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._entries: list[SessionEntry] = []
        self._rows: dict[Path, int] = {}
        self._shown: list[list[_Row]] = []

    @property
    def entries(self) -> Sequence[SessionEntry]:
        """All files in the list."""
        return self._entries

    @property
    def by_path(self) -> dict[Path, SessionEntry]:
        """All files in the list, by path."""
        return {entry.path: entry for entry in self._entries}

    def add(self, entries: Iterable[SessionEntry]) -> None:
        """Add files to the list; a listed file is replaced."""
        changed = {entry.path: entry for entry in entries}
        fresh = [entry for path, entry in changed.items() if path not in self._rows]
        if any(self._entries[self._rows[path]] != entry for path, entry in changed.items() if path in self._rows):
            self.show(list((self.by_path | changed).values()))
        elif fresh:
            first = len(self._entries)
            self.beginInsertRows(_ROOT, first, first + len(fresh) - 1)
            self._take(fresh)
            self.endInsertRows()

    def show(self, entries: Sequence[SessionEntry]) -> None:
        """List these files only."""
        self.beginResetModel()
        self._entries, self._rows, self._shown = [], {}, []
        self._take(entries)
        self.endResetModel()

    def _take(self, entries: Iterable[SessionEntry]) -> None:
        for entry in entries:
            self._rows[entry.path] = len(self._entries)
            self._entries.append(entry)
            head = _session_row(entry)
            self._shown.append([head, *(_test_row(entry, test, head) for test in entry.tests)])

    # -- what Qt asks -------------------------------------------------------------------------------------

    def index(self, row: int, column: int, parent: Index = _ROOT) -> QModelIndex:
        """Return the index of a cell."""
        if not self.hasIndex(row, column, parent):
            return QModelIndex()
        return self.createIndex(row, column, parent.row() + 1 if parent.isValid() else 0)

    def parent(self, index: Index = _ROOT) -> QModelIndex:  # type: ignore[override]
        """Return the file of a test."""
        if not index.isValid() or index.internalId() == 0:
            return QModelIndex()
        return self.createIndex(int(index.internalId()) - 1, 0, 0)

    def rowCount(self, parent: Index = _ROOT) -> int:  # noqa: N802
        """Return the number of files, or of tests of a file."""
        if not parent.isValid():
            return len(self._entries)
        if parent.internalId() or parent.column() > 0:
            return 0
        return len(self._entries[parent.row()].tests)

    def columnCount(self, parent: Index = _ROOT) -> int:  # noqa: N802
        """Return the number of columns."""
        return len(COLUMNS)

    def flags(self, index: Index) -> Qt.ItemFlag:
        """Return the flags of a cell; a file that is not a session cannot be selected."""
        if not index.isValid():
            return Qt.ItemFlag.NoItemFlags
        enabled = Qt.ItemFlag.ItemIsEnabled
        return enabled if self._row(index).problem else enabled | Qt.ItemFlag.ItemIsSelectable

    def headerData(self, section: int, way: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> object:  # noqa: N802
        """Return the headings."""
        if way == Qt.Orientation.Horizontal and role == Qt.ItemDataRole.DisplayRole:
            return _(COLUMNS[section])
        if role == Qt.ItemDataRole.TextAlignmentRole:
            side = Qt.AlignmentFlag.AlignRight if section in _NUMBERS else Qt.AlignmentFlag.AlignLeft
            return side | Qt.AlignmentFlag.AlignVCenter
        return None

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return the data of a cell."""
        if not index.isValid():
            return None
        row, column = self._row(index), index.column()
        if role == Qt.ItemDataRole.DisplayRole:
            return row.texts[column]
        if role == SORT:
            return row.keys[column]
        if role == WORDS:
            return row.search_text
        if role == ITEM:
            return row.item
        if role == Qt.ItemDataRole.ToolTipRole:
            return plain_tip(row.hint or row.texts[column])
        if role == Qt.ItemDataRole.AccessibleTextRole:
            return f"{_(COLUMNS[column])}: {row.texts[column]}"
        if role == Qt.ItemDataRole.TextAlignmentRole and column in _NUMBERS:
            return Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        if role == Qt.ItemDataRole.ForegroundRole:
            colour = "muted" if row.problem else _VERDICT_COLOURS.get(row.verdict, "") if column == QUALITY else ""
            return QColor(getattr(appearance.theme, colour)) if colour else None
        return None

    def _row(self, index: Index) -> _Row:
        parent = int(index.internalId())
        return self._shown[parent - 1][index.row() + 1] if parent else self._shown[index.row()][0]


class _Row:
    """Texts and sort keys of a row."""

    __slots__ = ("hint", "item", "keys", "problem", "search_text", "texts", "verdict")

    def __init__(
        self,
        item: SessionEntry | TestEntry,
        texts: list[str],
        keys: list[float | str],
        *,
        verdict: str = "",
        more: str = "",
    ) -> None:
        self.item = item
        self.texts = texts
        self.keys = keys
        self.verdict = verdict
        self.problem = isinstance(item, SessionEntry) and bool(item.problem)
        self.hint = f"{item.path}\n{item.problem}" if isinstance(item, SessionEntry) and item.problem else ""
        self.search_text = " ".join([*texts, more]).casefold()


def _session_row(entry: SessionEntry) -> _Row:
    name = clean(entry.path.name)
    if entry.problem:
        texts = [f"{name}: {entry.problem}", *[""] * (len(COLUMNS) - 1)]
        return _Row(entry, texts, [-1.0, "", "", -1.0, -1.0, "", -1.0, "", name.casefold()])
    verdict = max((test.verdict for test in entry.tests), key=VERDICTS.index, default="")
    seconds = sum(test.seconds for test in entry.tests)
    texts = [
        _date(entry.when),
        subject_text(entry.pseudonym),
        _joined(test.site for test in entry.tests) or name,
        _(VERDICT_WORDS[verdict]),
        str(len(entry.tests)),
        _joined(_(test.kind) for test in entry.tests),
        f"{fixed(seconds, 1)} s",
        _joined(_(test.configuration) for test in entry.tests),
        name,
    ]
    return _Row(entry, texts, _keys(texts, entry.when, len(entry.tests), verdict, seconds), verdict=verdict)


def _test_row(entry: SessionEntry, test: TestEntry, session: _Row) -> _Row:
    ended = "" if test.status == "completed" else f", {_(test.status)}"
    # The newest session comes first, and its first test too.
    texts = [
        _("Test {number}{site}").format(number=test.number, site=ended),
        "",
        clean(test.site),
        _(VERDICT_WORDS[test.verdict]),
        "",
        _(test.kind),
        f"{fixed(test.seconds, 1)} s",
        _(test.configuration),
        "",
    ]
    keys = _keys(texts, -test.number, 0, test.verdict, test.seconds)
    more = " ".join(session.texts[column] for column in (DATE, SUBJECT, FILE))
    return _Row(test, texts, keys, verdict=test.verdict, more=f"{more} {len(entry.tests)}")


def _keys(texts: list[str], first: float, tests: int, verdict: str, seconds: float) -> list[float | str]:
    keys: list[float | str] = [text.casefold() for text in texts]
    keys[DATE] = first if math.isfinite(first) else 0.0
    keys[TESTS], keys[QUALITY], keys[DURATION] = float(tests), float(VERDICTS.index(verdict)), seconds
    return keys


def _date(when: float) -> str:
    """Return local date and time of day."""
    try:
        return datetime.fromtimestamp(when).strftime("%Y-%m-%d %H:%M")
    except (ValueError, OverflowError, OSError):
        return MISSING


def _joined(texts: Iterable[str]) -> str:
    named = list(dict.fromkeys(clean(text) for text in texts))
    return ", ".join(named[:_MOST_NAMED]) + (", …" if len(named) > _MOST_NAMED else "")


class SessionFilter(QSortFilterProxyModel):
    """A session is shown when one of its tests is; a file that is no session while nothing but words are asked for."""

    def __init__(self, model: SessionModel, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._words: tuple[str, ...] = ()
        self._subject = self._site = self._kind = ""
        self.setSourceModel(model)
        self.setSortRole(SORT)
        self.sort(DATE, Qt.SortOrder.DescendingOrder)

    def ask(self, search: str, subject: str, site: str, kind: str) -> None:
        """Set the search words and filters; "" is no filter."""
        asked = tuple(search.casefold().split()), subject, site, kind
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
            self._wants(item, test, model.data(model.index(test_row, DATE, index), WORDS))
            for test_row, test in zip(tests, item.tests, strict=True)
        )

    def shown(self) -> Iterator[tuple[QModelIndex, SessionEntry]]:
        """Yield the shown files in order, with their indices."""
        for row in range(self.rowCount()):
            index = self.index(row, DATE)
            yield index, self.data(index, ITEM)

    def _wants(self, entry: SessionEntry, test: TestEntry, text: str) -> bool:
        return (
            self._subject in ("", entry.pseudonym)
            and self._site in ("", test.site)
            and self._kind in ("", test.kind)
            and self._has_words(text)
        )

    def _has_words(self, text: str) -> bool:
        return all(word in text for word in self._words)


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
            style_sheet="QTreeView::item { padding: 2px 0px; }",
            sorting_enabled=True,
            expands_on_double_click=False,
            tab_key_navigation=False,
            text_elide_mode=Qt.TextElideMode.ElideRight,
        )
        header = build.styled(
            self.header(),
            stretch_last_section=True,
            sections_movable=True,
            context_menu_policy=Qt.ContextMenuPolicy.CustomContextMenu,
            tip=_("The menu chooses the columns; where there is no room, some are hidden"),
        )
        header.customContextMenuRequested.connect(self._offer_columns)
        header.sectionResized.connect(self._take_width)
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
            build.add_check(menu, title, column not in self._unwanted, functools.partial(self._want, column))
        return menu

    def _offer_columns(self, position: QPoint) -> None:
        self.columns_menu().popup(self.header().mapToGlobal(position))

    def _want(self, column: int, _wanted: bool) -> None:
        self._unwanted ^= {column}
        self.fold()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Open on Return on every platform."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.isAutoRepeat():
            if self.currentIndex().isValid():
                self.opened.emit(self.currentIndex())
            return
        super().keyPressEvent(event)

    def say_empty(self, text: str) -> None:
        """Set the text of the empty list."""
        self._empty = text
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
