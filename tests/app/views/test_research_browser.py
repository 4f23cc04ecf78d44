"""The list of sessions on the page Research: found, filtered, chosen, opened, kept."""

import shutil
import threading

import pytest
from app.benches import WAIT_MS
from app.views.research_hosts import click, listed, save, show, wait_shown
from coded import made, reads, shows
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit, QPushButton, QSpinBox

from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher import session_search
from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.browser import Browser
from tissueid.app.views.researcher.session_tree import COLUMNS, FILE, QUALITY
from tissueid.app.window_state import keep_visited_study

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def test_a_year_is_listed_newest_first_and_what_is_no_session_is_greyed_with_the_reason(opened):
    _, view = opened()
    shown = view.browser.shown
    assert listed(view) == ["b.h5", "a.h5", "c.h5", "rubbish.h5"]
    assert shown.index(0, QUALITY).data() == "Repeat"
    assert [shown.rowCount(shown.index(row, 0)) for row in range(4)] == [1, 2, 1, 0]
    rubbish = shown.index(3, 0)
    assert rubbish.data() == made("session.damaged", path="rubbish.h5:").replace(" is ", " ")
    assert rubbish.data(Qt.ItemDataRole.ForegroundRole) == QColor(LIGHT.muted)
    assert not shown.flags(rubbish) & Qt.ItemFlag.ItemIsSelectable
    assert view.browser.count.text() == "3 sessions, 1 unreadable"


