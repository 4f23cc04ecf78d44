"""The emergency stop: by a person, by the program, or because the window does not answer. Independent of Qt."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QFocusEvent, QKeyEvent
from PySide6.QtWidgets import QAbstractButton, QApplication, QWidget

from tissueid.errors import CancelledError, UnattendedError
from tissueid.messages import Message

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


PATIENCE_S = 1.0
"""Longest time between two heartbeats of the window while the coil can be energised, s."""


BY_BUTTON = Message("stop.button", "stopped in the window")
BY_CLOSING = Message("stop.window_closed", "the window was closed")
BY_DEFECT = Message("stop.defect", "a defect in the window")
_LOOK_S = 0.05
"""Time between two looks at the stop while the window is awaited, s."""
NO_ANSWER = Message("stop.no_answer", "the window did not answer; the coil was released")


def seconds_since_boot() -> float:
    """Return a monotonic time in seconds, including sleep of the computer where the system counts it."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)  # Linux; on Windows the monotonic clock counts them by itself
    return time.monotonic() if clock is None else time.clock_gettime(clock)


class EmergencyStop:
    """Stops one test or calibration and cannot be reset. The first reason is kept.

    Any thread may :meth:`press` it; the measuring thread calls :meth:`check` after every poll. It is also a watchdog of
    the window: after the first :meth:`beat`, more than ``disk_timeout_s`` seconds without a beat trigger the stop.
    ``clock`` returns a monotonic time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = seconds_since_boot, disk_timeout_s: float = PATIENCE_S) -> None:
        self._clock = clock
        self._patience_s = disk_timeout_s
        self._lock = threading.Lock()
        self._pressed = threading.Event()
        self._watching = threading.Event()
        self._last_beat_s: float | None = None
        self._reason = ""

    @property
    def reason(self) -> str:
        """Why it was stopped; empty if it was not."""
        return self._reason

    def press(self, reason: str) -> None:
        """Stop for this reason."""
        with self._lock:
            self._reason = self._reason or reason
            self._pressed.set()

    def beat(self) -> None:
        """Record a heartbeat of the window. A late heartbeat does not clear a timeout."""
        self._miss()
        self._last_beat_s = self._clock()
        self._watching.set()

    @property
    def watching(self) -> bool:
        """Whether the window is watched: it has recorded a heartbeat."""
        return self._watching.is_set()

    def wait_until_watched(self) -> None:
        """Wait until the window is watched, as a procedure does before it opens the instrument.

        Raises:
            CancelledError: the stop was triggered meanwhile.
        """
        while not self._watching.wait(_LOOK_S):
            self.check()
        self.check()

    def is_set(self) -> bool:
        """Return whether to stop."""
        self._miss()
        return self._pressed.is_set()

    def check(self) -> bool:
        """Return False, or raise if the stop was triggered.

        Raises:
            CancelledError: the stop was triggered; the message says why. An UnattendedError where it was not a person.
        """
        if self.is_set():
            if self._reason == NO_ANSWER:
                raise UnattendedError(self._reason)
            kind = UnattendedError if self._reason == BY_DEFECT else CancelledError
            raise kind(Message("stop.released", "{cause}; the coil is released", cause=self._reason))
        return False

    def wait(self, seconds: float) -> None:
        """Wait, or return at once when the stop is triggered."""
        self._pressed.wait(seconds)

    def _miss(self) -> None:
        last = self._last_beat_s
        if last is not None and self._clock() - last > self._patience_s:
            self.press(NO_ANSWER)
