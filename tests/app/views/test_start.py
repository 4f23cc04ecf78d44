"""The first page, help and log: chosen by hand, remembered, and unharmed by what lies in a folder."""

import dataclasses
import os
import shutil
import threading
from dataclasses import replace

import pytest
from app.benches import WAIT_MS, found
from app.test_window import idle, press
from coded import made, reads
from failing_disk import FULL
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QGuiApplication

from tissueid.acquisition import journal_path
from tissueid.acquisition.quality import HEADLINES, judge_session, quality_of
from tissueid.app.panels import FOLDER, HELP_KEY, MOST_LINES
from tissueid.app.views.researcher.session_search import entry_of
from tissueid.app.views.start.recent import MOST_SHOWN, look_into
from tissueid.app.views.start.view import brief
from tissueid.app.words import CalibrationState
from tissueid.cli.test import answer_of
from tissueid.instrument import FoundInstrument
from tissueid.reports.verdict import judge
from tissueid.sessions import Subject, read_session, write_session
from tissueid.sessions.accepted_result import AcceptedResult, AcceptedTest, AcceptedValue, write_result

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

PAGES = ["start", "measure", "research", "gap", "instrument", "studies"]


@pytest.fixture
def open_start(qtbot, open_window):
    """Opens windows on the first page, and waits until its folder is read."""

    def make(**changes):
        window = open_window(first_page="start", **changes)
        qtbot.waitUntil(lambda: settled(window), timeout=WAIT_MS)
        return window

    return make


def settled(window):
    return idle(window) and not window.pages.start.refresh_timer.isActive()


def said(table):
    return [
        [table.item(row, column).text() for column in range(table.columnCount())] for row in range(table.rowCount())
    ]


@pytest.mark.parametrize("status", ["aborted", "recovered"])
@pytest.mark.parametrize("stored", ["judged now", "judged by an older version", "not judged"])
def test_a_test_that_ended_early_has_one_verdict_everywhere(tmp_path, saved, status, stored):
    session = read_session(saved)
    test = dataclasses.replace(session.tests[0], status=status, notes=session.tests[0].notes | {"reason": "a cause"})
    ((_test, quality),) = judge_session(dataclasses.replace(session, tests=(test,)))
    note = quality.as_notes()["quality"]
    if stored == "judged by an older version":
        note = note.replace('"severity": "repeat"', '"severity": "look"')
    notes = {name: value for name, value in test.notes.items() if name != "quality"}
    test = dataclasses.replace(test, notes=notes if stored == "not judged" else notes | {"quality": note})
    path = tmp_path / "stopped.h5"
    write_session(path, dataclasses.replace(session, tests=(test,)))
    kept = quality_of(test)
    verdict = judge(test, {})
    (line,) = look_into(tmp_path, threading.Event()).sessions
    assert quality.verdict == "repeat", "tissueid quality"
    assert kept is None or kept.verdict == "repeat", "the page Measure and the second box of the report"
    assert (verdict.level, verdict.headline) == ("poor", HEADLINES["repeat"]), "the guide, and the banner of the report"
    assert (line.level, line.verdict) == ("poor", HEADLINES["repeat"]), "Start"
    assert entry_of(path, (0, 0)).tests[0].verdict == "repeat", "Research"
    assert answer_of(test, None, None)["verdict"] == "repeat", "tissueid test"


def test_a_first_start_shows_the_first_page_with_the_keyboard_on_a_role(open_window):
    window = open_window(first_page="")
    assert window.ui.page == "start"
    assert window.pages.start.cards["clinician"].hasFocus()


@pytest.mark.parametrize(
    ("role", "page"), [("clinician", "measure"), ("researcher", "research"), ("technician", "instrument")]
)
def test_a_card_sets_the_role_and_goes_to_its_page(qtbot, open_start, role, page):
    window = open_start()
    card = window.pages.start.cards[role]
    card.setFocus()
    qtbot.keyClick(card, Qt.Key.Key_Return)
    assert (window.ui.role.role, window.ui.page) == (role, page)
    assert card.accessibleName().startswith(f"{role.capitalize()} (current)")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)


