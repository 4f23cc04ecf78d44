"""Work off the window's thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, QThread, Signal

from tissueid.app.words import in_words
from tissueid.language import _


class Job(QThread):
    """One piece of work in a thread of its own. It ends with one of the two signals, in the window's thread.

    Connect them to methods of QObjects only: those are called in the object's own thread.
    """

    succeeded = Signal(object)
    failed = Signal(str)

    def __init__(self, work: Callable[[], Any], parent: QObject) -> None:
        super().__init__(parent)
        self._work = work

    def run(self) -> None:
        """Work; Qt calls this in the new thread."""
        try:
            result = self._work()
        except Exception as error:  # noqa: BLE001 - the last stop before the window, which says it in words
            self.failed.emit(in_words(error))
        else:
            self.succeeded.emit(result)


class Jobs(QObject):
    """The jobs that go on. ``changed`` is sent when one begins and when it has ended; it is true while one goes on."""

    changed = Signal()
    failed = Signal(str)
    """Why a job failed, in words, once whoever began it was told."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._running: dict[Job, str] = {}

    def __bool__(self) -> bool:
        return bool(self._running)

    @property
    def why(self) -> str:
        """What goes on and where it can be ended, in words, for whoever waits for it; empty where nothing goes on."""
        said = [why for why in self._running.values() if why]
        return said[0] if said else _("Something is being finished: wait a moment.") if self._running else ""

    def do(
        self,
        work: Callable[[], Any],
        succeeded: Callable[[Any], None],
        failed: Callable[[str], None],
        *,
        why: str = "",
    ) -> None:
        """Begin a piece of work; one of the two methods is called at its end.

        ``why`` says to others what they wait for meanwhile, and where it can be ended; work of moments needs none.
        """
        job = Job(work, self)
        job.succeeded.connect(succeeded)
        job.failed.connect(failed)
        job.failed.connect(self.failed)
        job.finished.connect(self._finished)
        self._running[job] = why
        self.changed.emit()
        job.start()

    def _finished(self) -> None:
        job = self.sender()
        if isinstance(job, Job):
            job.wait()
            self._running.pop(job, None)
            job.deleteLater()
        self.changed.emit()
