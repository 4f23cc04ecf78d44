"""A control with its name before it, in one row."""

from __future__ import annotations

from PySide6.QtWidgets import QHBoxLayout, QLabel, QWidget


def in_a_row(holder: QWidget, name: str, control: QWidget, *, look: str = "field", apart: int = 14) -> QHBoxLayout:
    """Fill ``holder`` with a name in the style ``look`` and the control ``apart`` pixels beside it."""
    label = QLabel(name)
    label.setProperty("role", look)
    row = QHBoxLayout(holder)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(apart)
    row.addWidget(label)
    row.addWidget(control)
    return row
