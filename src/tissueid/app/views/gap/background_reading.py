"""Background reading of the Gap page: stored diagnoses and the titles of sessions."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Signal

from tissueid.app.jobs import Jobs
from tissueid.app.views.gap.diagnosis_store import KeptDiagnoses, read_kept
from tissueid.app.views.gap.session_titles import read_titles


class BackgroundReading(QObject):
    """Reader with one job at a time; :meth:`go_on` starts the next one.

    ``kept_read`` carries the kept diagnoses, ``titles_read`` the titles of sessions by their paths; ``failed`` says in
    words why kept diagnoses cannot be read. ``wanted`` is whether they are still to be read.
    """

    kept_read = Signal(object)
    titles_read = Signal(object)
    failed = Signal(str)

    def __init__(self, jobs: Jobs, folder: Path, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs, self._folder = jobs, folder
        self.wanted = True
        self._cancelled = threading.Event()
        self.running = False

    def go_on(self, untitled: Sequence[Path]) -> bool:
        """Read the stored diagnoses once, then missing titles of sessions; return False if nothing remains."""
        if self.running:
            return True
        if self.wanted:
            self.wanted = False
            self._begin(functools.partial(read_kept, self._folder), self._kept_ended)
            return True
        if untitled:
            self._cancelled = threading.Event()
            self._begin(functools.partial(read_titles, tuple(untitled), self._cancelled), self._titles_ended)
            return True
        return False

    def cancel(self) -> None:
        """Request cancellation of the running job."""
        self._cancelled.set()

    def _begin(self, work: Callable[[], Any], ended: Callable[[Any], None]) -> None:
        self.running = True
        self._jobs.do(work, ended, self._broke)

    def _kept_ended(self, kept: KeptDiagnoses) -> None:
        self.running = False
        self.kept_read.emit(kept)

    def _titles_ended(self, titles: dict[Path, str | None]) -> None:
        self.running = False
        self.titles_read.emit(titles)

    def _broke(self, words: str) -> None:
        self.running = False
        self.failed.emit(words)
