"""One piece of slow work of a page at a time, with words about it and a way to end it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, Signal

from tissueid.app.views.view import Desk
from tissueid.errors import CancelledError
from tissueid.language import _

Cancelled = Callable[[], None]


class _GivenUp:
    """Stands for the result of work that was cancelled."""


class Errands(QObject):
    """Hands work to the jobs of the window; nothing begins beside other work. ``changed``: it began, or is over."""

    changed = Signal()

    def __init__(self, desk: Desk, parent: QObject) -> None:
        super().__init__(parent)
        self._desk = desk
        self._stop = threading.Event()
        self._done: Callable[[Any], None] | None = None
        self._failed: Callable[[str], None] | None = None
        self.words = ""

    @property
    def running(self) -> bool:
        """Whether work of this page goes on."""
        return bool(self.words)

    def start(
        self,
        words: str,
        work: Callable[[Cancelled], Any],
        done: Callable[[Any], None],
        failed: Callable[[str], None],
    ) -> bool:
        """Begin; ``work`` gets what it must call from time to time. False where something else goes on."""
        if self._desk.busy or self.running:
            return False
        self._stop = stop = threading.Event()
        self._done, self._failed, self.words = done, failed, words

        def check() -> None:
            if stop.is_set():
                raise CancelledError("it was cancelled")

        def run() -> Any:
            try:
                return work(check)
            except CancelledError:
                return _GivenUp()

        why = _("Work goes on on the page Instrument: cancel it there, or wait.")
        self._desk.jobs.do(run, self._succeeded, self._broke, why=why)
        self.changed.emit()
        return True

    def cancel(self) -> None:
        """End what goes on, soon."""
        self._stop.set()

    def _succeeded(self, result: Any) -> None:
        done, failed = self._over()
        if isinstance(result, _GivenUp) or self._stop.is_set():
            # Work that was over before it heard of it is given up as well: nobody waits for its result.
            failed("")
        else:
            done(result)
        self.changed.emit()

    def _broke(self, words: str) -> None:
        self._over()[1](words)
        self.changed.emit()

    def _over(self) -> tuple[Callable[[Any], None], Callable[[str], None]]:
        done, failed = self._done, self._failed
        assert done is not None
        assert failed is not None
        self._done = self._failed = None
        self.words = ""
        return done, failed