def test_an_instrument_that_is_chosen_is_that_of_the_next_test(qtbot, open_start):
    window = open_start()
    page = window.pages.start
    assert said(page.instruments)[1][0] == "✓ simulated://forearm"
    assert "not checked" in said(page.instruments)[0][1]
    assert not page.use.isEnabled()
    page.instruments.setFocus()
    page.instruments.selectRow(2)
    qtbot.keyClick(page.instruments, Qt.Key.Key_Return)
    assert window.ui.form.instrument.url == "simulated://spring"
    assert said(page.instruments)[2][0] == "✓ simulated://spring"
    page.instruments.selectRow(0)
    press(qtbot, page.use)
    assert window.ui.form.instrument.url == "/dev/ttyACM7"
    assert "/dev/ttyACM7" in page.about_instruments.text()
    window.ui.form.instrument.choose("socket://elsewhere:1")
    assert said(page.instruments)[0][0] == "✓ socket://elsewhere:1"


def test_the_calibration_of_a_typed_address_is_shown(open_start):
    window = open_start()
    chooser = window.ui.form.instrument
    chooser.choose("socket://127.0.0.1:7000")
    chooser.tell_calibration(chooser.url, CalibrationState("Calibrated today", "good", until="2026-04-01"))
    assert said(window.pages.start.instruments)[0][2] == "Calibrated today; next by 2026-04-01"


def test_finding_asks_every_port_and_says_how_each_stands(qtbot, open_start):
    def finder(*, probe, opener=None):
        if probe:
            opener("/dev/ttyACM7").close()
        dead = FoundInstrument("/dev/ttyS0", "n/a", False, "no answer; check the cable")
        return [*found(probe=probe), *([dead] if probe else [])]

    window = open_start(finder=finder)
    page = window.pages.start
    qtbot.keyClick(page.seek, Qt.Key.Key_D, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: len(said(page.instruments)) == 4 and settled(window), timeout=WAIT_MS)
    lines = said(page.instruments)
    assert reads(lines[0][1], "instruments.ready", what="desktop indenter, TEST-7")
    assert lines[0][2] != "Not known yet"
    assert lines[3][1] == brief(made("instruments.no_answer", what="no answer; check the cable"))
    assert "check the cable" in page.instruments.item(3, 1).toolTip()


def test_the_newest_sessions_are_listed_and_return_opens_one(qtbot, open_start, tmp_path, saved):
    session = read_session(saved)
    for number in range(MOST_SHOWN + 2):
        path = tmp_path / f"{number:02d}.h5"
        shutil.copy(saved, path) if number else write_session(path, session)
        os.utime(path, (1e9 + number, 1e9 + number))
    window = open_start()
    page = window.pages.start
    assert page.recent.rowCount() == MOST_SHOWN
    assert said(page.recent)[0][1:3] == ["left calf", "anonymous"]
    assert page.about_recent.text() == f"The newest {MOST_SHOWN} of {MOST_SHOWN + 2}."
    assert not page.open.isEnabled()
    page.recent.setFocus()
    page.recent.selectRow(1)
    assert page.open.isEnabled()
    qtbot.keyClick(page.recent, Qt.Key.Key_Return)
    assert window.ui.page == "measure"
    qtbot.waitUntil(lambda: window.findings is not None and idle(window), timeout=WAIT_MS)
    assert window.findings.path == tmp_path / f"{MOST_SHOWN:02d}.h5"
    assert window.findings.verdict.headline in window.panels.log.lines.toPlainText()


def test_a_session_without_a_site_has_the_name_of_its_file(open_start, tmp_path, saved):
    session = read_session(saved)
    unnamed = replace(session, tests=tuple(replace(test, site="") for test in session.tests))
    for name in ("imported.h5", "2026-01-15_10-30-00.h5"):
        write_session(tmp_path / name, unnamed)
    page = open_start().pages.start
    assert {line[1] for line in said(page.recent)} >= {"imported.h5", "Site not recorded"}


def test_rubbish_has_a_line_that_says_so_and_cannot_harm(qtbot, open_start, tmp_path):
    (tmp_path / "rubbish.h5").write_bytes(b"\x00rubbish")
    (tmp_path / "<b>bold\x07.h5").write_bytes(b"")
    (tmp_path / "folder.h5").mkdir()
    window = open_start()
    page = window.pages.start
    assert sorted(line[1] for line in said(page.recent)) == ["<b>bold\ufffd.h5", "rubbish.h5"]
    assert {line[3] for line in said(page.recent)} == {"Is damaged, or not an HDF5 session."}
    page.recent.selectRow(0)
    press(qtbot, page.open)
    qtbot.waitUntil(lambda: idle(window) and window.ui.notice.isVisible(), timeout=WAIT_MS)
    assert window.ui.notice.property("level") == "problem"


