"""The page Instrument as a technician uses it: asking, comparing calibrations, finding faults, verifying the log."""

import csv
import dataclasses
import functools
import threading

import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from PySide6.QtCore import QItemSelectionModel, QPoint, Qt
from PySide6.QtWidgets import QAbstractButton, QLabel
from support import connect

from tissueid.audit import AuditLog
from tissueid.calibration import Calibration, Quantity, write_calibration
from tissueid.calibration.file import utc_date
from tissueid.errors import LinkLostError
from tissueid.sessions import read_session, write_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

HEALTH, CALIBRATIONS, FAULTS, AUDIT = range(4)
PLACES = tuple(0.002 * k for k in range(1, 16))


def sweep(share=1.0, date="", **changes):
    figures = {
        "force_constant_n_per_a": Quantity(value=3.0 * share, std=0.015, unit="N/A"),
        "linear_region_min_m": Quantity(value=0.004, std=5e-5, unit="m"),
        "linear_region_max_m": Quantity(value=0.027, std=5e-5, unit="m"),
    }
    row = tuple(1.0 for _ in PLACES)
    tables = {
        "force_constant": {"position_m": PLACES, "value_n_per_a": tuple(3.0 * share for _ in PLACES)},
        "sweep": {"position_m": PLACES, "mass_kg": row, "damping_n_s_per_m": row, "stiffness_n_per_m": row},
    }
    fields = dict(
        kind="sweep",
        model="desktop indenter (in-process simulation)",
        serial_number="TWIN-3",
        date=date or utc_date(),
        software="t",
        verdict="passed",
        quantities=figures,
        tables=tables,
    )
    return Calibration(**(fields | changes))


def static(date="", resistance=12.0):
    figures = {
        "coil_resistance_ohm": Quantity(value=resistance, std=0.003, unit="ohm"),
        "force_constant_n_per_a": Quantity(value=3.01, std=0.001, unit="N/A"),
        "current_offset_a": Quantity(value=0.001, std=1e-4, unit="A"),
    }
    tables = {"electrical": {"voltage_v": (-1.0, 0.0, 1.0), "residual_a": (1e-3, -2e-3, 1e-3)}}
    return sweep(date=date, kind="static", quantities=figures, tables=tables)


@pytest.fixture
def page(qtbot, open_window, calibrations, audit_file):
    """Opens the window on the page, and waits until what it reads by itself is read."""

    def make(tab=HEALTH, **changes):
        around = dict(first_page="instrument", role="technician", calibrations=calibrations, audit=AuditLog(audit_file))
        window = open_window(**(around | changes))
        view = next(view for view in window.pages.views if view.name == "instrument")
        view.window_ = window
        rest(qtbot, view)
        choose(qtbot, view, tab)
        return view

    return make


def rest(qtbot, view):
    """Until the page has read what it wants to, and nothing goes on."""
    qtbot.waitUntil(
        lambda: idle(view.window_) and not view._soon.isActive() and not view._current.stale, timeout=WAIT_MS
    )


def choose(qtbot, view, tab):
    bar = view.tabs.tabBar()
    qtbot.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(tab).center())
    rest(qtbot, view)


def select(table, *rows):
    """Rows, as with Ctrl held down."""
    chosen = table.selectionModel()
    chosen.clearSelection()
    for row in rows:
        flags = QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows
        chosen.select(table.model().index(row, 0), flags)


def column(model, number):
    return [model.data(model.index(row, number)) for row in range(model.rowCount())]


# -- health ---------------------------------------------------------------------------------------------------


def test_asking_tells_who_it_is_and_lights_yellow_without_a_calibration(qtbot, page, bench):
    view = page()
    assert view.health.lamps.level == ""
    assert "not been asked" in view.health.headline.text()
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    facts = view.health.identity.facts
    assert facts["Serial number"] == "TWIN-3"
    assert facts["Temperature"] == "25.0 °C"
    assert facts["Force limit"] == "12 N clinical, 15 N research"
    assert facts["Protocol"].startswith("none")
    assert view.health.lamps.level == "check"
    assert "Not calibrated" in view.health.reasons.text()
    assert bench.opened[-1]._run is None
    assert bench.opened[-1]._command.size == 0  # nothing was ever loaded


