"""The panel of analyses: its form, its history, what it keeps and saves."""

import csv
import dataclasses
import json
from itertools import pairwise

import pytest
from app.benches import WAIT_MS
from app.views.research_panels import answer, choose, press, run, wait
from coded import begins, coded
from PySide6.QtCore import QByteArray, QCoreApplication, QPoint, Qt
from PySide6.QtGui import QImage
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QComboBox,
    QLineEdit,
    QTableView,
)

from tissueid.app.views.researcher.analysis import STATE
from tissueid.app.views.researcher.engine_outcome import Preparation, read_results, write_results
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_names, get_engine

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


# -- the form ----------------------------------------------------------------------------------------------


def test_the_form_of_every_engine_gives_its_defaults_back(panel):
    for engine in engine_names():
        choose(panel, engine)
        assert panel.form.options() == get_engine(engine)().options()
        for name in get_engine(engine).model_fields:
            field = panel.form.field(name)
            assert field.controls[0].accessibleName()
            assert field.controls[0].toolTip()


def test_bounds_units_and_automatic_come_from_the_declaration(panel):
    choose(panel, "wiener")
    degree, surface = panel.form.field("degree").controls[0], panel.form.field("surface_position_m")
    assert (degree.minimum(), degree.maximum()) == (1, 20)
    assert panel.form.field("memory").controls[0].suffix() == " s"
    assert panel.form.field("memory").controls[0].minimum() > 0.0
    spin, automatic = surface.controls
    assert spin.suffix() == " mm"
    assert automatic.isChecked()
    assert not spin.isEnabled()
    automatic.setChecked(False)
    spin.setValue(2.5)
    assert panel.form.options()["surface_position_m"] == 0.0025
    choose(panel, "lms")
    tolerance = panel.form.field("tolerance").controls[0]
    assert tolerance.text() == "1e-12"
    assert tolerance.maximum() < 1.0


