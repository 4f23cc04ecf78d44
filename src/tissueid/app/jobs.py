"""Jobs: work in threads outside the GUI thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, QThread, Signal

from tissueid.app.words import in_words
from tissueid.errors import CancelledError
from tissueid.language import _
from tissueid.procedures.control import Control


class JobControl(Control):
    """Progress, notices and cancellation. The GUI thread reads ``step``, ``fraction``, ``notices`` and ``parts``.

    ``fraction`` is the completed share from 0 to 1, None where it is not known.
    """

    def __init__(self) -> None:
        self._cancelled = threading.Event()
        self.step = ""
        self.fraction: float | None = 0.0
        self.notices: list[str] = []
        self.parts: list[Any] = []

    def progress(self, fraction: float | None, step: str) -> None:
        """Keep the step and its completed share."""
        self.step, self.fraction = step, fraction

    def notice(self, message: str) -> None:
        """Keep a notice for the end of the job."""
        self.notices.append(message)

    def finished(self, part: object) -> None:
        """Keep a part of the result that is ready."""
        self.parts.append(part)

    def cancel(self) -> None:
        """Request cancellation."""
        self._cancelled.set()

    def cancelled(self) -> bool:
        """Return whether cancellation was requested."""
        return self._cancelled.is_set()


class Job(QThread):
    """A job in its own thread. It ends with one of two signals, which are delivered in the GUI thread.

    Connect the signals to methods of QObjects only: these are called in the thread of the object.
    """

    succeeded = Signal(object)
    failed = Signal(str)

    def __init__(self, work: Callable[[], Any], gate: threading.Event | None, parent: QObject) -> None:
        super().__init__(parent)
        self._work, self._gate = work, gate

    def run(self) -> None:
        """Run the work; called by Qt in the new thread."""
        try:
            result = self._work()
        except Exception as error:  # noqa: BLE001 - the last stop before the window, which says it in words
            self._wait()
            self.failed.emit(in_words(error))
        else:
            self._wait()
            self.succeeded.emit(result)

    def _wait(self) -> None:
        if self._gate is not None:
            self._gate.wait()


class Jobs(QObject):
    """The running jobs; ``changed`` is sent when a job starts and when it has ended.

    True while a short job runs, or one that uses the instrument: no other job can start then. Long work on saved files
    is apart: it excludes other long work only, so that one can measure, open sessions and write reports meanwhile.
    """

    changed = Signal()
    failed = Signal(str)
    """Carries the error message of a failed job, after its own callback was called."""
    ready = Signal()
    """Sent when a job has succeeded, before its result is shown."""

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._running: dict[Job, str] = {}
        self._long: dict[Job, str] = {}
        self._gate = threading.Event()
        self._gate.set()

    def __bool__(self) -> bool:
        return bool(self._running)

    @property
    def idle(self) -> bool:
        """Whether no job runs."""
        return not (self._running or self._long)

    @property
    def working(self) -> bool:
        """Whether long work runs."""
        return bool(self._long)

    @property
    def why(self) -> str:
        """Return why no job can start: the running job and how to end it; empty if no short job runs."""
        said = [why for why in self._running.values() if why]
        return said[0] if said else _("Something is being finished: wait a moment.") if self._running else ""

    @property
    def why_no_work(self) -> str:
        """Return why no long work can start; empty if no job runs."""
        return next(iter(self._long.values()), "") or self.why

    def hold_results(self, hold: bool) -> None:
        """Keep back the results of long work, whose display would stall the window during a measurement."""
        if hold:
            self._gate.clear()
        else:
            self._gate.set()

    def do(
        self,
        work: Callable[[], Any],
        succeeded: Callable[[Any], None],
        failed: Callable[[str], None],
        *,
        why: str = "",
        long: bool = False,
    ) -> None:
        """Start a job; one of the two callbacks is called at its end.

        ``why`` describes the job and how to end it, for controls that are disabled meanwhile; short jobs need none.
        ``long`` work must run in a process of its own, at low priority, to leave the processor to a measurement.
        """
        job = Job(work, self._gate if long else None, self)
        job.succeeded.connect(self._say_ready)
        job.succeeded.connect(succeeded)
        job.failed.connect(failed)
        job.failed.connect(self.failed)
        job.finished.connect(self._finished)
        (self._long if long else self._running)[job] = why
        self.changed.emit()
        job.start()

    def _say_ready(self, _result: object) -> None:
        self.ready.emit()

    def _finished(self) -> None:
        job = self.sender()
        if isinstance(job, Job):
            job.wait()
            self._running.pop(job, None)
            self._long.pop(job, None)
            job.deleteLater()
        self.changed.emit()


class _Cancelled:
    """Result of a cancelled job."""


class PageJob(QObject):
    """One cancellable job of a page at a time. It does not start while another job of the window runs.

    ``changed`` is sent when the job starts and when it has ended.
    """

    changed = Signal()

    def __init__(self, jobs: Jobs, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs = jobs
        self._control = JobControl()
        self._done: Callable[[Any], None] | None = None
        self._failed: Callable[[str], None] | None = None
        self.activity = ""

    @property
    def running(self) -> bool:
        """Whether the page has a running job."""
        return bool(self.activity)

    def start(
        self,
        activity: str,
        work: Callable[[Callable[[], object]], Any],
        done: Callable[[Any], None],
        failed: Callable[[str], None],
    ) -> bool:
        """Start ``work`` in a thread; return False where another job runs.

        ``work`` gets a function that it must call from time to time: it raises CancelledError after :meth:`cancel`.
        ``failed`` gets the error message, which is empty for a cancelled job. ``activity`` says what the job does.
        """
        if self._jobs or self.running:
            return False
        self._control = control = JobControl()
        self._done, self._failed, self.activity = done, failed, activity

        def run() -> Any:
            try:
                return work(control.check)
            except CancelledError:
                return _Cancelled()

        why = _("Work goes on on the page Instrument: cancel it there, or wait.")
        self._jobs.do(run, self._succeeded, self._broke, why=why)
        self.changed.emit()
        return True

    def cancel(self) -> None:
        """Cancel the job; it ends at the next call of its check."""
        self._control.cancel()

    def _succeeded(self, result: Any) -> None:
        done, failed = self._over()
        if isinstance(result, _Cancelled) or self._control.cancelled():
            # A job that finished before it noticed the cancellation counts as cancelled.
            failed("")
        else:
            done(result)
        self.changed.emit()

    def _broke(self, message: str) -> None:
        self._over()[1](message)
        self.changed.emit()

    def _over(self) -> tuple[Callable[[Any], None], Callable[[str], None]]:
        done, failed = self._done, self._failed
        assert done is not None
        assert failed is not None
        self._done = self._failed = None
        self.activity = ""
        return done, failed
