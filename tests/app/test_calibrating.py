"""Calibrating from the window: the technician's page, the person who is asked, STOP, and the file that is left."""

import functools

import pytest
from app.benches import WAIT_MS, Gate
from app.test_window import idle, press
from coded import begins, made, reads, shows
from PySide6.QtCore import Qt
from support import connect

from firmware_sim.identity import Identity
from tissueid.app import emergency
from tissueid.app.calibration_controller import OperatorPrompts
from tissueid.app.calibration_page import CalibrationOutcome
from tissueid.app.emergency import BY_BUTTON, EmergencyStop
from tissueid.app.words import sentence
from tissueid.audit import AuditLog, last_lines
from tissueid.calibration import CalibratedQuantity, Calibration, plans, read_calibration
from tissueid.calibration.status import free_name
from tissueid.errors import CancelledError
from tissueid.procedures.control import BY_KEY
from tissueid.reports import calibration_page

PROBLEM, REMARK = "the spring is not the one that was named", "2.0 mm was left out"

pytestmark = [
    pytest.mark.qt_log_level_fail("WARNING"),
    pytest.mark.qt_log_ignore("This plugin does not support"),
    pytest.mark.usefixtures("long_frames"),
]


def spring(stage=True):
    """A device with the calibration spring under its probe, with a motorised stage for it or without."""
    return connect("calibration-spring", seed=3, identity=Identity(stage=stage))


@pytest.fixture
def technicians(open_window, calibrations, audit_file, monkeypatch):
    """Opens windows for technicians who are short of time: not all steps of a static calibration."""
    monkeypatch.setattr(plans, "STEPS", ("electrical", "temperature"))
    return functools.partial(open_window, role="technician", calibrations=calibrations, audit=AuditLog(audit_file))


def logged(audit_file):
    return [(line.role, line.what) for line in last_lines(audit_file, 100) if not line.what.startswith("audit.")]


def page_of(window):
    window.ui.pages.setCurrentWidget(window.ui.calibration)
    return window.ui.calibration


def test_only_a_technician_sees_the_page_and_every_change_of_role_is_logged(qtbot, open_window, audit_file):
    window = open_window(audit=AuditLog(audit_file))
    ui = window.ui
    assert ui.role.role == "clinician"
    assert not ui.pages.isTabVisible(2)
    ui.role.choice.setCurrentText("Technician")
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert ui.pages.isTabVisible(2)
    ui.role.choice.setCurrentText("Researcher")
    assert not ui.pages.isTabVisible(2)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert logged(audit_file) == [("technician", "role.changed"), ("researcher", "role.changed")]


def test_a_static_calibration_leaves_a_valid_file_a_report_and_is_in_force_afterwards(
    qtbot, technicians, calibrations, audit_file
):
    shown = []
    window = technicians(opener=lambda _: spring(), show_file=lambda path: shown.append(path) or True)
    ui = window.ui
    for_a_test = ui.guidance.instruction.text()
    page = page_of(window)
    warning = ui.guidance.instruction.text()
    assert warning != for_a_test  # never "place the probe on the skin" above a coil that is about to move a spring
    assert not ui.guidance.lamp.isVisible()
    page.room_known.setChecked(True)
    page.room.setValue(24.0)
    seen = {}

    def look(x, _):
        seen["points"] = max(seen.get("points", 0), x.size)
        seen["probe"], seen["force"] = ui.safety.contact.text(), ui.safety.force.text()
        drawn = ui.signals.curves["force"].getData()[0]
        seen["drawn"] = 0 if drawn is None else drawn.size

    page.show_curve, show = look, page.show_curve
    press(qtbot, page.begin["static"])
    assert window.testing
    assert ui.stop.hasFocus()
    assert not page.begin["sweep"].isEnabled()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    page.show_curve = show
    assert seen["points"] > 5
    assert seen["probe"].endswith("mm")
    assert seen["force"].endswith("N of 12 N")
    assert seen["drawn"] > 100
    assert ui.guidance.instruction.text() == warning
    ui.pages.setCurrentWidget(ui.running)
    assert ui.guidance.instruction.text() == for_a_test
    ui.pages.setCurrentWidget(ui.calibration)
    assert reads(
        page.headline.text(),
        "calibration.headline",
        kind="Static calibration",
        verdict=made("calibration.verdict.passed"),
    )
    (path,) = calibrations.glob("*.toml")
    calibration = read_calibration(path)
    assert calibration.kind == "static"
    assert calibration.quantities["coil_resistance_ohm"].value == pytest.approx(12.0, rel=0.01)
    assert calibration.conditions["ambient_c"] == 24.0
    assert calibration.conditions["audit_head"]
    assert page.figures.rowCount() == len(calibration.quantities)
    assert str(path) in page.said.text()
    assert reads(
        window.ui.form.instrument.calibration.text(),
        "calibration.summary.no_region",
        words=made("calibration.summary.static", age=made("age.today")),
    )
    press(qtbot, page.report)
    assert shown == [path.with_suffix(".html")]
    assert "Static calibration of" in shown[0].read_text(encoding="utf-8")
    assert logged(audit_file) == [("technician", "calibration.begun"), ("technician", "calibration.made")]


