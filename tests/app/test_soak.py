"""The window opened and closed two hundred times, with everything in it looked at: nothing stays behind."""

import functools
import gc
import os
import sys
import threading
from pathlib import Path

import pytest
from app.bare_plots import counted, references_left
from app.benches import WAIT_MS, found
from PySide6.QtCore import QCoreApplication, QEvent, QSettings
from PySide6.QtWidgets import QApplication

from tissueid.app.context import AppServices
from tissueid.app.main_window import MainWindow
from tissueid.app.theme import DARK, LIGHT, appearance
from tissueid.audit import AuditLog

WINDOWS = 200
WARM = 40
"""Windows until caches of pyqtgraph, fonts and figures are filled."""


@pytest.fixture
def plots_rendered():
    return True


def live_and_die(qtbot, folder, saved, *, analyse):
    kept = functools.partial(QSettings, str(folder / "window.ini"), QSettings.Format.IniFormat)
    window = MainWindow(
        AppServices(
            finder=found,
            folder=folder,
            calibrations=folder,
            show_file=lambda _: True,
            first_page="start",
            settings=kept,
            audit=AuditLog(folder / "audit.log"),
        )
    )
    window.show()
    for page in window.ui.rail.buttons:
        window.pages.show(page)
        QCoreApplication.processEvents()
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    if analyse:
        window.open_session(saved)
        qtbot.waitUntil(lambda: window.findings is not None and not window.jobs, timeout=WAIT_MS)
        window.grab()
    for theme in (DARK, LIGHT):
        appearance.use(theme)
    made = counted(window)
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    window.deleteLater()
    return made


def resident_mb():
    """Memory that this process holds, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.mark.soak
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.timeout(1800)
def test_two_hundred_windows_with_every_page_leave_nothing_behind(qtbot, tmp_path, saved):
    counts = []
    gc.collect()
    gc.freeze()
    gc.disable()  # as the application does: only this thread may delete widgets
    try:
        for number in range(WINDOWS):
            made = live_and_die(qtbot, tmp_path, saved, analyse=number % 20 == 0)
            QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
            gc.collect()
            counts.append(
                (
                    len(QApplication.allWidgets()),
                    threading.active_count(),
                    len(gc.get_objects()),
                    resident_mb(),
                    sys.getrefcount(None),
                )
            )
        bare = references_left(made)
    finally:
        gc.enable()
        gc.unfreeze()
    widgets, threads, objects, resident, nones = zip(*counts, strict=True)
    windows = WINDOWS - WARM
    assert max(widgets[WARM:]) <= widgets[WARM]
    assert max(threads[WARM:]) <= threads[WARM]
    assert objects[-1] - objects[WARM] < 2 * windows
    assert resident[-1] - resident[WARM] < 0.05 * windows
    if sys.version_info < (3, 12):  # later on None is immortal, and its count means nothing
        # 189 a window, every one of them pyqtgraph's: 31 plots, 98 curves and 11 lines alone leave as many.
        assert abs((nones[-1] - nones[WARM]) / windows - bare) < 10