def test_a_calibrated_instrument_is_green_and_its_force_constants_stand_over_their_dates(qtbot, page, calibrations):
    write_calibration(calibrations / "static.toml", static())
    write_calibration(calibrations / "sweep.toml", sweep())
    view = page()
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "good"
    assert view.health.lamps.accessibleName() == "Traffic light: green"
    assert view.health.state.facts["State"] == "Calibrated today, linear 4.0 to 27.0 mm"
    assert view.health.state.facts["Resistance"] == "12 Ω"
    assert view.health._static.getData()[1] == pytest.approx([3.01])
    assert view.health._sweep.getData()[1] == pytest.approx([3.0])


def test_a_cable_is_told_by_frames_and_round_trip_and_the_coil_stays_free(qtbot, page):
    opened = []

    def opener(url):
        opened.append(connect(seed=3))
        return opened[-1]

    view = page(opener=opener)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    facts = view.health.link.facts
    assert facts["Frames"].endswith(", 0 damaged")
    assert facts["Round trip"].endswith(" ms")
    assert facts["Requests repeated"] == "0"
    assert facts["Samples"].endswith(", 0 of them lost")
    link = opened[0]._link
    assert link.closed
    assert not link.firmware.energised


def test_damage_on_the_cable_is_a_reason_in_words(qtbot, page):
    def opener(url):
        instrument = connect(seed=3)
        count = iter(range(10**9))
        instrument._link.to_host = lambda data: data if next(count) % 7 else bytes(byte ^ 0x10 for byte in data)
        return instrument

    view = page(opener=opener)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "check"
    assert "frames were damaged" in view.health.reasons.text()
    assert "samples did not arrive" in view.health.reasons.text()


def test_what_does_not_answer_is_red_with_the_reason(qtbot, page):
    def opener(url):
        raise LinkLostError("no instrument answers on /dev/ttyACM7; check the cable and the power")

    view = page(opener=opener)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "poor"
    assert view.health.reasons.text().startswith("No instrument answers on /dev/ttyACM7")


def test_f5_asks_and_cancel_ends_it(qtbot, page, bench):
    held, go = threading.Event(), threading.Event()

    def opener(url):
        held.set()
        assert go.wait(WAIT_MS / 1000)
        return bench.open(url)

    view = page(opener=opener)
    view.health.ask.setFocus()
    qtbot.keyClick(view.health.ask, Qt.Key.Key_F5)
    qtbot.waitUntil(held.is_set, timeout=WAIT_MS)
    assert view.give_up.isVisible()
    assert "Asking simulated://forearm" in view.doing.text()
    assert not view.health.ask.isEnabled()
    press(qtbot, view.give_up)
    go.set()
    rest(qtbot, view)
    assert view.health.lamps.level == ""
    assert not view.give_up.isVisible()
    assert len(bench.opened) == 1


def test_closing_in_mid_work_waits_for_it_and_closes(qtbot, page, bench):
    held, go = threading.Event(), threading.Event()

    def opener(url):
        held.set()
        assert go.wait(WAIT_MS / 1000)
        return bench.open(url)

    view = page(opener=opener)
    window = view.window_
    press(qtbot, view.health.ask)
    qtbot.waitUntil(held.is_set, timeout=WAIT_MS)
    assert not window.close()
    go.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)


def test_the_newest_test_and_a_fault_of_it_are_told_without_asking(qtbot, page, tmp_path, saved):
    session = read_session(saved)
    reason = "the instrument released the coil: the coil is too hot: let it cool for some minutes"
    test = dataclasses.replace(session.tests[0], status="aborted", notes={"reason": reason})
    write_session(tmp_path / "hot.h5", dataclasses.replace(session, tests=(test,)))
    view = page()
    assert view.health.link.facts["Newest test"].endswith("aborted")
    assert view.health.link.facts["– its samples"].endswith(" lost")
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert "ended with a fault" in view.health.reasons.toolTip()


# -- calibrations ---------------------------------------------------------------------------------------------


def test_each_calibration_says_whether_it_is_in_force_or_why_not(qtbot, page, calibrations):
    write_calibration(calibrations / "a.toml", sweep())
    write_calibration(calibrations / "b.toml", sweep(date="2026-01-01T00:00:00Z"))
    write_calibration(calibrations / "c.toml", sweep(serial_number="OTHER", date="2025-12-01T00:00:00Z"))
    failed = sweep(verdict="failed", problems=("the spring slipped",), date="2025-11-01T00:00:00Z")
    write_calibration(calibrations / "d.toml", failed)
    (calibrations / "e.toml").write_bytes(b"\xff\x00 [[[")
    view = page(CALIBRATIONS)
    assert "Ask the instrument" in view.calibrations.about.text()
    choose(qtbot, view, HEALTH)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    choose(qtbot, view, CALIBRATIONS)
    model = view.calibrations.model
    assert column(model, 5) == ["a.toml", "b.toml", "c.toml", "d.toml", "e.toml"]
    force = column(model, 4)
    assert force[0] == "Yes"
    assert force[1] == "No: a newer one is"
    assert "it is of OTHER, not of TWIN-3" in force[2]
    assert "the spring slipped" in force[3]
    assert "not text" in force[4]
    select(view.calibrations.list, 4)
    assert view.calibrations.detail.currentWidget() is view.calibrations.hint
    assert "not text" in view.calibrations.hint.text()


