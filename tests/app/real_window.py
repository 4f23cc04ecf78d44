"""Sits in front of the program as it is started by ``tissueid``, on a real display, and measures once.

Run as ``real_window.py URL``: begins on the first page as a clinician, types where and with which instrument, presses
Start, reads the result, and closes the window. What goes wrong is printed, and the exit status is 1.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable

from PySide6.QtCore import QPoint, Qt, QTimer
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from tissueid.app import window as program
from tissueid.app.main_window import MainWindow

LONGEST_S = 60.0
ALT, CONTROL = Qt.KeyboardModifier.AltModifier, Qt.KeyboardModifier.ControlModifier


def until(done: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + LONGEST_S
    while not done():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        QTest.qWait(20)


def point_at(widget: QWidget) -> None:
    """A click where the widget is in its window, so that whatever covers it gets the click instead."""
    top = widget.window()
    place = widget.mapTo(top, QPoint(widget.width() // 2, widget.height() // 2))
    assert top.rect().contains(place), f"{widget.accessibleName()} is not on the screen"
    QTest.mouseClick(top.windowHandle(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, place)


def type_over(text: str) -> None:
    """Type into whatever has the keyboard, in place of what is there."""
    handle = QGuiApplication.focusWindow()
    QTest.keyClick(handle, Qt.Key.Key_A, CONTROL)
    for letter in text:
        QTest.keyClick(handle, letter)


def sit_down(window: MainWindow, url: str) -> None:
    ui = window.ui
    assert QGuiApplication.platformName() == "xcb"
    until(window.isActiveWindow, "the keyboard")
    until(lambda: ui.page == "start" and not window.jobs, "the first page")
    point_at(window.pages.start.cards["clinician"])
    until(lambda: ui.page == "measure" and not window.jobs, "the page of the test")
    assert ui.role.role == "clinician"
    handle = window.windowHandle()
    QTest.keyClick(handle, Qt.Key.Key_I, ALT)
    assert ui.form.instrument.choice.hasFocus()
    type_over(url)
    point_at(ui.form.fold)
    until(ui.form.options["seconds"].isVisible, "the settings")
    QTest.keyClick(handle, Qt.Key.Key_A, ALT)
    assert ui.form.options["seconds"].controls[0].hasFocus()
    type_over("1")
    QTest.keyClick(handle, Qt.Key.Key_T, ALT)
    assert ui.form.site.hasFocus()
    type_over("left calf")
    QTest.keyClick(handle, Qt.Key.Key_Return)
    assert ui.form.subject.hasFocus()
    type_over("P 042")
    assert not window.testing
    point_at(ui.start)
    assert window.testing
    assert ui.stop.hasFocus()
    until(lambda: window.findings is not None and not window.jobs, "the result")
    assert not window.testing
    assert ui.notice.isHidden(), ui.notice.text.text()
    assert ui.gate.isVisible()
    assert ui.pages.currentWidget() is ui.result
    # What the display itself shows, which no widget painted by hand: text, colours, curves.
    picture = window.screen().grabWindow(0).toImage()
    colours = {picture.pixel(x, y) for x in range(0, picture.width(), 3) for y in range(0, picture.height(), 3)}
    assert len(colours) > 50
    QTest.keyClick(handle, Qt.Key.Key_1, CONTROL)
    until(lambda: not window.jobs and window.pages.start.recent.rowCount() == 1, "the test among the recent sessions")


def main(url: str) -> int:
    failures: list[str] = []
    shown = MainWindow.show

    def show(window: MainWindow) -> None:
        shown(window)
        window.activateWindow()

        def begin() -> None:
            try:
                sit_down(window, url)
            except BaseException:  # noqa: BLE001 - an exception in a slot of Qt would reach nobody
                failures.append(traceback.format_exc())
            window.close()

        QTimer.singleShot(0, window, begin)

    MainWindow.show = show  # type: ignore[method-assign]
    status = program.run()
    assert QApplication.topLevelWidgets() == [] or not any(item.isVisible() for item in QApplication.topLevelWidgets())
    sys.stdout.write("\n".join(failures))
    return 1 if failures else status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
