"""The technician's page: faults, the audit log, and the page as a whole."""

import csv
import dataclasses
import functools

import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from app.views.technician_pages import (
    AUDIT,
    CALIBRATIONS,
    FAULTS,
    HEALTH,
    choose,
    column,
    rest,
    select,
    static,
    sweep,
)
from coded import begins, shows
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QAbstractButton, QLabel

from tissueid.app.words import sentence
from tissueid.audit import AuditLog
from tissueid.calibration import write_calibration
from tissueid.instrument.replies import FAULT_TEXTS, released_by_faults
from tissueid.messages import codes_in
from tissueid.procedures.control import BY_KEY
from tissueid.sessions import read_session, write_session
from tissueid.sessions.model import reason_notes
from tissueid.wire import Fault

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- faults ---------------------------------------------------------------------------------------------------


@pytest.fixture
def mishaps(tmp_path, saved, audit_file):
    """A session with a fault that is in the log too, one that was stopped, one completed, and rubbish."""
    session = read_session(saved)
    log = AuditLog(audit_file)
    hot = released_by_faults(Fault.OVER_TEMPERATURE).message
    for name, status, what, reason in (
        ("hot", "aborted", "test.fault", hot),
        ("stopped", "aborted", "test.stopped", BY_KEY),
        ("whole", "completed", "test.completed", ""),
    ):
        test = dataclasses.replace(session.tests[0], status=status, notes=reason_notes(reason) if reason else {})
        write_session(tmp_path / f"{name}.h5", dataclasses.replace(session, session_id=name, tests=(test,)))
        log.record(
            "clinician",
            what,
            subject=f"{name} test 1",
            new={"samples": 10, "reason": reason, "codes": sorted(codes_in(reason))},
        )
    (tmp_path / "rubbish.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 3)
    return tmp_path


def test_faults_are_listed_once_with_what_to_do_and_their_session_is_opened(qtbot, page, mishaps):
    view = page(FAULTS, whole=True)
    faults = view.faults
    assert sorted(column(faults.model, 1)) == ["Fault", "Unreadable file"]
    select(faults.list, column(faults.model, 1).index("Fault"))
    assert faults.advice.text() == f"What to do: {sentence(FAULT_TEXTS[Fault.OVER_TEMPERATURE].remedy)}"
    assert str(mishaps / "hot.h5") == faults.where.text()
    assert faults.open.isEnabled()
    faults.kind.setFocus()
    qtbot.keyClick(faults.kind, Qt.Key.Key_Down)
    assert sorted(column(faults.model, 1)) == ["Completed", "Fault", "Stopped", "Unreadable file"]
    qtbot.keyClick(faults.list, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    assert faults.search.hasFocus()
    qtbot.keyClicks(faults.search, "COIL hot")
    assert column(faults.model, 1) == ["Fault"]
    assert faults.count.text().startswith("1 shown")
    select(faults.list, 0)
    press(qtbot, faults.open)
    window = view.window_
    assert window.ui.page == "measure"
    qtbot.waitUntil(lambda: idle(window) and window.findings is not None, timeout=WAIT_MS)
    assert window.findings.path.name == "hot.h5"


def test_empty_folders_and_no_log_are_no_trouble(qtbot, page, tmp_path):
    view = page(FAULTS, folder=tmp_path / "nothing", audit=AuditLog(tmp_path / "none.jsonl"))
    assert view.faults.model.rowCount() == 0
    choose(qtbot, view, AUDIT)
    assert shows(view.audit.count.text(), "audit.missing", path=tmp_path / "none.jsonl")
    press(qtbot, view.audit.verify)
    rest(qtbot, view)
    assert shows(view.window_.said[-1], "audit.missing", path=tmp_path / "none.jsonl")
    assert view.audit.verdict_text.text() == "Not verified."
    assert not view.audit.export.isEnabled()


# -- the audit log --------------------------------------------------------------------------------------------


def test_the_log_is_shown_filtered_and_exported(qtbot, page, tmp_path, audit_file):
    log = AuditLog(audit_file)
    log.record("clinician", "test.begun", subject="=cmd()", new={"site": "left calf"})
    log.record("technician", "role.changed", old="clinician", new="technician")
    view = page(AUDIT)
    audit = view.audit
    assert column(audit.model, 0) == ["3", "2", "1"]
    assert column(audit.model, 6)[0] == "clinician"
    assert column(audit.model, 7)[0] == "technician"
    audit.search.setFocus()
    qtbot.keyClicks(audit.search, "calf")
    assert column(audit.model, 4) == ["test.begun"]
    select(audit.list, 0)
    assert "Site: left calf" in audit.full.text()
    target = tmp_path / "log.csv"
    audit.export_to(target)
    rest(qtbot, view)
    rows = list(csv.reader(target.read_text(encoding="utf-8").splitlines()))
    assert [row[4] for row in rows] == ["what", "test.begun"]
    assert rows[1][5] == "'=cmd()"  # no formula of a spreadsheet
    assert "1 lines" in view.window_.said[-1]
    before = audit_file.read_bytes()
    audit.export_to(audit_file)
    rest(qtbot, view)
    assert "audit log itself" in view.window_.said[-1]
    assert audit_file.read_bytes() == before
    audit.search.clear()
    audit.role.setFocus()
    qtbot.keyClicks(audit.role, "tech")
    assert column(audit.model, 4) == ["role.changed"]


def test_verify_tells_a_whole_log_from_one_that_was_changed(qtbot, page, audit_file):
    log = AuditLog(audit_file)
    for number in range(5):
        log.record("clinician", "test.begun", subject=f"s{number}")
    view = page(AUDIT)
    press(qtbot, view.audit.verify)
    rest(qtbot, view)
    assert view.audit.verdict_text.text().startswith("Intact: 6 lines")
    assert view.audit.verdict.property("level") == "good"
    audit_file.write_bytes(audit_file.read_bytes().replace(b'"s2"', b'"x2"'))
    press(qtbot, view.audit.verify)
    rest(qtbot, view)
    assert begins(view.audit.verdict_text.text(), "audit.table.broken", place=4)
    assert view.audit.verdict.property("level") == "poor"
    press(qtbot, view.audit.again)
    rest(qtbot, view)
    assert shows(view.audit.count.text(), "audit.table.piece")


def test_rubbish_in_place_of_the_log_gives_words(qtbot, page, audit_file):
    view = page(AUDIT)
    for content in (b"", b"\x00" * 300_000, b"{}\n" * 50, bytes(range(256)) * 500):
        audit_file.write_bytes(content)
        press(qtbot, view.audit.again)
        rest(qtbot, view)
        assert view.audit.model.rowCount() == 0
        press(qtbot, view.audit.verify)
        rest(qtbot, view)
        assert view.audit.verdict_text.text()
        assert view.audit.verdict.property("level") in ("check", "poor")


# -- the page as a whole --------------------------------------------------------------------------------------


def test_tab_filter_and_search_are_there_again_at_the_next_start(qtbot, page, open_window, audit_file):
    view = page(AUDIT, whole=True)
    view.audit.search.setText("calf")
    view.faults.kind.setCurrentText("Fault")
    view.window_.close()
    qtbot.waitUntil(lambda: not view.window_.isVisible(), timeout=WAIT_MS)
    window = open_window(first_page="", audit=AuditLog(audit_file))
    again = next(item for item in window.pages.views if item.name == "instrument")
    assert window.ui.page == "instrument"
    assert again.tabs.currentWidget() is again.audit
    assert again.audit.search.text() == "calf"
    assert again.faults.kind.currentText() == "Fault"


def test_text_of_files_is_shown_as_it_stands(qtbot, page, calibrations):
    nasty = "<img src=x><b>S</b>"
    write_calibration(calibrations / "n.toml", sweep(serial_number=nasty))
    write_calibration(calibrations / "m.toml", sweep(serial_number=nasty, date="2026-01-01T00:00:00Z"))
    view = page(CALIBRATIONS)
    select(view.calibrations.list, 0, 1)
    assert "&lt;b&gt;" in view.calibrations.sweeps.key.text()
    rich = [
        label
        for label in view.findChildren(QLabel)
        if label.textFormat() != Qt.TextFormat.PlainText and ("<img" in label.text() or "<b>S" in label.text())
    ]
    assert rich == []


@pytest.mark.soak
def test_nothing_is_clipped_at_the_smallest_size(qtbot, page, calibrations, mishaps):
    for number, date in enumerate(("", "2026-01-01T00:00:00Z")):
        write_calibration(calibrations / f"w{number}.toml", sweep(date=date))
        write_calibration(calibrations / f"s{number}.toml", static(date))
    view = page(whole=True)
    view.window_.resize(1100, 640)
    press(qtbot, view.health.ask)
    for tab in range(4):
        choose(qtbot, view, tab)
        assert view.minimumSizeHint().width() <= 1100 - 92
        assert view.minimumSizeHint().height() <= 640 - 40
        for button in view.findChildren(QAbstractButton):
            if button.isVisible() and button.text():
                assert button.width() >= button.fontMetrics().horizontalAdvance(button.text())


def test_the_tab_key_goes_through_each_tab_and_nothing_begins_beside_a_test(qtbot, page):
    view = page(whole=True)
    expected = {
        HEALTH: ["ask"],
        CALIBRATIONS: ["calibrate", "again", "list"],
        FAULTS: ["kind", "search", "again", "list"],
        AUDIT: ["role", "act", "search", "again", "verify", "list"],
    }
    for tab, names in expected.items():
        choose(qtbot, view, tab)
        part, first = view.all[tab], view.tabs.tabBar()
        first.setFocus()
        visited = []
        for _ in range(12):
            qtbot.keyClick(view.window_.focusWidget(), Qt.Key.Key_Tab)
            widget = view.window_.focusWidget()
            if not part.isAncestorOf(widget):
                break
            visited.append(widget)
        assert visited == [getattr(part, name) for name in names]
    view.update_enabled(busy=True, testing=True)
    buttons = [view.health.ask, view.calibrations.calibrate, view.calibrations.again, view.faults.again]
    buttons += [view.audit.again, view.audit.verify, view.audit.export]
    assert not any(button.isEnabled() for button in buttons)
    qtbot.keyClick(view.tabs.tabBar(), Qt.Key.Key_F5)
    assert idle(view.window_)


def test_a_hundred_thousand_lines_are_shown_in_pieces_and_filtered_at_once(qtbot, page):
    from tissueid.app.views.technician.events import LogPage, haystack
    from tissueid.app.views.technician.log_tabs import Read
    from tissueid.audit.line import make_line

    view = page(AUDIT)
    about = dict(time="2026-01-01T00:00:00Z", role="clinician", who="w", what="test.begun", old=None, new=None)
    line = functools.partial(make_line, **about, software="s", previous="0" * 64)
    some = [line(number=number, subject=f"s{number}")[0] for number in range(100)]
    lines = tuple(some * 1000)
    view.audit._loaded(Read(LogPage(lines), tuple(haystack(item) for item in some) * 1000, ("test.begun",)))
    model, table = view.audit.model, view.audit.list
    seen = model.rowCount()
    assert seen <= 400

    def more():
        table.scrollToBottom()
        return model.rowCount() > seen

    qtbot.waitUntil(more, timeout=WAIT_MS)
    assert model.rowCount() < 2000
    view.audit.search.setText("s77")
    assert len(view.audit.model.rows) == 1000


def test_a_failed_calibration_is_one_row_and_a_test_is_named_by_site_and_person(qtbot, page, audit_file):
    log = AuditLog(audit_file)
    lost = "the connection broke"
    for what, subject, new in (
        ("session.begun", "a1", {"pseudonym": "P-007"}),
        ("test.begun", "a1 test 1", {"site": "left calf"}),
        ("test.aborted", "a1 test 1", {"reason": lost}),
        ("session.broken_off", "a1", lost),
        ("test.aborted", "", {"site": "right calf", "pseudonym": "P-008", "reason": lost}),
        ("calibration.begun", "SIM-0001", "sweep"),
        ("session.begun", "b2", {"pseudonym": "anonymous"}),
        ("test.begun", "b2 test 1", {"site": ""}),
        ("test.aborted", "b2 test 1", {"reason": lost}),
        ("session.broken_off", "b2", lost),
        ("calibration.broken_off", "SIM-0001", lost),
    ):
        log.record("technician", what, subject=subject, new=new)
    view = page(FAULTS)
    about = ["SIM-0001", "Test 1, left calf, P-007", "right calf, P-008"]
    assert sorted(column(view.faults.model, 2)) == about
    assert set(column(view.faults.model, 1)) == {"Interrupted"}
    choose(qtbot, view, AUDIT)
    rest(qtbot, view)
    assert set(about) < set(column(view.audit.model, 5))
    qtbot.keyClicks(view.audit.search, "p-007 aborted")
    assert column(view.audit.model, 4) == ["test.aborted"]
