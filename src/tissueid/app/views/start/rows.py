"""Tables of whole rows and the other small widgets of the first page."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QColor, QKeyEvent, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QBoxLayout,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app import build
from tissueid.app.theme import appearance
from tissueid.app.views.start.recent import Recent

Cell = tuple[str, str]
"""What a cell says, and the level of its colour: good, check, poor, or none."""
_LEVEL = Qt.ItemDataRole.UserRole
_LONGEST_ADDRESS = 36
"""Characters of an address in the list of instruments; the tooltip shows all of it."""
_LOWEST = 4
"""Rows that are seen at least."""


class Rows(QTableWidget):
    """Shows lines of words. ``taken`` carries the number of a row that was double-clicked, or on which Return fell."""

    taken = Signal(int)

    def __init__(
        self, name: str, headings: Sequence[str], stretched: Sequence[int], parent: QWidget | None = None
    ) -> None:
        super().__init__(0, len(headings), parent)
        build.for_reading(self, name, self.fontMetrics().height() + 8, horizontal_header_labels=list(headings))
        build.styled(
            self,
            selection_mode=QAbstractItemView.SelectionMode.SingleSelection,
            word_wrap=True,
            vertical_scroll_mode=QAbstractItemView.ScrollMode.ScrollPerPixel,
            horizontal_scroll_bar_policy=Qt.ScrollBarPolicy.ScrollBarAlwaysOff,
        )
        header = self.horizontalHeader()
        header.setSectionsClickable(False)
        self._stretched = tuple(stretched)
        for column in range(len(headings)):
            kind = QHeaderView.ResizeMode.Fixed if column in stretched else QHeaderView.ResizeMode.ResizeToContents
            header.setSectionResizeMode(column, kind)
        header.setMinimumSectionSize(40)
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.verticalHeader().setMinimumSectionSize(self.verticalHeader().defaultSectionSize())
        self.setMinimumHeight(header.sizeHint().height() + _LOWEST * self.verticalHeader().defaultSectionSize())
        self.cellDoubleClicked.connect(self._take)
        appearance.follow(self._colour)

    @property
    def chosen(self) -> int:
        """The number of the row that is selected; -1 where none is."""
        rows = self.selectionModel().selectedRows()
        return rows[0].row() if rows else -1

    def fill(self, rows: Sequence[Sequence[Cell]]) -> None:
        """Show other lines; the row that is selected stays so."""
        kept = min(self.chosen, len(rows) - 1)
        self.setRowCount(len(rows))
        for row, cells in enumerate(rows):
            for column, (text, level) in enumerate(cells):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                item.setData(_LEVEL, level)
                self.setItem(row, column, item)
        self._colour()
        self._share_room()
        if kept >= 0:
            self.selectRow(kept)

    def explain(self, row: int, text: str) -> None:
        """Return the complete text of a row for tooltip and screen reader."""
        for column in range(self.columnCount()):
            if (item := self.item(row, column)) is not None:
                item.setToolTip(text)
                item.setData(Qt.ItemDataRole.AccessibleDescriptionRole, text)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Distribute the width over the columns again."""
        super().resizeEvent(event)
        self._share_room()

    def _share_room(self) -> None:
        """Columns that are stretched get what the others leave, by what each has to say; too long a text is wrapped."""
        header = self.horizontalHeader()
        header.resizeSections(QHeaderView.ResizeMode.ResizeToContents)
        wanted = [max(self.sizeHintForColumn(c), header.sectionSizeHint(c)) for c in self._stretched]
        others = sum(self.columnWidth(c) for c in range(self.columnCount()) if c not in self._stretched)
        left = max(0, self.viewport().width() - others)
        # Narrowest first: a column that needs less than an equal share gets its need, the longest texts share the rest.
        places = sorted(range(len(wanted)), key=wanted.__getitem__)
        for number, place in enumerate(places):
            share = left // (len(places) - number)
            spare = max(0, left - sum(wanted[other] for other in places[number:])) // (len(places) - number)
            width = share if number == len(places) - 1 else min(wanted[place] + spare, share)
            self.setColumnWidth(self._stretched[place], width)
            left -= width
        self.resizeRowsToContents()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Return takes the row that is selected, once for each time that the key goes down."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            if self.chosen >= 0 and not event.isAutoRepeat():
                self.taken.emit(self.chosen)
            return
        super().keyPressEvent(event)

    def _take(self, row: int, _column: int) -> None:
        self.taken.emit(row)

    def _colour(self) -> None:
        theme = appearance.theme
        colours = {"good": theme.good, "check": theme.check, "poor": theme.poor}
        for row in range(self.rowCount()):
            for column in range(self.columnCount()):
                if (item := self.item(row, column)) is not None:
                    item.setForeground(QColor(colours.get(item.data(_LEVEL), theme.text)))


def cells(item: Recent) -> tuple[tuple[str, str], ...]:
    """Return the cells of a row for a session."""
    subject = "  ·  ".join(filter(None, [item.subject, item.study]))
    return (item.date, ""), (item.site, ""), (subject, ""), (item.verdict, item.level), (item.accepted, "")


def short_address(url: str) -> str:
    """Return an address without its middle where it is long: the end names a port or a file."""
    if len(url) <= _LONGEST_ADDRESS:
        return url
    kept = _LONGEST_ADDRESS // 3
    return f"{url[:kept]}…{url[-2 * kept :]}"


def brief(health: str) -> str:
    """Return a problem without its advice, which is in the tooltip of the row."""
    return health.partition(";")[0]


def under_heading(title: str, about: QLabel, table: Rows, *buttons: QWidget) -> QBoxLayout:
    """A table under a heading with buttons next to the heading."""
    about.setProperty("role", "muted")
    return build.column(
        build.row(build.styled(QLabel(title), role="heading"), (about, 1), *buttons, spacing=8), (table, 1), spacing=4
    )
