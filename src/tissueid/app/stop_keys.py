"""The keys that stop: Escape and Space, whatever has the focus, with a dialog open too."""

from __future__ import annotations

from PySide6.QtCore import QCoreApplication, QEvent, QObject, Qt, Signal
from PySide6.QtGui import QKeyEvent

_KEYS = (Qt.Key.Key_Escape, Qt.Key.Key_Space)
_MEANT = (QEvent.Type.ShortcutOverride, QEvent.Type.KeyPress)
"""A key is offered as a shortcut before it is pressed: taken there already, it reaches no shortcut and no field."""


class StopKeys(QObject):
    """Sees every key of the application before anything else does, while it listens. ``pressed`` is sent at once.

    It does not use a shortcut: a dialog would hide that, and a field that can be typed into would take the Space.
    """

    pressed = Signal()

    def listen(self, on: bool) -> None:
        """Listen, or leave the keys alone."""
        application = QCoreApplication.instance()
        if application is not None:
            application.removeEventFilter(self)
            if on:
                application.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Take the keys that stop, whoever they were meant for."""
        if event.type() in _MEANT and isinstance(event, QKeyEvent) and event.key() in _KEYS:
            event.accept()
            self.pressed.emit()
            return True
        return False
