"""The command palette: found by a word, run by Return, and never in the way of STOP."""

import pytest
from app.benches import WAIT_MS, Gate
from app.test_geometry import FRAME, SIZES, fully_visible, settle
from app.test_window import idle, press, type_site
from coded import shows
from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

CONTROL = Qt.KeyboardModifier.ControlModifier


def open_palette(qtbot, window):
    qtbot.keyClick(window.focusWidget() or window, Qt.Key.Key_K, CONTROL)
    palette = window.commands
    assert palette.isVisible()
    assert palette.search.hasFocus()
    return palette


def listed(palette):
    return [palette.list.item(row).text() for row in range(palette.list.count())]


@pytest.fixture
def window(fresh_window):
    return fresh_window


def test_a_page_is_found_by_a_word_and_shown_by_return(qtbot, window):
    window.ui.form.subject.setFocus()
    palette = open_palette(qtbot, window)
    qtbot.keyClicks(palette.search, "page gap")
    assert [text.split("  ")[0] for text in listed(palette)] == ["Page Gap"]
    qtbot.keyClick(palette.search, Qt.Key.Key_Return)
    assert window.ui.page == "gap"
    assert palette.isHidden()


def test_it_speaks_the_language_of_the_window(qtbot, open_window):
    window = open_window(language="de")
    palette = open_palette(qtbot, window)
    qtbot.keyClicks(palette.search, "forsch")
    assert palette.chosen.title == "Seite Forschung"


def test_escape_closes_it_and_gives_the_keyboard_back(qtbot, window):
    window.ui.form.subject.setFocus()
    palette = open_palette(qtbot, window)
    qtbot.keyClick(palette.search, Qt.Key.Key_Escape)
    assert palette.isHidden()
    assert window.ui.form.subject.hasFocus()
    assert not window.ui.notice.isVisible()


def test_the_arrow_keys_choose_among_what_is_possible(qtbot, window):
    palette = open_palette(qtbot, window)
    first = palette.chosen.title
    qtbot.keyClick(palette.search, Qt.Key.Key_Down)
    assert palette.chosen.title != first
    qtbot.keyClick(palette.search, Qt.Key.Key_Up)
    assert palette.chosen.title == first
    for _ in range(20):
        qtbot.keyClick(palette.search, Qt.Key.Key_PageDown)
    assert palette.chosen is not None
    assert not palette.chosen.why_not()


def test_what_is_impossible_is_listed_with_the_reason_and_does_nothing(qtbot, window):
    palette = open_palette(qtbot, window)
    qtbot.keyClicks(palette.search, "stop release")
    assert len(listed(palette)) == 1
    assert shows(listed(palette)[0], "stop.no_test")
    assert palette.chosen is None
    qtbot.keyClick(palette.search, Qt.Key.Key_Return)
    assert palette.isVisible()


def test_start_leads_to_its_button_and_starts_nothing(qtbot, window):
    type_site(qtbot, window)
    window.pages.show("start")
    palette = open_palette(qtbot, window)
    qtbot.keyClicks(palette.search, "start test")
    assert palette.chosen.energises
    qtbot.keyClick(palette.search, Qt.Key.Key_Return)
    assert not window.testing
    assert window.ui.page == "measure"
    assert window.ui.start.hasFocus()
    assert window.ui.start.isEnabled()


def test_no_action_that_energises_the_coil_begins_anything(qtbot, open_window):
    window = open_window(role="technician")
    type_site(qtbot, window)
    leading = [action for action in window.declare_actions() if action.energises]
    ui = window.ui
    assert len(leading) == 3 + len(ui.calibration.begin)
    for action in leading:
        action.run()
        assert not window.testing
        assert not window.jobs


@pytest.mark.parametrize("key", [Qt.Key.Key_Escape, Qt.Key.Key_Space])
def test_the_keys_that_stop_do_so_while_it_is_open(qtbot, open_window, bench, key):
    gate = Gate(passed=60)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    palette = open_palette(qtbot, window)
    assert fully_visible(window.ui.stop)
    qtbot.keyClick(palette.search, key)
    assert window.emergency.is_set()
    assert not palette.search.text()
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert bench.opened[0].current_run is None


@pytest.mark.parametrize("language", ["en", "de"])
def test_it_covers_neither_start_nor_stop(qtbot, open_window, language):
    window = open_window(language=language)
    for size in SIZES:
        window.resize(*size)
        settle()
        palette = open_palette(qtbot, window)
        settle()
        assert fully_visible(window.ui.start), size
        assert fully_visible(window.ui.stop), size
        assert window.rect().adjusted(0, 0, 0, -FRAME).contains(palette.geometry())
        qtbot.keyClick(palette.search, Qt.Key.Key_Escape)


def test_titles_and_shortcuts_are_unique(window):
    for page in ("research", "gap", "instrument"):
        window.pages.show(page)
    actions = window.declare_actions()
    for values in (
        [action.title for action in actions],
        [QKeySequence(action.keys).toString() for action in actions if action.keys],
    ):
        assert sorted(values) == sorted(set(values))
    assert all(action.title for action in actions)
