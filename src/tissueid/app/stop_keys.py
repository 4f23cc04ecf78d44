"""The stop keys, Escape and Space: they work with any focus and while a dialog is open."""

from __future__ import annotations

from PySide6.QtCore import QCoreApplication, QEvent, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent

_KEYS = (Qt.Key.Key_Escape, Qt.Key.Key_Space)
_MEANT = (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress)
"""Events of a key: it is offered as a shortcut first. Accepting both keeps it from shortcuts and fields."""


class StopKeys(QObject):
    """An event filter of the application that sends ``pressed`` for each stop key while it listens.

    A shortcut would not do: a dialog hides it, and a text field takes the Space.
    """

    pressed = Signal()

    def listen(self, on: bool) -> None:
        """Start or stop listening."""
        application = QCoreApplication.instance()
        if application is not None:
            application.removeEventFilter(self)
            if on:
                application.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Intercept the stop keys of all widgets."""
        if event.type() in _MEANT and isinstance(event, QKeyEvent) and event.key() in _KEYS:
            event.accept()
            self.pressed.emit()
            return True
        return False
