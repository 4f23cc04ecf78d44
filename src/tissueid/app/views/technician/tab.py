"""Base class and widgets of the tabs of the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QObject, QPersistentModelIndex, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QHeaderView,
    QLabel,
    QTableView,
    QWidget,
)

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.jobs import PageJob
from tissueid.app.theme import appearance
from tissueid.formatting import clean

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

    def show_rows(self, rows: Sequence[Any]) -> None:
        """Other rows, from the first on."""
        self.beginResetModel()
        self.rows = rows
        self._shown = min(PIECE, len(rows))
        self.endResetModel()

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
            return QColor(getattr(appearance.theme, level)) if level else None
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
    resize = QHeaderView.ResizeMode.Interactive
    build.for_reading(table, name, _ROW, resize, alternating_row_colors=True, minimum_height=60)
    header = table.horizontalHeader()
    header.setStretchLastSection(True)
    for column, width in enumerate(widths):
        header.resizeSection(column, width)
    return table


class Tab(QWidget):
    """A tab. ``stale``: its files are read again when it is shown and no job runs. ``read``: they were read once."""

    def __init__(self, context: AppContext, page_job: PageJob, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.context = context
        self.page_job = page_job
        self.stale = True
        self.read = False

    def load(self) -> None:
        """Read what is shown, in a job."""

    def update_enabled(self, *, busy: bool) -> None:
        """Enable what makes sense now."""

    def save_state(self) -> None:
        """Save the state of the tab to the settings."""

    def read_files(self, activity: str, work: Callable[[Callable[[], object]], object]) -> None:
        """Start reading, for :meth:`_loaded`; an error is shown as a notice."""
        if self.page_job.start(activity, work, self._loaded, self.complain):
            self.stale = False

    def _loaded(self, content: Any) -> None:
        """Show what was read."""

    def complain(self, message: str) -> None:
        """Show an error; a cancelled job has an empty one."""
        if message:
            self.context.say(message, problem=True)


def unmarked(text: str) -> str:
    """Return a text whose tags are not interpreted as markup in a heading."""
    return clean(text).replace("<", "‹")


class FactsCard(QFrame):
    """A heading over labels and values, row by row."""

    def __init__(self, title: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        build.styled(self, role="card", name=title)
        self._grid = QGridLayout()
        build.styled(self._grid, horizontal_spacing=12, vertical_spacing=3)
        self._grid.setColumnStretch(1, 1)
        self._cells: list[tuple[QLabel, QLabel]] = []
        build.column(build.label("heading", title), self._grid, None, spacing=4, margins=(12, 8, 12, 8), parent=self)

    @property
    def facts(self) -> dict[str, str]:
        """What is shown."""
        return {name.text(): value.text() for name, value in self._cells if not name.isHidden()}

    def show_facts(self, facts: dict[str, str]) -> None:
        """Show these rows, and no others."""
        while len(self._cells) < len(facts):
            row = len(self._cells)
            name, value = build.label("muted"), build.label()
            name.setWordWrap(False)
            build.styled(
                value,
                text_interaction_flags=Qt.TextInteractionFlag.TextSelectableByMouse,
                alignment=Qt.AlignmentFlag.AlignTop,
            )
            name.setAlignment(Qt.AlignmentFlag.AlignTop)
            self._grid.addWidget(name, row, 0)
            self._grid.addWidget(value, row, 1)
            self._cells.append((name, value))
        rows = [*facts.items(), *[("", "")] * (len(self._cells) - len(facts))]
        for (name, value), (label, text) in zip(self._cells, rows, strict=True):
            name.setText(label)
            value.setText(text)
            value.setAccessibleName(f"{label}: {text}")
            name.setVisible(bool(label))
            value.setVisible(bool(label))