def test_a_folder_that_is_not_there_is_empty_and_nothing_is_made(qtbot, open_start, tmp_path):
    window = open_start(folder=tmp_path / "none")
    page = window.pages.start
    assert page.recent.rowCount() == 0
    assert reads(page.about_recent.text(), "start.no_session")
    press(qtbot, page.folder)
    assert "first test" in window.ui.notice.text.text()
    assert not (tmp_path / "none").exists()


def test_unfinished_tests_are_offered_and_recovered(qtbot, open_start, tmp_path):
    journal = journal_path(tmp_path / "broken.h5")
    journal.write_bytes(b"not a journal")
    window = open_start()
    page = window.pages.start
    assert "broken.h5" in page.unfinished.text()
    assert window.ui.notice.isHidden()
    press(qtbot, page.recover)
    qtbot.waitUntil(lambda: settled(window) and window.ui.notice.isVisible(), timeout=WAIT_MS)
    assert window.ui.notice.property("level") == "problem"
    assert journal.exists()


def test_a_session_that_is_recorded_meanwhile_is_listed(qtbot, open_start, tmp_path, saved):
    window = open_start()
    page = window.pages.start
    shutil.copy(saved, tmp_path / "new.h5")
    window.state.session_saved.emit(tmp_path / "new.h5")
    qtbot.waitUntil(lambda: page.recent.rowCount() == 1, timeout=WAIT_MS)


def test_reading_is_cancelled_and_what_is_asked_for_meanwhile_comes_next(qtbot, open_window, tmp_path, monkeypatch):
    reached, go_on = threading.Event(), threading.Event()

    def slow(folder, cancelled, known, **search):
        reached.set()
        assert go_on.wait(WAIT_MS / 1000)
        return look_into(folder, cancelled, known, **search)

    monkeypatch.setattr("tissueid.app.views.start.view.look_into", slow)
    (tmp_path / "rubbish.h5").write_bytes(b"rubbish")
    window = open_window(first_page="start")
    page = window.pages.start
    qtbot.waitUntil(reached.is_set, timeout=WAIT_MS)
    assert page.stop_reading.isVisible()
    press(qtbot, page.stop_reading)
    go_on.set()
    qtbot.waitUntil(lambda: settled(window), timeout=WAIT_MS)
    assert reads(page.about_recent.text(), "start.cancelled", read=0, count=1)
    assert page.stop_reading.isHidden()
    reached.clear()
    go_on.clear()
    window.state.session_saved.emit(tmp_path / "other.h5")
    qtbot.waitUntil(reached.is_set, timeout=WAIT_MS)
    press(qtbot, page.cards["researcher"])
    assert window.ui.page == "start"
    go_on.set()
    qtbot.waitUntil(lambda: window.ui.page == "research" and idle(window), timeout=WAIT_MS)


def test_closing_while_the_folder_is_read(qtbot, open_window, monkeypatch):
    reached, seen = threading.Event(), []

    def slow(folder, cancelled, known, **search):
        reached.set()
        seen.append(cancelled.wait(WAIT_MS / 1000))
        return look_into(folder, cancelled, known, **search)

    monkeypatch.setattr("tissueid.app.views.start.view.look_into", slow)
    window = open_window(first_page="start")
    qtbot.waitUntil(reached.is_set, timeout=WAIT_MS)
    window.close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert seen == [True]


def test_nothing_works_beside_a_running_test(open_start):
    page = open_start().pages.start
    page.update_enabled(busy=True, testing=True)
    assert not page.isEnabled()
    page.update_enabled(busy=True, testing=False)
    assert page.isEnabled()
    assert not any(part.isEnabled() for part in (page.recent, page.seek, page.recover, *page.cards.values()))


def test_the_tab_key_visits_the_page_from_top_to_bottom(qtbot, open_start):
    window = open_start()
    page, ui = window.pages.start, window.ui
    page.recent.setRowCount(1)
    page.focus_first()
    visited = [window.focusWidget()]
    for _ in range(20):
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Tab)
        if window.focusWidget() is visited[0]:
            break
        visited.append(window.focusWidget())
    expected = [*page.cards.values(), page.search, page.recent, page.seek, page.instruments, page.folder]
    expected += [chooser.choice for chooser in page.choosers]
    assert visited[: len(expected)] == expected
    assert set(visited[len(expected) :]) == {ui.role.choice, ui.open, ui.rail.buttons["start"], *ui.rail.feet}


