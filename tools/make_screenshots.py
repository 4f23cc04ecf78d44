"""Take the pictures of docs/images from the real window: run with the environment's Python, no display needed.

Instruments and subjects are simulated and all dates are fixed, so that every run gives the same pictures.
"""

from __future__ import annotations

import functools
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from PySide6.QtCore import QItemSelectionModel, QSettings
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication, QDialog, QLabel
from screenshot_scene import (
    LONGEST_S,
    SetClock,
    process_events_for,
    set_clock,
    take,
    use_relative_folders,
    use_set_clock,
    wait_until,
)
from screenshot_sessions import (
    FOREARM,
    SPRING,
    PausableWait,
    opener,
    record_laboratory,
    record_past,
    record_study,
    write_calibrations,
)

from tissueid.app.context import AppServices
from tissueid.app.emergency import EmergencyStop
from tissueid.app.main_window import MainWindow
from tissueid.app.stimulus_form import FROM_FILE, MULTISTEP
from tissueid.app.views.gap.view import GapView
from tissueid.app.views.researcher.view import ResearchView
from tissueid.app.views.studies.view import StudiesView
from tissueid.app.views.technician.view import InstrumentView
from tissueid.audit import AuditLog
from tissueid.calibration import activate_calibration
from tissueid.instrument import FoundInstrument

SIZE, WIDE = (1280, 800), (1440, 900)
"""Of the window; help is shown next to a page only if both fit."""
HELD_AT_POLL = 430
"""Poll at which the running test is paused for its picture, after a little more than half of its stimulus."""


def main() -> None:
    """Take all pictures, page by page, or those of the page ``studies`` alone if that is the argument."""
    application = QApplication([])
    application.setStyle("Fusion")
    with tempfile.TemporaryDirectory() as folder:
        before = Path.cwd()
        use_relative_folders(Path(folder))
        use_set_clock()
        try:
            _take_all(application)
        finally:
            os.chdir(before)


def _take_all(application: QApplication) -> None:
    sessions, audit = Path("Documents/TissueID"), AuditLog(Path("data/audit.jsonl"))
    calibrations = write_calibrations(Path("calibrations"))
    calibrate = functools.partial(activate_calibration, folder=calibrations)
    record_past(sessions, audit, calibrate)
    record_laboratory(sessions / "2026-01-12_bearing.h5")
    set_clock()
    pace = PausableWait(HELD_AT_POLL)
    services = AppServices(
        opener=opener,
        finder=_found,
        calibrate=calibrate,
        calibrations=calibrations,
        audit=audit,
        folder=sessions,
        language="en",
        wait=pace.wait,
        separate_process=False,
        now=SetClock.now,
        show_file=lambda _: True,
        stop=lambda: EmergencyStop(disk_timeout_s=LONGEST_S),  # a busy machine must not end the run
        settings=lambda: QSettings("config/window.ini", QSettings.Format.IniFormat),
    )
    window = MainWindow(services)
    window.resize(*SIZE)
    window.show()
    idle = functools.partial(wait_until, lambda: window.jobs.idle, "work to end")
    process_events_for(300)
    idle()
    if sys.argv[1:] != ["studies"]:
        take_start(window, idle)
        take_measure(window, pace, idle)
        take_repeats(window, idle)
        take_dark(window, application)
        take_research(window, idle)
        take_gap(window, sessions, idle)
        take_instrument(window, idle)
        take_stimuli(window, idle)
    pace.left = 0  # holds no test
    take_studies(window, idle)
    window.close()
    wait_until(lambda: not window.isVisible(), "the window to close")


