"""Progress and cancellation of an analysis that runs in a thread."""

from __future__ import annotations

import threading

from tissueid.errors import CancelledError


class AnalysisProgress:
    """Thread-safe progress and cancellation flag."""

    def __init__(self) -> None:
        self._cancelled = threading.Event()
        self._state = ("", 0.0)

    @property
    def state(self) -> tuple[str, float]:
        """Current step and completed share (0 to 1)."""
        return self._state

    @property
    def cancelled(self) -> bool:
        """Whether cancellation was requested."""
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Request cancellation."""
        self._cancelled.set()

    def tell(self, words: str, share: float) -> None:
        """Report the current step and the completed share (0 to 1).

        Raises:
            CancelledError: the work was cancelled.
        """
        self._state = (words, min(1.0, max(0.0, share)))
        if self.cancelled:
            raise CancelledError("cancelled")