def test_two_sweeps_are_laid_over_each_other_and_their_drift_is_said(qtbot, page, calibrations):
    write_calibration(calibrations / "new.toml", sweep(0.988))
    write_calibration(calibrations / "old.toml", sweep(date="2026-01-01T00:00:00Z"))
    write_calibration(calibrations / "older.toml", sweep(1.01, date="2025-06-01T00:00:00Z"))
    view = page(CALIBRATIONS)
    panel = view.calibrations.sweeps
    table = view.calibrations.list
    where = [table.visualRect(table.model().index(row, 0)).center() for row in range(3)]
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=where[0])
    assert "select another" in panel.words.text()
    control = Qt.KeyboardModifier.ControlModifier
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, control, QPoint(where[1]))
    assert panel.words.text() == "Force constant 1.2 % lower than on 2026-01-01, within the uncertainty of ±1.4 %."
    force = panel.cards[0]
    assert force._lines[1].getData()[0] == pytest.approx([1e3 * place for place in PLACES])
    assert force._lines[0].getData()[1] == pytest.approx([2.964] * len(PLACES))
    assert force._regions[0][0].getData()[0] == pytest.approx([4.0, 27.0])
    assert panel.cards[4]._missing.text() == "None of these sweeps holds it."
    assert column(panel.model, 1)[0] == "−1.2 %"
    assert not panel.against.isVisible()
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, control, QPoint(where[2]))
    assert panel.against.isVisible()
    panel.against.setFocus()
    qtbot.keyClick(panel.against, Qt.Key.Key_Down)
    assert "2025-06-01" in panel.words.text()
    assert "OTHER" not in panel.key.text()


def test_a_static_calibration_shows_figures_residuals_and_its_trend(qtbot, page, calibrations):
    for number, date in enumerate(("", "2026-01-01T00:00:00Z", "2025-06-01T00:00:00Z")):
        write_calibration(calibrations / f"s{number}.toml", static(date, 12.0 + 0.1 * number))
    view = page(CALIBRATIONS)
    select(view.calibrations.list, 0)
    panel = view.calibrations.statics
    assert view.calibrations.detail.currentWidget() is panel
    assert "Coil resistance" in column(panel.model, 0)
    assert column(panel.model, 1)[0] == "12.0000 ± 0.0030"
    assert panel._dots.getData()[1] == pytest.approx([1.0, -2.0, 1.0])
    assert panel.figure.currentText() == "Force constant"
    panel.figure.setFocus()
    qtbot.keyClick(panel.figure, Qt.Key.Key_Up)
    assert panel.figure.currentText() == "Coil resistance"
    assert panel._dated.getData()[1] == pytest.approx([12.2, 12.1, 12.0])
    assert "falls by" in panel.drift.text()


def test_the_way_to_a_calibration_is_a_technicians_and_begins_nothing(qtbot, page, bench):
    view = page(CALIBRATIONS, role="clinician")
    press(qtbot, view.calibrations.calibrate)
    assert view.window_.ui.page == "instrument"
    assert "role Technician" in view.window_.ui.notice.text.text()
    view.window_.ui.role.choice.setCurrentText("Technician")
    qtbot.waitUntil(lambda: idle(view.window_), timeout=WAIT_MS)
    opened = len(bench.opened)
    press(qtbot, view.calibrations.calibrate)
    assert view.window_.ui.page == "measure"
    assert "Begin static calibration" in view.window_.ui.notice.text.text()
    assert len(bench.opened) == opened


def test_a_folder_that_is_not_there_is_said(qtbot, page, tmp_path):
    view = page(CALIBRATIONS, calibrations=tmp_path / "nowhere")
    assert "nowhere" in view.window_.ui.notice.text.text()
    assert view.calibrations.model.rowCount() == 0
    assert "nominal figures" in view.calibrations.about.text()


