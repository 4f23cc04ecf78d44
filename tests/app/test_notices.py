"""What the window says stays where it belongs, and goes when it is no longer so; what an instrument is taken for."""

import pytest
from app.benches import WAIT_MS, found
from app.test_window import idle, press, type_site
from coded import reads
from failing_disk import FULL, Disk
from PySide6.QtWidgets import QPushButton

from tissueid.acquisition import SessionRecorder, journal_path
from tissueid.app import words
from tissueid.app.words import sentence
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.instrument import FoundInstrument, SimulatedInstrument
from tissueid.procedures import test_run

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

PORT = "/dev/ttyACM7"
FULL_DISK, CABLE_OFF, SILENT = "The disk is full.", "The cable is off.", "it does not answer: check the cable"


@pytest.fixture
def window(fresh_window):
    return fresh_window


def shown(window):
    return window.ui.notice.text.text() if window.ui.notice.isVisible() else ""


def test_news_are_gone_once_their_page_is_left(window):
    window.ui.notice.say("It is saved.")
    assert shown(window) == "It is saved."
    window.pages.show("start")
    assert not shown(window)
    window.pages.show("measure")
    assert not shown(window)


def test_a_problem_waits_on_its_page(window):
    window.ui.notice.say(FULL_DISK, problem=True)
    window.pages.show("start")
    assert not shown(window)
    window.pages.show("measure")
    assert shown(window) == FULL_DISK
    window.ui.notice.dismiss.click()
    window.pages.show("start")
    window.pages.show("measure")
    assert not shown(window)


def test_news_go_when_another_action_begins_and_a_problem_when_it_succeeds(qtbot, window):
    notice, button = window.ui.notice, window.ui.views["start"].use
    notice.say("It is saved.")
    button.pressed.emit()
    assert not shown(window)
    notice.say(FULL_DISK, problem=True)
    button.pressed.emit()
    assert shown(window)
    window.jobs.do(lambda: 1 / 0, window.on_logged, window.on_logged)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert shown(window)
    window.jobs.do(lambda: 1, window.on_logged, window.on_logged)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert not shown(window)


def test_what_an_action_says_itself_an_offer_and_a_defect_stay_when_it_succeeds(qtbot, window):
    notice, button = window.ui.notice, window.ui.views["start"].use
    for say in (
        lambda: notice.say(FULL_DISK, problem=True),
        lambda: notice.say("One is unfinished.", offer="Recover"),
        lambda: notice.say_everywhere("Defect."),
    ):
        say()
        if not notice.text.text().startswith("The disk"):
            button.pressed.emit()
        window.jobs.do(lambda: 1, window.on_logged, window.on_logged)
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
        assert shown(window)


def test_an_offer_waits_on_its_page(window):
    window.ui.notice.say("One is unfinished.", offer="Recover")
    window.pages.show("start")
    window.pages.show("measure")
    assert window.ui.notice.offer.isVisible()


def test_what_befalls_a_test_is_said_where_somebody_looks_and_on_its_own_page(window):
    window.pages.show("start")
    window.ui.notice.say(CABLE_OFF, problem=True, page="measure")
    assert shown(window) == CABLE_OFF
    window.pages.show("measure")
    assert shown(window) == CABLE_OFF
    window.pages.show("start")
    window.pages.show("research")
    assert not shown(window)


def test_newer_words_take_the_place_of_what_waits(window):
    window.ui.notice.say(FULL_DISK, problem=True)
    window.pages.show("start")
    window.ui.notice.say("Two instruments answer.")
    window.pages.show("measure")
    assert not shown(window)


def test_a_defect_is_said_on_every_page_until_it_is_dismissed(window, monkeypatch, tmp_path):
    monkeypatch.setattr(words, "user_log_path", lambda *_, **__: tmp_path)
    window.on_defect(ZeroDivisionError())
    for name in ("start", "measure", "instrument"):
        window.pages.show(name)
        assert "defect" in shown(window)
    window.ui.notice.dismiss.click()
    window.pages.show("start")
    assert not shown(window)


