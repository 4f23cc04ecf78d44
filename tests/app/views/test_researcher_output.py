"""Measured against simulated output, and names that tell results and tests apart."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from app.views.research_panels import run
from PySide6.QtWidgets import QComboBox

from tissueid.analysis import analyse
from tissueid.analysis.curves.validation import output_plots
from tissueid.app.views.researcher.engine_outcome import OUTPUT, EngineOutcome, keys_of
from tissueid.app.views.researcher.pictures import in_the_middle
from tissueid.app.views.researcher.plot_stack import Channel, LoadedTest, RecordedSignal
from tissueid.app.views.researcher.selected_test import SelectedTest, distinguishing_labels, short_label, timestamp_of
from tissueid.app.views.researcher.signals import StatisticsTable
from tissueid.identification.validation import vaf_percent
from tissueid.sessions import read_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def one(path="a.h5", number=1, subject="P-1", site="calf", when=1.7e9):
    return SelectedTest(Path("/x") / path, number, site, subject, "label", when)


@pytest.mark.parametrize(("engine", "scheduled"), [("lms", False), ("wiener", False), ("depth", True), ("als", True)])
def test_output_and_residual_are_those_behind_the_score_on_held_out_data(saved, engine, scheduled):
    analysis = analyse(read_session(saved), engine)
    upper, lower = output_plots(analysis)
    measured, output, *others = upper.curves
    residual = lower.curves[0]
    held_out = analysis.held_out_record[analysis.held_out]
    np.testing.assert_allclose(measured.y, 1e3 * held_out.output)
    np.testing.assert_allclose(
        output.y, 1e3 * analysis.model.simulate(analysis.held_out_record.input)[analysis.held_out]
    )
    np.testing.assert_allclose(residual.y, measured.y - output.y, atol=1e-9)
    assert measured.x[0] == pytest.approx(analysis.held_out.start / 2000.0)
    report = analysis.model.report
    assert vaf_percent(measured.y, output.y) == pytest.approx(report.vaf_validation_percent, abs=0.5)
    assert bool(others) == scheduled == (report.vaf_scheduled_percent is not None)
    if scheduled:
        assert vaf_percent(measured.y, others[0].y) == pytest.approx(report.vaf_scheduled_percent, abs=0.5)


def test_fits_of_one_test_lie_over_one_measurement_with_their_scores(qtbot, panel, two):
    run(qtbot, panel, two[:1])
    run(qtbot, panel, two[:1], "depth")
    pictures = panel.pictures
    pictures.choice.setCurrentText(OUTPUT)
    colours = [curve.colour for curve in pictures.plots.plots[0].curves]
    assert colours == ["muted", "measured", "model", "model"]  # the measurement, LMS, and both runs of the depth engine
    common, labels = pictures.keys()
    assert "P-001" in common
    assert [label.split(":")[0] for label in labels] == ["LMS", "Depth"]
    report = panel.results.outcomes[1].report
    assert f"VAF {report.vaf_validation_percent:.1f} %" in labels[1]
    assert f"{report.vaf_scheduled_percent:.1f} %)" in labels[1]
    run(qtbot, panel, two[1:])
    under = [curve.colour for curve in pictures.plots.plots[0].curves if curve.width > 1.0]
    assert under == ["measured", "model", "good"]  # each test has a measurement of its own


def test_the_legend_uses_the_room_there_is_and_never_cuts_a_score(qtbot, panel, two):
    long = [dataclasses.replace(test, site="a very long name of a site " * 2 + test.pseudonym) for test in two]
    run(qtbot, panel, long)
    pictures = panel.pictures
    pictures.choice.setCurrentText(OUTPUT)
    pictures.resize(1600, 400)
    assert "…" not in pictures.legend.text()
    pictures.resize(300, 400)
    assert "…" in pictures.legend.text()
    for outcome in panel.results.outcomes:
        assert f"VAF&nbsp;{outcome.report.vaf_validation_percent:.1f}&nbsp;%" in pictures.legend.text()


def test_a_closer_look_is_taken_back(qtbot, panel, two):
    run(qtbot, panel, two[:1])
    pictures = panel.pictures
    pictures.choice.setCurrentText(OUTPUT)
    upper, lower = pictures.plots.axes
    whole = upper.get_xlim()
    pictures.plots.zoom(0.5)
    assert lower.get_xlim()[1] < whole[1]
    run(qtbot, panel, two[:1], "wiener")
    assert pictures.plots.axes[0].get_xlim() == pytest.approx(whole, abs=0.05)


def test_an_old_range_does_not_stay_where_one_point_is_left(qtbot, panel, two):
    run(qtbot, panel, two[:1], "depth")
    pictures = panel.pictures
    pictures.choice.setCurrentText("Against depth")
    panel._remove(list(panel.results.outcomes))
    run(qtbot, panel, two[:1])
    (stiffness,) = panel.results.outcomes[0].plots.panels["stiffness"].curves[0].y
    low, high = pictures.plots.axes[2].get_ylim()
    assert low < stiffness < high


def test_a_long_name_of_a_kernel_does_not_widen_the_page(panel):
    choice = panel.pictures.kernel.choice
    before = choice.minimumSizeHint().width(), choice.sizeHint().width()
    choice.addItem("x" * 200)
    assert (choice.minimumSizeHint().width(), choice.sizeHint().width()) == before
    assert choice.sizeAdjustPolicy() == QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon


# -- names -------------------------------------------------------------------------------------------------


def test_a_label_has_what_differs_and_the_rest_is_said_once():
    tests = [one(), one("b.h5", when=1.7e9 + 60)]
    common, labels = distinguishing_labels([[test] for test in tests])
    assert common == "P-1, calf, #1"
    assert [label[-5:] for label in labels] == [short_label(test)[14:19] for test in tests]
    common, labels = distinguishing_labels([[one(subject="P-1")], [one("b.h5", subject="P-2")]])
    assert labels == ["P-1", "P-2"]
    assert "calf" in common


def test_where_nothing_else_differs_file_and_folder_do():
    assert distinguishing_labels([[one("a.h5")], [one("b.h5")]])[1] == ["a", "b"]
    twin = dataclasses.replace(one(), path=Path("/y/a.h5"))
    assert distinguishing_labels([[one()], [twin]])[1] == ["a, /x", "a, /y"]


def test_one_test_has_its_whole_name_and_a_nameless_one_that_of_its_file():
    (label,) = distinguishing_labels([[one(number=3)]])[1]
    assert label.startswith("P-1, calf, 20")
    assert label.endswith("#3")
    assert distinguishing_labels([])[1] == []
    assert short_label(one(when=None)) == "label"
    assert short_label(one(when=1e300)) == "label"


def test_results_of_one_test_are_told_apart_by_engine_and_of_one_engine_by_test():
    def outcome(engine, test):
        return EngineOutcome(engine, {}, (test,), ("force", "position"))

    assert keys_of([outcome("lms", one()), outcome("wiener", one())])[1] == ["LMS", "Wiener"]
    common, labels = keys_of([outcome("lms", one()), outcome("lms", one("b.h5", site="thigh"))])
    assert common.startswith("LMS, P-1")
    assert labels == ["calf", "thigh"]
    assert keys_of([outcome("lms", one())])[1][0].startswith("LMS, P-1, calf")
    assert keys_of([]) == ("", [])


def test_long_names_are_cut_in_their_middle():
    assert in_the_middle("a" * 30 + "b" * 30, 11) == "aaaaa…bbbbb"
    assert in_the_middle("short", 11) == "short"


def test_dates_of_files_are_read_or_passed_over():
    assert timestamp_of("2026-01-01T00:00:00Z") == timestamp_of("2026-01-01T00:00:00") == 1767225600.0
    assert timestamp_of("yesterday") is None


def test_the_table_of_signals_gives_names_the_room_that_figures_leave(qtbot):
    table = StatisticsTable()
    qtbot.addWidget(table)
    table.resize(700, 200)
    table.show()
    channel = Channel("position", "m")
    track = RecordedSignal(np.sin(np.arange(4000.0)), 2000.0)
    tests = [one(f"{'long' * 10}{place}.h5", when=None) for place in range(2)]
    table.show_stretch([LoadedTest(test, 0.0, {channel: track}) for test in tests], [channel], 0.0, 1.0)
    assert [table.item(row, 0).text()[-1] for row in range(2)] == ["0", "1"]
    assert table.columnWidth(0) > 250
    assert not table.horizontalScrollBar().isVisible()
