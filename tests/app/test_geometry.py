"""Every page in small and in usual windows: nothing to operate is out of reach, covered, overlapped or cut."""

from __future__ import annotations

import functools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from app.benches import WAIT_MS, Clock, Gate, found
from app.test_live_analysis import seen
from gap_records import recorded
from PySide6.QtCore import QCoreApplication, QPoint, QRect, QSettings, Qt
from PySide6.QtGui import QPainter, QPicture
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QAbstractSpinBox,
    QComboBox,
    QLabel,
    QLineEdit,
    QMainWindow,
    QPushButton,
    QScrollArea,
    QScrollBar,
    QTabBar,
    QWidget,
)
from support import connect

from firmware_sim.identity import Identity
from tissueid.app.calibration_page import CalibrationOutcome
from tissueid.app.context import AppServices
from tissueid.app.emergency import EmergencyStop
from tissueid.app.import_dialog import ImportDialog, preview_of
from tissueid.app.layout import SMALLEST
from tissueid.app.main_window import MainWindow
from tissueid.app.notice import Notice
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.gap.diagnosis_result import result_of
from tissueid.app.widgets import ElidedLabel
from tissueid.calibration import CalibratedQuantity, Calibration
from tissueid.calibration.active import activate_calibration
from tissueid.gap import diagnose, fit_tasks, prepare
from tissueid.gap.workers import SerialExecutor
from tissueid.instrument import SimulatedInstrument
from tissueid.language import current_language, set_language
from tissueid.procedures.diagnosis import DiagnosedSession
from tissueid.procedures.gap_plans import DiagnosisPlan
from tissueid.twin import catalogue as shelf

LANGUAGES = [pytest.param("en", marks=pytest.mark.soak), "de"]
"""German has the longer texts: what fits in it fits in English."""

pytestmark = [
    pytest.mark.qt_log_level_fail("WARNING"),
    pytest.mark.qt_log_ignore("This plugin does not support"),
    pytest.mark.usefixtures("long_frames"),
]

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
QUICK = SIZES[0], SIZES[-1]
SIZES_IN_TURN = pytest.mark.parametrize(
    "sizes", [QUICK, pytest.param(SIZES[1:-1], marks=pytest.mark.soak)], ids=["smallest and largest", "between"]
)
CONTROLS = (QAbstractButton, QAbstractSpinBox, QComboBox, QLineEdit, QAbstractScrollArea, QTabBar)
SLACK = 2
"""Pixels by which a frame may be overlapped or left."""
LONG = (
    "The report is saved in /home/someone/Documents/TissueID sessions/2026-01-10_10-30-00.html. No program here shows "
    "a PDF: open that file with one that does, here or on another computer."
)


@pytest.fixture
def plots_laid_out():
    return True


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


def overlaps(window, widgets):
    """Pairs of siblings of which one covers a part of the other."""
    found_pairs = []
    top = window.centralWidget() if isinstance(window, QMainWindow) else window
    for parent in [top, *widgets]:
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


def cut_texts(window, widgets):
    """Buttons and labels whose text needs more room than they have."""
    cut = [
        f"{called(button)} needs {button.sizeHint().width()}"
        for button in widgets
        if isinstance(button, QAbstractButton) and button.text() and button.sizeHint().width() > button.width() + SLACK
    ]
    for line in window.findChildren(QLineEdit):
        if line.isVisible() and line.placeholderText() and not line.text():
            needed = line.fontMetrics().horizontalAdvance(line.placeholderText())
            if needed > line.contentsRect().width() - 2 * SLACK:
                cut.append(f"{called(line)}: {line.placeholderText()!r} needs {needed}")
    for label in widgets:
        if not isinstance(label, QLabel) or isinstance(label, ElidedLabel) or not label.text():
            continue
        room = label.contentsRect()
        if label.wordWrap():
            needed, there = label.heightForWidth(label.width()), label.height()
        else:
            needed, there = label.sizeHint().width(), label.width()
        if needed > there + SLACK:
            cut.append(f"{called(label)} in {room.width()}x{room.height()} needs {needed}")
    return cut


