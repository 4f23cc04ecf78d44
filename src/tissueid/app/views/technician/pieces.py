"""Tables of any length: rows are passed to the view in pieces and formatted when they are visible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QObject, QPersistentModelIndex, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView

from tissueid.app.theme import Theme

PIECE = 200
_ROW = 22
_Index = QModelIndex | QPersistentModelIndex


class PiecesModel(QAbstractTableModel):
    """Rows of anything. ``cell`` says what stands in a column; ``level`` the level of the colour of a row's text.

    The level counts in the column ``marked`` alone. ``right`` are the columns of numbers.
    """

    def __init__(
        self,
        headers: Sequence[str],
        cell: Callable[[Any, int], str],
        *,
        level: Callable[[Any], str] = lambda _: "",
        marked: int = 0,
        right: Sequence[int] = (),
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self.rows: Sequence[Any] = ()
        self._headers = headers
        self._cell = cell
        self._level = level
        self._marked = marked
        self._right = frozenset(right)
        self._shown = 0
        self._theme: Theme | None = None

    def show_rows(self, rows: Sequence[Any]) -> None:
        """Other rows, from the first on."""
        self.beginResetModel()
        self.rows = rows
        self._shown = min(PIECE, len(rows))
        self.endResetModel()

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        if self._shown:
            last = self.index(self._shown - 1, len(self._headers) - 1)
            self.dataChanged.emit(self.index(0, 0), last, [Qt.ItemDataRole.ForegroundRole])

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008, N802
        """How many rows the view knows of."""
        return 0 if parent.isValid() else self._shown

    def columnCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008, N802
        """How many columns there are."""
        return 0 if parent.isValid() else len(self._headers)

    def canFetchMore(self, parent: _Index) -> bool:  # noqa: N802
        """Whether there are rows that the view does not know of yet."""
        return not parent.isValid() and self._shown < len(self.rows)

    def fetchMore(self, parent: _Index) -> None:  # noqa: N802
        """Show the next batch of rows."""
        if self.canFetchMore(parent):
            more = min(PIECE, len(self.rows) - self._shown)
            self.beginInsertRows(QModelIndex(), self._shown, self._shown + more - 1)
            self._shown += more
            self.endInsertRows()

    def data(self, index: _Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Text, alignment and colour of one cell; the whole text when the mouse stands on it."""
        if not index.isValid() or index.row() >= len(self.rows):
            return None
        row = self.rows[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return self._cell(row, index.column())
        if role == Qt.ItemDataRole.TextAlignmentRole and index.column() in self._right:
            return Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        if role == Qt.ItemDataRole.ForegroundRole and index.column() == self._marked:
            level = self._level(row)
            return QColor(getattr(self._theme, level)) if level and self._theme is not None else None
        return None

    def headerData(  # noqa: N802
        self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole
    ) -> Any:
        """What a column is called."""
        if role == Qt.ItemDataRole.DisplayRole and orientation == Qt.Orientation.Horizontal:
            return self._headers[section]
        return None


def table_of(model: PiecesModel, name: str, widths: Sequence[int]) -> QTableView:
    """A table for a model, called so for screen readers; ``widths`` in pixels, the last column takes the rest."""
    table = QTableView()
    table.setModel(model)
    table.setAccessibleName(name)
    table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
    table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    table.setTabKeyNavigation(False)
    table.setShowGrid(False)
    table.setAlternatingRowColors(True)
    table.setWordWrap(False)
    table.setMinimumHeight(60)
    table.verticalHeader().hide()
    table.verticalHeader().setDefaultSectionSize(_ROW)
    header = table.horizontalHeader()
    header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
    header.setStretchLastSection(True)
    header.setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
    header.setHighlightSections(False)
    for column, width in enumerate(widths):
        header.resizeSection(column, width)
    return table
