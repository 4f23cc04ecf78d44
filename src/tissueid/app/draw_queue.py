"""Queue of canvases to be drawn: one in each turn of the event loop, so that the window answers between two of them."""

from __future__ import annotations

from typing import Protocol

from PySide6.QtCore import QCoreApplication, QObject, QTimer
from shiboken6 import isValid


class Drawable(Protocol):
    """A widget that draws itself on request."""

    @property
    def pending(self) -> bool:
        """Whether there is something to draw."""

    def isVisible(self) -> bool:  # noqa: N802 - as Qt calls it
        """Return whether the widget is on the screen."""

    def draw_pending(self) -> None:
        """Draw it."""


class _DrawQueue(QObject):
    def __init__(self, parent: QObject | None) -> None:
        super().__init__(parent)
        self._waiting: list[Drawable] = []
        self._last: Drawable | None = None
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._next)

    def request(self, canvas: Drawable) -> None:
        if self._timer.isActive() and self._last is not canvas:
            if canvas not in self._waiting:
                self._waiting.append(canvas)
            return
        self._last = canvas
        self._timer.start(0)
        canvas.draw_pending()

    def _next(self) -> None:
        while self._waiting:
            canvas = self._waiting.pop(0)
            if isValid(canvas) and canvas.pending and canvas.isVisible():
                self._last = canvas
                canvas.draw_pending()
                return
        self._last = None
        self._timer.stop()


_queue: _DrawQueue | None = None
"""Queue of the application; made for the first canvas."""


def request_drawing(canvas: Drawable) -> None:
    """Draw a canvas at once, or in a later turn of the event loop if another one was drawn in this turn."""
    global _queue
    if _queue is None or not isValid(_queue):
        _queue = _DrawQueue(QCoreApplication.instance())
    _queue.request(canvas)