def scrolled_sideways(widgets):
    """Areas that have to be scrolled to and fro to read a line."""
    areas = [area for area in widgets if isinstance(area, QScrollArea) and area.horizontalScrollBar().maximum() > 0]
    return [f"{called(area)} for {', '.join(widest(area.widget()))}" for area in areas]


def widest(widget):
    """The widget that needs the most width, and in it the one that does, and so on."""
    inside = [item for item in widget.children() if isinstance(item, QWidget) and item.isVisibleTo(widget)]
    if not inside:
        return []
    most = max(inside, key=lambda item: item.minimumSizeHint().expandedTo(item.minimumSize()).width())
    return [f"{called(most)} {most.minimumSizeHint().width()}", *widest(most)]


def check(window):
    widgets = shown(window, QWidget)
    unreachable = [
        f"{called(widget)}: {why}"
        for widget in widgets
        if isinstance(widget, CONTROLS) and (why := out_of_reach(widget, window))
    ]
    wrong = {
        "out of reach": unreachable,
        "overlapping": overlaps(window, widgets),
        "cut": cut_texts(window, widgets),
        "scrolled sideways": scrolled_sideways(widgets),
    }
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
                QTest.qWait(5)  # without a pause this thread would keep the one that measures from ending
            window.deleteLater()
        windows.clear()

    def make(language, state):
        if (language, state) in windows:
            return windows[language, state][0]
        close()
        folder = tmp_path_factory.mktemp("window")
        shutil.copy(saved, folder / "2026-01-15_10-30-00.h5")
        gate = {"testing": Gate(passed=60), "calibrating-with-stage": Gate(passed=600)}.get(state)
        if state.startswith("calibrating"):
            instrument = connect("calibration-spring", seed=3, identity=Identity(stage=gate is not None))
            if gate is not None:
                poll = instrument.poll
                instrument.poll = lambda timeout_s: (gate.wait(timeout_s), poll(timeout_s))[1]
            opener = lambda _: instrument  # noqa: E731
        else:
            opener = lambda _: SimulatedInstrument("forearm", seed=3)  # noqa: E731
        window = MainWindow(
            AppServices(
                opener=opener,
                finder=found,
                folder=folder,
                wait=gate.wait if state == "testing" else lambda _: None,
                separate_process=False,
                stop=lambda: EmergencyStop(Clock().read),  # no window has to keep up with these tests
                calibrate=functools.partial(activate_calibration, folder=folder),
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

    def calibration_waits(window):
        """A calibration of a stage has come to its gate; one by hand asks for something."""
        gate = make.gate(window)
        return window.ui.calibration.done.isVisible if gate is None else gate.reached.is_set

    make.calibration_waits = calibration_waits
    before = current_language()
    yield make
    close()
    set_language(before)


@pytest.fixture(scope="module")
def diagnosis():
    """Why a recording with dry friction differs from the twin, searched among two effects only."""
    session = recorded("dry_friction", samples=3000)
    every = shelf.all_effects()
    with pytest.MonkeyPatch.context() as patch:
        few = {name: every[name] for name in ("dry_friction", "directional_damping")}
        patch.setattr(fit_tasks, "all_effects", lambda: few)
        return session, diagnose(prepare(session, (), ()), SerialExecutor())


class Unreported(DiagnosedSession):
    """A diagnosis whose report, which no page shows, is not drawn."""

    report_html = ""


def small_study(folder):
    """A study with a protocol, a table of two tests, and a session that is not in it."""
    (folder / "results").mkdir(parents=True, exist_ok=True)
    sites = ["left forearm, posterior", "right forearm, anterior", "left upper arm"]
    conditions = [{"product": "lotion", "minutes_since_application": 60}]
    protocol = {
        "name": "Lotion study",
        "sites": sites,
        "conditions": conditions,
        "demographics": [],
        "photograph": True,
    }
    (folder / "protocol.json").write_text(json.dumps(protocol))
    head = "session,subject,site,condition,repeat,quality,engine,vaf_percent,mass_kg,mass_kg_sd"
    rows = [f"P01/{place}.h5,P01,{place},lotion,1,good,wiener,80,0.09,0.001" for place in ("arm", "leg")]
    (folder / "results" / "table.csv").write_text("\n".join([head, *rows]))
    (folder / "new.h5").touch()
    return folder


@pytest.fixture
def in_state(qtbot, opened, request):
    """A window of a language in a state."""

    def idle(window):
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
        settle()

    def make(language, state):
        window = opened(language, state.split(" ")[0])
        ui = window.ui
        ui.notice.retract()
        for panel in (window.panels.help, window.panels.log):
            panel.hide()
        _, _, page = state.rpartition(" on ")
        if state.startswith("calibrating"):
            window.pages.show("measure")
            ui.pages.setCurrentWidget(ui.calibration)
            if not window.testing:
                ui.calibration.begin["static"].click()
                qtbot.waitUntil(opened.calibration_waits(window), timeout=WAIT_MS)
                window.frame_timer.stop()
                window.draw_frame()
            window.pages.show(page)
            settle()
            return window
        if state.startswith("testing"):
            if not window.testing:
                ui.form.site.setEditText("left forearm")
                ui.start.click()
                qtbot.waitUntil(opened.gate(window).reached.is_set, timeout=WAIT_MS)
                window.frame_timer.stop()  # nothing new is drawn while one looks
                window.show_frame()
            window.pages.show(page)
            settle()
            return window
        idle(window)
        name, _, part = page.partition(":")
        window.pages.show(name)
        idle(window)
        if name == "measure":
            if part == "sitting":
                window.context.begin_sitting(small_study(window.services.folder / "study"), "P01")
                idle(window)
            elif window.study.leads:
                window.study.leave()
            ui.form.fold.setChecked(part.startswith("settings"))
            if part.startswith("settings "):
                ui.form.stimulus.fill(part.removeprefix("settings "))
            if part.startswith("calibration "):
                ui.calibration.show_outcome(outcome_of(part, window.services.folder))
            if part == "result" and window.findings is None:
                window.open_session(window.services.folder / "2026-01-15_10-30-00.h5")
                idle(window)
            shown_part = {"result": ui.result, "calibration": ui.calibration}.get(part.split(" ")[0], ui.running)
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
                plan = DiagnosisPlan(session=Path("friction.h5"))
                page.history.add(result_of(Unreported(plan, session, None, answer)))
            page.result.tabs.setCurrentIndex(int(part.removeprefix("diagnosed ")))
        elif name == "gap":
            ui.views[name].asking.fold.setChecked(part == "settings")
        elif name == "studies" and part:
            page = ui.views[name]
            page.open_study(small_study(window.services.folder / "study"))
            idle(window)
            page.tabs.setCurrentWidget(page.figures if part == "figures" else page.tests)
            if part == "progress":
                page.asking.progress.show_progress(0.5, "Analysing sessions: 20 of 40, about 12 s left")
        elif name == "instrument":
            ui.views[name].tabs.setCurrentIndex(int(part) if part.isdigit() else 0)
        idle(window)
        for panel, button in (("help", window.panels.help_button), ("log", window.panels.log_button)):
            if panel in part:
                button.click()
        settle()
        return window

    return make


QUICK_STATES = (
    "idle on start",
    "idle on measure:signals",
    "idle on measure:result",
    "idle on measure:sitting",
    "idle on research:0",
    "idle on gap:",
    "idle on instrument:0",
    "idle on studies:tests",
    "testing on measure",
    "testing on research",
    "calibrating-by-hand on measure",
)
"""States that are looked at in every run: each page once, and those in which a coil can be energised."""
STATES = [
    "idle on start",
    "idle on measure:signals",
    "idle on measure:settings",
    "idle on measure:result",
    "idle on measure:calibration",
    "idle on measure:calibration passed",
    "idle on measure:calibration failed",
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
    "idle on measure:sitting",
    *(f"idle on studies:{part}" for part in ("", "tests", "figures", "progress")),
    "testing on measure",
    "testing on start",
    "testing on research",
    "calibrating-with-stage on measure",
    "calibrating-by-hand on measure",
    "calibrating-by-hand on research",
    *(f"idle on {page}:help" for page in ("start", "research", "gap", "instrument", "studies")),
]


@pytest.mark.parametrize(
    "state", [state if state in QUICK_STATES else pytest.param(state, marks=pytest.mark.soak) for state in STATES]
)
@pytest.mark.parametrize("language", LANGUAGES)
@SIZES_IN_TURN
def test_everything_fits_or_scrolls_at_every_size(in_state, language, state, sizes):
    window = in_state(language, state)
    for size in sizes:
        window.resize(*size)
        settle()
        try:
            assert window.size().toTuple() == size
            check(window)
            if window.ui.page == "measure":
                assert fully_visible(window.ui.start)
                assert fully_visible(window.ui.stop)
            assert fully_visible(window.ui.halt) == (window.testing and window.ui.page != "measure")
        except AssertionError as error:
            raise AssertionError(f"at {size}: {error}") from None


@pytest.mark.soak
@pytest.mark.parametrize("language", LANGUAGES)
def test_all_live_plots_fit_or_scroll_at_every_size(in_state, language):
    window = in_state(language, "testing on measure")
    panel = window.ui.analysis
    panel.show_view(seen())
    for size in (*SIZES, (1920, 1080 - FRAME)):
        window.resize(*size)
        settle()
        for tab in range(max(1, panel.tabs.count())):
            panel.tabs.setCurrentIndex(tab)
            settle()
            check(window)
            assert any(card.isVisible() for card in panel.cards)


def outcome_of(part, folder):
    """The outcome of a calibration with as many words as there may be."""
    failed = part.endswith("failed")
    figures = ("force_constant_n_per_a", "resistance_ohm", "inductance_h", "back_emf_v_s_per_m", "travel_m")
    calibration = Calibration(
        kind="sweep" if failed else "static",
        model="desktop indenter",
        serial_number="TEST-7",
        date="2026-01-01T00:00:00Z",
        software="1",
        verdict="failed" if failed else "passed",
        problems=(LONG, LONG) if failed else (),
        quantities={name: CalibratedQuantity(value=2.9, std=0.01, unit="N/A") for name in figures},
    )
    return CalibrationOutcome(calibration, folder / "calibration.toml", folder / "calibration.html", (LONG,))


@pytest.fixture
def import_dialog(qtbot, tmp_path):
    """The dialog that imports a record of many long columns, over a window of a size."""

    def make(described=False):
        names = ["Zeit (s)", *(f"Kanal {k} mit einem langen Namen (mN)" for k in range(12))]
        path = tmp_path / f"{'messung mit langem Namen ' * 4}.csv"
        lines = [";".join(names), *(";".join(f"{k / 1000:.4f}" for _ in names) for k in range(9))]
        path.write_text("\n".join(lines) + "\n")
        preview = preview_of([path] * 7)
        dialog = ImportDialog(replace(preview, described=described), tmp_path / "messung.h5")
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, False)
        qtbot.addWidget(dialog)
        dialog.show()
        return dialog

    before = current_language()
    yield make
    set_language(before)


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("described", [False, pytest.param(True, marks=pytest.mark.soak)])
@pytest.mark.parametrize("said", [pytest.param("", marks=pytest.mark.soak), LONG])
def test_the_import_dialog_fits_every_screen(import_dialog, language, described, said):
    set_language(language)
    dialog = import_dialog(described)
    if said:
        dialog.say(said)
    for size in SIZES:
        dialog.resize(*size)
        settle()
        try:
            assert dialog.size().toTuple() == size
            check(dialog)
            assert fully_visible(dialog.go)
            assert fully_visible(dialog.cancel)
        except AssertionError as error:
            raise AssertionError(f"at {size}: {error}") from None


def test_units_are_not_cut_in_the_import_dialog(import_dialog):
    dialog = import_dialog()
    settle()
    unit = dialog.unit_of(0)
    unit.setEditText("minutes")
    line = unit.lineEdit()
    assert line.width() >= line.fontMetrics().horizontalAdvance("minutes")


@pytest.mark.soak
@pytest.mark.parametrize("state", ["idle on measure:signals", "calibrating-by-hand on measure"])
@pytest.mark.parametrize("language", LANGUAGES)
def test_the_command_palette_fits_and_follows_the_window(in_state, language, state):
    window = in_state(language, state)
    palette = window.commands
    palette.toggle()
    for size in SIZES[::-1]:
        window.resize(*size)
        settle()
        check(window)
        assert window.rect().adjusted(0, 0, 0, -FRAME).contains(palette.geometry()), size
        assert fully_visible(palette.search), size
        assert fully_visible(window.ui.stop), size
        assert fully_visible(window.ui.start), size
    palette.toggle()
    assert palette.isHidden()


@pytest.mark.parametrize("page", ["measure", pytest.param("research", marks=pytest.mark.soak)])
def test_help_in_a_narrow_window_takes_the_place_of_the_page_and_gives_it_back(in_state, page):
    window = in_state("en", f"idle on {page}:help")
    window.resize(*SMALLEST)
    settle()
    reader, content = window.panels.help.reader, window.ui.main_scroll if page == "measure" else window.ui.stack
    assert fully_visible(window.panels.help.close_button)
    assert reader.width() > 300
    assert reader.horizontalScrollBar().maximum() == 0
    assert not content.isVisible()
    window.resize(1440, 800)
    settle()
    assert content.isVisible()
    assert reader.isVisible()
    window.resize(*SMALLEST)
    settle()
    window.ui.rail.chosen.emit(page)
    settle()
    assert content.isVisible()
    assert not reader.isVisible()
    assert not window.panels.help_button.isChecked()


def numbers_at(axis):
    """The numbers that an axis shows in its present size."""
    picture = QPicture()
    painter = QPainter(picture)
    try:
        _, _, texts = axis.generateDrawSpecs(painter)
    finally:
        painter.end()
    return [text for place, _, text in texts if axis.boundingRect().intersects(place)]


@pytest.mark.soak
def test_the_curve_of_a_calibration_has_numbers_on_both_axes(in_state):
    window = in_state("en", "calibrating-with-stage on measure")
    window.resize(1280, 720)
    settle()
    curve = window.ui.calibration.curve
    assert curve.isVisible()
    curve.grab()
    for side in ("left", "bottom"):
        assert len(numbers_at(curve.plot.getAxis(side))) > 1, side


def places(window):
    """Where everything that can be operated stands."""
    return {widget: QRect(widget.mapTo(window, QPoint(0, 0)), widget.size()) for widget in shown(window, CONTROLS)}


@pytest.mark.parametrize(
    "state",
    [
        "idle on measure:signals",
        *(
            pytest.param(state, marks=pytest.mark.soak)
            for state in ("idle on start", "idle on gap:", "testing on research")
        ),
    ],
)
@pytest.mark.parametrize("size", [SMALLEST, pytest.param((1280, 720), marks=pytest.mark.soak)])
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


@pytest.mark.parametrize("text", [pytest.param("It is saved.", marks=pytest.mark.soak), LONG])
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
    bars = window.ui.result.verticalScrollBar(), window.ui.main_scroll.verticalScrollBar()
    assert all(bar.maximum() > 0 for bar in bars)
    for bar in bars:
        bar.setValue(bar.maximum())
    window.open_session(window.findings.path)
    qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    settle()
    assert [bar.value() for bar in bars] == [0, 0]


def test_a_row_folds_where_its_parts_need_more_than_was_thought(qtbot):
    holder = QWidget()
    qtbot.addWidget(holder)
    row = FoldingBox(100, holder)
    row.setContentsMargins(0, 0, 0, 0)
    parts = [QPushButton(text, holder) for text in ("Noch einmal messen (2 von 5)", "Fertig: diesen Test nehmen")]
    for part in parts:
        row.addWidget(part)
    holder.show()
    holder.resize(sum(part.sizeHint().width() for part in parts) - 20, 100)
    settle()
    assert parts[1].y() > parts[0].y()
    assert all(part.width() >= part.sizeHint().width() for part in parts)


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
        assert not any(part.geometry().right() > holder.width() for part in parts)
        assert row.minimumSize().width() < 200
