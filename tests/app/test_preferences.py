"""Appearance, text size and the state of the window, as they were chosen and left."""

import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import Qt

from tissueid.app.theme import DARK, LIGHT, appearance
from tissueid.app.window_state import show_window

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def chosen(window, title):
    {action.title: action for action in window.declare_actions()}[title].run()


def test_appearance_and_text_size_are_chosen_in_the_palette_and_kept(qtbot, open_window):
    window = open_window()
    assert appearance.theme is LIGHT
    before = window.font().pointSizeF()
    chosen(window, "Appearance: Dark")
    chosen(window, "Text size: Larger (130 %)")
    qtbot.waitUntil(lambda: appearance.theme is DARK and window.font().pointSizeF() > 1.2 * before, timeout=WAIT_MS)
    assert window.pages.start.appearance.choice.currentData() == "dark"
    assert window.ui.form.site.font().pointSizeF() == pytest.approx(1.3 * before, abs=0.6)
    again = open_window()
    assert appearance.theme is DARK
    assert again.font().pointSizeF() == window.font().pointSizeF()
    chosen(again, "Appearance: As the system")
    qtbot.waitUntil(lambda: appearance.theme is LIGHT, timeout=WAIT_MS)


def test_a_window_that_was_left_maximised_comes_back_maximised(qtbot, open_window):
    window = open_window()
    window.showMaximized()
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    again = open_window()
    again.hide()
    show_window(again)
    assert again.isMaximized()
    again.showNormal()
    again.close()
    qtbot.waitUntil(lambda: not again.isVisible(), timeout=WAIT_MS)
    assert again.settings.value("window/maximised") == "no"


def test_the_log_opens_at_its_newest_line(qtbot, open_window):
    window = open_window()
    for number in range(300):
        window.panels.log.note(f"line {number}")
    window.panels.log_button.click()
    bar = window.panels.log.lines.verticalScrollBar()
    qtbot.waitUntil(lambda: window.panels.log.isVisible() and bar.value() == bar.maximum() > 0, timeout=WAIT_MS)


def test_the_palette_says_where_nothing_matches(qtbot, open_window):
    window = open_window()
    window.commands.toggle()
    qtbot.keyClicks(window.commands.search, "xyzzy")
    item = window.commands.list.item(0)
    assert window.commands.list.count() == 1
    assert item.text()
    assert item.flags() == Qt.ItemFlag.NoItemFlags
    assert window.commands.chosen is None