# -- faults ---------------------------------------------------------------------------------------------------


@pytest.fixture
def mishaps(tmp_path, saved, audit_file):
    """A session with a fault that is in the log too, one that was stopped, one completed, and rubbish."""
    session = read_session(saved)
    log = AuditLog(audit_file)
    hot = "the instrument released the coil: the coil is too hot: let it cool for some minutes"
    for name, status, what, reason in (
        ("hot", "aborted", "test.fault", hot),
        ("stopped", "aborted", "test.stopped", "stopped by a key"),
        ("whole", "completed", "test.completed", ""),
    ):
        test = dataclasses.replace(session.tests[0], status=status, notes={"reason": reason} if reason else {})
        write_session(tmp_path / f"{name}.h5", dataclasses.replace(session, session_id=name, tests=(test,)))
        log.record("clinician", what, subject=f"{name} test 1", new={"samples": 10, "reason": reason})
    (tmp_path / "rubbish.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 3)
    return tmp_path


def test_faults_are_listed_once_with_what_to_do_and_their_session_is_opened(qtbot, page, mishaps):
    view = page(FAULTS)
    faults = view.faults
    assert sorted(column(faults.model, 1)) == ["Fault", "Unreadable file"]
    select(faults.list, column(faults.model, 1).index("Fault"))
    assert faults.advice.text() == "What to do: Let it cool for some minutes."
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
    assert "There is no audit log" in view.audit.count.text()
    press(qtbot, view.audit.verify)
    rest(qtbot, view)
    assert "nothing has been logged yet" in view.window_.ui.notice.text.text()
    assert view.audit.words.text() == "Not verified."
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
    audit.export_to(str(target))
    rest(qtbot, view)
    rows = list(csv.reader(target.read_text(encoding="utf-8").splitlines()))
    assert [row[4] for row in rows] == ["what", "test.begun"]
    assert rows[1][5] == "'=cmd()"  # no formula of a spreadsheet
    assert "1 lines" in view.window_.ui.notice.text.text()
    before = audit_file.read_bytes()
    audit.export_to(str(audit_file))
    rest(qtbot, view)
    assert "audit log itself" in view.window_.ui.notice.text.text()
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
    assert view.audit.words.text().startswith("Whole: 6 lines")
    assert view.audit.verdict.property("level") == "good"
    audit_file.write_bytes(audit_file.read_bytes().replace(b'"s2"', b'"x2"'))
    press(qtbot, view.audit.verify)
    rest(qtbot, view)
    assert "not as it was written. Line 4" in view.audit.words.text()
    assert view.audit.verdict.property("level") == "poor"
    press(qtbot, view.audit.again)
    rest(qtbot, view)
    assert "1 piece is no whole line" in view.audit.count.text()


def test_rubbish_in_place_of_the_log_gives_words(qtbot, page, audit_file):
    view = page(AUDIT)
    for content in (b"", b"\x00" * 300_000, b"{}\n" * 50, bytes(range(256)) * 500):
        audit_file.write_bytes(content)
        press(qtbot, view.audit.again)
        rest(qtbot, view)
        assert view.audit.model.rowCount() == 0
        press(qtbot, view.audit.verify)
        rest(qtbot, view)
        assert view.audit.words.text()
        assert view.audit.verdict.property("level") in ("check", "poor")


# -- the page as a whole --------------------------------------------------------------------------------------


def test_tab_filter_and_search_are_there_again_at_the_next_start(qtbot, page, open_window, audit_file):
    view = page(AUDIT)
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


def test_nothing_is_clipped_at_the_smallest_size(qtbot, page, calibrations, mishaps):
    for number, date in enumerate(("", "2026-01-01T00:00:00Z")):
        write_calibration(calibrations / f"w{number}.toml", sweep(date=date))
        write_calibration(calibrations / f"s{number}.toml", static(date))
    view = page()
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
    view = page()
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
    view.settle(busy=True, testing=True)
    buttons = [view.health.ask, view.calibrations.calibrate, view.calibrations.again, view.faults.again]
    buttons += [view.audit.again, view.audit.verify, view.audit.export]
    assert not any(button.isEnabled() for button in buttons)
    qtbot.keyClick(view.tabs.tabBar(), Qt.Key.Key_F5)
    assert idle(view.window_)


def test_a_hundred_thousand_lines_are_shown_in_pieces_and_filtered_at_once(qtbot, page):
    from tissueid.app.views.technician.audit_table import Read
    from tissueid.app.views.technician.log_reading import LogPage, haystack
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