@pytest.mark.parametrize(
    "error",
    [OSError(28, "No space left on device"), pytest.param(ValueError("a figure of nothing"), marks=pytest.mark.soak)],
)
def test_a_calibration_whose_report_cannot_be_written_is_not_called_failed(
    qtbot, technicians, calibrations, audit_file, monkeypatch, error
):
    def fails(*_):
        raise error

    monkeypatch.setattr(calibration_page, "static_report", fails)
    window = technicians(opener=lambda _: spring())
    page = page_of(window)
    press(qtbot, page.begin["static"])
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert reads(
        page.headline.text(),
        "calibration.headline",
        kind="Static calibration",
        verdict=made("calibration.verdict.passed"),
    )
    assert window.ui.notice.isHidden()
    (path,) = calibrations.iterdir()
    assert read_calibration(path).verdict == "passed"
    assert shows(page.said.text(), "calibration.no_report")
    assert f"Saved in {path}." in page.said.text()
    assert not page.report.isEnabled()
    assert page.begin["static"].isEnabled()
    assert reads(
        window.ui.form.instrument.calibration.text(),
        "calibration.summary.no_region",
        words=made("calibration.summary.static", age=made("age.today")),
    )
    assert [what for _, what in logged(audit_file)] == ["calibration.begun", "calibration.made"]


def test_without_a_stage_the_person_is_asked_and_return_goes_on(qtbot, technicians, calibrations, monkeypatch):
    monkeypatch.setattr(emergency, "QUIET_S", 0.0)
    window = technicians(opener=lambda _: spring(stage=False))
    page = page_of(window)
    press(qtbot, page.begin["static"])
    asked = []
    while not idle(window):
        qtbot.waitUntil(lambda: idle(window) or page.done.isVisible(), timeout=WAIT_MS)
        if page.done.isVisible():
            asked.append(window.ui.guidance.instruction.text())
            assert page.done.hasFocus()
            qtbot.keyClick(page.done, Qt.Key.Key_Return)
            qtbot.waitUntil(lambda: idle(window) or not page.done.isVisible(), timeout=WAIT_MS)
    assert shows(asked[0], "calibration.ask.spring")
    (path,) = calibrations.glob("*.toml")
    assert str(path) in page.said.text()


@pytest.mark.parametrize("how", ["space", "button"])
def test_stop_while_the_person_is_asked(qtbot, technicians, calibrations, audit_file, how):
    window = technicians(opener=lambda _: spring(stage=False))
    page = page_of(window)
    press(qtbot, page.begin["static"])
    qtbot.waitUntil(page.done.isVisible, timeout=WAIT_MS)
    if how == "space":
        qtbot.keyClick(page.done, Qt.Key.Key_Space)  # and not the button that has the focus
    else:
        press(qtbot, window.ui.stop)
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert begins(window.ui.notice.text.text(), "stop.released", cause=BY_KEY if how == "space" else BY_BUTTON)
    assert list(calibrations.iterdir()) == []
    assert [what for _, what in logged(audit_file)] == ["calibration.begun", "calibration.stopped"]
    assert page.begin["static"].isEnabled()


