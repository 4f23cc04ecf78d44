"""Every way in which a test in the window is stopped: by whom, how soon, and that it needs no living window."""

import dataclasses
import threading

import numpy as np
import pytest
from app.benches import WAIT_MS, Clock, Gate
from app.german import assert_german
from app.test_window import idle, only_session, press, type_site, wait_for_result
from coded import begins, coded, reads, shows
from failing_disk import FULL
from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QDialog, QLineEdit, QVBoxLayout
from support import connect

from tissueid.acquisition import recorder
from tissueid.acquisition.surface_detection import Contact
from tissueid.app import main_window
from tissueid.app import words as app_words
from tissueid.app.emergency import (
    BY_BUTTON,
    BY_CLOSING,
    BY_DEFECT,
    NO_ANSWER,
    EmergencyStop,
    seconds_since_boot,
)
from tissueid.app.live_signals import LiveSignals
from tissueid.app.live_test import LiveTest
from tissueid.app.session_jobs import find
from tissueid.app.views.technician.events import read_events, read_log
from tissueid.app.words import sentence
from tissueid.audit import AuditLog, last_lines
from tissueid.errors import CancelledError, LinkLostError
from tissueid.instrument import CLINICAL, SimulatedInstrument
from tissueid.messages import MISSING, Message
from tissueid.procedures.control import BY_KEY
from tissueid.procedures.test_plan import TestPlan
from tissueid.procedures.test_run import run_test

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


LOST = Message("link.broken", "the connection to {port} broke", port="loopback")


@pytest.fixture(scope="module")
def some_findings(saved):
    return find(saved)


@pytest.fixture(autouse=True)
def _identified_at_once(some_findings, monkeypatch):
    """What comes after the stop is not what these tests are about: nothing is fitted."""

    def find_at_once(path, session, number):
        return dataclasses.replace(some_findings, path=path, session=session, test=session.test(number))

    monkeypatch.setattr(main_window, "find", find_at_once)


# -- the switch itself ----------------------------------------------------------------------------------------


def test_the_first_reason_stays():
    stop = EmergencyStop()
    assert not stop.check()
    stop.press(BY_KEY)
    stop.press(BY_CLOSING)
    assert stop.is_set()
    assert stop.reason == BY_KEY
    with pytest.raises(CancelledError, check=coded("stop.released", cause=BY_KEY)):
        stop.check()


@pytest.mark.parametrize(
    "reason", [BY_BUTTON, BY_KEY, BY_CLOSING, BY_DEFECT, NO_ANSWER], ids=lambda reason: reason.code
)
def test_every_reason_of_a_stop_is_german_in_a_german_window(reason):
    stop = EmergencyStop()
    stop.press(reason)
    with pytest.raises(CancelledError) as stopped:
        stop.check()
    assert_german(stopped.value.message)


@pytest.mark.parametrize(("late_s", "stopped"), [(0.99, False), (1.01, True), (36_000.0, True)])
@pytest.mark.parametrize("beat_again", [False, True])
def test_a_window_that_misses_its_beat_has_stopped_the_test_even_when_it_comes_back(late_s, stopped, beat_again):
    clock = Clock()
    stop = EmergencyStop(clock.read)
    clock.now += 100.0  # before the first beat nothing is watched
    assert not stop.is_set()
    stop.beat()
    clock.now += late_s
    if beat_again:
        stop.beat()
    assert stop.is_set() is stopped
    if stopped:
        with pytest.raises(CancelledError, check=coded("stop.no_answer")):
            stop.check()


def test_beats_in_time_go_on_for_ever():
    clock = Clock()
    stop = EmergencyStop(clock.read)
    for _ in range(1000):
        stop.beat()
        clock.now += 0.9
        assert not stop.check()


def test_waiting_ends_when_it_is_stopped():
    stop = EmergencyStop()
    threading.Thread(target=lambda: stop.press("stopped by key")).start()
    stop.wait(WAIT_MS / 1000)
    assert stop.is_set()


def test_its_clock_goes_on():
    before = seconds_since_boot()
    assert seconds_since_boot() >= before > 0.0


# -- in the window --------------------------------------------------------------------------------------------