def test_the_arrow_keys_go_from_page_to_page_on_the_rail(qtbot, open_start):
    window = open_start()
    rail = window.ui.rail
    rail.buttons["start"].setFocus()
    shown = []
    for _ in PAGES:
        qtbot.keyClick(window.focusWidget(), Qt.Key.Key_Down)
        shown.append(window.ui.page)
        assert rail.buttons[window.ui.page].hasFocus()
        qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert shown == [*PAGES[1:], PAGES[0]]
    qtbot.waitUntil(lambda: settled(window), timeout=WAIT_MS)


# -- help and log ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES)
def test_every_page_has_a_help_that_can_be_read_in_one_go(page):
    text = (FOLDER / f"{page}.md").read_text(encoding="utf-8")
    assert text.count("\n") < 60
    for needed in ("## Keys", "colours mean", "Steps", HELP_KEY, "F9"):
        assert needed in text
    assert "http" not in text


def test_help_follows_the_page_and_gives_the_keyboard_back(qtbot, window):
    window.ui.form.subject.setFocus()
    qtbot.keyClick(window, Qt.Key.Key_F1)
    panel = window.panels.help
    assert panel.isVisible()
    assert panel.reader.toPlainText().startswith("Measure")
    qtbot.waitUntil(panel.reader.hasFocus, timeout=WAIT_MS)
    window.pages.show("gap")
    assert panel.reader.toPlainText().startswith("Gap")
    window.pages.show("measure")
    qtbot.keyClick(panel.reader, Qt.Key.Key_F1)
    assert panel.isHidden()
    assert not window.panels.help_button.isChecked()
    press(qtbot, window.panels.help_button)
    assert panel.isVisible()


def test_the_log_has_every_notice_and_failure_with_its_time(qtbot, window, tmp_path):
    log = window.panels.log
    window.ui.notice.say("Something <b>happened</b>\nhere.")
    window.ui.notice.say("Something <b>happened</b>\nhere.")

    def fails():
        raise OSError(28, FULL)

    window.jobs.do(fails, window.context.say_failed, window.context.say_failed)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    qtbot.keyClick(window, Qt.Key.Key_F9)
    assert log.isVisible()
    lines = log.lines.toPlainText().splitlines()
    assert [line[9:] for line in lines] == [
        "  TissueID was started.",
        "  Something <b>happened</b> here.",
        f"! {FULL}.",
    ]
    press(qtbot, log.copy)
    assert QGuiApplication.clipboard().text().splitlines()[:3] == lines
    log.save_to(tmp_path / "log.txt")
    assert (tmp_path / "log.txt").read_text(encoding="utf-8").splitlines()[:3] == lines
    log.save_to(tmp_path / "none" / "log.txt")
    assert window.ui.notice.property("level") == "problem"
    for number in range(MOST_LINES + 10):
        log.note(f"line {number}")
    assert log.lines.document().blockCount() == MOST_LINES
    assert log.lines.toPlainText().endswith(f"line {MOST_LINES + 9}")


def test_the_details_of_a_defect_are_folded_away(qtbot, window, tmp_path, monkeypatch):
    where = lambda *_, **__: tmp_path  # noqa: E731
    monkeypatch.setattr("tissueid.app.words.user_log_path", where)
    monkeypatch.setattr("tissueid.app.panels.user_log_path", where)
    log = window.panels.log
    qtbot.keyClick(window, Qt.Key.Key_F9)
    assert log.fold.isHidden()
    window.on_defect(ValueError("a figure of nothing"))
    assert log.details.isHidden()
    press(qtbot, log.fold)
    assert log.details.isVisible()
    assert "ValueError: a figure of nothing" in log.details.toPlainText()
    assert str(tmp_path / "last-defect.txt") in log.details.toPlainText()


# -- what is found again -----------------------------------------------------------------------------------------


