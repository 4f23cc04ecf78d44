"""A table with one column drawn as bars."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRectF, Qt
from PySide6.QtGui import QColor, QPainter
from PySide6.QtWidgets import (
    QHeaderView,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from tissueid.app.theme import appearance, faint

_SHARE = Qt.ItemDataRole.UserRole
_ROW = 24


class BarTable(QTableWidget):
    """Table of texts; column ``bars`` also shows a share as a bar."""

    def __init__(self, name: str, head: Sequence[str], bars: int, parent: QWidget | None = None) -> None:
        super().__init__(0, len(head), parent)
        self._bars = bars
        self.setHorizontalHeaderLabels(list(head))
        self.setAccessibleName(name)
        self.verticalHeader().hide()
        self.verticalHeader().setMinimumSectionSize(_ROW)
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        self.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
        self.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
        self.setSelectionMode(QTableWidget.SelectionMode.SingleSelection)
        self.setTabKeyNavigation(False)
        self.setShowGrid(False)
        self.setWordWrap(True)
        header = self.horizontalHeader()
        header.setHighlightSections(False)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        for column in range(len(head)):
            header.setSectionResizeMode(column, QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(0, QHeaderView.ResizeMode.Stretch)
        self._delegate = _Bar(self)
        self.setItemDelegateForColumn(bars, self._delegate)

    def fill(self, rows: Sequence[tuple[Sequence[str], float, bool]]) -> None:
        """Show rows of texts, share of the bar (0 to 1), and whether the row is bold."""
        self.blockSignals(True)
        self.setRowCount(len(rows))
        for place, (words, share, bold) in enumerate(rows):
            for column, text in enumerate(words):
                item = QTableWidgetItem(text)
                item.setToolTip(text if column != self._bars else "")
                font = item.font()
                font.setBold(bold)
                item.setFont(font)
                if column == self._bars:
                    item.setData(_SHARE, share)
                self.setItem(place, column, item)
        self.blockSignals(False)


class _Bar(QStyledItemDelegate):
    """Delegate that draws a bar behind the text."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        """Draw a cell."""
        place = QRectF(option.rect).adjusted(3, 4, -3, -4)  # type: ignore[attr-defined]
        chosen = bool(option.state & QStyle.StateFlag.State_Selected)  # type: ignore[attr-defined]
        if chosen:
            painter.fillRect(option.rect, QColor(appearance.theme.accent))  # type: ignore[attr-defined]
        share = min(max(float(index.data(_SHARE) or 0.0), 0.0), 1.0)
        painter.fillRect(place, faint(appearance.theme.muted, 40))
        bar = QRectF(place.left(), place.top(), max(share * place.width(), 1.0 if share > 0.0 else 0.0), place.height())
        painter.fillRect(bar, faint(appearance.theme.model, 130))
        painter.setPen(QColor(appearance.theme.accent_text if chosen else appearance.theme.text))
        painter.drawText(place.adjusted(5, 0, -5, 0), Qt.AlignmentFlag.AlignVCenter, str(index.data() or ""))