class Watched(SimulatedInstrument):
    """A simulation that tells when its coil is released."""

    def __init__(self):
        super().__init__("forearm", seed=3)
        self.released = threading.Event()
        self.played = 0

    def poll(self, timeout_s):
        self.played += self.energised
        return super().poll(timeout_s)

    def release(self):
        super().release()
        if self.played:
            self.released.set()


def begin(qtbot, window, gate):
    """A test that is held in the middle of its stimulus."""
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: gate.reached.is_set() or idle(window), timeout=WAIT_MS)
    assert gate.reached.is_set(), window.ui.notice.text.text()


@pytest.mark.parametrize(
    ("focus", "key"),
    [
        ("tabs", Qt.Key.Key_Escape),
        ("dismiss", Qt.Key.Key_Space),
        ("dialog", Qt.Key.Key_Escape),
        ("dialog", Qt.Key.Key_Space),
    ],
)
def test_the_keys_stop_whatever_has_the_focus(qtbot, open_window, bench, tmp_path, key, focus):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    dialog = QDialog(window)
    field = QLineEdit(dialog)
    QVBoxLayout(dialog).addWidget(field)
    if focus == "dialog":
        dialog.open()
        field.setFocus()
        target = field
    else:
        window.ui.notice.say("something")
        target = window.ui.pages.tabBar() if focus == "tabs" else window.ui.notice.dismiss
        target.setFocus()
    qtbot.keyClick(target, key)
    assert window.emergency.is_set()
    assert "Stopping" in window.ui.guidance.instruction.text()
    if focus == "dialog":
        assert dialog.isVisible()
        assert field.text() == ""
        dialog.close()
    gate.opened.set()
    wait_for_result(qtbot, window)
    test = only_session(tmp_path)[1].test()
    assert test.status == "aborted"
    assert test.notes["reason"].startswith("stopped by key; ")
    assert bench.opened[0].current_run is None
    # Afterwards the keys belong to the fields again, and hammering on them begins nothing.
    for _ in range(3):
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Space)
    assert not window.testing
    window.ui.form.subject.setFocus()
    qtbot.keyClick(window.ui.form.subject, Qt.Key.Key_Space)
    assert window.ui.form.subject.text().endswith(" ")


def test_a_window_that_hangs_does_not_keep_the_coil_energised(qtbot, open_window, clock, tmp_path):
    instrument = Watched()
    gate = Gate(passed=300)
    window = open_window(opener=lambda _: instrument, wait=gate.wait)
    begin(qtbot, window, gate)
    seen = []

    def hang():
        """The event loop is in here, and gets out only after the coil is free."""
        seen.append(window.testing)
        clock.now += 1.2
        gate.opened.set()
        seen.append(instrument.released.wait(WAIT_MS / 1000))

    QTimer.singleShot(0, hang)
    wait_for_result(qtbot, window)
    assert seen == [True, True]
    assert begins(window.ui.notice.text.text(), "stop.no_answer")
    test = only_session(tmp_path)[1].test()
    assert (test.status, test.notes["reason"]) == ("aborted", NO_ANSWER)
    assert test.samples < 6000


def test_the_coil_is_released_without_any_event_loop(clock, tmp_path):
    """The thread of the instrument ends the test by itself: there is no window, and nothing runs that could answer."""
    instrument, stop, gate, ended = Watched(), EmergencyStop(clock.read), Gate(passed=300), []
    plan = TestPlan(url="simulated://forearm", site="left calf", out=tmp_path / "alone.h5")
    stop.beat()

    def work():
        control = LiveTest(LiveSignals(), stop)
        ended.append(run_test(plan, control, None, opener=lambda _: instrument, pace=gate.wait, separate_process=False))

    thread = threading.Thread(target=work)
    thread.start()
    assert gate.reached.wait(WAIT_MS / 1000)
    assert instrument.energised
    clock.now += 1.2
    gate.opened.set()
    thread.join(WAIT_MS / 1000)
    assert instrument.released.is_set()
    assert not instrument.energised
    assert (ended[0].session.test().status, ended[0].session.test().notes["reason"]) == ("aborted", NO_ANSWER)


