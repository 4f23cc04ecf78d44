"""The technician's page: health of an instrument, and its calibrations."""

import dataclasses
import threading

import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from app.views.technician_pages import CALIBRATIONS, HEALTH, PLACES, choose, column, rest, select, static, sweep
from coded import begins, made, reads, shows
from golden.golden_page import check_golden_page, lines_of_widget
from PySide6.QtCore import QPoint, Qt
from support import connect

from tissueid.app.emergency import BY_BUTTON, BY_CLOSING
from tissueid.app.views.technician.log_tabs import gather
from tissueid.calibration import write_calibration
from tissueid.cli.stop_key import BY_KEY
from tissueid.errors import LinkLostError
from tissueid.messages import Message
from tissueid.sessions import read_session, write_session
from tissueid.sessions.model import reason_notes

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- health ---------------------------------------------------------------------------------------------------


def test_asking_tells_who_it_is_and_lights_yellow_without_a_calibration(qtbot, page, bench):
    view = page()
    assert view.health.lamps.level == ""
    assert view.health.headline.text() == "Not checked yet"
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    facts = view.health.identity.facts
    assert facts["Serial number"] == "TWIN-3"
    assert facts["Temperature"] == "25.0 °C"
    assert facts["Force limit"] == "12 N clinical, 15 N research"
    assert facts["Protocol"].startswith("none")
    assert view.health.lamps.level == "check"
    assert "Not calibrated" in view.health.reasons.text()
    assert bench.opened[-1].current_run is None
    assert bench.opened[-1].state.command_v.size == 0  # nothing was ever loaded


def test_a_calibrated_instrument_is_green_and_its_force_constants_stand_over_their_dates(qtbot, page, calibrations):
    write_calibration(calibrations / "static.toml", static())
    write_calibration(calibrations / "sweep.toml", sweep())
    view = page()
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "good"
    assert view.health.lamps.accessibleName() == "Traffic light: green"
    assert reads(
        view.health.state.facts["State"],
        "calibration.summary.linear",
        words=made("calibration.summary.static", age=made("age.today")),
        low=4.0,
        high="27.0 mm",
    )
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
    link = opened[0].link
    assert link.closed
    assert not link.firmware.energised


def test_damage_on_the_cable_is_a_reason_in_words(qtbot, page):
    def opener(url):
        instrument = connect(seed=3)
        count = iter(range(10**9))
        instrument.link.to_host = lambda data: data if next(count) % 7 else bytes(byte ^ 0x10 for byte in data)
        return instrument

    view = page(opener=opener)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "check"
    assert "frames were damaged" in view.health.reasons.text()
    assert shows(view.health.reasons.text(), "checkup.lost")


def test_what_does_not_answer_is_red_with_the_reason(qtbot, page):
    def opener(url):
        raise LinkLostError(made("link.no_instrument", port="/dev/ttyACM7"))

    view = page(opener=opener)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert view.health.lamps.level == "poor"
    assert begins(view.health.reasons.text(), "link.no_instrument", port="/dev/ttyACM7")


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

    view = page(opener=opener, whole=True)
    window = view.window_
    press(qtbot, view.health.ask)
    qtbot.waitUntil(held.is_set, timeout=WAIT_MS)
    assert not window.close()
    go.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)


def test_the_newest_test_and_a_fault_of_it_are_told_without_asking(qtbot, page, tmp_path, saved):
    session = read_session(saved)
    hot = Message("fault.over_temperature", "the coil is too hot: let it cool for some minutes")
    hot = Message("instrument.released", "the instrument released the coil: {fault}", fault=hot)
    test = dataclasses.replace(session.tests[0], status="aborted", notes=reason_notes(hot))
    write_session(tmp_path / "hot.h5", dataclasses.replace(session, tests=(test,)))
    view = page()
    assert view.health.link.facts["Newest test"].endswith("aborted")
    assert view.health.link.facts["– its samples"].endswith(" lost")
    instrument = f"{session.instrument.model}, {session.instrument.serial_number}"
    assert view.health.link.facts["– its instrument"] == instrument
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    assert "ended with a fault" in view.health.reasons.toolTip()
    asked = view.health.checkup.nominal
    assert (asked.model, asked.serial_number) != (session.instrument.model, session.instrument.serial_number)
    assert view.health.link.facts["– its instrument"] == f"another one: {instrument}"


