"""Control of a procedure that runs in a thread of the window."""

from __future__ import annotations

import threading

from tissueid.procedures.control import Control


class JobControl(Control):
    """Progress, notices and cancellation. The GUI thread reads ``step``, ``fraction`` and ``notices``, and cancels.

    ``fraction`` is the completed share from 0 to 1, None where it is not known.
    """

    def __init__(self) -> None:
        self._cancelled = threading.Event()
        self.step = ""
        self.fraction: float | None = 0.0
        self.notices: list[str] = []

    def progress(self, fraction: float | None, step: str) -> None:
        """Keep the step and its completed share."""
        self.step, self.fraction = step, fraction

    def notice(self, message: str) -> None:
        """Keep a notice for the end of the job."""
        self.notices.append(message)

    def cancel(self) -> None:
        """Request cancellation."""
        self._cancelled.set()

    def cancelled(self) -> bool:
        """Return whether cancellation was requested."""
        return self._cancelled.is_set()
