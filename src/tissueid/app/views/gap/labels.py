"""Labels for texts that come from files."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel


def plain_label(role: str = "") -> QLabel:
    """An empty label that wraps, shows what it is given as it is, and can be copied from."""
    label = QLabel()
    if role:
        label.setProperty("role", role)
    label.setWordWrap(True)
    label.setMinimumWidth(1)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def show_level(widget: object, level: str) -> None:
    """Colour a widget by how good a thing it says."""
    widget.setProperty("level", level)  # type: ignore[attr-defined]
    widget.style().unpolish(widget)  # type: ignore[attr-defined]
    widget.style().polish(widget)  # type: ignore[attr-defined]
