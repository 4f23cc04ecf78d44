"""Slow work of this page, between the thread that does it and the window that shows how far it is, or ends it."""

from __future__ import annotations

import threading

from PySide6.QtCore import QSize, QTimer
from PySide6.QtWidgets import QHBoxLayout, QProgressBar, QPushButton, QWidget

from tissueid.app.elided import ElidedLabel
from tissueid.errors import CancelledError
from tissueid.language import _

_LOOK_MS = 60
_STEPS = 1000
_WIDTH = 240
"""Pixels of the strip; its words are cut before its button is."""


class Errand:
    """One piece of work. The thread that does it tells the ``fraction`` done, and stops soon after it is cancelled."""

    def __init__(self, words: str) -> None:
        self.words = words
        self.fraction = 0.0
        self._cancelled = threading.Event()

    def tell(self, fraction: float) -> None:
        """So much of it is done, 0 to 1.

        Raises:
            CancelledError: it is not wanted any more.
        """
        self.fraction = fraction
        if self._cancelled.is_set():
            raise CancelledError("cancelled")

    def cancel(self) -> None:
        """It is not wanted any more."""
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        """Whether it is not wanted any more."""
        return self._cancelled.is_set()


class ErrandStrip(QWidget):
    """Progress of the running errand, and the button that cancels it. Hidden while there is none."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._errand: Errand | None = None
        self._words = ElidedLabel()
        self._words.setProperty("role", "muted")
        self._bar = QProgressBar()
        self._bar.setRange(0, _STEPS)
        self._bar.setTextVisible(False)
        self._bar.setAccessibleName(_("Progress"))
        self.stop = QPushButton(_("Cancel"))
        self.stop.setProperty("role", "small")  # it stands in the corner of a bar of tabs
        self.stop.setAccessibleName(_("Cancel what is going on"))
        self.stop.clicked.connect(self.cancel)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self._words, 2)
        row.addWidget(self._bar, 1)
        row.addWidget(self.stop)
        self._timer = QTimer(self)
        self._timer.setInterval(_LOOK_MS)
        self._timer.timeout.connect(self._look)
        keep = self.sizePolicy()
        keep.setRetainSizeWhenHidden(True)
        self.setSizePolicy(keep)
        self.hide()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the same width whatever is going on: the corner of tabs gives no more, and cuts what is wider."""
        return QSize(_WIDTH, super().sizeHint().height())

    def watch(self, errand: Errand) -> None:
        """Show how far an errand is, until :meth:`rest`."""
        self._errand = errand
        self.stop.setEnabled(True)
        self._words.setText(errand.words)
        self._bar.setAccessibleName(errand.words)
        self._bar.setValue(0)
        self._timer.start()
        self.show()

    def rest(self) -> None:
        """It has ended."""
        self._errand = None
        self._timer.stop()
        self.hide()

    def cancel(self) -> None:
        """End it soon."""
        if self._errand is not None:
            self._errand.cancel()
            self.stop.setEnabled(False)
            self._words.setText(_("Stopping…"))

    def _look(self) -> None:
        if self._errand is not None:
            self._bar.setValue(round(_STEPS * self._errand.fraction))


__all__ = ["Errand", "ErrandStrip"]
