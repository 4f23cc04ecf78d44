"""The sessions as a tree for Qt's views: files, and below each its tests."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from PySide6.QtCore import QAbstractItemModel, QModelIndex, QObject, QPersistentModelIndex, Qt
from PySide6.QtGui import QColor

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
            return row.words
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

    __slots__ = ("hint", "item", "keys", "problem", "texts", "verdict", "words")

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
        self.words = " ".join([*texts, more]).casefold()


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
