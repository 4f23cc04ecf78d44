"""Sits in front of the program as it is started by ``tissueid``, and measures once, as soon as the window can be used.

Run as ``first_test.py [DELAY_S]``. Prints one line of JSON: the longest time between two beats of the window
while the coil could be energised, s, and how the test ended. Where that took longer than ``SLOW_S``, the stacks of all
threads at that moment are on the standard error.
"""

from __future__ import annotations

import faulthandler
import json
import os
import sys
import time

from PySide6.QtCore import QTimer

from tissueid.app import window as program
from tissueid.app.emergency import EmergencyStop
from tissueid.app.main_window import MainWindow
from tissueid.app.navigation_bar import MEASURE

SLOW_S = 0.4
LONGEST_S = 150.0


class Visitor:
    """Begins a test ``delay_s`` after the window is shown, and ends the process with the test."""

    def __init__(self, window: MainWindow, delay_s: float) -> None:
        self._window = window
        self._last = self._longest = 0.0
        self._began = time.monotonic()
        ended, failed = window.on_test_ended, window.on_test_failed
        visitor, beat = self, EmergencyStop.beat

        def seen(stop: EmergencyStop) -> None:
            beat(stop)
            visitor._beat()

        EmergencyStop.beat = seen  # type: ignore[method-assign]
        window.on_test_ended = lambda outcome: (ended(outcome), self._leave(outcome.error))
        window.on_test_failed = lambda words: (failed(words), self._leave(words))
        QTimer.singleShot(round(1000 * delay_s), window, self._begin)

    def _beat(self) -> None:
        now = time.monotonic()
        if self._last:
            self._longest = max(self._longest, now - self._last)
        self._last = now
        faulthandler.dump_traceback_later(SLOW_S)
        if now - self._began > LONGEST_S:
            self._leave("the test did not end")

    def _begin(self) -> None:
        window, form = self._window, self._window.ui.form
        if window.jobs:
            QTimer.singleShot(10, window, self._begin)
            return
        if window.ui.page != MEASURE:
            window.pages.show(MEASURE)
            QTimer.singleShot(50, window, self._begin)
            return
        form.fill({"url": "simulated://forearm", "site": "left calf", "seconds": 1.0})
        if not window.ui.start.isEnabled():
            QTimer.singleShot(10, window, self._begin)
            return
        window.ui.start.click()
        if not window.testing:
            self._leave(window.ui.notice.text.text())

    def _leave(self, error: object) -> None:
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.write(json.dumps({"longest_s": self._longest, "error": str(error or "")}) + "\n")
        sys.stdout.flush()
        os._exit(0)  # the analysis of the test is not waited for


def main(delay_s: str = "0.2") -> int:
    shown = MainWindow.show

    def show(window: MainWindow) -> None:
        shown(window)
        window.visitor = Visitor(window, float(delay_s))  # type: ignore[attr-defined]

    MainWindow.show = show  # type: ignore[method-assign]
    return program.run()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
