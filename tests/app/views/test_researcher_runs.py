"""The panel of analyses: engines that are run, compared and cancelled."""

import csv
import dataclasses
import functools
import pickle
import threading

import numpy as np
import pytest
from app.benches import WAIT_MS
from app.views.research_panels import answer, choose, chosen_of, press, run, wait
from golden.golden_page import check_golden_page, lines_of_widget
from PySide6.QtCore import QPoint, Qt
from PySide6.QtWidgets import (
    QTableView,
)

from tissueid import analysis
from tissueid.app.theme import DARK, appearance
from tissueid.app.views.researcher import batch
from tissueid.app.views.researcher.engine_outcome import PICTURES, AnalysisTask
from tissueid.identification.base import PREDICTS_NOTHING
from tissueid.messages import MISSING
from tissueid.procedures.control import Control
from tissueid.sessions import read_session, write_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- running -----------------------------------------------------------------------------------------------


def test_engine_and_run_give_table_plots_and_a_line_of_history(qtbot, panel, strip, history, two):
    choose(panel, "lms")
    panel.form.field("memory").controls[1].setChecked(False)
    panel.form.field("memory").controls[0].setValue(0.06)
    run(qtbot, panel, two)
    run(qtbot, panel, two[:1], "wiener")
    assert strip.said == []
    rows = panel.results.rows()
    table = [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]
    assert [(row["engine"], row["subject"]) for row in table] == [
        ("lms", "P-001"),
        ("lms", "P-002"),
        ("wiener", "P-001"),
    ]
    for row in table:
        assert 0.07 < float(row["mass_kg"]) < 0.095
        assert float(row["mass_kg_std"]) > 0.0
        assert float(row["vaf_validation_percent"]) > 95.0
    model = panel.results.model()
    columns = range(model.columnCount())
    heads = [model.headerData(column, Qt.Orientation.Horizontal).replace("\n", " ") for column in columns]
    assert "Mass (g)" in heads
    assert "±" in model.index(0, heads.index("Mass (g)")).data()
    panels = [outcome.plots.panels for outcome in panel.results.outcomes]
    drawn = [{name for name, plot in some.items() if plot.parts} for some in panels]
    assert all({"impulse", "magnitude", "phase", "coherence"} <= some for some in drawn)
    assert {"autocorrelation", "cross"} <= drawn[0]
    assert panels[2]["autocorrelation"].missing
    assert ["nonlinearity" in some for some in drawn] == [False, False, True]
    # The same system by two engines: the same peak of the impulse response, in mm/(N s).
    peaks = [some["impulse"].curves[0].y.max() for some in panels]
    assert peaks[0] == pytest.approx(peaks[2], rel=0.2)
    # A static compliance in mm/N is one over the stiffness in N/mm.
    low = panels[2]["magnitude"].curves[0].y[0]
    assert low == pytest.approx(1e3 / float(table[2]["stiffness_n_per_m"]), rel=0.15)
    for place, name in enumerate(PICTURES):
        panel.pictures.choice.setCurrentIndex(place)
        assert panel.pictures.choice.currentText() == name
        appearance.use(DARK)
    entries, bad = history.read()
    assert ([entry.task.engines for entry in entries], bad) == ([("wiener",), ("lms",)], 0)
    assert "2 of 2 fitted" in entries[1].headline
    assert panel.past.table.rowCount() == 2
    run(qtbot, panel, two)  # once more the same: it takes the place of the first
    assert len(panel.results.outcomes) == 3


