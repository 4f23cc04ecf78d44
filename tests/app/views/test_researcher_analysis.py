"""The panel of analyses as a researcher uses it: engine, options, run; table, plots, recommendation, history."""

import csv
import dataclasses
import json
import threading
from itertools import pairwise

import pytest
from app.benches import WAIT_MS
from PySide6.QtCore import QByteArray, QPoint, QSettings, Qt
from PySide6.QtGui import QImage
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QComboBox,
    QFileDialog,
    QLineEdit,
    QTableView,
    QWidget,
)

from tissueid.app.jobs import Jobs
from tissueid.app.surroundings import Surroundings
from tissueid.app.theme import DARK, LIGHT
from tissueid.app.views.researcher import batch
from tissueid.app.views.researcher.analysis import AnalysisPanel
from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.history import History
from tissueid.app.views.researcher.pictures import PICTURES
from tissueid.app.views.researcher.state import STATE, recall
from tissueid.app.views.view import Desk
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_names, get_engine
from tissueid.sessions import read_session, write_session

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


class Strip:
    """What the panel says, and whether as a problem."""

    def __init__(self):
        self.said = []

    def __call__(self, text, *, problem=False):
        self.said.append((text, problem))


@pytest.fixture
def strip():
    return Strip()


@pytest.fixture
def history(tmp_path):
    return History(tmp_path / "data" / "analyses.jsonl")


@pytest.fixture
def open_panel(qtbot, tmp_path, strip, history):
    """Opens panels on a desk of their own; each is settled as the window would, and its work is waited for."""
    opened = []

    def make():
        home = QWidget()
        qtbot.addWidget(home)
        jobs = Jobs(home)
        settings = QSettings(str(tmp_path / "panel.ini"), QSettings.Format.IniFormat)
        nothing = lambda *_: None  # noqa: E731
        around = Surroundings(folder=tmp_path)
        desk = Desk(around, jobs, settings, strip, lambda: "researcher", nothing, nothing, nothing, nothing)
        panel = AnalysisPanel(desk, home, history=history)
        jobs.changed.connect(lambda: panel.settle(busy=bool(jobs), testing=False))
        panel.paint_with(LIGHT)
        home.resize(700, 560)
        panel.resize(700, 560)
        home.show()
        opened.append((home, panel))
        return panel

    yield make
    for _, panel in opened:
        panel.cancel()
        wait(qtbot, panel)


@pytest.fixture
def panel(open_panel):
    return open_panel()


def wait(qtbot, panel):
    qtbot.waitUntil(lambda: not panel.desk.jobs, timeout=WAIT_MS)


def press(qtbot, widget):
    qtbot.mouseClick(widget, Qt.MouseButton.LeftButton)


def chosen_of(path, subject="P-001", number=1):
    return Chosen(path, number, "left calf", subject, f"{subject} #{number}")


@pytest.fixture
def two(tmp_path, saved):
    """Two sessions of the same record, of different subjects."""
    session = read_session(saved)
    paths = []
    for name in ("P-001", "P-002"):
        path = tmp_path / f"{name}.h5"
        write_session(path, dataclasses.replace(session, subject=dataclasses.replace(session.subject, pseudonym=name)))
        paths.append(chosen_of(path, name))
    return paths


def choose(panel, engine):
    panel.form.engine.setCurrentIndex(panel.form.engine.findData(engine))


def run(qtbot, panel, chosen, engine="lms"):
    choose(panel, engine)
    panel.show_tests(chosen)
    press(qtbot, panel.run)
    wait(qtbot, panel)


def answer(qtbot, panel, path):
    """Answer the file dialog that is open."""
    qtbot.waitUntil(lambda: bool(panel.findChildren(QFileDialog)), timeout=WAIT_MS)
    dialog = panel.findChildren(QFileDialog)[-1]
    dialog.fileSelected.emit(str(path))
    dialog.close()
    wait(qtbot, panel)


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
    assert "give numbers with commas" in panel.form.problem.text()
    panel.show_tests(two)
    press(qtbot, panel.run)
    assert not panel.desk.jobs
    assert strip.said[-1][1]
    line.clear()
    qtbot.keyClicks(line, "12, 13.5")
    qtbot.keyClick(line, Qt.Key.Key_Return)
    assert panel.form.options()["breakpoints_m"] == [0.012, 0.0135]
    assert not panel.form.problem.isVisible()


# -- running -----------------------------------------------------------------------------------------------


