"""What somebody meets who is new to the window: told before it is too late, and no longer than it holds."""

import sys
import threading
from pathlib import Path

import pytest
from app.benches import WAIT_MS, Gate
from app.german import assert_german
from app.test_window import idle, press, type_site, wait_for_result
from coded import begins, coded, made, reads, shows
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtWidgets import QGraphicsView, QPushButton, QWidget

from tissueid.acquisition import journal_path
from tissueid.acquisition.surface_detection import Contact
from tissueid.app.emergency import NO_ANSWER
from tissueid.app.jobs import Jobs
from tissueid.app.live_signals import Safety
from tissueid.app.plotting import PlotCard
from tissueid.app.readouts import SafetyReadouts
from tissueid.app.user_files import check_save_path
from tissueid.app.widgets import ElidedLabel, show_disabled_reason
from tissueid.app.words import outcome_text, sentence
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.instrument.limits import PROFILES
from tissueid.procedures.test_run import TestOutcome

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- where to save ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("nowhere/s.h5", "save_path.no_folder"),
        ("test.h5", "save_path.exists"),
        ("folder.h5", "save_path.folder"),
        ("s.txt", "save_path.suffix"),
        ("left.h5", "save_path.unfinished"),
        ("", "save_path.empty"),
    ],
)
def test_a_path_that_no_session_can_be_saved_to(tmp_path, name, code):
    (tmp_path / "test.h5").write_text("text")
    (tmp_path / "folder.h5").mkdir()
    journal_path(tmp_path / "left.h5").write_bytes(b"")
    there = sorted(tmp_path.iterdir())
    with pytest.raises(UnusableInputError, check=coded(code)) as refused:
        check_save_path(tmp_path / name if name else Path())
    assert_german(refused.value.message)
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.skipif(sys.platform == "win32", reason="other names are too long there")
@pytest.mark.parametrize("letters", [227, 240, 245, 252, 300])
def test_a_name_is_refused_where_a_temporary_name_would_not_fit(tmp_path, letters):
    with pytest.raises(UnusableInputError, check=coded("save_path.too_long")):
        check_save_path(tmp_path / f"{'n' * letters}.h5")
    check_save_path(tmp_path / f"{'n' * 226}.h5")
    assert list(tmp_path.iterdir()) == []


def test_checking_a_path_writes_nothing(tmp_path):
    check_save_path(tmp_path / "new.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a folder that nobody can write to")
def test_a_folder_that_cannot_be_written_to():
    with pytest.raises(UnusableInputError, check=coded("save_path.not_writable", folder="/proc")):
        check_save_path(Path("/proc/new.h5"))


def test_a_bad_path_is_reported_before_an_instrument_is_opened(qtbot, window, bench, tmp_path):
    type_site(qtbot, window)
    window.ui.form.path.setText(str(tmp_path / "nowhere" / "s.h5"))
    window.ui.form.take_own_path()
    press(qtbot, window.ui.start)
    assert not window.testing
    assert bench.opened == []
    assert begins(window.ui.notice.text.text(), "file.no_folder", folder=str(tmp_path / "nowhere"))
    assert window.ui.form.path.hasFocus()
    window.ui.form.path.setText(str(tmp_path / "s.h5"))
    assert window.ui.notice.isHidden()


# -- what is waited for -----------------------------------------------------------------------------------------------


def test_what_is_grey_says_what_is_waited_for(qtbot):
    why = "An analysis is running"
    home, button, other = QWidget(), QPushButton("Start"), QPushButton("Stop")
    qtbot.addWidget(home)
    button.setParent(home)
    other.setParent(home)
    button.setToolTip("begins")
    button.setEnabled(False)
    for _round in range(2):
        show_disabled_reason((button, other), why)
        assert (button.toolTip(), button.accessibleDescription()) == (why, why)
        assert other.toolTip() == ""
    button.setEnabled(True)
    show_disabled_reason((button, other), "")
    assert (button.toolTip(), button.accessibleDescription()) == ("begins", "")


def test_jobs_tell_why(qtbot):
    home = QWidget()
    qtbot.addWidget(home)
    jobs, go = Jobs(home), threading.Event()
    assert jobs.why == ""
    jobs.do(go.wait, _ignore, _ignore)
    assert jobs.why
    jobs.do(go.wait, _ignore, _ignore, why="A test is running.")
    assert jobs.why == "A test is running."
    go.set()
    qtbot.waitUntil(lambda: not jobs, timeout=WAIT_MS)
    assert jobs.why == ""


def _ignore(_):
    pass