def test_selected_rows_alone_are_drawn_and_delete_takes_them_out(qtbot, panel, two):
    run(qtbot, panel, two)
    table = panel.results
    assert isinstance(table, QTableView)
    place = table.visualRect(table.model().index(1, 0)).center()
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=QPoint(place.x(), place.y()))
    assert [outcome.tests for outcome in panel.results.chosen] == [(two[1],)]
    assert "P-002" in panel.pictures.legend.text()
    assert "P-001" not in panel.pictures.legend.text()
    qtbot.keyClick(table, Qt.Key.Key_Delete)
    assert [outcome.tests for outcome in table.outcomes] == [(two[0],)]
    qtbot.keyClick(table, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert [outcome.tests for outcome in table.outcomes] == [(two[0],), (two[1],)]
    press(qtbot, panel.clear)
    assert table.outcomes == ()
    assert not panel.save_table.isEnabled()
    table.setFocus()
    qtbot.keyClick(table, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert [outcome.tests for outcome in table.outcomes] == [(two[0],), (two[1],)]
    assert panel.save_table.isEnabled()


def test_kernels_and_depth_can_be_seen(qtbot, panel, two):
    choose(panel, "volterra")
    panel.form.field("memory").controls[1].setChecked(False)
    panel.form.field("memory").controls[0].setValue(0.03)
    run(qtbot, panel, two[:1], "volterra")
    run(qtbot, panel, two[:1], "direction")
    volterra, direction = panel.results.outcomes
    (kernel,) = volterra.plots.kernels
    assert kernel.surface.unit == "mm/(N²·s²)"
    assert [curve.name for curve in direction.plots.panels["damping"].curves] == ["", "faint: on the way out"]
    magnitude = direction.plots.kernels[1].surface
    assert magnitude.unit == "mm/N"
    # Without motion the tissue is a spring: its compliance is one over the stiffness, 3 N/mm.
    assert magnitude.x[0] == 0.0
    assert np.median(magnitude.values[:, 0]) == pytest.approx(1.0 / 3.0, rel=0.25)
    assert magnitude.values[:, -1].max() < 0.05 * magnitude.values.max()
    assert 50.0 < magnitude.x[-1] < 600.0
    assert panel.pictures.kernel.choice.count() == 3
    panel.pictures.choice.setCurrentIndex(panel.pictures.choice.count() - 1)
    assert panel.pictures.kernel.canvas.axes
    assert panel.pictures.kernel.plot is kernel


def test_one_session_that_fails_costs_itself_alone(qtbot, panel, strip, tmp_path, two):
    rubbish = tmp_path / "rubbish.h5"
    rubbish.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 20)
    run(qtbot, panel, [chosen_of(rubbish), chosen_of(tmp_path / "gone.h5", "P-005"), *two])
    assert [bool(outcome.refused) for outcome in panel.results.outcomes] == [True, True, False, False]
    text, problem = strip.said[-1]
    assert problem
    assert "rubbish.h5" in text
    assert "gone.h5" in text
    assert panel.results.model().index(0, 2).data() == "refused"


def test_tests_of_a_file_are_fitted_together_where_that_is_asked_for(qtbot, panel, tmp_path, saved):
    session = read_session(saved)
    second = dataclasses.replace(session.tests[0], number=2, repeat_of=1)
    path = tmp_path / "pair.h5"
    write_session(path, dataclasses.replace(session, tests=(session.tests[0], second)))
    panel.form.together.setChecked(True)
    run(qtbot, panel, [chosen_of(path), chosen_of(path, number=2)])
    (outcome,) = panel.results.outcomes
    assert [test.number for test in outcome.tests] == [1, 2]


def test_fits_are_shown_as_they_finish(qtbot, panel, held, two):
    panel.show_tests(two)
    press(qtbot, panel.run)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    assert panel.results.outcomes == ()
    held.once()
    qtbot.waitUntil(lambda: len(panel.results.outcomes) == 1, timeout=WAIT_MS)
    assert not panel.context.jobs.idle
    held.go_on.set()
    wait(qtbot, panel)
    assert len(panel.results.outcomes) == 2


def test_cancel_ends_after_the_fit_that_runs_and_keeps_nothing_of_the_rest(qtbot, panel, strip, history, held, two):
    panel.show_tests(two)
    press(qtbot, panel.run)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    assert panel.cancelling.isVisible()
    assert not panel.run.isEnabled()
    assert not panel.folder.isEnabled()
    qtbot.waitUntil(lambda: "1 of 2" in panel.step.text(), timeout=WAIT_MS)
    press(qtbot, panel.cancelling)
    assert "Cancelling" in panel.step.text()
    held.go_on.set()
    wait(qtbot, panel)
    assert panel.results.outcomes == ()
    assert "Cancelled" in strip.said[-1][0]
    assert "cancelled" in history.read()[0][0].headline
    assert not panel.cancelling.isVisible()
    assert panel.run.isEnabled()


def test_nothing_is_run_beside_a_test_or_without_tests(qtbot, panel, two):
    assert not panel.run.isEnabled()
    panel.show_tests(two)
    assert panel.run.isEnabled()
    panel.update_enabled(busy=False, testing=True)
    for control in (panel.run, panel.compare, panel.folder, panel.save_table, panel.past.run):
        assert not control.isEnabled()
    panel.show_tests(())
    panel.update_enabled(busy=False, testing=False)
    assert not panel.run.isEnabled()
    assert panel.folder.isEnabled()


def test_a_folder_is_run_through_and_rubbish_in_it_is_told(qtbot, panel, strip, tmp_path, two):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "junk.h5").write_bytes(b"junk")
    press(qtbot, panel.folder)
    answer(qtbot, panel, tmp_path)
    assert len(panel.results.outcomes) == len(two)
    assert "junk.h5" in strip.said[-1][0]
    (tmp_path / "empty").mkdir()
    press(qtbot, panel.folder)
    answer(qtbot, panel, tmp_path / "empty")
    said, problem = strip.said[-1]
    assert problem
    assert str(tmp_path / "empty") in said


