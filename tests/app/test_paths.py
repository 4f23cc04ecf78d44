"""Whole paths, one a role, by keyboard and mouse: from the page where somebody begins to the file that is left."""

import csv

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.test_window import idle, press
from app.views.research_hosts import drag
from coded import begins, made, reads
from gap_records import recorded
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtWidgets import QApplication, QFileDialog
from support import connect

from firmware_sim.identity import Identity
from tissueid.app import emergency
from tissueid.audit import AuditLog, last_lines
from tissueid.calibration import plans, read_calibration
from tissueid.gap import fit_tasks
from tissueid.instrument import SimulatedInstrument
from tissueid.instrument.twin_file import read_twin
from tissueid.sessions import read_session, write_session
from tissueid.twin import catalogue as shelf
from tissueid.twin.effects.dry_friction import EFFECT as FRICTION

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]

CONTROL = Qt.KeyboardModifier.ControlModifier


@pytest.fixture
def from_start(qtbot, open_window, audit_file):
    """Opens windows on the first page, and begins there in a role: by its card, as at every start."""

    def make(role, **changes):
        window = open_window(first_page="start", audit=AuditLog(audit_file), **changes)
        rest(qtbot, window)
        press(qtbot, window.pages.start.cards[role])
        rest(qtbot, window)
        assert window.ui.role.role == role
        return window

    return make


def rest(qtbot, window):
    """Until nothing goes on, and nothing waits to."""
    waiting = [view.refresh_timer for view in window.pages.views if hasattr(view, "refresh_timer")]
    qtbot.waitUntil(lambda: idle(window) and not any(timer.isActive() for timer in waiting), timeout=WAIT_MS)


def answer(qtbot, window, path):
    """Answer the file dialog that is open; it is Qt's own, or the system's."""
    qtbot.waitUntil(lambda: any(item.isVisible() for item in window.findChildren(QFileDialog)), timeout=WAIT_MS)
    (dialog,) = (item for item in window.findChildren(QFileDialog) if item.isVisible())
    dialog.fileSelected.emit(str(path))
    dialog.close()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    rest(qtbot, window)


def logged(audit_file):
    return [line.what for line in last_lines(audit_file, 100) if not line.what.startswith("audit.")]


# -- the clinician ----------------------------------------------------------------------------------------------------


def test_a_clinician_measures_a_site_twice_accepts_and_prints(qtbot, from_start, bench, tmp_path, audit_file):
    def open_next(_url):
        bench.opened.append(SimulatedInstrument("forearm", seed=len(bench.opened)))
        return bench.opened[-1]

    shown = []
    window = from_start("clinician", opener=open_next, show_file=lambda path: shown.append(path) or True)
    ui = window.ui
    assert ui.page == "measure"
    qtbot.keyClick(window, Qt.Key.Key_B, Qt.KeyboardModifier.AltModifier)
    assert ui.form.subject.hasFocus()
    ui.form.subject.selectAll()
    qtbot.keyClicks(ui.form.subject, "P-021")
    ui.form.fill({"seconds": 1.0})
    press(qtbot, ui.form.map)
    chart = window.clinician.body_map
    qtbot.waitUntil(lambda: chart.isVisible() and chart.isActiveWindow(), timeout=WAIT_MS)
    press(qtbot, chart.spots["left thigh"])
    press(qtbot, chart.use)
    assert ui.form.site.currentText() == "left thigh"
    window.activateWindow()  # there is no window manager here that would
    qtbot.waitUntil(ui.form.subject.hasFocus, timeout=WAIT_MS)
    qtbot.keyClick(ui.form.subject, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: window.testing, timeout=WAIT_MS)
    assert ui.stop.hasFocus()
    rest(qtbot, window)
    assert (ui.gate.headline.text(), ui.gate.property("level")) == (
        window.findings.verdict.headline,
        window.findings.verdict.level,
    )
    bar = ui.gate.repeats
    assert reads(bar.repeat.text(), "sitting.measure_again", number=2, count=5)
    assert reads(bar.accept.text(), "sitting.finish")
    press(qtbot, bar.repeat)
    assert window.testing
    rest(qtbot, window)
    assert reads(bar.accept.text(), "sitting.finish_mean", count=2)
    press(qtbot, bar.accept)
    rest(qtbot, window)
    assert reads(ui.result.summary.heading.text(), "sitting.accepted_mean", count=2)
    assert ui.result.simulated.isVisible()
    assert ui.result.pdf.hasFocus()
    qtbot.keyClick(ui.result.pdf, Qt.Key.Key_Space)
    rest(qtbot, window)
    sessions = [read_session(path) for path in sorted(tmp_path.glob("*.h5"))]
    assert {(session.subject.pseudonym, session.test().site) for session in sessions} == {("P-021", "left thigh")}
    assert len({session.test().notes["sitting"] for session in sessions}) == 1
    assert [path.suffix for path in shown] == [".pdf"]
    assert shown[0].read_bytes().startswith(b"%PDF")
    assert str(shown[0]) in ui.notice.text.text()
    said = logged(audit_file)
    assert said.count("test.completed") == 2
    assert "sitting.accepted" in said
    assert all(instrument.current_run is None for instrument in bench.opened)