def test_what_was_wrong_in_the_form_is_no_longer_said_once_that_is_changed(qtbot, window):
    press(qtbot, window.ui.start)
    assert "site" in shown(window)
    assert window.ui.notice.property("level") == "problem"
    type_site(qtbot, window)
    assert not shown(window)
    window.ui.notice.say(CABLE_OFF, problem=True)
    window.ui.form.subject.setText("P-001")
    assert shown(window) == CABLE_OFF


def test_what_a_page_says_late_belongs_to_that_page(window):
    window.pages.show("instrument")
    context = window.ui.views["instrument"].context
    window.pages.show("measure")
    context.say("It was read.", problem=True)
    assert shown(window) == "It was read."
    window.pages.show("instrument")
    assert shown(window) == "It was read."


# -- to a calibration -------------------------------------------------------------------------------------------------


def test_calibrate_brings_the_right_tab_to_the_front(qtbot, open_window):
    window = open_window(first_page="instrument", role="technician")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    view = window.ui.views["instrument"]
    view.tabs.setCurrentWidget(view.calibrations)
    qtbot.waitUntil(lambda: idle(window) and not view.refresh_timer.isActive(), timeout=WAIT_MS)
    press(qtbot, view.calibrations.calibrate)
    assert window.ui.page == "measure"
    assert window.ui.pages.currentWidget() is window.ui.calibration
    begin = window.ui.calibration.begin["static"]
    assert isinstance(begin, QPushButton)
    assert begin.isVisible()
    assert begin.hasFocus()
    assert "Begin static calibration" in shown(window)
    assert not window.testing


# -- what an instrument is taken for ----------------------------------------------------------------------------------


@pytest.fixture
def measure_with(qtbot, open_window):
    """A window whose instrument at a port has answered; a test with it has begun and is over."""

    def run(opener=lambda _: SimulatedInstrument("forearm"), before=lambda: None):
        def finder(**_):
            return [FoundInstrument(PORT, "desktop indenter", True), *found(probe=False)[1:]]

        window = open_window(opener=opener, finder=finder)
        form = window.ui.form
        form.instrument.choose(PORT)
        form.fill({"seconds": 0.5})
        assert reads(form.instrument.about.text(), "instruments.ready", what="desktop indenter")
        type_site(qtbot, window)
        before()
        press(qtbot, window.ui.start)
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
        return window

    return run


def test_a_full_disk_says_nothing_about_the_instrument(measure_with, monkeypatch):
    add = SessionRecorder.add

    def fill(recorder, samples):
        add(recorder, samples)
        if recorder.samples_appended > 1000:
            Disk(monkeypatch, journal_path(recorder.path), fails_at=1)

    window = measure_with(before=lambda: monkeypatch.setattr(SessionRecorder, "add", fill))
    assert FULL in shown(window)
    assert reads(window.ui.form.instrument.about.text(), "instruments.ready", what="desktop indenter")


def test_a_folder_that_cannot_be_written_says_nothing_about_the_instrument(measure_with, monkeypatch):
    def refuse(*_, **__):
        raise UnusableInputError("cannot write there")

    window = measure_with(before=lambda: monkeypatch.setattr(test_run, "SessionRecorder", refuse))
    assert shown(window) == "Cannot write there."
    assert reads(window.ui.form.instrument.about.text(), "instruments.ready", what="desktop indenter")


def test_an_instrument_that_fails_is_told_so_until_it_is_asked_anew(qtbot, measure_with):
    def silent(_url):
        raise InstrumentError(SILENT)

    window = measure_with(opener=silent)
    assert shown(window) == sentence(SILENT)
    about = window.ui.form.instrument.about
    assert reads(about.text(), "instruments.failed", what="desktop indenter")
    press(qtbot, window.ui.form.instrument.refresh)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert reads(about.text(), "instruments.ready", what="desktop indenter")
