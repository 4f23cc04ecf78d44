"""The page Research: sessions found, filtered, selected, looked at and exported, as people do it."""

import csv
import gc
import json
import threading

import numpy as np
import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import QCoreApplication, QEvent, QPoint, QSettings, Qt
from PySide6.QtGui import QColor, QImage
from PySide6.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit, QMainWindow, QPushButton, QSpinBox

from tissueid.app.jobs import Jobs
from tissueid.app.surroundings import Surroundings
from tissueid.app.theme import DARK, LIGHT
from tissueid.app.views.researcher.session_model import QUALITY, SITE
from tissueid.app.views.researcher.view import ResearchView
from tissueid.app.views.view import Desk
from tissueid.device import DeviceDescription
from tissueid.sessions import Session, Subject, Test, write_session
from tissueid.sessions.quality import NOTE

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

RATE = 2000.0
SITES = {"a": "left forearm", "b": "right calf", "c": "left forearm"}


def signals(seed, samples=4000):
    """A force that is noise about 5 N, and a position that swings at 50 Hz by 2 mm about 14 mm."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / RATE
    return {
        "command": rng.normal(0.0, 1.0, samples),
        "voltage": rng.normal(0.0, 2.0, samples),
        "force": rng.normal(5.0, 1.5, samples),
        "position": 0.014 + 0.002 * np.sin(2 * np.pi * 50.0 * time),
    }


def save(path, *, subject="P-1", site="left forearm", created="2026-03-01T10:00:00Z", tests=1, verdict=None):
    note = {}
    if verdict:
        finding = {"code": "x", "severity": verdict, "words": "w", "advice": "a", "value": None}
        note = {NOTE: json.dumps({"verdict": verdict, "findings": [finding]})}
    made = tuple(
        Test(number, "stochastic", signals(number), RATE, site=site, preload_s=0.5, notes=note)
        for number in range(1, tests + 1)
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_session(path, Session(DeviceDescription(), Subject(subject), made, created=created))
    return path


@pytest.fixture(scope="module")
def year(tmp_path_factory):
    """Three sessions in nested folders, and two files that are none."""
    folder = tmp_path_factory.mktemp("year")
    save(folder / "march" / "a.h5", subject="P-1", site=SITES["a"], created="2026-03-01T10:00:00Z", tests=2)
    save(folder / "b.h5", subject="P-2", site=SITES["b"], created="2026-05-01T10:00:00Z", verdict="repeat")
    save(folder / "march" / "deep" / "c.h5", subject="P-3", site=SITES["c"], created="2026-01-01T10:00:00Z")
    (folder / "march" / "rubbish.h5").write_bytes(b"<b>no session</b>")
    (folder / "notes.txt").write_text("not looked at")
    return folder


class Host(QMainWindow):
    """What stands around the page, as far as it sees: jobs, settings, and somebody who hears what it says."""

    def __init__(self, folder, ini):
        super().__init__()
        self.jobs = Jobs(self)
        self.settings = QSettings(str(ini), QSettings.Format.IniFormat)
        self.said, self.opened = [], []
        around = Surroundings(folder=folder)
        none = [lambda *_: None] * 2
        desk = Desk(
            around, self.jobs, self.settings, self.say, lambda: "researcher", none[0], self.opened.append, *none
        )
        self.view = ResearchView(desk)
        self.jobs.changed.connect(self.settle)
        self.view.paint_with(LIGHT)
        self.setCentralWidget(self.view)
        self.resize(1000, 580)
        self.settle()

    def say(self, text, *, problem=False):
        self.said.append(text)

    def settle(self):
        self.view.settle(busy=bool(self.jobs), testing=False)

    def start(self):
        self.view.enter()
        self.show()
        self.activateWindow()
        return self.view


def listed(view):
    return [entry.path.name for _, entry in view.browser.shown.shown()]


@pytest.fixture
def host(qtbot, tmp_path):
    hosts = []

    def make(folder, ini=None):
        hosts.append(Host(folder, ini or tmp_path / "window.ini"))
        view = hosts[-1].start()
        qtbot.waitUntil(hosts[-1].isActiveWindow, timeout=WAIT_MS)
        return hosts[-1], view

    gc.disable()
    yield make
    for one in hosts:
        one.view.cancel()
        qtbot.waitUntil(lambda one=one: not one.jobs, timeout=WAIT_MS)
        one.close()
        one.deleteLater()
    hosts.clear()
    QCoreApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    gc.enable()


@pytest.fixture
def opened(qtbot, host, year):
    def make(folder=year, ini=None):
        window, view = host(folder, ini)
        qtbot.waitUntil(lambda: not window.jobs and not view.browser._all_wanted, timeout=WAIT_MS)
        return window, view

    return make


def click(qtbot, view, row, modifier=Qt.KeyboardModifier.NoModifier, double=False):
    tree = view.browser.tree
    place = tree.visualRect(view.browser.shown.index(row, SITE)).center()
    qtbot.mouseClick(tree.viewport(), Qt.MouseButton.LeftButton, modifier, place)
    if double:
        qtbot.mouseDClick(tree.viewport(), Qt.MouseButton.LeftButton, modifier, place)


def show(qtbot, window, view, rows, tests):
    for row in rows:
        click(qtbot, view, row, Qt.KeyboardModifier.ControlModifier)
    wait_shown(qtbot, window, view, tests)


def wait_shown(qtbot, window, view, tests):
    qtbot.waitUntil(lambda: len(view.signals.loaded) == tests and not window.jobs, timeout=WAIT_MS)
    qtbot.waitUntil(lambda: not view.signals._figures.isActive() and not view.signals.stack._frame.isActive())


def test_a_year_is_listed_newest_first_and_what_is_no_session_is_greyed_with_the_reason(opened):
    _, view = opened()
    shown = view.browser.shown
    assert listed(view) == ["b.h5", "a.h5", "c.h5", "rubbish.h5"]
    assert shown.index(0, QUALITY).data() == "Repeat"
    assert [shown.rowCount(shown.index(row, 0)) for row in range(4)] == [1, 2, 1, 0]
    rubbish = shown.index(3, 0)
    assert rubbish.data() == "rubbish.h5: damaged, or not an HDF5 session"
    assert rubbish.data(Qt.ItemDataRole.ForegroundRole) == QColor(LIGHT.muted)
    assert not shown.flags(rubbish) & Qt.ItemFlag.ItemIsSelectable
    assert view.browser.count.text() == "3 sessions, 1 unreadable"


def test_search_and_filters_narrow_the_list_down(qtbot, opened):
    _, view = opened()
    bar = view.browser.bar
    qtbot.keyClick(view.browser.tree, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    assert bar.words.hasFocus()
    qtbot.keyClicks(bar.words, "FOREARM p-3")
    assert listed(view) == ["c.h5"]
    assert view.browser.count.text() == "3 sessions, 1 unreadable; 1 shown"
    qtbot.keyClicks(bar.words, " nowhere")
    assert listed(view) == []
    qtbot.mouseClick(bar.clear, Qt.MouseButton.LeftButton)
    assert len(listed(view)) == 4
    assert [bar.subject.itemText(place) for place in range(4)] == ["All subjects", "P-1", "P-2", "P-3"]
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


def test_signals_of_selected_tests_are_laid_over_one_another(qtbot, opened):
    window, view = opened()
    assert view.signals.empty.isVisible()
    show(qtbot, window, view, (0, 1), tests=3)
    assert view.browser.picked.text() == "3 tests of 2 sessions selected"
    table = view.signals.table
    assert [table.horizontalHeaderItem(column).text() for column in range(4)] == [
        "Mean ± SD",
        "Voltage (V)",
        "Force (N)",
        "Position (mm)",
    ]
    assert table.rowCount() == 3
    assert table.item(0, 0).text() == "P-2, right calf, test 1 (b)"
    # A sine of 2 mm deviates by 2 / sqrt(2) mm from its mean.
    assert table.item(0, 3).text() == "14.0 ± 1.4"
    x, y = view.signals.spectrum.card.plot.listDataItems()[0].getData()
    assert 10.0 ** x[np.argmax(y)] == pytest.approx(50.0, abs=2.0)
    tree = view.browser.tree
    tree.clearSelection()
    qtbot.waitUntil(view.signals.empty.isVisible, timeout=WAIT_MS)


def test_one_test_of_a_session_can_be_selected_by_keyboard(qtbot, opened):
    window, view = opened()
    tree = view.browser.tree
    tree.setFocus()
    tree.setCurrentIndex(view.browser.shown.index(1, 0))
    for key in (Qt.Key.Key_Right, Qt.Key.Key_Down, Qt.Key.Key_Down):
        qtbot.keyClick(tree, key)
    wait_shown(qtbot, window, view, 1)
    qtbot.waitUntil(lambda: view.signals.loaded[0].chosen.number == 2, timeout=WAIT_MS)
    assert view.browser.picked.text() == "1 test of 1 session selected"


def drag(qtbot, card, low, high):
    port = card.plot.viewport()
    box = card.plot.getViewBox()
    view = box.viewRange()[0]
    ends = []
    for time in (low, high):
        scene = box.sceneBoundingRect()
        share = (time - view[0]) / (view[1] - view[0])
        ends.append(QPoint(round(scene.left() + share * scene.width()), round(scene.center().y())))
    qtbot.mousePress(port, Qt.MouseButton.LeftButton, pos=ends[0])
    qtbot.mouseMove(port, ends[1])
    qtbot.mouseRelease(port, Qt.MouseButton.LeftButton, pos=ends[1])


def ranges(view):
    return [tuple(card.plot.getViewBox().viewRange()[0]) for card in view.signals.stack.cards]


def test_a_brush_over_one_plot_zooms_the_others_and_tells_its_figures(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    panel = view.signals
    stack = panel.stack
    drag(qtbot, stack.cards[1], 0.5, 1.0)
    wait_shown(qtbot, window, view, 1)
    low, high = stack.brush
    assert (low, high) == (pytest.approx(0.5, abs=0.01), pytest.approx(1.0, abs=0.01))
    assert ranges(view) == [(low, high), (0.0, 2.0), (low, high)]
    force = signals(1)["force"]
    first, last = (int(np.ceil(round(time * RATE, 6))) for time in (low, high))
    mean, std = force[first:last].mean(), force[first:last].std()
    assert panel.table.item(0, 2).text() == f"{mean:.1f} ± {std:.1f}"
    assert panel.about.text().startswith(f"Brushed: {high - low:.3f} s, ")
    drag(qtbot, stack.cards[1], (low + high) / 2, (low + high) / 2 + 0.3)  # takes hold of the brush and moves it
    assert stack.brush == (pytest.approx(low + 0.3, abs=0.01), pytest.approx(high + 0.3, abs=0.01))
    panel.low.setFocus()
    panel.low.selectAll()
    qtbot.keyClicks(panel.low, "0.25")
    qtbot.keyClick(panel.low, Qt.Key.Key_Return)
    assert stack.brush[0] == pytest.approx(0.25)
    qtbot.mouseClick(panel.whole, Qt.MouseButton.LeftButton)
    wait_shown(qtbot, window, view, 1)
    assert stack.brush is None
    assert ranges(view) == [(0.0, 2.0)] * 3
    drag(qtbot, stack.cards[0], 0.5, 0.501)  # a click is no brush
    assert stack.brush is None


def test_the_menu_chooses_the_signals_and_the_choice_is_kept(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    menu = view.signals.channels.menu()
    action = next(action for action in menu.actions() if action.text() == "Command")
    assert not action.isChecked()
    action.trigger()
    assert len(view.signals.stack.cards) == 4
    view.browser.bar.words.setText("calf")
    view.save_state()
    again, view = opened()
    assert view.browser.bar.words.text() == "calf"
    assert listed(view) == ["b.h5"]
    show(qtbot, again, view, (0,), tests=1)
    assert view.signals.channels.text() == "Signals (4 of 4)"


def test_data_are_exported_and_nothing_raw_is_changed(qtbot, opened, year, tmp_path):
    window, view = opened()
    before = {path: path.read_bytes() for path in year.rglob("*.h5")}
    assert not view.export.isEnabled()
    show(qtbot, window, view, (0, 1), tests=3)
    for folder in ("b-csv", "a-csv"):
        assert not (tmp_path / folder).exists()
    view.export.menu().actions()[0].trigger()
    (dialog,) = window.findChildren(QFileDialog)
    dialog.fileSelected.emit(str(tmp_path))
    dialog.reject()
    qtbot.waitUntil(lambda: (tmp_path / "a-csv").exists() and not window.jobs, timeout=WAIT_MS)
    assert sorted(path.name for path in (tmp_path / "a-csv").glob("*.csv")) == ["test-0001.csv", "test-0002.csv"]
    with (tmp_path / "b-csv" / "test-0001.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_array_equal([float(row["force (N)"]) for row in rows], signals(1)["force"])
    assert "Exported 2 sessions" in window.said[-1]
    assert {path: path.read_bytes() for path in year.rglob("*.h5")} == before


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_the_figure_is_saved(qtbot, opened, tmp_path, ending):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    path = tmp_path / f"figure.{ending}"
    qtbot.mouseClick(view.signals.save, Qt.MouseButton.LeftButton)
    (dialog,) = window.findChildren(QFileDialog)
    dialog.fileSelected.emit(str(path))
    dialog.reject()
    qtbot.waitUntil(lambda: path.exists() and not window.jobs, timeout=WAIT_MS)
    if ending == "png":
        assert QImage(str(path)).width() > 1000
    else:
        text = path.read_text(encoding="utf-8")
        assert "Position (mm)" in text
        assert "right calf" in text
    assert str(path) in window.said[-1]


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
    view.heard_of(path)
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
    folders.add(str(year / "march"))
    folders.add(str(year / "gone"))
    qtbot.waitUntil(lambda: len(listed(view)) == 3 and not window.jobs, timeout=WAIT_MS)
    assert "There is no folder" in window.said[-1]
    view.save_state()
    _, view = opened(folder=tmp_path)
    assert len(listed(view)) == 3


class Held:
    """Reading of outlines that waits before its second file until it is let go."""

    def __init__(self, monkeypatch):
        from tissueid.app.views.researcher import index

        self.read, self.count = index.read_outline, 0
        self.reached, self.go = threading.Event(), threading.Event()
        monkeypatch.setattr(index, "read_outline", self)

    def __call__(self, path):
        self.count += 1
        if self.count == 2:
            self.reached.set()
            assert self.go.wait(WAIT_MS / 1000)
        return self.read(path)


@pytest.fixture
def held(monkeypatch):
    return Held(monkeypatch)


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
    view.settle(busy=True, testing=True)
    for part in (view.browser.tree, view.browser.folders, view.export, view.signals.save, view.signals.low):
        assert not part.isEnabled()
    view.settle(busy=False, testing=False)
    assert view.browser.tree.isEnabled()


def test_every_control_has_a_name_and_the_tab_key_reaches_it(qtbot, opened):
    window, view = opened()
    show(qtbot, window, view, (0,), tests=1)
    bar = view.browser.bar
    expected = [view.browser.folders, view.browser.again, bar.words, bar.clear, bar.subject, bar.site, bar.kind]
    expected += [view.browser.tree, view.export, view.tabs.tabBar(), view.signals.channels, view.signals.low]
    expected += [view.signals.high, view.signals.save, view.signals.table, view.signals.spectrum.choice]
    bar.words.setText("p-2")  # so that Clear can be pressed
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


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_colours_of_tests_stand_out(theme):
    from tissueid.app.views.researcher.colours import series

    def luminance(name):
        parts = [value / 255 for value in QColor(name).getRgb()[:3]]
        linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    for colour in series(theme):
        lighter, darker = sorted((luminance(colour), luminance(theme.panel)), reverse=True)
        assert (lighter + 0.05) / (darker + 0.05) >= 3.0


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
