"""Buttons that a person must be able to hit."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QPushButton


class BigButton(QPushButton):
    """A button that Return presses as well as Space, once for each time that the key goes down."""

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Press; a key that is held down is not pressed again."""
        if event.isAutoRepeat():
            return
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.click()
            return
        super().keyPressEvent(event)
