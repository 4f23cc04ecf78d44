"""A control with a label in front of it, in one row."""

from __future__ import annotations

from PySide6.QtWidgets import QHBoxLayout, QLabel, QWidget


def labelled_row(
    holder: QWidget, name: str, control: QWidget, *, role: str = "field", spacing: int = 14
) -> QHBoxLayout:
    """Fill ``holder`` with a label in the style ``role`` and a control, ``spacing`` pixels from each other."""
    label = QLabel(name)
    label.setProperty("role", role)
    row = QHBoxLayout(holder)
    row.setContentsMargins(0, 0, 0, 0)
    row.setSpacing(spacing)
    row.addWidget(label)
    row.addWidget(control)
    return row