def test_a_window_that_hangs_ends_a_calibration(qtbot, technicians, clock, calibrations):
    instrument = spring()
    gate = Gate(passed=20)
    poll = instrument.poll
    instrument.poll = lambda timeout_s: (gate.wait(timeout_s), poll(timeout_s))[1]
    window = technicians(opener=lambda _: instrument)
    press(qtbot, page_of(window).begin["static"])
    qtbot.waitUntil(gate.reached.is_set, timeout=WAIT_MS)
    clock.now += 1.2
    gate.opened.set()
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert reads(window.ui.notice.text.text(), "stop.no_answer")
    assert list(calibrations.iterdir()) == []
    assert not instrument.link.firmware.energised


@pytest.mark.soak
@pytest.mark.parametrize(("kind", "headline"), [("static", "Static calibration"), ("sweep", "Dynamic sweep")])
def test_both_calibrations_in_full(qtbot, open_window, calibrations, audit_file, kind, headline):
    window = open_window(
        role="technician", calibrations=calibrations, audit=AuditLog(audit_file), opener=lambda _: spring()
    )
    page = page_of(window)
    press(qtbot, page.begin[kind])
    qtbot.waitUntil(lambda: idle(window), timeout=10 * WAIT_MS)
    assert reads(
        page.headline.text(), "calibration.headline", kind=headline, verdict=made("calibration.verdict.passed")
    )
    (path,) = calibrations.glob("*.toml")
    assert read_calibration(path).verdict == "passed"
    assert path.with_suffix(".html").stat().st_size > 10_000
    assert path.with_suffix(".h5").exists() is (kind == "sweep")


def test_no_instrument_is_said(qtbot, technicians):
    window = technicians()
    window.ui.form.instrument.choice.setEditText(" ")
    press(qtbot, page_of(window).begin["sweep"])
    assert "Choose an instrument" in window.ui.notice.text.text()
    assert idle(window)


def test_a_failed_calibration_is_shown_as_one(qtbot, technicians, tmp_path):
    window = technicians()
    page = page_of(window)
    calibration = Calibration(
        kind="sweep",
        model="m",
        serial_number="s",
        date="2026-01-01T00:00:00Z",
        software="x",
        verdict="failed",
        problems=(PROBLEM,),
        quantities={"force_constant_n_per_a": CalibratedQuantity(value=2.9, std=0.01, unit="N/A")},
    )
    page.show_outcome(CalibrationOutcome(calibration, tmp_path / "c.toml", tmp_path / "c.html", (REMARK,)))
    assert page.headline.text().startswith("Dynamic sweep failed")
    assert page.headline.property("level") == "poor"
    assert f"{sentence(PROBLEM)}\n{sentence(REMARK)}" in page.said.text()
    assert [page.figures.item(0, column).text() for column in range(3)][1] == "2.900 ± 0.010"


def test_a_question_ends_with_the_answer_or_with_stop():
    stop = EmergencyStop()
    prompts = OperatorPrompts(stop)
    stop.press("stopped by key")
    with pytest.raises(CancelledError):
        prompts.ask("Do something.")
    assert prompts.cancelled()
    assert prompts.snapshot().instruction == ""


def test_files_of_calibrations_are_never_written_over(tmp_path):
    from datetime import datetime

    moment = datetime(2026, 3, 4, 5, 6, 7)
    first = free_name(tmp_path, "../TWIN 0", "static", moment)
    assert first == tmp_path / "TWIN-0-static-2026-03-04_05-06-07.toml"
    first.with_suffix(".html").touch()
    assert free_name(tmp_path, "../TWIN 0", "static", moment).name == "TWIN-0-static-2026-03-04_05-06-07_2.toml"


@pytest.mark.soak
def test_the_figures_and_the_verdict_of_a_calibration_are_said_in_german(qtbot, technicians):
    window = technicians(language="de", opener=lambda _: spring())
    page = page_of(window)
    press(qtbot, page.begin["static"])
    qtbot.waitUntil(lambda: idle(window), timeout=WAIT_MS)
    assert reads(
        page.headline.text(),
        "calibration.headline",
        kind="Static calibration",
        verdict=made("calibration.verdict.passed"),
    )
    labels = {page.figures.item(row, 0).text() for row in range(page.figures.rowCount())}
    assert "Nullpunkt des Stromkanals" in labels
