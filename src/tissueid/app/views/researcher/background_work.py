"""Work in a thread with progress and cancellation, and the strip that shows it."""

from __future__ import annotations

from PySide6.QtCore import QSize
from PySide6.QtWidgets import QWidget

from tissueid.app import build
from tissueid.app.build import timer
from tissueid.app.jobs import JobControl
from tissueid.app.widgets import ElidedLabel
from tissueid.language import _

_LOOK_MS = 60
_WIDTH = 240
"""Pixels of the strip; its words are cut before its button is."""


class BackgroundWork(JobControl):
    """Work with progress. Its thread reports the ``fraction`` done and stops soon after a cancellation."""

    def __init__(self, label: str) -> None:
        super().__init__()
        self.label = label

    def tell(self, fraction: float) -> None:
        """Report the fraction done, 0 to 1.

        Raises:
            CancelledError: the work was cancelled.
        """
        self.progress(fraction, self.label)
        self.check()


class ProgressStrip(QWidget):
    """Progress bar of the running work with a button that cancels it; hidden when idle."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._errand: BackgroundWork | None = None
        self._progress = build.ProgressRow(ElidedLabel(), _("Progress"), _("Cancel the running work"), self.cancel)
        label, bar, self.stop = self._progress.parts
        build.row((label, 2), (bar, 1), build.styled(self.stop, role="small"), parent=self)
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
        self._progress.bar.setAccessibleName(errand.label)
        self._look()
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
            self._look()

    def _look(self) -> None:
        if self._errand is not None:
            text = _("Stopping…") if self._errand.cancelled() else self._errand.label
            self._progress.show_progress(self._errand.fraction or 0.0, text)
