"""The tests of a study: filters, choice of parameters, and the table."""

from __future__ import annotations

from collections.abc import Iterable

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
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
from tissueid.app.views.studies.study_data import StudyData
from tissueid.app.views.studies.tests_model import SUBJECT, WITHOUT, TestsModel
from tissueid.formatting import clean, label_and_unit, subject_text
from tissueid.language import _, marked
from tissueid.messages import Message, translated

_ALL = (marked("All subjects"), marked("All sites"), marked("All conditions"))
_NAMES = (marked("Subject"), marked("Site"), marked("Condition"))
_MOST_OFFERED = 2000
_ROW, _LEAST = 22, 96
_MEASURED = 60
"""Rows that are looked at for the width of a column."""
_WIDEST = 240
_FILTERS_IN_A_ROW = 620
_MOST_SPANS = 300


class TestsTab(QWidget):
    """Filters above the table."""

    __test__ = False

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.model = TestsModel(self)
        self._data: StudyData | None = None
        self.words = styled(
            QLineEdit(),
            placeholder_text=_("Search in all columns"),
            name=_("Search in all columns"),
            tip=_("Rows that have every word (Ctrl+F)"),
            clear_button_enabled=True,
        )
        self.choices = tuple(QComboBox() for _name in _NAMES)
        self.subject, self.site, self.condition = self.choices
        for choice, name, everything in zip(self.choices, _NAMES, _ALL, strict=True):
            build.styled(
                choice,
                name=_("Filter by {column}").format(column=_(name)),
                size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
                minimum_contents_length=len(_(everything)),
            )
            choice.addItem(_(everything), "")
            choice.currentIndexChanged.connect(self._filter)
        self.parameters = button(_("Parameters"), tip=_("Columns of the table"), menu=QMenu(self))
        self.count = styled(QLabel(), role="muted", word_wrap=True, minimum_width=1)
        self.table = QTableView()
        self._dress()
        holder = QWidget()
        fill(FoldingBox(_FILTERS_IN_A_ROW, holder), self.words, *self.choices, self.parameters)
        foot = QHBoxLayout()
        foot.addWidget(self.count, 1)
        build.column(holder, (self.table, 1), foot, margins=(0, 8, 0, 0), parent=self)
        self.words.textChanged.connect(self._filter)
        self.model.modelReset.connect(self._span)
        self.model.layoutChanged.connect(self._span)
        find = QShortcut(QKeySequence(QKeySequence.StandardKey.Find), self)
        find.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        find.activated.connect(self.words.setFocus)

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
        return [self.words, *self.choices, self.parameters, self.table]

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
        self.model.filter(self.words.text(), subject, site, condition)
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
        asked = str(choice.currentData() or "")
        choice.blockSignals(True)
        for place in range(choice.count() - 1, 0, -1):
            choice.removeItem(place)
        for value in sorted({value for value in values if value}, key=str.casefold)[:_MOST_OFFERED]:
            choice.addItem(subject_text(value) if choice is self.subject else clean(value), value)
        if choice is self.condition and choice.count() > 1:
            choice.addItem(_("without a condition"), WITHOUT)
        choice.setCurrentIndex(max(0, choice.findData(asked)))
        choice.blockSignals(False)

    def _fill_menu(self) -> None:
        menu = self.parameters.menu()
        menu.clear()
        assert self._data is not None
        for name in self._data.parameters:
            action = menu.addAction(_(label_and_unit(name)[0]))
            action.setCheckable(True)
            action.setChecked(name in self.model.parameters)
            action.setData(name)
            action.toggled.connect(self._choose_parameters)
        self.parameters.setEnabled(bool(self._data.parameters))

    def _choose_parameters(self) -> None:
        chosen = [str(action.data()) for action in self.parameters.menu().actions() if action.isChecked()]
        self.model.show_parameters(chosen)