def test_search_and_filters_narrow_the_list_down(qtbot, opened):
    _, view = opened()
    bar = view.browser.bar
    qtbot.keyClick(view.browser.tree, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    assert bar.search.hasFocus()
    qtbot.keyClicks(bar.search, "FOREARM p-3")
    assert listed(view) == ["c.h5"]
    assert view.browser.count.text() == "3 sessions, 1 unreadable; 1 shown"
    qtbot.keyClicks(bar.search, " nowhere")
    assert listed(view) == []
    qtbot.mouseClick(bar.clear, Qt.MouseButton.LeftButton)
    assert len(listed(view)) == 4
    assert [bar.subject.itemText(place) for place in range(4)] == ["Subject", "P-1", "P-2", "P-3"]
    bar.site.setFocus()
    qtbot.keyClick(bar.site, Qt.Key.Key_Down)
    assert bar.site.currentText() == "left forearm"
    assert listed(view) == ["a.h5", "c.h5"]


def test_every_column_sorts(qtbot, opened):
    _, view = opened()
    tree = view.browser.tree
    orders = set()
    for column in range(view.browser.model.columnCount()):
        tree.sortByColumn(column, Qt.SortOrder.AscendingOrder)
        orders.add(tuple(listed(view)))
    assert ("rubbish.h5", "c.h5", "a.h5", "b.h5") in orders
    tree.sortByColumn(QUALITY, Qt.SortOrder.DescendingOrder)
    assert listed(view)[0] == "b.h5"


def test_a_study_in_which_a_subject_was_measured_is_listed(qtbot, host, year, saved, tmp_path):
    ini, study = tmp_path / "window.ini", tmp_path / "lotion"
    (study / "P01").mkdir(parents=True)
    shutil.copy(saved, study / "P01" / "visit.h5")
    settings = QSettings(str(ini), QSettings.Format.IniFormat)
    for folder in (study, year / "march"):  # the second one is below the listed folder: nothing is listed twice
        keep_visited_study(settings, folder)
    settings.sync()
    window, view = host(year, ini)
    qtbot.waitUntil(lambda: window.jobs.idle and not view.browser._all_wanted, timeout=WAIT_MS)
    assert sorted(listed(view)) == ["a.h5", "b.h5", "c.h5", "rubbish.h5", "visit.h5"]


def test_one_test_of_a_session_can_be_selected_by_keyboard(qtbot, opened):
    window, view = opened()
    tree = view.browser.tree
    tree.setFocus()
    tree.setCurrentIndex(view.browser.shown.index(1, 0))
    for key in (Qt.Key.Key_Right, Qt.Key.Key_Down, Qt.Key.Key_Down):
        qtbot.keyClick(tree, key)
    wait_shown(qtbot, window, view, 1)
    qtbot.waitUntil(lambda: view.signals.loaded[0].chosen.number == 2, timeout=WAIT_MS)
    assert reads(view.browser.picked.text(), "research.selected", tests="1 test", sessions="1 session")


def test_a_session_is_opened_by_double_click_and_by_return(qtbot, opened):
    window, view = opened()
    click(qtbot, view, 0, double=True)
    qtbot.waitUntil(lambda: len(window.opened) == 1, timeout=WAIT_MS)
    view.browser.tree.setCurrentIndex(view.browser.shown.index(1, 0))
    qtbot.keyClick(view.browser.tree, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: len(window.opened) == 2, timeout=WAIT_MS)
    view.browser.tree.setCurrentIndex(view.browser.shown.index(3, 0))
    qtbot.keyClick(view.browser.tree, Qt.Key.Key_Return)  # it is none
    qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    assert [path.name for path in window.opened] == ["b.h5", "a.h5"]


def test_a_new_session_is_heard_of_and_a_vanished_one_goes(qtbot, opened, tmp_path):
    window, view = opened(folder=tmp_path)
    assert listed(view) == []
    assert window.said == []
    path = save(tmp_path / "new.h5")
    view.on_session_saved(path)
    qtbot.waitUntil(lambda: listed(view) == ["new.h5"] and not window.jobs, timeout=WAIT_MS)
    path.unlink()
    save(tmp_path / "newer.h5")
    qtbot.keyClick(view.browser.tree, Qt.Key.Key_F5)
    qtbot.waitUntil(lambda: listed(view) == ["newer.h5"] and not window.jobs, timeout=WAIT_MS)


def test_folders_are_added_removed_and_kept(qtbot, opened, year, tmp_path):
    window, view = opened(folder=tmp_path)
    folders = view.browser.folders
    folders.menu().actions()[0].trigger()
    (dialog,) = window.findChildren(QFileDialog)
    dialog.fileSelected.emit(str(year))
    dialog.reject()
    qtbot.waitUntil(lambda: len(listed(view)) == 4 and not window.jobs, timeout=WAIT_MS)
    folders.menu().actions()[-1].trigger()
    qtbot.waitUntil(lambda: listed(view) == [] and not window.jobs, timeout=WAIT_MS)
    folders.add(year / "march")
    folders.add(year / "gone")
    qtbot.waitUntil(lambda: len(listed(view)) == 3 and not window.jobs, timeout=WAIT_MS)
    assert shows(window.said[-1], "file.no_folder", folder=year / "gone")
    view.save_state()
    _, view = opened(folder=tmp_path)
    assert len(listed(view)) == 3


class Held:
    """Reading of outlines that waits before some of its files, by number, until it is let go."""

    def __init__(self, monkeypatch):
        self.read, self.count, self.stops = session_search.read_outline, 0, (2,)
        self.reached, self.go = threading.Event(), threading.Event()
        monkeypatch.setattr(session_search, "read_outline", self)

    def __call__(self, path):
        self.count += 1
        if self.count in self.stops:
            self.reached.set()
            assert self.go.wait(WAIT_MS / 1000)
            self.go.clear()
        return self.read(path)


@pytest.fixture
def held(monkeypatch):
    return Held(monkeypatch)


def test_sessions_are_listed_while_the_search_goes_on(qtbot, host, year, held):
    held.stops = 2, 4
    window, view = host(year)
    for count in (1, 3):
        qtbot.waitUntil(lambda count=count: len(listed(view)) == count, timeout=WAIT_MS)
        assert window.jobs
        held.go.set()
    qtbot.waitUntil(lambda: len(listed(view)) == 4 and not window.jobs, timeout=WAIT_MS)


def test_files_of_a_slow_folder_are_read_before_it_is_walked_to_the_end(year):
    class Watched(type(year)):
        def is_dir(self):
            read.append(search.entries.qsize())
            return False

    read, search = [], session_search.SessionSearch([year, Watched(year / "gone")], [], {})
    search.walk_s = 0.0
    search.run()
    assert read == [4]


def test_a_search_is_cancelled_and_keeps_what_it_found(qtbot, host, year, held):
    window, view = host(year)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    assert view.strip.isVisible()
    qtbot.mouseClick(view.strip.stop, Qt.MouseButton.LeftButton)
    held.go.set()
    qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    assert not view.strip.isVisible()
    assert len(listed(view)) == 2
    assert "stopped" in window.said[-1]
    qtbot.mouseClick(view.browser.again, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: len(listed(view)) == 4 and not window.jobs, timeout=WAIT_MS)


def test_closing_in_mid_search_ends_it(qtbot, open_window, year, held):
    window = open_window(first_page="research", folder=year)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    window.close()
    held.go.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert held.count == 2


def test_a_file_that_is_damaged_after_it_was_listed_is_told(qtbot, opened, tmp_path):
    path = save(tmp_path / "x.h5")
    window, view = opened(folder=tmp_path)
    path.write_bytes(b"gone")
    click(qtbot, view, 0)
    qtbot.waitUntil(lambda: bool(window.said) and not window.jobs, timeout=WAIT_MS)
    assert "damaged" in window.said[-1]
    assert view.signals.empty.isVisible()
    assert not view.signals.save.isEnabled()


def test_rubbish_settings_are_passed_over(opened, tmp_path):
    ini = tmp_path / "rubbish.ini"
    settings = QSettings(str(ini), QSettings.Format.IniFormat)
    for name, value in (("folders", "[1"), ("asked", '["a"]'), ("columns", "x"), ("signals", '{"a": 1}'), ("tab", "x")):
        settings.setValue(f"research/{name}", value)
    settings.sync()
    _, view = opened(ini=ini)
    assert len(listed(view)) == 4


def test_nothing_works_beside_a_running_test(opened):
    _, view = opened()
    view.update_enabled(busy=True, testing=True)
    for part in (view.browser.tree, view.browser.folders, view.export, view.signals.save, view.signals.low):
        assert not part.isEnabled()
    view.update_enabled(busy=False, testing=False)
    assert view.browser.tree.isEnabled()


def test_every_control_has_a_name_and_the_tab_key_reaches_it(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    bar = view.browser.bar
    expected = [view.browser.folders, view.browser.again, bar.search, bar.clear, bar.subject, bar.site, bar.kind]
    expected += [
        view.browser.tree,
        view.export,
        view.fold_list,
        view.tabs.tabBar(),
        view.signals.channels,
        view.signals.low,
    ]
    expected += [view.signals.high, view.signals.save, view.signals.table, view.signals.spectrum.choice]
    bar.search.setText("p-2")  # so that Clear can be pressed
    expected[0].setFocus()
    visited = [window.focusWidget()]
    for _ in range(len(expected) - 1):
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Tab)
        visited.append(window.focusWidget())
    assert visited == expected
    for widget in (
        child for kind in (QPushButton, QComboBox, QLineEdit, QSpinBox) for child in view.findChildren(kind)
    ):
        if widget.focusPolicy() != Qt.FocusPolicy.NoFocus and not widget.objectName().startswith("qt_"):
            assert widget.accessibleName() or getattr(widget, "text", str)(), widget


@pytest.mark.soak
def test_it_fits_the_smallest_window(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    assert view.minimumSizeHint().width() <= 1000
    window.resize(1008, 598)  # what the smallest window leaves
    QApplication.processEvents()
    assert (window.width(), window.height()) == (1008, 598)
    for part in (view.export, view.signals.save, view.signals.spectrum, view.browser.tree):
        corner = part.mapTo(window, part.rect().bottomRight())
        assert corner.x() < 1008
        assert corner.y() < 598


def test_columns_without_room_are_folded_so_that_the_list_needs_no_sideways_scrolling(opened):
    _window, view = opened()
    tree = view.browser.tree
    for width in (380, 500, 700, 1000):
        tree.resize(width, 300)
        tree.fold()
        shown = [column for column in range(view.browser.model.columnCount()) if not tree.isColumnHidden(column)]
        assert shown[:4] == [0, 1, 2, 3]
        needed = sum(tree._widths[column] for column in shown)
        assert needed <= tree.viewport().width() or shown == [0, 1, 2, 3]
    assert len(shown) == 9
    view.browser.bar.search.setText("a.h5")
    assert listed(view) == ["a.h5"]


def test_columns_come_back_with_room_also_at_the_next_start_unless_they_were_taken_out(opened, tmp_path):
    _, view = opened()
    tree, header = view.browser.tree, view.browser.tree.header()
    tree.resize(380, 300)
    tree.fold()
    view.save_state()
    again = Browser(view.context, view.strip)
    again.resize(1600, 300)
    again.show()
    again.tree.fold()
    assert not any(again.tree.isColumnHidden(column) for column in range(header.count()))
    menu = again.tree.columns_menu()
    assert [action.text() for action in menu.actions()] == list(COLUMNS[1:])
    menu.actions()[FILE - 1].trigger()
    assert again.tree.isColumnHidden(FILE)
    again.save_state()
    last = Browser(view.context, view.strip)
    last.resize(1600, 300)
    last.show()
    last.tree.fold()
    assert [column for column in range(header.count()) if last.tree.isColumnHidden(column)] == [FILE]
    for browser in (again, last):
        browser.deleteLater()


def test_cancel_of_a_search_stays_within_the_strip_whatever_it_is_called(opened):
    _window, view = opened()
    view.strip.watch(BackgroundWork("looking for sessions in a folder of a very long name " * 3))
    stop = view.strip.stop
    assert stop.geometry().right() <= view.strip.width()
    assert view.strip.mapTo(view.tabs, stop.geometry().topRight()).x() <= view.tabs.width()
    assert stop.width() >= stop.sizeHint().width()
    view.strip.clear()
