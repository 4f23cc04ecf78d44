"""Work in a thread with progress and cancellation, and the strip that shows it."""

from __future__ import annotations

from PySide6.QtCore import QSize
from PySide6.QtWidgets import QProgressBar, QWidget

from tissueid.app import build
from tissueid.app.build import button, styled, timer
from tissueid.app.jobs import JobControl
from tissueid.app.widgets import ElidedLabel
from tissueid.language import _

_LOOK_MS = 60
_STEPS = 1000
_WIDTH = 240
"""Pixels of the strip; its words are cut before its button is."""


class BackgroundWork(JobControl):
    """Work with progress. Its thread reports the ``fraction`` done and stops soon after a cancellation."""

    def __init__(self, words: str) -> None:
        super().__init__()
        self.words = words

    def tell(self, fraction: float) -> None:
        """Report the fraction done, 0 to 1.

        Raises:
            CancelledError: the work was cancelled.
        """
        self.progress(fraction, self.words)
        self.check()


class ProgressStrip(QWidget):
    """Progress bar of the running work with a button that cancels it; hidden when idle."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._errand: BackgroundWork | None = None
        self._words = styled(ElidedLabel(), role="muted")
        self._bar = styled(QProgressBar(), range=(0, _STEPS), text_visible=False, name=_("Progress"))
        self.stop = button(_("Cancel"), self.cancel, role="small", name=_("Cancel the running work"))
        build.row((self._words, 2), (self._bar, 1), self.stop, parent=self)
        self._timer = timer(self, _LOOK_MS, self._look, repeat=True)
        keep = self.sizePolicy()
        keep.setRetainSizeWhenHidden(True)
        self.setSizePolicy(keep)
        self.hide()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a fixed width, because the corner of the tabs cuts a wider widget."""
        return QSize(_WIDTH, super().sizeHint().height())

    def watch(self, errand: BackgroundWork) -> None:
        """Show the progress of work until :meth:`clear`."""
        self._errand = errand
        self.stop.setEnabled(True)
        self._words.setText(errand.words)
        self._bar.setAccessibleName(errand.words)
        self._bar.setValue(0)
        self._timer.start()
        self.show()

    def clear(self) -> None:
        """Hide the strip."""
        self._errand = None
        self._timer.stop()
        self.hide()

    def cancel(self) -> None:
        """Request cancellation."""
        if self._errand is not None:
            self._errand.cancel()
            self.stop.setEnabled(False)
            self._words.setText(_("Stopping…"))

    def _look(self) -> None:
        if self._errand is not None:
            self._bar.setValue(round(_STEPS * (self._errand.fraction or 0.0)))