def test_everything_but_subject_and_site_is_found_again(qtbot, open_start, open_window):
    first = open_start()
    press(qtbot, first.pages.start.cards["researcher"])
    qtbot.waitUntil(lambda: idle(first), timeout=WAIT_MS)
    form = first.ui.form
    form.instrument.choose("simulated://spring")
    form.subject.setText("P-017")
    form.site.setEditText("left calf")
    form.limits.setCurrentIndex(form.limits.findData("research"))
    form.stimulus.live_method.setCurrentIndex(form.stimulus.live_method.findData("als"))
    form.fold.setChecked(True)
    press(qtbot, first.panels.log_button)
    first.resize(1300, 700)
    first.close()
    again = open_window(first_page="")
    assert (again.ui.page, again.ui.role.role) == ("research", "researcher")
    form = again.ui.form
    assert (form.instrument.url, form.subject.text()) == ("simulated://spring", "")
    assert (form.limits.currentData(), form.site.currentText()) == ("research", "")
    assert form.fold.isChecked()
    assert form.plan().shown_method == "als"
    assert again.panels.log.isVisible()
    assert again.panels.log_button.isChecked()
    assert again.height() == 700  # the screen of these tests is narrower than any window


def test_the_role_in_use_is_kept_when_the_program_dies(qtbot, open_start, open_window):
    first = open_start()
    press(qtbot, first.pages.start.cards["technician"])
    qtbot.waitUntil(lambda: idle(first), timeout=WAIT_MS)
    assert open_window(first_page="").ui.role.role == "technician"  # the first was never closed


def test_choices_are_found_again_in_another_language(open_window):
    def choices(window):
        window.pages.show("research")
        research = window.ui.views["research"].analysis.pictures.choice
        window.pages.show("instrument")
        return research, window.ui.views["instrument"].audit.role

    first = open_window(language="de", role="technician")
    for choice in choices(first):
        choice.setCurrentIndex(2)
    first.close()
    assert [choice.currentIndex() for choice in choices(open_window(language="en", role="technician"))] == [2, 2]


def test_settings_that_somebody_else_wrote_do_no_harm(open_window, tmp_path):
    settings = QSettings(str(tmp_path / "window.ini"), QSettings.Format.IniFormat)
    for key in (
        "window/geometry",
        "window/panels",
        "window/page",
        "window/role",
        "test/limits",
        "test/instrument",
        "test/live-method",
    ):
        settings.setValue(key, "rubbish\n" * 500)
    settings.setValue("test/subject", ["a", "list"])
    settings.sync()
    window = open_window(first_page="")
    form = window.ui.form
    assert (window.ui.page, window.ui.role.role) == ("start", "clinician")
    assert (form.limits.currentData(), form.subject.text()) == ("clinical", "")
    assert form.plan().shown_method == "sliding"
    assert len(form.instrument.url) <= 200


@pytest.mark.parametrize("size", [(1100, 640), (1600, 900)])
def test_the_page_fits(qtbot, open_start, size):
    window = open_start()
    window.resize(*size)
    page = window.pages.start
    qtbot.waitUntil(lambda: (window.width(), window.height()) == size, timeout=WAIT_MS)
    for part in (*page.cards.values(), page.recent, page.instruments, page.folder):
        corner = part.mapTo(window, part.rect().bottomRight())
        assert corner.x() < size[0]
        assert corner.y() < size[1]


# -- sittings -------------------------------------------------------------------------------------------------------


def test_sittings_are_listed_by_the_time_of_their_tests_with_their_accepted_mean(open_start, tmp_path, saved):
    session = read_session(saved)
    key = "0f8fad5b-d9cb-469f-a165-70867728950e"
    files = []
    for number in range(3):
        notes = session.tests[0].notes | {"sitting": key, "repeat": number + 1.0}
        test = dataclasses.replace(session.tests[0], notes=notes)
        created = f"2026-02-0{number + 1}T10:00:00Z"
        path = tmp_path / f"2026-02-0{number + 1}_11-00-00.h5"
        files.append(path)
        write_session(path, dataclasses.replace(session, session_id=str(number), created=created, tests=(test,)))
    # Copied today, measured a year before: older than all of them, whatever its file says.
    write_session(tmp_path / "copied.h5", dataclasses.replace(session, created="2025-02-01T10:00:00Z"))
    for path in files:
        os.utime(path, (1e9, 1e9))
    tests = tuple(AcceptedTest(file=path.name, number=1, session_id=str(k)) for k, path in enumerate(files[:2]))
    values = {"mass_kg": AcceptedValue(mean=0.0927, std=0.001, repeatability=0.0028, count=2)}
    write_result(tmp_path, AcceptedResult(sitting=key, tests=tests, values=values))
    page = open_start().pages.start
    lines = said(page.recent)
    assert len(lines) == 2
    assert lines[0][1] == "left calf (3 tests)"
    assert lines[0][4] == made("start.accepted_mean", count=2, values="92.7 g")
    assert lines[1][0].startswith("2025-02-01")
    assert [item.path for item in page._look.sessions] == [files[1], tmp_path / "copied.h5"]
    assert page.about_recent.text() == ""
    (tmp_path / f"sitting-{key}.json").write_text("{", encoding="utf-8")
    assert [item.site for item in look_into(tmp_path, threading.Event()).sessions] == [
        "left calf (3 tests)",
        "left calf",
    ]