# -- the researcher ---------------------------------------------------------------------------------------------------


@pytest.mark.soak
def test_a_researcher_finds_looks_identifies_compares_and_exports(qtbot, from_start, saved, tmp_path):
    before = saved.read_bytes()
    window = from_start("researcher", folder=saved.parent)
    assert window.ui.page == "research"
    view = window.ui.views["research"]
    browser, panel = view.browser, view.analysis
    qtbot.waitUntil(lambda: browser.shown.rowCount() == 1, timeout=WAIT_MS)
    rest(qtbot, window)
    qtbot.keyClick(browser.tree, Qt.Key.Key_F, CONTROL)
    qtbot.keyClicks(browser.bar.search, "calf")
    assert browser.shown.rowCount() == 1
    place = browser.tree.visualRect(browser.shown.index(0, 0)).center()
    qtbot.mouseClick(browser.tree.viewport(), Qt.MouseButton.LeftButton, pos=place)
    qtbot.waitUntil(lambda: len(view.signals.loaded) == 1, timeout=WAIT_MS)
    rest(qtbot, window)
    # Looking: a brush over one plot, and its figures.
    test = read_session(saved).test()
    drag(qtbot, view.signals.stack.cards[0], 0.5, 1.5)
    rest(qtbot, window)
    low, high = view.signals.stack.brush
    assert (low, high) == (pytest.approx(0.5, abs=0.02), pytest.approx(1.5, abs=0.02))
    table = view.signals.table
    qtbot.waitUntil(lambda: table.rowCount() == 1, timeout=WAIT_MS)
    heads = [table.horizontalHeaderItem(place).text() for place in range(table.columnCount())]
    stretch = slice(*(int(np.ceil(round(2000.0 * moment, 3))) for moment in (low, high)))
    mean, _, _ = table.item(0, heads.index("Force (N)")).text().partition(" ± ")
    assert float(mean) == pytest.approx(test.signals["force"][stretch].mean(), abs=0.1)
    # Identifying: two engines, by keyboard.
    bar = view.tabs.tabBar()
    qtbot.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(1).center())
    for engine in ("lms", "wiener"):
        choice = panel.form.engine
        choice.setFocus()
        qtbot.keyClick(choice, Qt.Key.Key_Home)
        while choice.currentData() != engine:
            qtbot.keyClick(choice, Qt.Key.Key_Down)
        panel.run.setFocus()
        qtbot.keyClick(panel.run, Qt.Key.Key_Space)
        assert window.jobs.working
        rest(qtbot, window)
    assert len(panel.results.outcomes) == 2
    # Comparing.
    panel.verdicts.take_compared(["lms", "spectral"])
    press(qtbot, panel.compare)
    rest(qtbot, window)
    assert panel.tabs.currentWidget() is panel.verdicts
    assert "Judged on" in panel.verdicts.reasons.toPlainText()
    # Exporting: the table, and the samples.
    press(qtbot, panel.save_table)
    answer(qtbot, window, tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {"lms", "wiener"} <= {row["engine"] for row in rows}
    assert all(0.06 < float(row["mass_kg"]) < 0.1 for row in rows if row["engine"] in ("lms", "wiener"))
    view.export.menu().setActiveAction(view.export.menu().actions()[0])
    qtbot.keyClick(view.export.menu(), Qt.Key.Key_Return)
    answer(qtbot, window, tmp_path)
    (data,) = tmp_path.glob("*-csv/*.csv")
    with data.open(newline="", encoding="utf-8") as file:
        force = [float(row["force (N)"]) for row in csv.DictReader(file)]
    np.testing.assert_array_equal(force, test.signals["force"])
    assert saved.read_bytes() == before


# -- the technician ---------------------------------------------------------------------------------------------------


@pytest.mark.soak
def test_a_technician_asks_calibrates_and_verifies(qtbot, from_start, calibrations, audit_file, monkeypatch):
    monkeypatch.setattr(plans, "STEPS", ("electrical", "temperature"))
    window = from_start(
        "technician",
        opener=lambda _: connect("calibration-spring", seed=3, identity=Identity(stage=True)),
        calibrations=calibrations,
    )
    assert window.ui.page == "instrument"
    view = window.ui.views["instrument"]

    def choose(tab):
        bar = view.tabs.tabBar()
        qtbot.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(view.tabs.indexOf(tab)).center())
        qtbot.waitUntil(lambda: not view.current.stale, timeout=WAIT_MS)
        rest(qtbot, window)

    choose(view.health)
    press(qtbot, view.health.ask)
    rest(qtbot, window)
    assert view.health.identity.facts["Serial number"] == "SIM-0001"
    assert "Not calibrated" in view.health.reasons.text()
    choose(view.calibrations)
    assert view.calibrations.model.rowCount() == 0
    press(qtbot, view.calibrations.calibrate)
    assert window.ui.page == "measure"
    assert "Begin static calibration" in window.ui.notice.text.text()
    page = window.ui.calibration
    assert page.isVisible()
    assert page.begin["static"].hasFocus()
    monkeypatch.setattr(emergency, "QUIET_S", 0.0)
    qtbot.keyClick(page.begin["static"], Qt.Key.Key_Space)
    assert window.testing
    assert window.ui.stop.hasFocus()
    rest(qtbot, window)
    assert reads(
        page.headline.text(),
        "calibration.headline",
        kind="Static calibration",
        verdict=made("calibration.verdict.passed"),
    )
    (path,) = calibrations.glob("*.toml")
    assert read_calibration(path).serial_number == "SIM-0001"
    qtbot.keyClick(window, Qt.Key.Key_5, CONTROL)
    assert window.ui.page == "instrument"
    choose(view.calibrations)
    model = view.calibrations.model
    assert [model.data(model.index(row, 5)) for row in range(model.rowCount())] == [path.name]
    assert model.data(model.index(0, 4)) == "Yes"
    table = view.calibrations.list
    qtbot.mouseClick(
        table.viewport(), Qt.MouseButton.LeftButton, pos=QPoint(table.visualRect(model.index(0, 0)).center())
    )
    assert view.calibrations.detail.currentWidget() is view.calibrations.statics
    choose(view.audit)
    press(qtbot, view.audit.verify)
    rest(qtbot, window)
    assert view.audit.verdict_text.text().startswith("Intact: ")
    assert view.audit.verdict.property("level") == "good"
    assert [what for what in logged(audit_file) if what.startswith("calibration.")] == [
        "calibration.begun",
        "calibration.made",
    ]