def test_every_page_says_it_while_an_analysis_runs(qtbot, window):
    window.pages.show("gap")
    window.pages.show("measure")
    go = threading.Event()
    why = "An analysis is running on Research: cancel it there, or wait."
    window.jobs.do(go.wait, _ignore, _ignore, why=why)
    ui, gap = window.ui, window.pages.views[-1]
    grey = [ui.start, ui.guidance.lamp.watch, ui.form.instrument.refresh, ui.open, ui.result.pdf, gap.asking.run]
    own = ui.stop.toolTip()
    assert [control.toolTip() for control in grey] == [why] * len(grey)
    go.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert all(control.toolTip() != why for control in grey)
    assert ui.stop.toolTip() == own


# -- words ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("saved", [True, False])
def test_a_window_that_hung_says_what_is_kept_and_what_to_do(tmp_path, saved):
    path = tmp_path / "s.h5"
    session = object() if saved else None
    problem = sentence(NO_ANSWER)
    words, failed = outcome_text(TestOutcome(path, session, error=CancelledError(NO_ANSWER)), unanswered=True)
    assert failed
    assert words.startswith(f"{problem} ")
    assert shows(words, "outcome.saved", path=path) if saved else shows(words, "outcome.nothing_yet")
    assert words.endswith(made("outcome.start_again"))


def test_after_a_window_that_hung_nothing_is_waited_for(qtbot, open_window, clock):
    gate = Gate(passed=4)
    window = open_window(wait=gate.wait)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    clock.now += 2.0
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    ui = window.ui
    assert shows(ui.notice.text.text(), "outcome.start_again")
    assert ui.guidance.lamp.contact is Contact.UNWATCHED
    assert not ui.analysis.isVisible()
    assert reads(ui.safety.keys.text(), "stop.no_test")


def test_a_coil_that_is_free_again_leaves_no_figures(qtbot):
    shown = SafetyReadouts()
    qtbot.addWidget(shown)
    safety = Safety(PROFILES["clinical"], force_n=9.3, temperature_c=25.0, contact=True)
    shown.expect()
    shown.show_safety(safety)
    assert shown.contact.text() == "on the skin"
    shown.show_safety(safety, free=True)
    shown.show_key_reach(reach=True)
    assert reads(shown.keys.text(), "stop.no_test")
    assert "9.3" not in shown.force.text()
    assert shown.contact.text() != "on the skin"
    shown.expect()
    shown.show_key_reach(reach=True)
    assert reads(shown.keys.text(), "stop.keys")


# -- whose result -----------------------------------------------------------------------------------------------------


def test_a_reopened_session_says_whose_it_is(qtbot, window, saved):
    window.ui.form.subject.setText("P-999")
    window.open_session(saved)
    wait_for_result(qtbot, window)
    ui = window.ui
    assert ui.result.whose.text() == "left calf  ·  anonymous"
    assert "left calf  ·  anonymous" in ui.guidance.instruction.text()
    assert ui.form.other_test.isVisible()


# -- looks ------------------------------------------------------------------------------------------------------------


def taken(card, place):
    """Whether a turn of the wheel over a place of a plot is taken by it, and not left to the page around it."""
    over = card.plot.viewport()
    event = QWheelEvent(
        QPointF(place),
        QPointF(over.mapToGlobal(place)),
        QPoint(),
        QPoint(0, -120),
        Qt.MouseButton.NoButton,
        Qt.KeyboardModifier.NoModifier,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )
    QGraphicsView.wheelEvent(card.plot, event)
    return event.isAccepted()


def test_the_wheel_over_an_axis_is_left_to_the_page_where_nothing_zooms(qtbot):
    card = PlotCard("Force", "Time (s)", "N")
    qtbot.addWidget(card)
    card.resize(300, 300)
    card.show()
    qtbot.waitExposed(card)
    on_axis = QPoint(10, 100)
    assert not taken(card, on_axis)
    assert not taken(card, QPoint(150, 100))
    card.plot.setMouseEnabled(x=False, y=True)
    before = card.plot.viewRange()[1]
    assert taken(card, on_axis)
    assert card.plot.viewRange()[1] != before


def test_a_line_that_is_cut_keeps_its_beginning_and_its_end(qtbot):
    label = ElidedLabel()
    qtbot.addWidget(label)
    label.setText("Fitting P-001, left forearm, posterior: test 3 of 12")
    label.resize(160, 20)
    label.show()
    assert label.shown.startswith("Fit")
    assert label.shown.endswith("12")
    assert "…" in label.shown
    assert label.text().endswith("test 3 of 12")
    label.resize(900, 20)
    assert label.shown == label.text()


def test_ctrl_q_closes_the_window(qtbot, window):
    qtbot.keyClick(window, Qt.Key.Key_Q, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
