"""The tests of a study: filters, choice of parameters, and the table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QObject, QPersistentModelIndex, Qt
from PySide6.QtGui import QColor, QKeySequence
from PySide6.QtWidgets import (
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QMenu,
    QTableView,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, fill, styled
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import appearance
from tissueid.app.views.studies.study_data import StudyData, TestRow
from tissueid.app.widgets import plain_tip
from tissueid.formatting import axis_label, clean, fixed, label_and_unit, plus_minus, subject_text
from tissueid.identification import engine_label, engine_names
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.records import Estimate
from tissueid.units import shown_si

_FIRST = (
    marked("Subject"),
    marked("Site"),
    marked("Condition"),
    marked("Repetition"),
    marked("Quality"),
    marked("Engine"),
    marked("VAF (%)"),
)
SUBJECT, SITE, CONDITION, REPEAT, QUALITY, ENGINE, VAF = range(len(_FIRST))
WITHOUT = "\n"
"""Filter of tests without a condition."""
_LAST = (marked("Remark"), marked("Session"))
_QUALITY_WORDS = {"good": marked("Good"), "look": marked("Look"), "repeat": marked("Repeat")}
_QUALITY_COLOURS = {"good": "good", "look": "check", "repeat": "poor"}

_ROLES = frozenset(
    {
        Qt.ItemDataRole.DisplayRole,
        Qt.ItemDataRole.ToolTipRole,
        Qt.ItemDataRole.TextAlignmentRole,
        Qt.ItemDataRole.ForegroundRole,
    }
)
"""Roles with an answer: a painted cell asks for seven."""
_RIGHT = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
Index = QModelIndex | QPersistentModelIndex
_TOP = QModelIndex()


class TestsModel(QAbstractTableModel):
    """Rows of tests. ``shown`` are the numbers of the rows that pass the filters, in the order of sorting."""

    __test__ = False

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._rows: tuple[TestRow, ...] = ()
        self._names: tuple[str, ...] = ()
        self._places: dict[str, int] = {}
        self._scales: dict[str, float] = {}
        self._asked: tuple[str, str, str, str] = ("", "", "", "")
        self._sorted: tuple[int, Qt.SortOrder] = (-1, Qt.SortOrder.AscendingOrder)
        self._labels = {name: engine_label(name) for name in engine_names()}
        self.shown: list[int] = []
        self.parameters: tuple[str, ...] = ()

    @property
    def without_test(self) -> list[int]:
        """Shown rows that are a session without a test: their first cell says why."""
        return [row for row, number in enumerate(self.shown) if not self._rows[number].is_test]

    @property
    def rows(self) -> Sequence[TestRow]:
        """All rows."""
        return self._rows

    def show_study(self, data: StudyData) -> None:
        """Show the tests of a study."""
        self.beginResetModel()
        self._rows, self._names = data.rows, data.parameters
        self._places = {name: index for index, name in enumerate(data.parameters)}
        self._take_scales()
        self.parameters = tuple(name for name in self.parameters if name in self._places) or data.parameters
        self._find()
        self.endResetModel()

    def show_parameters(self, names: Sequence[str]) -> None:
        """Show these parameters as columns."""
        self.beginResetModel()
        self.parameters = tuple(name for name in self._names if name in names)
        self._sorted = (-1, Qt.SortOrder.AscendingOrder)
        self._find()
        self.endResetModel()

    def filter(self, search: str = "", subject: str = "", site: str = "", condition: str = "") -> None:
        """Show the rows that have every word, and these values; "" asks for nothing."""
        self.beginResetModel()
        self._asked = (search, subject, site, condition)
        self._find()
        self.endResetModel()

    def sort(self, column: int, order: Qt.SortOrder = Qt.SortOrder.AscendingOrder) -> None:
        """Sort by a column; tests without a value come last, sessions without a test stay first."""
        self.layoutAboutToBeChanged.emit()
        self._sorted = (column, order)
        self._find()
        self.layoutChanged.emit()

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self.beginResetModel()
        self._take_scales()
        self.endResetModel()

    def _take_scales(self) -> None:
        """Take the factors from SI to the shown units."""
        self._scales = {name: shown_si(label_and_unit(name)[1])[1] for name in self._names}

    def _find(self) -> None:
        search, subject, site, condition = self._asked
        wanted = search.casefold().split()
        matches = [
            number
            for number, row in enumerate(self._rows)
            if (not subject or row.subject == subject)
            and (not site or row.site == site)
            and (not condition or (row.condition or WITHOUT * row.is_test) == condition)
            and all(word in row.search_text for word in wanted)
        ]
        column, order = self._sorted
        if 0 <= column < self.columnCount():
            key = self._key(column)
            keys = {number: key(self._rows[number]) for number in matches}
            first = [number for number in matches if not self._rows[number].is_test]
            tests = [number for number in matches if self._rows[number].is_test]
            empty = [number for number in tests if keys[number] in ("", -math.inf)]
            filled = [number for number in tests if keys[number] not in ("", -math.inf)]
            filled.sort(key=lambda number: keys[number], reverse=order == Qt.SortOrder.DescendingOrder)
            matches = first + filled + empty
        self.shown = matches

    def _key(self, column: int) -> Callable[[TestRow], Any]:
        """Return the function that gives what a column is sorted by: "" or -inf where a row has nothing."""
        if column == REPEAT:
            return lambda row: row.repeat or -math.inf
        if column == VAF:
            return lambda row: _sortable(row.vaf_percent)
        if len(_FIRST) <= column < len(_FIRST) + len(self.parameters):
            index = self._places[self.parameters[column - len(_FIRST)]]
            return lambda row: _sortable(row.values[index]) if row.values else -math.inf
        return lambda row: self._text(row, column).casefold()

    # -- what Qt asks -------------------------------------------------------------------------------------

    def rowCount(self, parent: Index = _TOP) -> int:  # noqa: N802
        """Return the number of rows that are shown."""
        return 0 if parent.isValid() else len(self.shown)

    def columnCount(self, parent: Index = _TOP) -> int:  # noqa: N802
        """Return the number of columns."""
        return 0 if parent.isValid() else len(_FIRST) + len(self.parameters) + len(_LAST)

    def headerData(self, section: int, way: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> object:  # noqa: N802
        """Return the headings."""
        if way != Qt.Orientation.Horizontal or role != Qt.ItemDataRole.DisplayRole:
            return None
        if section < len(_FIRST):
            return _(_FIRST[section])
        section -= len(_FIRST)
        if section < len(self.parameters):
            name = self.parameters[section]
            return axis_label(name, shown_si(label_and_unit(name)[1])[0])
        return _(_LAST[section - len(self.parameters)])

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> object:
        """Return the data of a cell."""
        if role not in _ROLES:
            return None
        row, column = self._rows[self.shown[index.row()]], index.column()
        if role == Qt.ItemDataRole.DisplayRole:
            return self._text(row, column)
        if role == Qt.ItemDataRole.ToolTipRole:
            return plain_tip(translated(row.problem) if row.problem else self._text(row, column))
        if role == Qt.ItemDataRole.TextAlignmentRole and self._is_number(column):
            return _RIGHT
        if role == Qt.ItemDataRole.ForegroundRole:
            colour = "muted" if row.problem else _QUALITY_COLOURS.get(row.quality, "") if column == QUALITY else ""
            return QColor(getattr(appearance.theme, colour)) if colour else None
        return None

    def _is_number(self, column: int) -> bool:
        return column in (REPEAT, VAF) or len(_FIRST) <= column < len(_FIRST) + len(self.parameters)

    def _text(self, row: TestRow, column: int) -> str:
        if column < len(_FIRST):
            return self._about(row, column)
        column -= len(_FIRST)
        if column < len(self.parameters):
            return self._value(row, self.parameters[column])
        return translated(row.problem) if column == len(self.parameters) else row.session

    def _about(self, row: TestRow, column: int) -> str:
        if not row.is_test:
            return f"{row.session}: {translated(row.problem)}" if column == 0 else ""
        if column == CONDITION:
            after = Message("study.after", "after {minutes:g} min", minutes=row.minutes)
            timed = row.condition and not math.isnan(row.minutes)
            return f"{row.condition}, {translated(after)}" if timed else row.condition
        if column == VAF:
            return MISSING if math.isnan(row.vaf_percent) else fixed(row.vaf_percent, 1)
        texts = {
            SUBJECT: subject_text(row.subject),
            SITE: row.site,
            REPEAT: str(row.repeat or MISSING),
            QUALITY: _(_QUALITY_WORDS[row.quality]) if row.quality in _QUALITY_WORDS else row.quality,
            ENGINE: self._labels.get(row.engine, row.engine),
        }
        return texts[column]

    def _value(self, row: TestRow, name: str) -> str:
        index = self._places[name]
        if not row.values or math.isnan(row.values[index]):
            return MISSING if row.is_test else ""
        std = row.stds[index]
        estimate = Estimate(row.values[index], None if math.isnan(std) else std)
        return plus_minus(estimate, self._scales[name])


def _sortable(value: float) -> float:
    return value if math.isfinite(value) else -math.inf


_ALL = (marked("All subjects"), marked("All sites"), marked("All conditions"))
_NAMES = (marked("Subject"), marked("Site"), marked("Condition"))
_MOST_OFFERED = 2000
_ROW, _LEAST = 22, 96
_MEASURED = 60
"""Rows that are looked at for the width of a column."""
_WIDEST = 240
_FILTERS_IN_A_ROW = 720
_MOST_SPANS = 300


class TestsTab(QWidget):
    """Filters above the table."""

    __test__ = False

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model = TestsModel(self)
        self._data: StudyData | None = None
        self.search = styled(
            QLineEdit(),
            placeholder_text=_("Search in all columns"),
            name=_("Search in all columns"),
            tip=_("Rows that have every word (Ctrl+F)"),
            clear_button_enabled=True,
        )
        filtering = _("Filter by {column}")
        self.choices = tuple(
            build.choice({"": _(text)}, self._filter, len(_(text)), name=filtering.format(column=_(name)))
            for name, text in zip(_NAMES, _ALL, strict=True)
        )
        self.subject, self.site, self.condition = self.choices
        self.parameters = button(_("Parameters"), tip=_("Columns of the table"), menu=QMenu(self))
        self.count = styled(QLabel(), role="muted", word_wrap=True, minimum_width=1)
        self.table = QTableView()
        self._dress()
        filters = build.holder(fill(FoldingBox(_FILTERS_IN_A_ROW), self.search, *self.choices, self.parameters))
        build.column(filters, (self.table, 1), self.count, margins=(0, 8, 0, 0), parent=self)
        self.search.textChanged.connect(self._filter)
        self.model.modelReset.connect(self._span)
        self.model.layoutChanged.connect(self._span)
        build.shortcut(self, QKeySequence.StandardKey.Find, self.search.setFocus)

    def show_study(self, data: StudyData) -> None:
        """Show the tests of a study; filters and columns stay as far as they fit."""
        self._data = data
        tests = [row for row in data.rows if row.is_test]
        self._offer(self.subject, {row.subject for row in tests})
        self._offer(self.site, {row.site for row in tests})
        self._offer(self.condition, {row.condition for row in tests})
        self.model.show_study(data)
        self._filter()
        self._fill_menu()
        self.table.resizeColumnsToContents()
        header = self.table.horizontalHeader()
        header.resizeSection(SUBJECT, header.fontMetrics().horizontalAdvance("P-0000000"))  # not the width of a reason
        for column in range(self.model.columnCount()):
            header.resizeSection(column, min(header.sectionSize(column), _WIDEST))

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.search, *self.choices, self.parameters, self.table]

    def _dress(self) -> None:
        table = self.table
        table.setModel(self.model)
        build.for_reading(
            table, _("Tests of the study"), _ROW, QHeaderView.ResizeMode.Interactive, minimum_height=_LEAST
        )
        table.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        header = table.horizontalHeader()
        header.setResizeContentsPrecision(_MEASURED)
        table.setSortingEnabled(True)
        table.sortByColumn(-1, Qt.SortOrder.AscendingOrder)

    def _filter(self) -> None:
        subject, site, condition = (str(choice.currentData() or "") for choice in self.choices)
        self.model.filter(self.search.text(), subject, site, condition)
        data = self._data
        if data is None:
            return
        said = translated(
            Message(
                "study.count",
                "{shown} of {count} rows; {tests} tests of {sessions} sessions",
                shown=len(self.model.shown),
                count=len(data.rows),
                tests=data.tests,
                sessions=data.sessions,
            )
        )
        if data.without_row:
            without = Message(
                "study.without_row",
                "Sessions without a test in the table: {count}; the first rows say why",
                count=data.without_row,
            )
            said = f"{said}. {translated(without)}"
        self.count.setText(said)

    def _span(self) -> None:
        """Give the reason of a session without a test the whole row."""
        self.table.clearSpans()
        for row in self.model.without_test[:_MOST_SPANS]:
            self.table.setSpan(row, 0, 1, self.model.columnCount())

    def _offer(self, choice: QComboBox, values: Iterable[str]) -> None:
        """Offer values; the chosen one stays if it is among them."""
        offered = sorted({value for value in values if value}, key=str.casefold)[:_MOST_OFFERED]
        named = subject_text if choice is self.subject else clean
        without = {WITHOUT: _("without a condition")} if choice is self.condition and offered else {}
        build.offer(choice, {"": choice.itemText(0)} | {value: named(value) for value in offered} | without)

    def _fill_menu(self) -> None:
        menu = self.parameters.menu()
        menu.clear()
        assert self._data is not None
        for name in self._data.parameters:
            shown = name in self.model.parameters
            build.add_check(menu, _(label_and_unit(name)[0]), shown, self._choose_parameters, name)
        self.parameters.setEnabled(bool(self._data.parameters))

    def _choose_parameters(self) -> None:
        chosen = [str(action.data()) for action in self.parameters.menu().actions() if action.isChecked()]
        self.model.show_parameters(chosen)