# -- the gap ----------------------------------------------------------------------------------------------------------


@pytest.mark.soak
def test_from_a_session_to_a_twin_that_is_measured(qtbot, from_start, tmp_path, audit_file, monkeypatch):
    everything = shelf.all_effects()
    few = {name: everything[name] for name in ("dry_friction", "directional_damping")}
    monkeypatch.setattr(fit_tasks, "all_effects", lambda: few)
    write_session(tmp_path / "friction.h5", recorded("dry_friction", samples=3000))
    window = from_start("researcher")
    qtbot.keyClick(window, Qt.Key.Key_4, CONTROL)
    assert window.ui.page == "gap"
    rest(qtbot, window)
    page = window.ui.views["gap"]
    assert page.asking.session.path == tmp_path / "friction.h5"
    page.asking.run.setFocus()
    qtbot.keyClick(page.asking.run, Qt.Key.Key_Return)
    assert page.asking.stop.isVisible()
    rest(qtbot, window)
    assert begins(page.result.headline.text(), "gap.explained", causes=FRICTION.title)
    press(qtbot, page.result.accept)
    answer(qtbot, window, tmp_path / "mine.toml")
    assert [item.name for item in read_twin(tmp_path / "mine.toml").effects] == ["dry_friction"]
    assert logged(audit_file)[-1] == "twin.accepted"
    assert "version 1, is saved" in window.ui.notice.text.text()