def take_start(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take the first page, after all instruments were queried."""
    window.pages.show("start")
    idle()
    window.device_search.find_instruments()
    idle()
    process_events_for(100)
    idle()
    window.ui.notice.hide()
    _without_folder(window)
    take(window, "window-start")


def take_measure(window: MainWindow, pace: PausableWait, idle: Callable[[], None]) -> None:
    """Take a test: before, on the body map, during, after."""
    ui = window.ui
    window.pages.show("measure")
    ui.form.subject.setText("P-001")
    take(window, "window-before")
    ui.form.site.setCurrentText("left forearm, posterior")
    window.clinician.open_map()
    process_events_for(100)
    take(_dialog(window), "window-body-map")
    _dialog(window).close()
    window.activateWindow()
    ui.start.click()
    wait_until(pace.held.is_set, "the test to come to where it is held")
    take(window, "window-during")
    pace.go_on.set()
    wait_until(lambda: window.findings is not None and window.jobs.idle, "what was found in the test")
    idle()
    take(window, "window")


def take_repeats(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take two further repeats, their mean, and the comparison with other sittings of the subject."""
    for minutes in (2, 4):
        set_clock(0, minutes)
        window.ui.gate.repeats.repeat.click()
        wait_until(lambda: bool(window.jobs), "the repeat to begin")
        idle()
    take(window, "window-repeats")
    window.resize(*WIDE)
    window.panels.help_button.click()
    window.panels.log_button.click()
    process_events_for(100)
    take(window, "window-help")
    window.panels.help_button.click()
    window.panels.log_button.click()
    window.resize(*SIZE)


def take_stimuli(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take the result of a feedback test, of a test in steps and of a test of a waveform file."""
    wave = Path("Documents/wave.csv")
    seconds = np.arange(6000) / 2000.0
    np.savetxt(wave, np.column_stack([seconds, 4.0 + 2.5 * np.sin(6.0 * seconds**2)]), delimiter=",")
    depths = {"depth_min_m": 2e-3, "depth_max_m": 4e-3}
    choices = (
        ("rtig", "rtig", depths),
        ("multistep", MULTISTEP, {"steps": 2, "target": 0.001} | depths),
        ("waveform", FROM_FILE, {}),
    )
    form = window.ui.form
    window.pages.show("measure")
    for place, (name, kind, options) in enumerate(choices):
        set_clock(1, 10 * place)
        form.site.setCurrentText("left forearm, posterior")
        form.fold.setChecked(True)
        form.stimulus.fill(kind, options)
        if kind == FROM_FILE:
            form.stimulus.file.setText(str(wave))
        window.ui.start.click()
        wait_until(lambda: bool(window.jobs), "the test to begin")
        idle()
        take(window, f"window-{name}")


def take_studies(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take the tests and a figure of a study, and a sitting that goes on."""
    folder = Path("Documents/lotion-study")
    record_study(folder)
    set_clock(2)
    window.pages.show("studies")
    page = window.ui.views["studies"]
    assert isinstance(page, StudiesView)
    page.open_study(folder)
    idle()
    page.analyse()
    idle()
    window.ui.notice.hide()
    take(window, "window-studies")
    page.compute_figures()
    idle()
    page.figures.kind.setCurrentIndex(0)
    page.figures.parameter.setCurrentIndex(page.figures.parameter.findData("scaled_mass_s2"))
    take(window, "window-study-figure")
    window.context.begin_sitting(folder, "P-005")
    idle()
    if window.study.dialog is not None:
        window.study.dialog.reject()
    window.ui.notice.hide()
    window.ui.start.click()
    wait_until(lambda: bool(window.jobs), "the test to begin")
    idle()
    take(window, "window-sitting")


def take_dark(window: MainWindow, application: QApplication) -> None:
    """Take the same in dark colours."""
    light = application.palette()
    dark = QPalette(QColor("#232a2f"), QColor("#1b2024"))
    dark.setColor(QPalette.ColorRole.WindowText, QColor("#e6eaec"))
    application.setPalette(dark)
    take(window, "window-dark")
    application.setPalette(light)
    process_events_for(200)


def take_research(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take the signals of two tests, the fit of an engine, and the comparison of engines."""
    window.pages.show("research")
    page = window.ui.views["research"]
    assert isinstance(page, ResearchView)
    process_events_for(300)
    idle()
    process_events_for(300)
    rows = page.browser.shown
    picked = page.browser.tree.selectionModel()
    flags = QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows
    for row in (0, 6):
        picked.select(rows.index(row, 0), flags)
    process_events_for(500)
    idle()
    process_events_for(300)
    idle()
    take(window, "research-signals")
    page.tabs.setCurrentWidget(page.analysis)
    analysis = page.analysis
    for engine in ("wiener", "lms"):
        analysis.form.choose(engine)
        analysis.run.click()
        idle()
    take(window, "research-analysis")
    analysis.verdicts.take_compared(("lms", "wiener", "dpn"))
    analysis.compare.click()
    idle()
    take(window, "research-recommendation")


def take_gap(window: MainWindow, sessions: Path, idle: Callable[[], None]) -> None:
    """Take one diagnosis, tab by tab."""
    window.pages.show("gap")
    page = window.ui.views["gap"]
    assert isinstance(page, GapView)
    page.asking.take(sessions / "2026-01-12_bearing.h5")
    page.asking.run.click()
    wait_until(lambda: window.jobs.working, "the diagnosis to begin")
    idle()
    for number, name in enumerate(("where", "which")):
        page.result.tabs.setCurrentIndex(number)
        take(window, f"gap-{name}")


def take_instrument(window: MainWindow, idle: Callable[[], None]) -> None:
    """Take the four tabs, and the one for the calibration of a coil."""
    ui = window.ui
    ui.role.choice.setCurrentIndex(ui.role.choice.findData("technician"))
    idle()
    window.pages.show("instrument")
    page = ui.views["instrument"]
    assert isinstance(page, InstrumentView)
    process_events_for(200)
    idle()
    page.health.ask.click()
    idle()
    ui.notice.hide()
    take(window, "instrument-health")
    for number, name in enumerate(("calibrations", "faults", "audit"), 1):
        page.tabs.setCurrentIndex(number)
        process_events_for(100)
        idle()
        if name == "calibrations":
            kinds = [row.item.calibration.kind for row in page.calibrations.model.rows]
            chosen = page.calibrations.list.selectionModel()
            flags = QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows
            for row in [place for place, kind in enumerate(kinds) if kind == "sweep"][:3]:
                chosen.select(page.calibrations.model.index(row, 0), flags)
        if name == "faults":
            page.faults.kind.setCurrentIndex(1)
            kinds = [event.kind for event in page.faults.model.rows]
            page.faults.list.selectRow(kinds.index("Stopped"))
        if name == "audit":
            page.audit.verify.click()
            idle()
        take(window, f"instrument-{name}")
    window.pages.show("measure")
    ui.pages.setCurrentWidget(ui.calibration)
    take(window, "window-calibration")


def _found(**_: object) -> list[FoundInstrument]:
    return [FoundInstrument(url, "simulation in this process", True) for url in (FOREARM, SPRING)]


def _without_folder(window: MainWindow) -> None:
    """Remove the folder of the pictures from displayed absolute paths."""
    here = f"{Path.cwd()}/"
    for label in window.ui.views["start"].findChildren(QLabel):
        label.setText(label.text().replace(here, ""))


def _dialog(window: MainWindow) -> QDialog:
    return next(found for found in window.findChildren(QDialog) if found.isVisible())


if __name__ == "__main__":
    main()
