"""The emergency stop: by a person, by the program, or because the window does not answer. Nothing here knows Qt."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from tissueid.errors import CancelledError

PATIENCE_S = 1.0
"""How long the window may stand still while the coil can be energised."""

BY_BUTTON = "stopped in the window"
BY_KEY = "stopped by key"
BY_CLOSING = "the window was closed"
BY_DEFECT = "a defect in the window"
NO_ANSWER = "the window did not answer; the coil was released"


def seconds_since_boot() -> float:
    """Seconds that never go back, those included that the computer slept, where the system counts them."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)  # Linux; on Windows the monotonic clock counts them by itself
    return time.monotonic() if clock is None else time.clock_gettime(clock)


class EmergencyStop:
    """Ends one test or calibration, once and for all: the first reason stays.

    Any thread may :meth:`press` it; the one that measures calls :meth:`check` after every poll. It is a dead man's
    switch too: from the first :meth:`beat` on, which is the window saying that it lives, more than ``patience_s``
    seconds without one are a reason of their own. ``clock`` gives seconds that never go back.
    """

    def __init__(self, clock: Callable[[], float] = seconds_since_boot, patience_s: float = PATIENCE_S) -> None:
        self._clock = clock
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._pressed = threading.Event()
        self._last_beat_s: float | None = None
        self._reason = ""

    @property
    def reason(self) -> str:
        """Why it was stopped; empty while it was not."""
        return self._reason

    def press(self, reason: str) -> None:
        """Stop, for this reason."""
        with self._lock:
            self._reason = self._reason or reason
            self._pressed.set()

    def beat(self) -> None:
        """The window lives. One that comes too late is no beat any more: what happened in between was not watched."""
        self._miss()
        self._last_beat_s = self._clock()

    def is_set(self) -> bool:
        """Whether to stop, for whatever reason."""
        self._miss()
        return self._pressed.is_set()

    def check(self) -> bool:
        """False; for whoever asks whether the test is cancelled.

        Raises:
            CancelledError: it is; the line says why.
        """
        if self.is_set():
            raise CancelledError(self._reason if self._reason == NO_ANSWER else f"{self._reason}; the coil is released")
        return False

    def wait(self, seconds: float) -> None:
        """Wait, but not when there is a reason to stop."""
        self._pressed.wait(seconds)

    def _miss(self) -> None:
        last = self._last_beat_s
        if last is not None and self._clock() - last > self._patience_s:
            self.press(NO_ANSWER)
