"""Build widgets in the order in which they are seen: rows, columns, labels, buttons and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QBoxLayout,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QLayout,
    QPushButton,
    QTableWidget,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.widgets import plain_label

Item = QWidget | QLayout | None
"""A part of a row or column; None is a stretch."""
AnyWidget = TypeVar("AnyWidget", bound=QWidget)


def fill(
    box: QBoxLayout, *items: Item | tuple[Item, int], spacing: int = 6, margins: Sequence[int] = (0,)
) -> QBoxLayout:
    """Fill a box with items, each with its stretch if it has one. One margin is that of all sides."""
    box.setSpacing(spacing)
    box.setContentsMargins(*(margins if len(margins) == 4 else [margins[0]] * 4))
    for entry in items:
        item, stretch = entry if isinstance(entry, tuple) else (entry, 0)
        if item is None:
            box.addStretch(1)
        elif isinstance(item, QWidget):
            box.addWidget(item, stretch)
        else:
            box.addLayout(item, stretch)
    return box


def row(*items: Item | tuple[Item, int], spacing: int = 6, margins: Sequence[int] = (0,)) -> QBoxLayout:
    """Return a row of items."""
    return fill(QHBoxLayout(), *items, spacing=spacing, margins=margins)


def column(*items: Item | tuple[Item, int], spacing: int = 6, margins: Sequence[int] = (0,)) -> QBoxLayout:
    """Return a column of items."""
    return fill(QVBoxLayout(), *items, spacing=spacing, margins=margins)


def styled(widget: AnyWidget, **properties: str) -> AnyWidget:
    """Set style properties such as ``role`` and ``level``, ``tip`` and ``name`` (for screen readers)."""
    for key, value in properties.items():
        if key == "tip":
            widget.setToolTip(value)
        elif key == "name":
            widget.setAccessibleName(value)
        else:
            widget.setProperty(key, value)
    return widget


def label(role: str = "", **properties: str) -> QLabel:
    """Return a label that wraps plain text and allows copying."""
    return styled(plain_label(role), **properties)


def button(text: str, **properties: str) -> QPushButton:
    """Return a button."""
    return styled(QPushButton(text), **properties)


def table(columns: Sequence[str], name: str, row_height: int = 22) -> QTableWidget:
    """Return a table that is read by rows, not edited."""
    made = QTableWidget(0, len(columns))
    made.setHorizontalHeaderLabels(list(columns))
    made.setAccessibleName(name)
    made.setEditTriggers(QTableWidget.EditTrigger.NoEditTriggers)
    made.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
    made.setTabKeyNavigation(False)
    made.setShowGrid(False)
    made.setWordWrap(False)
    made.verticalHeader().hide()
    made.verticalHeader().setDefaultSectionSize(row_height)
    header = made.horizontalHeader()
    header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
    header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
    header.setHighlightSections(False)
    return made
