"""How far work in a thread has come, and whether anybody still wants it."""

from __future__ import annotations

import threading

from tissueid.errors import CancelledError


class Progress:
    """Told by the thread that works, looked at by the window. Neither waits for the other."""

    def __init__(self) -> None:
        self._cancelled = threading.Event()
        self._state = ("", 0.0)

    @property
    def state(self) -> tuple[str, float]:
        """What is being done, and the share of all that is done, 0 to 1."""
        return self._state

    @property
    def cancelled(self) -> bool:
        """Whether it is to end."""
        return self._cancelled.is_set()

    def cancel(self) -> None:
        """Let it end as soon as it can."""
        self._cancelled.set()

    def tell(self, words: str, share: float) -> None:
        """Say where it stands; where nobody wants it any more, this ends it.

        Raises:
            CancelledError: it was cancelled.
        """
        self._state = (words, min(1.0, max(0.0, share)))
        if self.cancelled:
            raise CancelledError("cancelled")