def test_a_computer_that_slept_ends_the_test(qtbot, open_window, clock, bench, tmp_path):
    """All threads stand still together; the window may be the first to wake."""
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    clock.now += 3600.0
    qtbot.waitUntil(window.emergency.is_set, timeout=WAIT_MS)
    gate.opened.set()
    wait_for_result(qtbot, window)
    assert only_session(tmp_path)[1].test().notes["reason"] == NO_ANSWER
    assert bench.opened[0].current_run is None


def test_frames_that_cannot_be_drawn_are_no_beats(qtbot, open_window, clock, tmp_path, monkeypatch):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    drawn = threading.Event()

    def fail(_snapshot):
        drawn.set()
        raise ZeroDivisionError

    with qtbot.captureExceptions() as caught:
        monkeypatch.setattr(window.ui.signals, "show_live", fail)
        qtbot.waitUntil(drawn.is_set, timeout=WAIT_MS)
        monkeypatch.undo()
        # Unattended is there who would meet the defect (the application's hook does): the beat alone has to do.
        clock.now += 1.2
        gate.opened.set()
        wait_for_result(qtbot, window)
    assert caught
    assert only_session(tmp_path)[1].test().notes["reason"] == NO_ANSWER


def test_a_defect_in_the_window_releases_the_coil(qtbot, open_window, bench, tmp_path, monkeypatch):
    monkeypatch.setattr(app_words, "user_log_path", lambda *_, **__: tmp_path)
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    window.on_defect(ZeroDivisionError())
    gate.opened.set()
    wait_for_result(qtbot, window)
    assert begins(only_session(tmp_path)[1].test().notes["reason"], "stop.released", cause=BY_DEFECT)
    assert bench.opened[0].current_run is None
    assert (tmp_path / "last-defect.txt").exists()


def test_the_button_on_the_instrument(qtbot, open_window, tmp_path):
    links = []

    def opener(_url):
        instrument = connect()
        link = instrument.link
        links.append(link)

        def press_later(data):
            link.firmware.bench.button = link.now > 4.0
            return data

        link.to_host = press_later
        return instrument

    window = open_window(opener=opener)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    wait_for_result(qtbot, window)
    assert begins(window.ui.notice.text.text(), "outcome.stopped_by_button")
    assert not links[0].firmware.energised
    test = only_session(tmp_path)[1].test()
    assert test.status == "aborted"
    assert "button was pressed" in test.notes["reason"]


def test_a_process_that_dies_in_mid_test_leaves_the_coil_to_the_watchdog():
    """A crash of the window's thread takes the thread that measures with it: nothing of this program is left."""
    instrument = connect()
    link = instrument.link
    instrument.load(np.full(20_000, 1.0))
    instrument.arm(CLINICAL)
    instrument.start()
    for _ in range(20):
        instrument.poll(0.05)
    assert link.firmware.energised
    link.run_for(0.5)
    assert not link.firmware.energised


def test_what_could_not_be_saved_or_logged_is_said_beside_the_stop(qtbot, open_window, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, FULL)

    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    press(qtbot, window.ui.stop)
    monkeypatch.setattr(recorder, "write_journal_session", full)
    monkeypatch.setattr(AuditLog, "record", full)
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    words = window.ui.notice.text.text()
    assert begins(words, "outcome.stopped")
    assert FULL in words
    assert "Nothing was recorded" not in words
    assert shows(words, "audit.not_logged")
    assert list(tmp_path.glob("*.journal"))


def test_a_test_that_cannot_be_logged_does_not_begin(qtbot, open_window, bench, tmp_path):
    window = open_window(audit=AuditLog(tmp_path))
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert "audit log" in window.ui.notice.text.text()
    assert not bench.opened[0].energised
    assert list(tmp_path.iterdir()) == []


def test_what_happened_is_in_the_audit_log(qtbot, open_window, tmp_path, audit_file):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait, audit=AuditLog(audit_file))
    begin(qtbot, window, gate)
    press(qtbot, window.ui.stop)
    gate.opened.set()
    wait_for_result(qtbot, window)
    lines = {line.what: line for line in last_lines(audit_file, 100)}
    assert {line.role for line in lines.values() if not line.what.startswith("audit.")} == {"clinician"}
    assert reads(lines["test.stopped"].new["reason"], "stop.released", cause=BY_BUTTON)
    assert {"session.begun", "test.begun", "session.written"} <= set(lines)