def test_engine_and_run_give_table_plots_and_a_line_of_history(qtbot, panel, strip, history, two):
    choose(panel, "lms")
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
    heads = [model.headerData(column, Qt.Orientation.Horizontal) for column in range(model.columnCount())]
    assert "Mass (g)" in heads
    assert "±" in model.index(0, heads.index("Mass (g)")).data()
    lines = [outcome.drawn.lines for outcome in panel.results.outcomes]
    assert all({"impulse", "magnitude", "phase", "coherence"} <= set(some) for some in lines)
    assert {"autocorrelation", "cross"} <= set(lines[0])
    assert "too few" in panel.results.outcomes[2].drawn.missing["autocorrelation"]
    assert ["nonlinearity" in some for some in lines] == [False, False, True]
    # The same system by two engines: the same peak of the impulse response, in mm/(N s).
    peaks = [some["impulse"].y.max() for some in lines]
    assert peaks[0] == pytest.approx(peaks[2], rel=0.2)
    # A static compliance in mm/N is one over the stiffness in N/mm.
    low = 10.0 ** lines[2]["magnitude"].y[0]
    assert low == pytest.approx(1e3 / float(table[2]["stiffness_n_per_m"]), rel=0.15)
    for place, name in enumerate(PICTURES):
        panel.pictures.choice.setCurrentIndex(place)
        assert panel.pictures.choice.currentText() == name
        panel.paint_with(DARK)
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
    press(qtbot, panel.clear)
    assert table.outcomes == ()
    assert not panel.save_table.isEnabled()


def test_kernels_and_depth_can_be_seen(qtbot, panel, two):
    choose(panel, "volterra")
    panel.form.field("memory").controls[0].setValue(0.03)
    run(qtbot, panel, two[:1], "volterra")
    run(qtbot, panel, two[:1], "direction")
    volterra, direction = panel.results.outcomes
    (kernel,) = volterra.drawn.images
    assert kernel.values.shape == (kernel.x.size, kernel.y.size)
    assert kernel.unit == "mm/(N²·s²)"
    assert direction.drawn.lines["damping"].out_x is not None
    assert panel.pictures.kernel.choice.count() == 2
    panel.pictures.choice.setCurrentIndex(panel.pictures.choice.count() - 1)
    assert panel.pictures.kernel.card.plot.isVisible()
    assert panel.pictures.kernel.image is kernel


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


class Held:
    """Stands for an engine that takes its time: it fits when it is told to."""

    def __init__(self, real):
        self.real, self.reached, self.go_on = real, threading.Event(), threading.Event()

    def __call__(self, *args, **options):
        self.reached.set()
        assert self.go_on.wait(WAIT_MS / 1000)
        return self.real(*args, **options)


@pytest.fixture
def held(monkeypatch):
    held = Held(batch.analyse)
    monkeypatch.setattr(batch, "analyse", held)
    yield held
    held.go_on.set()


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
    panel.settle(busy=False, testing=True)
    for control in (panel.run, panel.compare, panel.folder, panel.save_table, panel.past.run):
        assert not control.isEnabled()
    panel.show_tests(())
    panel.settle(busy=False, testing=False)
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
    assert strip.said[-1] == (f"There is no session below {tmp_path / 'empty'}.", True)


def test_a_comparison_recommends_with_reasons(qtbot, panel, two):
    panel.verdicts.take_compared(["lms", "spectral", "localized"])
    panel.show_tests(two[:1])
    press(qtbot, panel.compare)
    wait(qtbot, panel)
    assert panel.tabs.currentWidget() is panel.verdicts
    assert panel.verdicts.headline.text().endswith(".")
    assert "Judged on" in panel.verdicts.words.toPlainText()
    standings = panel.verdicts.standings
    last = [[standings.item(row, column).text() for column in (0, 1)] for row in range(standings.rowCount())]
    assert sum(verdict == "recommended" for _, verdict in last) == 1
    assert last[-1][0] == "Localized"
    assert {outcome.engine for outcome in panel.results.outcomes} == {"lms", "spectral", "localized"}


def test_a_comparison_is_cancelled_between_its_engines(qtbot, panel, strip, monkeypatch, two):
    reached, go_on = threading.Event(), threading.Event()
    real = batch.split

    def slow(*args, **options):
        reached.set()
        assert go_on.wait(WAIT_MS / 1000)
        return real(*args, **options)

    monkeypatch.setattr(batch, "split", slow)
    panel.show_tests(two)
    press(qtbot, panel.compare)
    qtbot.waitUntil(reached.is_set, timeout=WAIT_MS)
    press(qtbot, panel.cancelling)
    go_on.set()
    wait(qtbot, panel)
    assert panel.results.outcomes == ()
    assert "Cancelled" in strip.said[-1][0]


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
    big = dict(hostile, headline="x" * 5000)
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
    assert "history could not be written" in strip.said[-1][0]


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
    good = panel.desk.settings.value(STATE)
    for rubbish in (None, "", "[1]", '{"engine": "moon"}', "x" * 200_000, '{"options": {"lms": 7}, "tab": "no"}', good):
        recall(rubbish, later.form, later.verdicts, later.pictures.choice, later.tabs)
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
    assert QImage(str(png)).width() == 2 * panel.pictures.canvas.width()
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
    qtbot.waitUntil(lambda: not window.jobs, timeout=WAIT_MS)
    view.analysis.show_tests(two)
    view.tabs.setCurrentWidget(view.analysis)
    press(qtbot, view.analysis.run)
    qtbot.waitUntil(held.reached.is_set, timeout=WAIT_MS)
    assert not window.close()
    held.go_on.set()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=WAIT_MS)
    assert view.analysis.results.outcomes == ()