def test_changes_are_undone_and_redone_from_within_a_field(qtbot, panel):
    choose(panel, "wiener")
    degree = panel.form.field("degree").controls[0]
    degree.setFocus()
    degree.selectAll()
    qtbot.keyClicks(degree, "7")
    qtbot.keyClick(degree, Qt.Key.Key_Return)
    assert panel.form.options()["degree"] == 7
    qtbot.keyClick(degree, Qt.Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert panel.form.options()["degree"] == 5
    both = Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier
    qtbot.keyClick(degree, Qt.Key.Key_Z, both)
    assert panel.form.options()["degree"] == 7
    press(qtbot, panel.form.defaults)
    assert panel.form.options()["degree"] == 5
    press(qtbot, panel.form.undo)
    assert panel.form.options()["degree"] == 7
    # An undo that belongs to another engine shows that engine again.
    choose(panel, "lms")
    press(qtbot, panel.form.undo)
    assert (panel.form.name, panel.form.options()["degree"]) == ("wiener", 5)
    assert not panel.form.undo.isEnabled()


def test_what_cannot_be_is_said_in_words_and_not_run(qtbot, panel, strip, two):
    choose(panel, "depth")
    field = panel.form.field("breakpoints_m")
    line, automatic = field.controls
    automatic.setChecked(False)
    line.setFocus()
    qtbot.keyClicks(line, "12, moon")
    qtbot.keyClick(line, Qt.Key.Key_Return)
    with pytest.raises(UnusableInputError, check=coded("form.numbers", label="Given breakpoints (mm)")):
        panel.form.options()
    assert panel.form.problem.isVisible()
    panel.show_tests(two)
    press(qtbot, panel.run)
    assert panel.context.jobs.idle
    assert strip.said[-1][1]
    line.clear()
    qtbot.keyClicks(line, "12, 13.5")
    qtbot.keyClick(line, Qt.Key.Key_Return)
    assert panel.form.options()["breakpoints_m"] == [0.012, 0.0135]
    assert not panel.form.problem.isVisible()


# -- history, state, saving --------------------------------------------------------------------------------


def test_a_run_of_the_history_is_put_into_the_form_and_run_again(qtbot, open_panel, two):
    panel = open_panel()
    choose(panel, "wiener")
    panel.form.field("degree").controls[0].setValue(9)
    run(qtbot, panel, two[:1], "wiener")
    later = open_panel()
    choose(later, "lms")
    table = later.past.table
    later.tabs.setCurrentWidget(later.past)
    assert table.item(0, 1).text() == "Wiener"
    assert "9" in table.item(0, 4).text()
    qtbot.mouseClick(table.viewport(), Qt.MouseButton.LeftButton, pos=table.visualItemRect(table.item(0, 0)).center())
    press(qtbot, later.past.fill)
    assert (later.form.name, later.form.options()["degree"]) == ("wiener", 9)
    press(qtbot, later.past.run)
    wait(qtbot, later)
    assert later.results.outcomes[0].options["degree"] == 9
    assert later.past.table.rowCount() == 2


def test_a_history_from_elsewhere_is_not_trusted(qtbot, open_panel, history, two):
    run(qtbot, open_panel(), two[:1])
    good = history.path.read_bytes()
    hostile = json.loads(good)
    hostile["task"]["tests"][0]["label"] = "<b>" + "x" * 290
    hostile["task"]["engines"] = ["moon"]
    lines = [b"\xff\xfe rubbish", b'{"time": 5}', b"[" * 100_000, json.dumps(hostile).encode(), good.strip()]
    big = dict(hostile, headline="x" * 5001)
    history.path.write_bytes(b"\n".join([*lines, json.dumps(big).encode(), good[:40]]))
    panel = open_panel()
    assert panel.past.table.rowCount() == 2
    assert panel.past.remark.text().startswith("5 lines")
    assert panel.minimumSizeHint().width() < 700
    panel.tabs.setCurrentWidget(panel.past)
    panel.past.table.selectRow(1)
    press(qtbot, panel.past.fill)  # an engine that is not there
    assert panel.form.name == "lms"
    run(qtbot, panel, two[:1])  # the line that was cut off does not spoil the next one
    assert len(history.read()[0]) == 3


def test_a_history_that_cannot_be_written_costs_no_result(qtbot, panel, strip, history, two):
    history.path.parent.write_text("a file where the folder should be")
    run(qtbot, panel, two[:1])
    assert len(panel.results.outcomes) == 1
    assert begins(strip.said[-1][0], "research.no_history")


def test_signals_are_prepared_and_the_tissue_alone_is_reported(qtbot, open_panel, two, tmp_path):
    panel = open_panel()
    run(qtbot, panel, two[:1])
    (plain,) = panel.results.outcomes
    wanted = Preparation(detrend=True, low_hz=1.0, high_hz=150.0, tissue_alone=True)
    panel.form.preparation.set_value(wanted)
    run(qtbot, panel, two[:1])
    _plain, prepared = panel.results.outcomes
    assert (plain.preparation, prepared.preparation) == (Preparation(), wanted)
    added = set(prepared.report.parameters) - set(plain.report.parameters)
    assert added == {"tissue_mass_kg", "tissue_damping_n_s_per_m"}
    assert prepared.report.vaf_percent != plain.report.vaf_percent
    write_results(tmp_path / "results.jsonl", [prepared])
    assert read_results(tmp_path / "results.jsonl").outcomes[0].key == prepared.key
    panel.save_state()
    assert open_panel().form.preparation.value() == wanted
    panel.form.preparation.set_value(Preparation())
    panel.past.wanted.emit(panel.past._entries[0].task)
    assert panel.form.preparation.value() == wanted


def test_new_results_are_brought_to_the_top_of_the_table(qtbot, panel, two):
    run(qtbot, panel, two[:1])
    panel.results.setFixedHeight(120)
    many = [dataclasses.replace(panel.results.outcomes[0]) for _ in range(40)]
    panel.results.show_outcomes(many)
    QCoreApplication.processEvents()
    panel.results.bring_up(many[20:])
    assert panel.results.indexAt(QPoint(5, 5)).row() == 20


def test_the_state_of_last_time_is_taken_up_or_passed_over(open_panel):
    panel = open_panel()
    choose(panel, "wiener")
    panel.form.field("degree").controls[0].setValue(4)
    panel.form.take_signals("current", "position", True)
    panel.pictures.choice.setCurrentIndex(2)
    panel.save_state()
    later = open_panel()
    assert (later.form.name, later.form.options()["degree"]) == ("wiener", 4)
    assert later.form.signals == ("current", "position")
    assert later.form.together.isChecked()
    assert later.pictures.choice.currentIndex() == 2
    good = panel.context.settings.value(STATE)
    for rubbish in (None, "", "[1]", '{"engine": "moon"}', "x" * 200_000, '{"options": {"lms": 7}, "tab": "no"}', good):
        later.restore_state(rubbish)
        assert later.form.name in engine_names()
    assert later.form.options()["degree"] == 4


def test_table_and_figure_are_saved(qtbot, panel, strip, tmp_path, two):
    evil = [dataclasses.replace(two[0], pseudonym="=HYPERLINK(1)")]
    run(qtbot, panel, evil)
    table, png, svg = (tmp_path / name for name in ("table.csv", "figure.png", "figure.svg"))
    press(qtbot, panel.save_table)
    answer(qtbot, panel, table)
    with table.open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["subject"] == "'=HYPERLINK(1)"
    assert float(row["stiffness_n_per_m"]) > 1000.0
    for path in (png, svg):
        press(qtbot, panel.save_figure)
        answer(qtbot, panel, path)
        assert strip.said[-1] == (f"Saved in {path}.", False)
    assert QImage(str(png)).width() == 7.2 * 300
    assert QSvgRenderer(QByteArray(svg.read_bytes())).isValid()
    press(qtbot, panel.save_table)
    answer(qtbot, panel, tmp_path / "nowhere" / "table.csv")
    assert strip.said[-1][1]


# -- manners -----------------------------------------------------------------------------------------------


def test_every_control_has_a_name_and_no_two_keys_are_the_same(panel):
    for kind in (QAbstractButton, QComboBox, QAbstractSpinBox, QTableView):
        for control in panel.findChildren(kind):
            if control.focusPolicy() & Qt.FocusPolicy.TabFocus:
                named = control.accessibleName() or (isinstance(control, QAbstractButton) and control.text())
                assert named, control
    for line in panel.findChildren(QLineEdit):
        if not isinstance(line.parent(), QAbstractSpinBox | QComboBox):
            assert line.accessibleName()
    keys = [b.text()[b.text().index("&") + 1].lower() for b in panel.findChildren(QAbstractButton) if "&" in b.text()]
    assert sorted(keys) == sorted(set(keys))


def test_the_tab_key_goes_through_the_form_in_the_order_of_the_screen(panel):
    choose(panel, "lms")
    order = [control for name in get_engine("lms").model_fields for control in panel.form.field(name).controls]
    for before, after in pairwise([panel.form.engine, *order]):
        following = before.nextInFocusChain()
        while not following.focusPolicy() & Qt.FocusPolicy.TabFocus or following.focusProxy() is not None:
            following = following.nextInFocusChain()
        assert following is after


def test_an_engine_that_is_not_there_is_refused(panel):
    with pytest.raises(UnusableInputError, match="moon"):
        panel.form.choose("moon")


def test_the_window_closes_in_mid_work(qtbot, open_window, held, monkeypatch, tmp_path, two):
    monkeypatch.setenv("TISSUEID_ANALYSES", str(tmp_path / "analyses.jsonl"))
    window = open_window(first_page="research")
    (view,) = [view for view in window.pages.views if view.name == "research"]
    qtbot.waitUntil(lambda: window.jobs.idle, timeout=WAIT_MS)
    view.analysis.show_tests(two)
    view.tabs.setCurrentWidget(view.analysis)
    press(qtbot, view.analysis.run)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    assert not window.close()
    held.go_on.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert view.analysis.results.outcomes == ()