def test_a_comparison_recommends_with_reasons(qtbot, panel, two, tmp_path):
    panel.verdicts.take_compared(["lms", "spectral", "localized"])
    panel.show_tests(two[:1])
    press(qtbot, panel.compare)
    wait(qtbot, panel)
    assert panel.tabs.currentWidget() is panel.verdicts
    assert panel.verdicts.headline.text().endswith(".")
    assert "Judged on" in panel.verdicts.reasons.toPlainText()
    standings = panel.verdicts.standings
    last = [[standings.item(row, column).text() for column in (0, 1)] for row in range(standings.rowCount())]
    assert sum(verdict == "recommended" for _, verdict in last) == 1
    assert last[-1][0] == "Localized"
    press(qtbot, panel.verdicts.save)
    answer(qtbot, panel, tmp_path / "recommendation.csv")
    with (tmp_path / "recommendation.csv").open(encoding="utf-8-sig", newline="") as file:
        saved = list(csv.reader(file))
    assert [row[0] for row in saved[1 : 1 + standings.rowCount()]] == [name for name, _ in last]
    assert [panel.verdicts.headline.text()] in saved
    assert {outcome.engine for outcome in panel.results.outcomes} == {"lms", "spectral", "localized"}


def test_a_comparison_is_cancelled_between_its_engines(qtbot, panel, strip, monkeypatch, two):
    reached, go_on = threading.Event(), threading.Event()
    real = analysis.split

    def slow(*args, **options):
        reached.set()
        assert go_on.wait(WAIT_MS / 1000)
        return real(*args, **options)

    monkeypatch.setattr(analysis, "split", slow)
    panel.show_tests(two)
    press(qtbot, panel.compare)
    qtbot.waitUntil(reached.is_set, timeout=WAIT_MS)
    press(qtbot, panel.cancelling)
    go_on.set()
    wait(qtbot, panel)
    assert panel.results.outcomes == ()
    assert "Cancelled" in strip.said[-1][0]


def test_a_fit_that_predicts_nothing_is_red_and_shows_no_parameters(qtbot, panel, tmp_path, saved):
    session = read_session(saved)
    test = session.test(1)
    noise = np.random.default_rng(3).standard_normal(test.samples)
    signals = {**test.signals, "position": 0.012 + 1e-4 * noise}
    path = tmp_path / "unrelated.h5"
    write_session(path, dataclasses.replace(session, tests=(dataclasses.replace(test, signals=signals),)))
    run(qtbot, panel, [chosen_of(saved), chosen_of(path)])
    appearance.use(DARK)
    model = panel.results.model()
    heads = [model.headerData(k, Qt.Orientation.Horizontal).replace("\n", " ") for k in range(model.columnCount())]
    mass = heads.index("Mass (g)")
    good, bad = (model.index(row, 0).data(Qt.ItemDataRole.ForegroundRole) for row in range(2))
    assert (good, bad.name()) == (None, DARK.poor)
    assert "±" in model.index(0, mass).data()
    assert model.index(1, mass).data() == MISSING
    assert PREDICTS_NOTHING in model.index(1, 0).data(Qt.ItemDataRole.ToolTipRole)


def test_the_page_research_reads_as_its_golden_page(qtbot, open_window, monkeypatch, tmp_path, two):
    """Renew the page by ``python tests/golden/renew.py``."""
    monkeypatch.setenv("TISSUEID_ANALYSES", str(tmp_path / "analyses.jsonl"))
    window = open_window(first_page="research")
    view = window.ui.views["research"]
    qtbot.waitUntil(lambda: window.jobs.idle, timeout=WAIT_MS)
    before = list(lines_of_widget(view))
    view.tabs.setCurrentWidget(view.analysis)
    view.analysis.show_tests(two)
    press(qtbot, view.analysis.run)
    qtbot.waitUntil(lambda: window.jobs.idle, timeout=WAIT_MS)
    check_golden_page("window-research", [*before, *lines_of_widget(view.analysis)])


def test_the_work_of_an_analysis_and_its_result_travel_between_processes(two, history, tmp_path):
    task = AnalysisTask(engines=("lms",), tests=tuple(two[:1]))
    work = functools.partial(batch.run, task, history, "2026-03-01T10:00:00+00:00")
    work = pickle.loads(pickle.dumps(work))  # noqa: S301 - written just now
    (outcome,) = pickle.loads(pickle.dumps(work(Control()))).outcomes  # noqa: S301
    assert outcome.report.engine == "lms"
    assert not outcome.without_curves
    assert len(history.read()[0]) == 1
