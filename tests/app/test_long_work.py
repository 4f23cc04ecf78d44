"""Long work on saved files: it keeps nothing from a measurement, and pages say what they could not read meanwhile."""

import os
import threading

import pytest
from app.benches import WAIT_MS, Gate
from app.test_window import idle, press, type_site, wait_for_result

from tissueid.audit import AuditLog
from tissueid.procedures.control import Control
from tissueid.procedures.separate_process import run_in_process

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

WHY = "A diagnosis is running on Gap: cancel it there, or wait."


def _ignore(_):
    pass


@pytest.fixture
def working(qtbot):
    """Starts long work in a window; it ends with the test."""
    go = threading.Event()

    def begin(window, done=_ignore):
        window.jobs.do(go.wait, done, _ignore, why=WHY, long=True)

    begin.end = go.set
    yield begin
    go.set()


def test_a_test_runs_and_its_result_is_read_while_long_work_goes_on(qtbot, window, working):
    window.pages.show("gap")
    window.pages.show("research")
    window.pages.show("measure")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    working(window)
    ui = window.ui
    free = [ui.start, ui.open, ui.guidance.lamp.watch, ui.role, ui.form.instrument.refresh, ui.result.pdf]
    assert all(control.isEnabled() for control in free)
    type_site(qtbot, window)
    press(qtbot, ui.start)
    qtbot.waitUntil(lambda: not window.jobs and window.findings is not None, timeout=WAIT_MS)
    assert window.findings.test.status == "completed"
    assert ui.report.isEnabled()
    assert all(control.isEnabled() for control in free)
    gap, research = window.ui.views["gap"], window.ui.views["research"].analysis
    assert not gap.asking.run.isEnabled()
    assert not research.folder.isEnabled()
    assert (gap.asking.doing.text(), research.step.text()) == (WHY, WHY)
    assert gap.asking.run.toolTip() == research.folder.toolTip() == WHY
    working.end()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert research.folder.isEnabled()
    assert research.step.text() != WHY
    assert not gap.asking.doing.isVisibleTo(gap)


def test_the_result_of_long_work_waits_for_the_end_of_a_test(qtbot, open_window, working):
    gate, shown = Gate(passed=4), []
    window = open_window(wait=gate.wait)

    def done(_):
        shown.append(window.testing)

    working(window, done)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    working.end()
    qtbot.wait(50)
    assert (shown, window.jobs.working) == ([], True)
    gate.opened.set()
    wait_for_result(qtbot, window)
    assert shown == [False]


def _niceness(_control):
    return os.nice(0)


@pytest.mark.skipif(not hasattr(os, "nice"), reason="priorities of this system are other ones")
def test_long_work_runs_in_a_process_that_gives_way():
    assert run_in_process(_niceness, Control()) >= min(os.nice(0) + 10, 19)


class _Collected(Control):
    def __init__(self):
        self.parts = []

    def finished(self, part):
        self.parts.append(part)


def _by_parts(control):
    control.finished(1)
    control.finished(2)
    return 3


def test_finished_parts_of_long_work_come_before_its_result():
    control = _Collected()
    assert run_in_process(_by_parts, control) == 3
    assert control.parts == [1, 2]


class _Cancelled(Control):
    def cancelled(self):
        return True


def _so_far(control):
    while not control.cancelled():
        pass
    return "so far"


def test_cancelled_work_returns_what_it_has_done_within_its_grace():
    assert run_in_process(_so_far, _Cancelled(), grace_s=20.0) == "so far"


def test_pages_say_what_is_not_read_while_the_instrument_works(qtbot, open_window, audit_file):
    gate = Gate(passed=4)
    window = open_window(wait=gate.wait, role="technician", audit=AuditLog(audit_file))
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    unread = f"Not read yet. {window.jobs.why}"
    assert "running" in unread
    for name in ("instrument", "research"):
        window.pages.show(name)
    page, research = window.ui.views["instrument"], window.ui.views["research"]
    said = [page.calibrations.about, page.faults.count, page.audit.count, research.browser.count]
    assert [label.text() for label in said] == [unread] * 4
    gate.opened.set()
    wait_for_result(qtbot, window)
    window.pages.show("research")
    qtbot.waitUntil(lambda: idle(window) and research.browser.count.text() == "1 session", timeout=WAIT_MS)
