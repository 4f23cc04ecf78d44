"""The tab key, page by page: it visits everything that can be operated, in the order of reading, and ends nowhere."""

import shutil

import pytest
from app.benches import WAIT_MS
from app.tabbing import check_tabs, named
from PySide6.QtCore import QCoreApplication

from tissueid.procedures.study_sitting import ProtocolPlan, write_protocol

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


@pytest.fixture
def on_page(qtbot, open_window, saved, tmp_path):
    """Opens a window of a technician on a page, with one session to be found."""

    def make(page, **changes):
        shutil.copy(saved, tmp_path / "2026-01-15_10-30-00.h5")
        window = open_window(**({"role": "technician", "first_page": page} | changes))
        window.resize(1280, 720)
        idle(qtbot, window)
        return window

    return make


def idle(qtbot, window):
    """Wait until nothing goes on, and nothing that was put off begins after it."""
    for _ in range(3):
        QCoreApplication.processEvents()
        qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)


def test_start(qtbot, on_page):
    window = on_page("start")
    page = window.pages.start
    seen = check_tabs(qtbot, window)
    assert {*page.cards.values(), page.recent, page.instruments, page.language.choice} <= set(seen)


def test_measure_before_a_test(qtbot, on_page):
    window = on_page("measure")
    window.ui.form.fold.setChecked(True)
    seen = check_tabs(qtbot, window)
    ui = window.ui
    assert {ui.form.options["seed"].controls[0], ui.start, ui.stop, ui.pages.tabBar()} <= set(seen)
    window.ui.pages.setCurrentWidget(window.ui.calibration)
    assert len(check_tabs(qtbot, window)) > len(seen)


def test_measure_with_a_result_and_a_notice(qtbot, on_page, saved):
    window = on_page("measure")
    window.open_session(saved)
    idle(qtbot, window)
    window.ui.notice.say("something", offer="Re&cover")
    seen = check_tabs(qtbot, window)
    assert {window.ui.result, window.ui.result.pdf, window.ui.report, window.ui.notice.offer} <= set(seen)


def test_research(qtbot, on_page):
    window = on_page("research")
    page = window.ui.views["research"]
    qtbot.waitUntil(lambda: page.browser.shown.rowCount() == 1, timeout=WAIT_MS)
    idle(qtbot, window)
    page.browser.tree.selectAll()
    qtbot.waitUntil(lambda: len(page.signals.loaded) == 1, timeout=WAIT_MS)
    idle(qtbot, window)
    signals = check_tabs(qtbot, window)
    page.tabs.setCurrentWidget(page.analysis)
    analysis = check_tabs(qtbot, window)
    assert page.analysis.run in analysis
    assert page.analysis.run not in signals
    for place in range(page.analysis.tabs.count()):
        page.analysis.tabs.setCurrentIndex(place)
        assert page.analysis.tabs.tabBar() in check_tabs(qtbot, window)


@pytest.mark.parametrize("tab", range(4), ids=["health", "calibrations", "faults", "audit"])
def test_instrument(qtbot, on_page, tab):
    window = on_page("instrument")
    page = window.ui.views["instrument"]
    page.tabs.setCurrentIndex(tab)
    idle(qtbot, window)
    seen = check_tabs(qtbot, window)
    assert page.tabs.tabBar() in seen, [named(widget) for widget in seen]


def test_gap_before_a_diagnosis(qtbot, on_page):
    window = on_page("gap")
    page = window.ui.views["gap"]
    page.asking.fold.setChecked(True)
    seen = check_tabs(qtbot, window)
    assert {page.asking.fit, page.asking.check, page.history.list} <= set(seen)


@pytest.mark.parametrize("tab", range(2), ids=["tests", "figures"])
def test_studies(qtbot, on_page, tmp_path, tab):
    window = on_page("studies")
    page = window.ui.views["studies"]
    write_protocol(ProtocolPlan(folder=tmp_path / "study"))
    page.open_study(tmp_path / "study")
    page.tabs.setCurrentIndex(tab)
    idle(qtbot, window)
    seen = check_tabs(qtbot, window)
    assert {page.asking.open, page.asking.measure, page.tabs.tabBar()} <= set(seen)
    assert (page.tests.search in seen) == (tab == 0)


def test_a_sitting_of_a_study(qtbot, on_page, tmp_path):
    window = on_page("measure")
    write_protocol(ProtocolPlan(folder=tmp_path / "study"))
    window.context.begin_sitting(tmp_path / "study", "P01")
    idle(qtbot, window)
    window.study.dialog.reject()
    seen = check_tabs(qtbot, window)
    assert {window.study.card.data, window.study.card.leave} <= set(seen)
