"""Labels for untrusted texts."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel


def plain_label(role: str = "") -> QLabel:
    """Return an empty label that wraps plain text and allows copying."""
    label = QLabel()
    if role:
        label.setProperty("role", role)
    label.setWordWrap(True)
    label.setMinimumWidth(1)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def show_level(widget: object, level: str) -> None:
    """Set the colour level of a widget: good, check or poor."""
    widget.setProperty("level", level)  # type: ignore[attr-defined]
    widget.style().unpolish(widget)  # type: ignore[attr-defined]
    widget.style().polish(widget)  # type: ignore[attr-defined]