@pytest.mark.parametrize(
    ("reason", "kind", "level"),
    [
        (BY_KEY, "Stopped", ""),
        (BY_BUTTON, "Stopped", ""),
        (BY_CLOSING, "Interrupted", "check"),
    ],
)
def test_a_stop_by_a_person_is_no_fault_where_only_the_session_tells_of_it(tmp_path, saved, reason, kind, level):
    session = read_session(saved)
    notes = reason_notes(Message("stop.released", "{cause}; the coil is released", cause=reason))
    test = dataclasses.replace(session.tests[0], status="aborted", notes=notes)
    folder = tmp_path / "stopped"
    folder.mkdir()
    write_session(folder / "stopped.h5", dataclasses.replace(session, tests=(test,)))
    (event,) = gather(folder, tmp_path / "no.log", lambda: None).entries
    assert (event.kind, event.level) == (kind, level)


# -- calibrations ---------------------------------------------------------------------------------------------


def test_each_calibration_says_whether_it_is_in_force_or_why_not(qtbot, page, calibrations):
    write_calibration(calibrations / "a.toml", sweep())
    write_calibration(calibrations / "b.toml", sweep(date="2026-01-01T00:00:00Z"))
    write_calibration(calibrations / "c.toml", sweep(serial_number="OTHER", date="2025-12-01T00:00:00Z"))
    failed = sweep(verdict="failed", problems=("the spring slipped",), date="2025-11-01T00:00:00Z")
    write_calibration(calibrations / "d.toml", failed)
    (calibrations / "e.toml").write_bytes(b"\xff\x00 [[[")
    view = page(CALIBRATIONS)
    assert "under Health" in view.calibrations.about.text()
    choose(qtbot, view, HEALTH)
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    choose(qtbot, view, CALIBRATIONS)
    model = view.calibrations.model
    assert column(model, 5) == ["a.toml", "b.toml", "c.toml", "d.toml", "e.toml"]
    force = column(model, 4)
    assert force[0] == "Yes"
    assert reads(force[1], "calibrations.superseded")
    assert shows(force[2], "calibration.other_device", found="OTHER", expected="TWIN-3")
    assert "the spring slipped" in force[3]
    assert "not a text file" in force[4]
    select(view.calibrations.list, 4)
    assert view.calibrations.detail.currentWidget() is view.calibrations.hint
    assert "not a text file" in view.calibrations.hint.text()


def test_two_sweeps_are_laid_over_each_other_and_their_drift_is_said(qtbot, page, calibrations):
    write_calibration(calibrations / "new.toml", sweep(0.988))
    write_calibration(calibrations / "old.toml", sweep(date="2026-01-01T00:00:00Z"))
    write_calibration(calibrations / "older.toml", sweep(1.01, date="2025-06-01T00:00:00Z"))
    view = page(CALIBRATIONS)
    panel = view.calibrations.sweeps
    table = view.calibrations.list
    where = [table.visualRect(table.model().index(row, 0)).center() for row in range(3)]
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=where[0])
    assert "select another" in panel.headline.text()
    control = Qt.KeyboardModifier.ControlModifier
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, control, QPoint(where[1]))
    assert reads(
        panel.headline.text(),
        "drift.lower",
        quantity="Force constant",
        difference="1.2 %",
        date="2026-01-01",
        significance=made("drift.uncertainty", uncertainty="1.4 %"),
    )
    (force,) = panel.cards["force_constant"].plots
    older, newest = (
        curve
        for colour in ("model", "measured")
        for curve in force.curves
        if curve.colour == colour and curve.kind == "line"
    )
    assert older.x == pytest.approx([1e3 * place for place in PLACES])
    assert newest.y == pytest.approx([2.964] * len(PLACES))
    assert force.curves[0].x == pytest.approx([4.0, 27.0])
    assert panel.cards["vaf"].plots[0].missing.code == "plot.no_profile"
    assert column(panel.model, 1)[0] == "−1.2 %"
    assert not panel.against.isVisible()
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, control, QPoint(where[2]))
    assert panel.against.isVisible()
    panel.against.setFocus()
    qtbot.keyClick(panel.against, Qt.Key.Key_Down)
    assert "2025-06-01" in panel.headline.text()
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
    assert panel.off.plots[0].curves[0].y == pytest.approx([1.0, -2.0, 1.0])
    assert panel.figure.currentText() == "Force constant"
    panel.figure.setFocus()
    qtbot.keyClick(panel.figure, Qt.Key.Key_Up)
    assert panel.figure.currentText() == "Coil resistance"
    assert panel.over_dates.plots[0].curves[0].y == pytest.approx([12.2, 12.1, 12.0])
    assert "falls by" in panel.drift.text()


