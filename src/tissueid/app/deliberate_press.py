"""Guard of the buttons that energise a coil: a key that was typed for a field never presses them."""

from __future__ import annotations

import time
from collections.abc import Iterable

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent
from PySide6.QtWidgets import QAbstractButton, QApplication, QWidget

QUIET_S = 0.5
"""Least time between the arrival of the focus and a key that presses, s; keys are typed faster."""
now = time.monotonic
_PRESSING = (Qt.Key.Key_Space, Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Select)
_MEANT = (
    Qt.FocusReason.TabFocusReason,
    Qt.FocusReason.BacktabFocusReason,
    Qt.FocusReason.MouseFocusReason,
    Qt.FocusReason.ShortcutFocusReason,
)
"""How the focus comes to a button where a person puts it there."""


class DeliberatePress(QObject):
    """An event filter that lets Space and Return press a button only where a person went there to press it.

    The focus must have come by the Tab key, the mouse or a shortcut, at least ``QUIET_S`` ago, and nothing else may
    have been typed since. Mouse and Alt shortcuts always press.
    """

    def __init__(self, buttons: Iterable[QAbstractButton], parent: QObject) -> None:
        super().__init__(parent)
        self._buttons = tuple(buttons)
        self._meant, self._since_s = False, 0.0
        for button in self._buttons:
            button.installEventFilter(self)
        application = QApplication.instance()
        assert isinstance(application, QApplication)
        application.focusChanged.connect(self._focus_moved)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:  # noqa: N802
        """Drop keys that were not meant for the button."""
        if isinstance(event, QFocusEvent) and event.gotFocus():
            self._meant, self._since_s = event.reason() in _MEANT, now()
        elif isinstance(event, QKeyEvent) and event.type() == QEvent.Type.KeyPress:
            if event.key() in _PRESSING:
                return not self._meant or event.isAutoRepeat() or now() - self._since_s < QUIET_S
            if event.text().isprintable() and event.text():
                self._meant = False
        return False

    def _focus_moved(self, old: QWidget | None, _new: QWidget | None) -> None:
        """Qt gives the reason Tab also where it moves the focus because its widget was disabled or hidden."""
        if old is not None and not (old.isEnabled() and old.isVisibleTo(old.window())):
            self._meant = False
