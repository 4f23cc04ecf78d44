"""Starting the application."""

from __future__ import annotations

import gc
import signal
import sys
from types import FrameType, TracebackType

from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QApplication

from tissueid.app.main_window import MainWindow

_HOUSEKEEPING_MS = 500


class Housekeeping(QObject):
    """What has to happen in the window's thread now and then.

    Cyclic garbage is collected here and only here, as often as Python would: a collection in a worker thread could
    delete a widget there. The visit also lets Python notice a signal (Ctrl+C) while Qt waits for events.
    """

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        gc.collect()
        gc.freeze()  # what was imported stays; later collections need not look at it
        gc.disable()
        timer = QTimer(self)
        timer.setInterval(_HOUSEKEEPING_MS)
        timer.timeout.connect(self._visit)
        timer.start()

    def _visit(self) -> None:
        if self._window.testing:
            return  # a collection stops every thread, the one that measures too
        full = [count > most for count, most in zip(gc.get_count(), gc.get_threshold(), strict=True)]
        for generation in (2, 1, 0):
            if full[generation]:
                gc.collect(generation)
                return


def run() -> int:
    """Open the window and stay until it is closed; returns the exit status."""
    application = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(application, QApplication)
    application.setApplicationName("TissueID")
    application.setStyle("Fusion")
    window = MainWindow()
    housekeeping = Housekeeping(window)

    def close(_number: int, _frame: FrameType | None) -> None:
        window.close()

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)
        window.meet_defect(error)

    previous = {number: signal.signal(number, close) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.excepthook = tell
    try:
        window.show()
        return application.exec()
    finally:
        sys.excepthook = sys.__excepthook__
        for number, handler in previous.items():
            signal.signal(number, handler)
        gc.enable()
        housekeeping.deleteLater()
