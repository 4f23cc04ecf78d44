"""A coil is started by a person who means it: never by Return or Space of somebody who fills in the form."""

import pytest
from app.test_window import idle, press, type_site
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication

from tissueid.app import emergency
from tissueid.app.emergency import QUIET_S

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

KEYS = [Qt.Key.Key_Space, Qt.Key.Key_Return, Qt.Key.Key_Enter]


@pytest.fixture
def seconds(monkeypatch):
    """The clock of the guard: it stands still until a test moves it on."""
    moment = [100.0]
    monkeypatch.setattr(emergency, "now", lambda: moment[0])
    return moment


@pytest.fixture
def technician(open_window):
    """A window with every button that can energise a coil to be seen."""
    window = open_window(role="technician")
    window.ui.pages.setCurrentWidget(window.ui.calibration)
    window.ui.gate.show()
    for button in window.ui.guarded:
        button.show()
    window.ui.gate.repeats.show()
    return window


def typed(qtbot, text):
    """Keys that go to whatever has the focus, as those of a keyboard."""
    for letter in text:
        qtbot.keyClick(QApplication.focusWidget(), letter)


def test_site_return_and_a_pseudonym_with_a_space_start_nothing(qtbot, window, bench, seconds):
    form = window.ui.form
    type_site(qtbot, window)
    qtbot.keyClick(form.site, Qt.Key.Key_Return)
    typed(qtbot, "P 001")
    assert (form.subject.text(), form.site.currentText()) == ("P 001", "left forearm")
    seconds[0] += 10.0
    for _ in range(30):
        qtbot.keyClick(QApplication.focusWidget(), Qt.Key.Key_Return)
    assert idle(window)
    assert bench.opened == []
    assert form.isAncestorOf(QApplication.focusWidget())
    press(qtbot, window.ui.start)
    assert window.testing


def test_return_visits_the_fields_and_no_button(qtbot, window):
    form = window.ui.form
    form.instrument.choice.setFocus()
    visited = [form.instrument.choice]
    while True:
        qtbot.keyClick(form, Qt.Key.Key_Return)
        if form.focusWidget() is visited[-1]:
            break
        visited.append(form.focusWidget())
    assert visited[:4] == [form.instrument.choice, form.site, form.subject, form.product]
    assert visited[-1] is form.path


def test_the_focus_that_comes_by_itself_presses_nothing(qtbot, technician, bench, seconds):
    """As after a test, when the button that had the focus is hidden, or when the window is activated again."""
    for button in technician.ui.guarded:
        for reason in (Qt.FocusReason.OtherFocusReason, Qt.FocusReason.ActiveWindowFocusReason):
            technician.ui.form.site.setFocus()
            button.setFocus(reason)
            seconds[0] += 10.0
            for key in KEYS:
                assert pressed_by(qtbot, button, key) == 0, button.text()
    assert idle(technician)
    assert bench.opened == []


def pressed_by(qtbot, button, key):
    """How often a key presses a button."""
    seen = []
    button.pressed.connect(lambda: seen.append(1))
    button.clicked.connect(lambda: seen.append(1))
    qtbot.keyClick(button, key)
    return len(seen)


@pytest.mark.parametrize("gone", ["hidden", "disabled"])
def test_focus_left_over_by_another_control_presses_nothing(qtbot, window, seconds, gone):
    ui = window.ui
    before = ui.guidance.lamp.watch
    ui.form.site.setEditText("left calf")
    before.setFocus(Qt.FocusReason.TabFocusReason)
    before.hide() if gone == "hidden" else before.setEnabled(False)
    assert ui.start.hasFocus()
    seconds[0] += 10.0
    qtbot.keyClick(ui.start, Qt.Key.Key_Space)
    qtbot.keyClick(ui.start, Qt.Key.Key_Return)
    assert idle(window)


@pytest.mark.parametrize("key", KEYS)
def test_start_takes_a_key_a_moment_after_the_tab_key_brought_the_focus(qtbot, window, seconds, key):
    ui = window.ui
    type_site(qtbot, window)
    ui.guidance.lamp.watch.setFocus()
    qtbot.keyClick(ui.guidance.lamp.watch, Qt.Key.Key_Tab)
    assert ui.start.hasFocus()
    seconds[0] += 0.9 * QUIET_S
    qtbot.keyClick(ui.start, key)
    assert idle(window)
    seconds[0] += QUIET_S
    held = QKeyEvent(QEvent.Type.KeyPress, key, Qt.KeyboardModifier.NoModifier, " ", True)
    QApplication.sendEvent(ui.start, held)
    assert idle(window)
    qtbot.keyClick(ui.start, key)
    assert window.testing


def test_text_that_is_typed_at_start_starts_nothing_later(qtbot, window, seconds):
    type_site(qtbot, window)
    window.ui.start.setFocus(Qt.FocusReason.TabFocusReason)
    seconds[0] += 10.0
    typed(qtbot, "P")
    seconds[0] += 10.0
    typed(qtbot, " 001")
    assert idle(window)