def test_a_sitting_is_marked_by_its_tests_that_can_be_used(tmp_path, saved):
    session = read_session(saved)
    (test,) = session.tests
    for number, status in enumerate(("completed", "aborted")):
        notes = test.notes | {"sitting": "0f8fad5b-d9cb-469f-a165-70867728950e"}
        kept = dataclasses.replace(test, notes=notes, status=status)
        write_session(tmp_path / f"2026-02-0{number + 1}_11-00-00.h5", dataclasses.replace(session, tests=(kept,)))
    (item,) = look_into(tmp_path, threading.Event()).sessions
    assert (item.level, item.tests, item.path.name) == ("good", 2, "2026-02-01_11-00-00.h5")


@pytest.fixture
def visits(tmp_path, saved):
    """A folder of sessions with a session of its own, and two studies: one in it, one elsewhere."""
    session = read_session(saved)
    home, other = tmp_path / "home", tmp_path / "elsewhere" / "lotion"
    for folder, subject, day in ((home / "skin", "P01", 3), (other, "P02", 2)):
        (folder / subject).mkdir(parents=True)
        (folder / "protocol.json").write_text("{}", encoding="utf-8")
        theirs = dataclasses.replace(
            session, subject=Subject(pseudonym=subject), created=f"2026-02-0{day}T10:00:00Z", session_id=subject
        )
        write_session(folder / subject / f"2026-02-0{day}_10-00-00.h5", theirs)
    write_session(home / "2026-02-01_10-00-00.h5", dataclasses.replace(session, created="2026-02-01T10:00:00Z"))
    return home, other


def test_visits_of_studies_are_listed_and_found_by_subject_and_date(visits):
    home, other = visits

    def found(search=""):
        look = look_into(home, threading.Event(), studies=[other, home / "skin" / ".." / "skin"], search=search)
        assert all(item.tests == 1 for item in look.sessions)
        return [(item.subject, item.study) for item in look.sessions]

    assert found() == [("P01", "skin"), ("P02", "lotion"), ("anonymous", "")]
    assert found("p01") == found("2026-02-03 calf") == [("P01", "skin")]
    assert found("2026-02") == found()
    assert found("lotion") == [("P02", "lotion")]
    assert found("P03") == []
    assert [item.subject for item in look_into(home, threading.Event()).sessions] == ["P01", "anonymous"]


def test_a_visit_is_searched_for_and_opened_on_the_page(qtbot, open_start, visits):
    home, _other = visits
    window = open_start(folder=home)
    page = window.pages.start
    assert [line[2] for line in said(page.recent)] == ["P01  ·  skin", "anonymous"]
    qtbot.keyClicks(page.search, "P01")
    qtbot.waitUntil(lambda: page.recent.rowCount() == 1 and settled(window), timeout=WAIT_MS)
    page.recent.setFocus()
    page.recent.selectRow(0)
    qtbot.keyClick(page.recent, Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: window.findings is not None and idle(window), timeout=WAIT_MS)
    assert window.findings.path.parent == home / "skin" / "P01"


@pytest.mark.parametrize("width", [1024, 1366])
def test_a_long_address_leaves_room_for_health_and_calibration(qtbot, open_start, width):
    long = "/dev/serial/by-id/usb-" + "Maker_of_Converters_" * 6 + "if00-port0"

    def finder(*, probe, opener=None):
        return [FoundInstrument(long, "serial port", True, "TWIN-7"), *found(probe=probe)]

    window = open_start(finder=finder)
    window.resize(width, 768)
    table = window.pages.start.instruments
    qtbot.waitUntil(lambda: window.width() == width, timeout=WAIT_MS)
    assert said(table)[0][0].endswith("if00-port0")
    assert long in table.item(0, 0).toolTip()
    assert min(table.columnWidth(column) for column in range(3)) >= 60
    assert table.rowHeight(0) <= 3 * table.fontMetrics().height() + 12
