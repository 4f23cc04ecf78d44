"""Opening and closing windows again and again: nothing is left of them."""

import functools
import gc
import sys
import weakref

import pytest
from app.bare_plots import counted, references_left
from app.benches import WAIT_MS, found
from PySide6.QtCore import QCoreApplication, QEvent, QSettings
from PySide6.QtWidgets import QApplication

from tissueid.app.context import AppServices
from tissueid.app.main_window import MainWindow
from tissueid.app.theme import DARK, LIGHT, appearance

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def plots_rendered():
    return True


def live_and_die(qtbot, folder, saved, *, analyse):
    kept = functools.partial(QSettings, str(folder / "window.ini"), QSettings.Format.IniFormat)
    window = MainWindow(
        AppServices(finder=found, folder=folder, show_file=lambda _: True, first_page="measure", settings=kept)
    )
    window.show()
    if analyse:
        window.open_session(saved)
        qtbot.waitUntil(lambda: window.findings is not None and not window.jobs, timeout=WAIT_MS)
        window.grab()
    for theme in (DARK, LIGHT):
        appearance.use(theme)
    made = counted(window)
    window.close()
    window.deleteLater()
    return weakref.ref(window), made


def test_twenty_windows_leave_nothing_behind(qtbot, tmp_path, saved):
    counts = []
    gc.collect()
    gc.freeze()
    gc.disable()  # as the application does: only this thread may delete widgets
    try:
        for number in range(20):
            window, made = live_and_die(qtbot, tmp_path, saved, analyse=number % 9 == 0)
            QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
            gc.collect()
            assert window() is None
            counts.append((len(QApplication.allWidgets()), sys.getrefcount(None)))
        bare = references_left(made)
    finally:
        gc.enable()
        gc.unfreeze()
    widgets, nones = zip(*counts, strict=True)
    assert max(widgets[5:]) <= widgets[5]
    if sys.version_info < (3, 12):  # later on None is immortal, and its count means nothing
        # A leak, or references given back twice, is thousands a window; what is left is pyqtgraph's own.
        assert abs((nones[-1] - nones[5]) / 14 - bare) < 10
