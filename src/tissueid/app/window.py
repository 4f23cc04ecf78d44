"""Starting the application."""

from __future__ import annotations

import contextlib
import gc
import importlib
import signal
import sys
import tempfile
import threading
from pathlib import Path
from types import FrameType, TracebackType

from PySide6.QtCore import QObject, QTimer
from PySide6.QtGui import QIcon
from PySide6.QtWidgets import QApplication

from tissueid.app import build
from tissueid.app.main_window import MainWindow
from tissueid.app.window_state import qt_texts, show_window
from tissueid.errors import TissueIDError

_HOUSEKEEPING_MS = 500
_WARMING_AFTER_MS = 300
_WANTED_SOON = (
    "scipy.fft",
    "scipy.signal",
    "scipy.optimize",
    "scipy.stats",
    "numba",
    "tissueid.instrument.simulated",
    "tissueid.procedures.test_run",
    "tissueid.analysis",
    "tissueid.reports.verdict",
    "tissueid.app.identifying",
    "matplotlib.backends.backend_qtagg",
    "tissueid.reports.plot_renderer",
)
"""What a test, its analysis and its plots need, in pieces that are short to wait for. None of it makes a widget."""
REHEARSED = "simulated://forearm"


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
        timer = build.timer(self, _HOUSEKEEPING_MS, self._visit, repeat=True)
        timer.start()

    def _visit(self) -> None:
        if self._window.testing:
            return  # a collection stops every thread, the one that measures too
        full = [count > most for count, most in zip(gc.get_count(), gc.get_threshold(), strict=True)]
        for generation in (2, 1, 0):
            if full[generation]:
                gc.collect(generation)
                return


class WarmUp(QObject):
    """Imports what will be wanted soon, in a thread of its own, once the window is there to be looked at.

    The coil is not energised before it is done: imports take turns with the window, which stalls for up to seconds.
    """

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._over, self._done = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._import, name="warm-up")
        QTimer.singleShot(_WARMING_AFTER_MS, self, self._begin)

    def _begin(self) -> None:
        if not self._over.is_set():
            self._thread.start()

    def _import(self) -> None:
        try:
            self._import_all()
        finally:
            self._done.set()

    def _import_all(self) -> None:
        for name in _WANTED_SOON:
            if self._over.is_set():
                return
            try:
                importlib.import_module(name)
            except ImportError:
                return  # reported where the module is used
        if not self._over.is_set():
            importlib.import_module("tissueid.reports.plot_renderer").load_fonts()
        if not self._over.is_set():
            _rehearse(self._over)

    @property
    def going_on(self) -> bool:
        """Whether modules are being imported, or will be."""
        return not self._done.is_set()

    def end(self) -> None:
        """Import nothing more; returns when the piece at hand is done."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()


def _rehearse(over: threading.Event) -> None:
    """Run a short simulated test into a temporary folder, so that the first real one imports and compiles nothing.

    ``over`` cancels it.
    """
    from tissueid.procedures.test_plan import TestPlan
    from tissueid.procedures.test_run import TestControl, run_test

    class Rehearsal(TestControl):
        def cancelled(self) -> bool:
            return over.is_set()

    with contextlib.suppress(TissueIDError, OSError), tempfile.TemporaryDirectory(prefix="tissueid-") as folder:
        plan = TestPlan(url=REHEARSED, site="rehearsal", out=Path(folder) / "rehearsal.h5", seconds=0.5)
        run_test(plan, Rehearsal(), None, separate_process=False)


def run() -> int:
    """Open the window and stay until it is closed; returns the exit status."""
    application = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(application, QApplication)
    application.setApplicationName("TissueID")
    build.styled(
        application,
        window_icon=QIcon(str(Path(__file__).with_name("tissueid.svg"))),
        desktop_file_name="tissueid",
        style="Fusion",
    )
    while True:
        window = MainWindow()
        status = _show(application, window)
        if not window.restarts:
            return status
        window.deleteLater()


def _show(application: QApplication, window: MainWindow) -> int:
    """Show a window until it is closed; returns the exit status."""
    said_by_qt = qt_texts()
    application.installTranslator(said_by_qt)
    housekeeping = Housekeeping(window)
    warm_up = WarmUp(window)
    window.warming = lambda: warm_up.going_on

    def close(_number: int, _frame: FrameType | None) -> None:
        window.close()

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)
        window.on_defect(error)

    previous = {number: signal.signal(number, close) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.excepthook = tell
    try:
        show_window(window)
        return application.exec()
    finally:
        warm_up.end()
        sys.excepthook = sys.__excepthook__
        for number, handler in previous.items():
            signal.signal(number, handler)
        gc.enable()
        housekeeping.deleteLater()
        application.removeTranslator(said_by_qt)