def test_the_way_to_a_calibration_is_a_technicians_and_begins_nothing(qtbot, page, bench):
    view = page(CALIBRATIONS, role="clinician", whole=True)
    press(qtbot, view.calibrations.calibrate)
    assert view.window_.ui.page == "instrument"
    assert "role Technician" in view.window_.ui.notice.text.text()
    view.window_.ui.role.choice.setCurrentText("Technician")
    assert view.window_.ui.notice.isHidden()
    qtbot.waitUntil(lambda: idle(view.window_), timeout=WAIT_MS)
    opened = len(bench.opened)
    press(qtbot, view.calibrations.calibrate)
    assert view.window_.ui.page == "measure"
    assert "Begin static calibration" in view.window_.ui.notice.text.text()
    assert len(bench.opened) == opened


def test_a_folder_that_is_not_there_is_said(qtbot, page, tmp_path):
    view = page(CALIBRATIONS, calibrations=tmp_path / "nowhere")
    assert "nowhere" in view.window_.said[-1]
    assert view.calibrations.model.rowCount() == 0
    assert view.calibrations.about.text() == view.context.unread


def test_the_page_instrument_reads_as_its_golden_page(qtbot, page, calibrations):
    """Renew the page by ``python tests/golden/renew.py``."""
    write_calibration(calibrations / "static.toml", static())
    write_calibration(calibrations / "sweep.toml", sweep())
    view = page()
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    lines = list(lines_of_widget(view))
    for tab in range(1, view.tabs.count()):
        choose(qtbot, view, tab)
        lines += lines_of_widget(view.tabs.currentWidget())
    check_golden_page("window-instrument", lines)


def test_calibrations_are_judged_for_the_chosen_instrument_and_one_just_made_is_an_answer(qtbot, page, calibrations):
    write_calibration(calibrations / "a.toml", sweep())
    view = page(HEALTH, whole=True)
    window, tab = view.window_, view.calibrations
    press(qtbot, view.health.ask)
    rest(qtbot, view)
    choose(qtbot, view, CALIBRATIONS)
    assert view.health.checkup is not None
    nominal = view.health.checkup.nominal
    chooser = window.ui.form.instrument
    assert chooser.calibration_of(chooser.url).level == "good"  # Measure and Start know what was answered here
    active = [tab.model.data(tab.model.index(0, 4))]
    other = next(url for url in window.ui.form.instrument.states if url != window.ui.form.instrument.url)
    window.pages.start.instrument_chosen.emit(other)
    window.pages.show("start")
    window.pages.show("instrument")
    rest(qtbot, view)
    assert view.health.checkup is None
    assert view.health.light.level == ""
    assert "Health" in tab.about.text()
    window.state.instrument_answered.emit(other, nominal)
    rest(qtbot, view)
    assert nominal.serial_number in tab.about.text()
    assert [tab.model.data(tab.model.index(0, 4))] == active
