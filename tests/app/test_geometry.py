"""Every page in small and in usual windows: nothing to operate is out of reach, covered, overlapped or cut."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import pytest
from app.benches import WAIT_MS, Clock, Gate, found
from gap_records import recorded
from PySide6.QtCore import QCoreApplication, QPoint, QRect, QSettings, Qt
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QAbstractSpinBox,
    QComboBox,
    QLabel,
    QLineEdit,
    QScrollArea,
    QScrollBar,
    QTabBar,
    QWidget,
)

from tissueid.app.elided import ElidedLabel
from tissueid.app.emergency import EmergencyStop
from tissueid.app.layout import SMALLEST
from tissueid.app.main_window import MainWindow
from tissueid.app.notice import Notice
from tissueid.app.small_window import FoldingBox
from tissueid.app.surroundings import Surroundings
from tissueid.app.views.gap.diagnosing import Asked, Result
from tissueid.app.views.gap.story import story_of
from tissueid.calibration.in_force import calibrated
from tissueid.gap import diagnose, observe
from tissueid.gap.workers import Alone
from tissueid.instrument import SimulatedInstrument
from tissueid.twin import catalogue as shelf

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

FRAME = 40
"""Height of the title bar, generously, pixels."""
SIZES = [
    SMALLEST,
    (853, 480 - FRAME),  # 1280x720 at 150 %
    (960, 540 - FRAME),  # 1920x1080 at 200 %
    (1024, 768 - FRAME),
    (1093, 614 - FRAME),  # 1366x768 at 125 %
    (1440, 900 - FRAME),
]
CONTROLS = (QAbstractButton, QAbstractSpinBox, QComboBox, QLineEdit, QAbstractScrollArea, QTabBar)
SLACK = 2
"""Pixels by which a frame may be overlapped or left."""
LONG = (
    "The report is saved in /home/someone/Documents/TissueID sessions/2026-01-10_10-30-00.html. No program here shows "
    "a PDF: open that file with one that does, here or on another computer."
)


# -- what is looked for -----------------------------------------------------------------------------------------------


def called(widget):
    text = widget.text() if isinstance(widget, QAbstractButton | QLabel) else ""
    name = text or widget.accessibleName() or widget.objectName()
    return f"{type(widget).__name__} {name[:50]!r} {widget.geometry().getRect()}"


def shown(window, kind):
    """The widgets of a kind that are in the window, without the inner parts of others."""
    inside = (QComboBox, QAbstractSpinBox, QTabBar, QLineEdit, QScrollBar)
    every = [widget for widget in window.findChildren(QWidget) if widget.isVisible() and widget.window() is window]
    every = [widget for widget in every if isinstance(widget, kind)]
    return [widget for widget in every if not isinstance(widget.parentWidget(), inside) and not _of_items(widget)]


def _of_items(widget):
    """Whether it is a part of a list or table: header, viewport, editor, corner."""
    parent = widget.parentWidget()
    while parent is not None:
        if isinstance(parent, QAbstractScrollArea) and not isinstance(parent, QScrollArea):
            return True
        parent = parent.parentWidget()
    return False


def out_of_reach(widget, window):
    """Where something cuts the widget off for good; empty where it is seen, or can be scrolled into view."""
    rect = widget.rect()
    while widget is not window:
        parent = widget.parentWidget()
        rect.translate(widget.pos())
        area = parent.parentWidget()
        if isinstance(area, QScrollArea) and parent is area.viewport():
            off = Qt.ScrollBarPolicy.ScrollBarAlwaysOff
            across = area.horizontalScrollBarPolicy() == off and not _within(rect.left(), rect.right(), parent.width())
            down = area.verticalScrollBarPolicy() == off and not _within(rect.top(), rect.bottom(), parent.height())
            if across or down:
                return f"cut off by {called(area)}, which does not scroll"
            rect = QRect(QPoint(0, 0), rect.size().boundedTo(parent.size()))
        elif not parent.rect().adjusted(-SLACK, -SLACK, SLACK, SLACK).contains(rect):
            return f"{rect.getRect()} is outside of {called(parent)}"
        widget = parent
    return ""


def _within(low, high, room):
    return low >= -SLACK and high <= room + SLACK


def fully_visible(widget):
    """Whether nothing has to be scrolled to see all of a widget, and nothing covers it."""
    window = widget.window()
    parent = widget.parentWidget()
    while parent is not None:
        place = QRect(widget.mapTo(parent, QPoint(0, 0)), widget.size())
        if not parent.rect().contains(place):
            return False
        parent = parent.parentWidget() if parent is not window else None
    corners = widget.rect().adjusted(2, 2, -2, -2)
    points = corners.topLeft(), corners.topRight(), corners.bottomLeft(), corners.bottomRight(), corners.center()
    return all(window.childAt(widget.mapTo(window, point)) is widget for point in points)


def overlaps(window):
    """Pairs of siblings of which one covers a part of the other."""
    found_pairs = []
    for parent in [window.centralWidget(), *shown(window, QWidget)]:
        if isinstance(parent, QAbstractScrollArea | QComboBox | QAbstractSpinBox | QTabBar | QLineEdit | QScrollBar):
            continue
        children = [item for item in parent.children() if isinstance(item, QWidget) and item.isVisible()]
        children = [item for item in children if not item.isWindow() and not isinstance(item, Notice)]
        for place, one in enumerate(children):
            for other in children[place + 1 :]:
                common = one.geometry() & other.geometry()
                if common.width() > SLACK and common.height() > SLACK:
                    found_pairs.append(f"{called(one)} and {called(other)}")
    return found_pairs


def cut_texts(window):
    """Buttons and labels whose text needs more room than they have."""
    cut = [
        f"{called(button)} needs {button.sizeHint().width()}"
        for button in shown(window, QAbstractButton)
        if button.text() and button.sizeHint().width() > button.width() + SLACK
    ]
    for label in shown(window, QLabel):
        if isinstance(label, ElidedLabel) or not label.text():
            continue
        room = label.contentsRect()
        if label.wordWrap():
            needed, there = label.heightForWidth(label.width()), label.height()
        else:
            needed, there = label.sizeHint().width(), label.width()
        if needed > there + SLACK:
            cut.append(f"{called(label)} in {room.width()}x{room.height()} needs {needed}")
    return cut


SIDEWAYS = {
    "idle on measure:help",  # a dock leaves less than the page can be folded to
    "idle on measure:help and log",
}
"""States in which a page may scroll sideways in a narrow window."""


def scrolled_sideways(window):
    """Areas that have to be scrolled to and fro to read a line."""
    areas = [area for area in shown(window, QScrollArea) if area.horizontalScrollBar().maximum() > 0]
    return [f"{called(area)} for {', '.join(widest(area.widget()))}" for area in areas]


def widest(widget):
    """The widget that needs the most width, and in it the one that does, and so on."""
    inside = [item for item in widget.children() if isinstance(item, QWidget) and item.isVisibleTo(widget)]
    if not inside:
        return []
    most = max(inside, key=lambda item: item.minimumSizeHint().expandedTo(item.minimumSize()).width())
    return [f"{called(most)} {most.minimumSizeHint().width()}", *widest(most)]


def check(window, sideways=True):
    unreachable = [
        f"{called(widget)}: {why}" for widget in shown(window, CONTROLS) if (why := out_of_reach(widget, window))
    ]
    wrong = {"out of reach": unreachable, "overlapping": overlaps(window), "cut": cut_texts(window)}
    if not sideways:
        wrong["scrolled sideways"] = scrolled_sideways(window)
    wrong = {what: which for what, which in wrong.items() if which}
    assert not wrong, "\n".join(f"{what}: {item}" for what, which in wrong.items() for item in which)


# -- the states of the window -----------------------------------------------------------------------------------------


def settle():
    for _ in range(4):
        QCoreApplication.processEvents()


@pytest.fixture(scope="module")
def opened(tmp_path_factory, saved):
    """The newest window by language and state, so that a test of another size does not wait for it again."""
    windows = {}

    def close():
        for window, gate in windows.values():
            if gate is not None:
                gate.opened.set()
            window.close()
        for window, _ in windows.values():
            while window.isVisible():
                QCoreApplication.processEvents()
            window.deleteLater()
        windows.clear()

    def make(language, state):
        if (language, state) in windows:
            return windows[language, state][0]
        close()
        folder = tmp_path_factory.mktemp("window")
        shutil.copy(saved, folder / "2026-01-15_10-30-00.h5")
        gate = Gate(passed=60) if state == "testing" else None
        window = MainWindow(
            Surroundings(
                opener=lambda _: SimulatedInstrument("forearm", seed=3),
                finder=found,
                folder=folder,
                wait=(lambda _: None) if gate is None else gate.wait,
                apart=False,
                stop=lambda: EmergencyStop(Clock().read),  # no window has to keep up with these tests
                calibrate=functools.partial(calibrated, folder=folder),
                calibrations=folder,
                show_file=lambda _: True,
                first_page="measure",
                role="technician",
                language=language,
                settings=functools.partial(QSettings, str(folder / "window.ini"), QSettings.Format.IniFormat),
            )
        )
        windows[language, state] = window, gate
        window.show()
        return window

    make.gate = lambda wanted: next(gate for window, gate in windows.values() if window is wanted)
    yield make
    close()


@pytest.fixture(scope="module")
def diagnosis():
    """Why a recording with dry friction differs from the twin, searched among two effects only."""
    session = recorded("dry_friction", samples=3000)
    every = shelf.all_effects()
    with pytest.MonkeyPatch.context() as patch:
        few = {name: every[name] for name in ("dry_friction", "directional_damping")}
        patch.setattr("tissueid.gap.search.all_effects", lambda: few)
        return session, diagnose(observe(session, (), ()), Alone())


@pytest.fixture
def in_state(qtbot, opened, request):
    """A window of a language in a state."""

    def idle(window):
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
        settle()

    def make(language, state):
        window = opened(language, "testing" if state.startswith("testing") else "idle")
        ui = window.ui
        ui.notice.retract()
        for panel in (window.panels.help, window.panels.log):
            panel.hide()
        _, _, page = state.rpartition(" on ")
        if state.startswith("testing"):
            if not window.testing:
                ui.form.site.setEditText("left forearm")
                ui.start.click()
                qtbot.waitUntil(opened.gate(window).reached.is_set, timeout=WAIT_MS)
                window._frames.stop()  # nothing new is drawn while one looks
                window._show_frame()
            window.pages.show(page)
            settle()
            return window
        idle(window)
        name, _, part = page.partition(":")
        window.pages.show(name)
        idle(window)
        if name == "measure":
            ui.form.fold.setChecked(part.startswith("settings"))
            if part.startswith("settings "):
                ui.form.stimulus.fill(part.removeprefix("settings "))
            if part == "result" and window.findings is None:
                window.open_session(window.around.folder / "2026-01-15_10-30-00.h5")
                idle(window)
            for panel, button in (("help", window.panels.help_button), ("log", window.panels.log_button)):
                if panel in part:
                    button.click()
            shown_part = {"result": ui.result, "calibration": ui.calibration}.get(part, ui.running)
            ui.pages.setCurrentWidget(shown_part)
        elif name == "research":
            view = ui.views[name]
            qtbot.waitUntil(lambda: view.browser.shown.rowCount() == 1, timeout=WAIT_MS)
            view.browser.tree.selectAll()
            qtbot.waitUntil(lambda: len(view.signals.loaded) == 1, timeout=WAIT_MS)
            idle(window)
            view.tabs.setCurrentWidget(view.signals if part == "signals" else view.analysis)
            if part.isdigit():
                view.analysis.tabs.setCurrentIndex(int(part))
            if part.startswith("fitted"):
                if not view.analysis.results.outcomes:
                    view.analysis.form.choose("lms")
                    view.analysis.run.click()
                    idle(window)
                view.analysis.tabs.setCurrentIndex(int(part.removeprefix("fitted ")))
        elif name == "gap" and part.startswith("diagnosed"):
            page = ui.views[name]
            if page.history.result is None:
                session, answer = request.getfixturevalue("diagnosis")
                asked = Asked(Path("friction.h5"))
                page.history.add(Result(asked, session.session_id, "", None, answer, story_of(answer, session)))
            page.result.tabs.setCurrentIndex(int(part.removeprefix("diagnosed ")))
        elif name == "gap":
            ui.views[name].asking.fold.setChecked(part == "settings")
        elif name == "instrument":
            ui.views[name].tabs.setCurrentIndex(int(part))
        idle(window)
        return window

    return make


STATES = [
    "idle on start",
    "idle on measure:signals",
    "idle on measure:settings",
    "idle on measure:result",
    "idle on measure:calibration",
    "idle on measure:help",
    "idle on measure:help and log",
    "idle on research:signals",
    "idle on research:0",
    "idle on research:1",
    "idle on research:2",
    "idle on gap:",
    "idle on gap:settings",
    *(f"idle on measure:settings {kind}" for kind in ("interchange", "file")),
    *(f"idle on research:fitted {tab}" for tab in range(4)),
    *(f"idle on gap:diagnosed {tab}" for tab in range(4)),
    *(f"idle on instrument:{tab}" for tab in range(4)),
    "testing on measure",
    "testing on start",
    "testing on research",
]


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("language", ["en", "de"])
def test_everything_fits_or_scrolls_at_every_size(in_state, language, state):
    window = in_state(language, state)
    for size in SIZES:
        window.resize(*size)
        settle()
        try:
            assert window.size().toTuple() == size
            check(window, sideways=state in SIDEWAYS)
            if window.ui.page == "measure":
                assert fully_visible(window.ui.start)
                assert fully_visible(window.ui.stop)
            assert fully_visible(window.ui.halt) == (window.testing and window.ui.page != "measure")
        except AssertionError as error:
            raise AssertionError(f"at {size}: {error}") from None


def places(window):
    """Where everything that can be operated stands."""
    return {widget: QRect(widget.mapTo(window, QPoint(0, 0)), widget.size()) for widget in shown(window, CONTROLS)}


@pytest.mark.parametrize("state", ["idle on start", "idle on measure:signals", "idle on gap:", "testing on research"])
@pytest.mark.parametrize("size", [SMALLEST, (1280, 720)])
def test_nothing_moves_when_a_notice_comes_or_goes(in_state, state, size):
    window = in_state("en", state)
    window.resize(*size)
    settle()
    notice = window.ui.notice
    before = places(window)
    for text in ("It is saved.", LONG, 3 * LONG):
        notice.say(text, problem=True, offer="Re&cover")
        settle()
        own = {notice.offer, notice.dismiss}
        assert {widget: place for widget, place in places(window).items() if widget not in own} == before
        assert notice.text.heightForWidth(notice.text.width()) <= notice.text.height()
        assert fully_visible(notice.dismiss)
        assert fully_visible(notice.offer)
        if window.ui.page == "measure":
            assert fully_visible(window.ui.start)
            assert fully_visible(window.ui.stop)
        assert fully_visible(window.ui.halt) == window.testing
    notice.retract()
    settle()
    assert places(window) == before


@pytest.mark.parametrize("text", ["It is saved.", LONG])
def test_a_notice_of_two_lines_covers_nothing(in_state, text):
    window = in_state("en", "idle on measure:signals")
    window.resize(1093, 614 - FRAME)
    settle()
    window.ui.notice.say(text, problem=True, offer="Re&cover")
    settle()
    covered = QRect(window.ui.notice.mapTo(window, QPoint(0, 0)), window.ui.notice.size())
    assert [
        called(widget)
        for widget, place in places(window).items()
        if place & covered and not (window.ui.notice.isAncestorOf(widget))
    ] == []


def test_a_result_is_shown_from_its_top(qtbot, in_state):
    window = in_state("en", "idle on measure:result")
    window.resize(*SMALLEST)
    settle()
    bars = window.ui.result.verticalScrollBar(), window.ui._main.verticalScrollBar()
    assert all(bar.maximum() > 0 for bar in bars)
    for bar in bars:
        bar.setValue(bar.maximum())
    window.open_session(window.findings.path)
    qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    settle()
    assert [bar.value() for bar in bars] == [0, 0]


def test_a_row_folds_where_it_has_no_room_and_unfolds_again(qtbot):
    holder = QWidget()
    qtbot.addWidget(holder)
    row = FoldingBox(300, holder)
    parts = [QLabel("one", holder), QLabel("two", holder)]
    for part in parts:
        part.setFixedSize(140, 20)
        row.addWidget(part)
    holder.show()
    for width, across in ((400, True), (200, False), (400, True)):
        holder.resize(width, 100)
        settle()
        assert (parts[1].x() > parts[0].x()) == across
        assert row.sizeHint().width() > 280
        assert row.minimumSize().width() < 200
