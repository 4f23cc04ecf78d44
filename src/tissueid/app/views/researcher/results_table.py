"""Table of results: one row per engine and test, with the colour of its curves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from PySide6.QtCore import (
    QAbstractTableModel,
    QItemSelectionModel,
    QModelIndex,
    QPersistentModelIndex,
    QSignalBlocker,
    QSortFilterProxyModel,
    Qt,
    Signal,
)
from PySide6.QtGui import QColor, QFont, QIcon, QKeyEvent, QKeySequence, QPainter, QPixmap
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

from tissueid.app import build
from tissueid.app.theme import appearance
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.words import sentence
from tissueid.formatting import axis_label, clean, fixed, label_and_unit, plain_text, plus_minus, subject_text
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.units import shown_si

SERIES = ("measured", "model", "good", "poor", "text", "check", "muted")
"""Roles of the theme for the colours of results: the maximum number that can be distinguished."""

_FIXED = (marked("Engine"), marked("Test"), marked("VAF fitted (%)"), marked("VAF held out (%)"))
_TEST, _HELD_OUT = 1, 3
_ANSWER = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
"""Parameters that are shown first, next to the engine and its score."""
_LAST = (marked("Subject"), marked("Site"))
_ROW = 22
_PADDING = 12
_ENGINE_WIDTH, _WIDEST = 150, 220
_SQUARE = 24
"""Room for the square in the colour of the curve, which may come after the columns are fitted, pixels."""
"""Pixels; what is longer is cut off, and its tip has all of it."""
_MEASURED = 60
"""Rows that are looked at for the width of a column: all of thousands would hold up the window for seconds."""
_ARROW = 16
"""Pixels that the mark of the sorted column takes."""
_LEAST = 96
_SORT = Qt.ItemDataRole.UserRole
_LONGEST = 60
Index = QModelIndex | QPersistentModelIndex
_TOP = QModelIndex()

_SIDE = 14
"""Side of the square in the colour of a curve, pixels."""


class ResultsTable(QTableView):
    """Table of results. ``chosen_changed``: the selection changed; ``removed`` carries results to remove."""

    chosen_changed = Signal()
    removed = Signal(list)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._model = _Results(self)
        self._sorted = QSortFilterProxyModel(self)
        self._sorted.setSourceModel(self._model)
        self._sorted.setSortRole(_SORT)
        self.setModel(self._sorted)
        build.for_reading(
            self,
            _("Results of the analyses"),
            _ROW,
            QHeaderView.ResizeMode.Interactive,
            selection_mode=QAbstractItemView.SelectionMode.ExtendedSelection,
            sorting_enabled=True,
            text_elide_mode=Qt.TextElideMode.ElideMiddle,
            minimum_height=_LEAST,
        )
        header = self.horizontalHeader()
        build.styled(
            header, minimum_height=2 * header.fontMetrics().height() + _PADDING, resize_contents_precision=_MEASURED
        )
        self.sortByColumn(-1, Qt.SortOrder.AscendingOrder)
        self.selectionModel().selectionChanged.connect(self.chosen_changed)
        header.sortIndicatorChanged.connect(self._make_room)

    @property
    def outcomes(self) -> tuple[EngineOutcome, ...]:
        """All results in the order of arrival."""
        return tuple(self._model.outcomes)

    @property
    def chosen(self) -> list[EngineOutcome]:
        """The selected results, or all if none is selected, in the order of the table."""
        rows = sorted(index.row() for index in self.selectionModel().selectedRows()) or range(self._sorted.rowCount())
        return [self._model.outcomes[self._source(row)] for row in rows]

    def show_outcomes(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Show results and clear the selection."""
        self._model.take(outcomes)
        self._fit_columns()

    def select(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Select results without a signal."""
        flags = QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows
        model, rows = self.selectionModel(), self._rows_of(outcomes)
        with QSignalBlocker(model):
            model.clearSelection()
            for row in rows:
                model.select(self._sorted.index(row, 0), flags)
        if rows:
            self.scrollTo(self._sorted.index(rows[0], 0))
        self.viewport().update()

    def bring_up(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Scroll the first of these results to the top."""
        for row in self._rows_of(outcomes)[:1]:
            self.scrollTo(self._sorted.index(row, 0), self.ScrollHint.PositionAtTop)

    def _rows_of(self, outcomes: Sequence[EngineOutcome]) -> list[int]:
        wanted = {id(outcome) for outcome in outcomes}
        return [row for row in range(self._sorted.rowCount()) if id(self._model.outcomes[self._source(row)]) in wanted]

    def colour(self, drawn: Sequence[EngineOutcome]) -> None:
        """Mark the drawn results with their colours, in the order of ``SERIES``."""
        self._model.colour({id(outcome): index for index, outcome in enumerate(drawn)})

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self._model.take_units()
        self._fit_columns()

    def rows(self) -> list[list[str]]:
        """Return a header row and a row per result in SI units, with columns for values and standard deviations."""
        names = self._model.parameters
        head = ["engine", "test", "subject", "site", "file", "numbers", "input", "output", "options"]
        head += ["vaf_percent", "vaf_validation_percent", "validated_on", "aicc", "seconds"]
        head += [column for name in names for column in (name, f"{name}_std")] + ["refused"]
        return [head, *(_plain_row(outcome, names) for outcome in self.outcomes)]

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Remove the selected results on Delete."""
        if event.matches(QKeySequence.StandardKey.Delete):
            if self.selectionModel().hasSelection():
                self.removed.emit(self.chosen)
            return
        super().keyPressEvent(event)

    def _fit_columns(self) -> None:
        """Fit the widths of the columns, and order them: engine, score and mechanical parameters first."""
        header = self.horizontalHeader()
        answer = [
            len(_FIXED) + self._model.parameters.index(name) for name in _ANSWER if name in self._model.parameters
        ]
        count = self._sorted.columnCount()
        order = [0, _HELD_OUT, *answer, _TEST, *range(count - len(_LAST), count)]
        order += [column for column in range(self._sorted.columnCount()) if column not in order]
        for position, column in enumerate(order if self._model.outcomes else ()):
            header.moveSection(header.visualIndex(column), position)
        for column in range(self._sorted.columnCount()):
            most = _ENGINE_WIDTH if column == 0 else _WIDEST
            width = max(self._head_width(column), self.sizeHintForColumn(column) + _PADDING // 2)
            width += _SQUARE if column == 0 else 0
            self.setColumnWidth(column, min(most, width))

    def _make_room(self, column: int) -> None:
        """Widen the sorted column for its sort mark."""
        if column >= 0:
            self.setColumnWidth(column, max(self.columnWidth(column), self._head_width(column)))

    def _head_width(self, column: int) -> int:
        header = self.horizontalHeader()
        lines = str(self._sorted.headerData(column, Qt.Orientation.Horizontal)).splitlines()
        least = max((header.fontMetrics().horizontalAdvance(line) for line in lines), default=0) + _PADDING
        return least + (_ARROW if column == header.sortIndicatorSection() else 0)

    def _source(self, row: int) -> int:
        return self._sorted.mapToSource(self._sorted.index(row, 0)).row()


class _Results(QAbstractTableModel):
    """The results behind the view."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.outcomes: list[EngineOutcome] = []
        self.parameters: list[str] = []
        self._colours: dict[int, int] = {}
        self._bold = QFont(parent.font())
        self._bold.setBold(True)

    def take(self, outcomes: Sequence[EngineOutcome]) -> None:
        self.beginResetModel()
        self.outcomes = list(outcomes)
        reports = [outcome.report for outcome in outcomes if outcome.report is not None]
        counts = Counter(name for report in reports for name in report.reportable_parameters)
        # What most of them have stands first, so that it can be compared without scrolling.
        self.parameters = [name for name, _count in counts.most_common()]
        self.endResetModel()

    def colour(self, places: dict[int, int]) -> None:
        self._colours = places
        self._tell_colours()

    def take_units(self) -> None:
        self.headerDataChanged.emit(Qt.Orientation.Horizontal, 0, max(0, self.columnCount() - 1))
        self._tell_colours()

    def _tell_colours(self) -> None:
        if self.outcomes:
            self.dataChanged.emit(self.index(0, 0), self.index(len(self.outcomes) - 1, self.columnCount() - 1))

    def rowCount(self, parent: Index = _TOP) -> int:  # noqa: N802
        return 0 if parent.isValid() else len(self.outcomes)

    def columnCount(self, parent: Index = _TOP) -> int:  # noqa: N802
        return 0 if parent.isValid() else len(_FIXED) + len(self.parameters) + len(_LAST)

    def headerData(  # noqa: N802
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> Any:
        if orientation is not Qt.Orientation.Horizontal or role != Qt.ItemDataRole.DisplayRole:
            return None
        return in_two_lines(self._head(section))

    def _head(self, section: int) -> str:
        if section < len(_FIXED):
            return _(_FIXED[section])
        if section >= len(_FIXED) + len(self.parameters):
            return _(_LAST[section - len(_FIXED) - len(self.parameters)])
        name = self.parameters[section - len(_FIXED)]
        return axis_label(name, shown_si(label_and_unit(name)[1])[0])

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        outcome, column = self.outcomes[index.row()], index.column()
        if role == Qt.ItemDataRole.DisplayRole:
            return self._text(outcome, column)
        if role == _SORT:
            return self._sorted_by(outcome, column)
        if role == Qt.ItemDataRole.ToolTipRole:
            return _tool_tip(outcome) if self._is_text(column) else None
        if role == Qt.ItemDataRole.DecorationRole and column == 0:
            series = self._colours.get(id(outcome))
            return None if series is None else _square(getattr(appearance.theme, SERIES[series % len(SERIES)]))
        if role == Qt.ItemDataRole.TextAlignmentRole and not self._is_text(column):
            return Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        if role == Qt.ItemDataRole.ForegroundRole:
            if outcome.refused:
                return QColor(appearance.theme.muted)
            if outcome.report is not None and outcome.report.predicts_nothing:
                return QColor(appearance.theme.poor)
            if outcome.changed:
                return QColor(appearance.theme.check)
        if role == Qt.ItemDataRole.FontRole and outcome.recommended:
            return self._bold
        return None

    def _is_text(self, column: int) -> bool:
        return column < 2 or column >= len(_FIXED) + len(self.parameters)

    def _text(self, outcome: EngineOutcome, column: int) -> str:
        first, report = outcome.tests[0], outcome.report
        if column < 2:
            return (engine_label(outcome.engine), outcome.test_label)[column][:_LONGEST]
        if self._is_text(column):
            about = subject_text(first.pseudonym), clean(first.site)
            return about[column - len(_FIXED) - len(self.parameters)][:_LONGEST]
        if report is None:
            return _("refused") if column in (2, _HELD_OUT) else MISSING
        if column < len(_FIXED):
            return fixed(report.vaf_percent if column == 2 else report.vaf_validation_percent, 2)
        name = self.parameters[column - len(_FIXED)]
        estimate = report.reportable_parameters.get(name)
        return MISSING if estimate is None else plus_minus(estimate, shown_si(label_and_unit(name)[1])[1])

    def _sorted_by(self, outcome: EngineOutcome, column: int) -> str | float:
        report = outcome.report
        if self._is_text(column):
            return self._text(outcome, column).lower()
        if report is None:
            return float("-inf")
        if column < len(_FIXED):
            value = report.vaf_percent if column == 2 else report.vaf_validation_percent
            return float("-inf") if value is None else value
        estimate = report.reportable_parameters.get(self.parameters[column - len(_FIXED)])
        return float("-inf") if estimate is None else estimate.value


def in_two_lines(head: str) -> str:
    """Return a heading broken into two short lines."""
    parts = head.split()
    parted = [(" ".join(parts[:split]), " ".join(parts[split:])) for split in range(1, len(parts))]
    return "\n".join(min(parted, key=lambda lines: max(map(len, lines)))) if parted else head


def _square(colour: str) -> QIcon:
    """Return a square in a colour with a light edge, which the selection does not tint."""
    picture = QPixmap(_SIDE, _SIDE)
    picture.fill(QColor("white"))
    painter = QPainter(picture)
    painter.fillRect(1, 1, _SIDE - 2, _SIDE - 2, QColor(colour))
    painter.end()
    icon = QIcon(picture)
    icon.addPixmap(picture, QIcon.Mode.Selected)
    return icon


def _tool_tip(outcome: EngineOutcome) -> str:
    """Return the tool tip of a result: options, findings and warnings, without markup."""
    lines = [outcome.label, *([sentence(translated(outcome.refused))] if outcome.refused else [])]
    if outcome.recommended:
        lines.append(_("Recommended by the comparison of engines"))
    if outcome.changed:
        lines.append(
            translated(
                Message("research.file_changed", "The file has changed or gone since this was fitted: run it again")
            )
        )
    if options := outcome.options | outcome.preparation.changed:
        lines.append(_("Options: {options}").format(options=plain_text(options)))
    if outcome.report is not None:
        lines += [_("VAF held out on {data}").format(data=translated(outcome.validated_on))]
        lines += [
            *map(translated, outcome.report.findings),
            *(_("Warning: {warning}").format(warning=translated(warning)) for warning in outcome.report.warnings),
        ]
    lines += [_("Residual: {finding}").format(finding=translated(finding)) for finding in outcome.findings]
    return "\n".join(clean(line).replace("<", "‹").replace(">", "›") for line in lines)


def _plain_row(outcome: EngineOutcome, names: Sequence[str]) -> list[str]:
    first, report = outcome.tests[0], outcome.report
    numbers = " ".join(str(test.number) for test in outcome.tests)
    row = [outcome.engine, outcome.test_label, first.pseudonym, first.site, str(first.path), numbers]
    row = [clean(text) for text in [*row, *outcome.signals, plain_text(outcome.options | outcome.preparation.changed)]]
    if report is None:
        return row + [""] * (5 + 2 * len(names)) + [clean(outcome.refused)]
    row += [_bare(report.vaf_percent), _bare(report.vaf_validation_percent), outcome.validated_on]
    row += [_bare(report.aicc), _bare(report.seconds)]
    for name in names:
        estimate = report.reportable_parameters.get(name)
        row += ["", ""] if estimate is None else [_bare(estimate.value), _bare(estimate.std)]
    return [*row, ""]


def _bare(value: float | None) -> str:
    return "" if value is None else f"{value:.10g}"