def test_stopping_twice_and_stopping_late_does_no_harm(qtbot, open_window, tmp_path):
    gate = Gate(passed=300)
    window = open_window(wait=gate.wait)
    begin(qtbot, window, gate)
    for _ in range(3):
        press(qtbot, window.ui.stop)
    gate.opened.set()
    wait_for_result(qtbot, window)
    words = window.ui.notice.text.text()
    assert begins(words, "outcome.stopped")
    assert begins(only_session(tmp_path)[1].test().notes["reason"], "stop.released", cause=BY_BUTTON)
    assert idle(window)


def test_a_test_that_ended_is_not_shown_as_running_while_it_is_saved(qtbot, open_window, tmp_path, monkeypatch):
    gate, saving, go_on = Gate(passed=300), threading.Event(), threading.Event()

    def lost(seconds):
        gate.wait(seconds)
        if gate.opened.is_set():
            raise LinkLostError(LOST, 0.5)

    written = recorder.write_journal_session

    def write_late(*arguments):
        saving.set()
        assert go_on.wait(WAIT_MS / 1000)
        return written(*arguments)

    monkeypatch.setattr(recorder, "write_journal_session", write_late)
    window = open_window(wait=lost)
    begin(qtbot, window, gate)
    window.ui.guidance.lamp.show_contact(Contact.ON)
    gate.opened.set()
    qtbot.waitUntil(lambda: saving.is_set() and window.abort_shown is not None, timeout=WAIT_MS)
    assert window.testing, "its recording is still being saved"
    assert window.ui.notice.text.text() == sentence(LOST)
    assert "0.5 s" in window.ui.safety.keys.text()
    assert window.ui.safety.force.text().endswith(MISSING)
    assert window.ui.guidance.lamp.contact is Contact.UNWATCHED
    go_on.set()
    wait_for_result(qtbot, window)
    assert only_session(tmp_path)[1].test().status == "aborted"


def test_a_window_that_does_not_keep_up_opens_no_instrument(qtbot, open_window, bench, monkeypatch, audit_file):
    monkeypatch.setattr(main_window, "KEEPS_UP_S", -1.0)
    window = open_window(audit=AuditLog(audit_file))
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    frames = []
    window.frame_timer.timeout.connect(lambda: frames.append(1))
    qtbot.waitUntil(lambda: len(frames) > 5, timeout=WAIT_MS)
    assert window.testing
    assert not window.emergency.watching
    assert bench.opened == []
    press(qtbot, window.ui.stop)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert bench.opened == []
    (line,) = [line for line in last_lines(audit_file, 100) if line.what.startswith("test.")]
    assert (line.what, line.new["codes"]) == ("test.stopped", ["stop.button", "stop.released"])


def test_what_warms_up_keeps_the_instrument_closed_until_it_is_done(qtbot, open_window, bench):
    window = open_window()
    warming = [True]
    window.warming = lambda: bool(warming)
    type_site(qtbot, window)
    press(qtbot, window.ui.start)
    frames = []
    window.frame_timer.timeout.connect(lambda: frames.append(1))
    qtbot.waitUntil(lambda: len(frames) > 5, timeout=WAIT_MS)
    assert bench.opened == []
    warming.clear()
    qtbot.waitUntil(lambda: bool(bench.opened), timeout=WAIT_MS)
    assert window.emergency.watching
    press(qtbot, window.ui.stop)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)


@pytest.mark.parametrize("begun", [False, True], ids=["while placing", "in the stimulus"])
def test_a_test_that_the_watchdog_of_the_window_ended_is_logged_as_aborted(
    qtbot, open_window, clock, audit_file, tmp_path, begun
):
    gate = Gate(passed=300 if begun else 1)
    window = open_window(wait=gate.wait, audit=AuditLog(audit_file))
    begin(qtbot, window, gate)
    clock.now += 1.2
    qtbot.waitUntil(window.emergency.is_set, timeout=WAIT_MS)
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    ends = [line for line in last_lines(audit_file, 100) if line.what in ("test.aborted", "test.stopped")]
    assert [(line.what, line.new["codes"]) for line in ends] == [("test.aborted", ["stop.no_answer"])]
    (event,) = read_events([], read_log(audit_file, lambda: None), lambda: None).entries
    assert event.level == "check"
