"""Results that outlive the window: kept at an ordinary close, read without trust, refitted to be drawn."""

import dataclasses
import json
import math
import stat
import time
from pathlib import Path

import numpy as np
import pytest
from app.views.research_panels import chosen_of, press, run, wait
from coded import codes, shows
from PySide6.QtCore import Qt

from tissueid.app.views.researcher.engine_outcome import EngineOutcome, read_results, write_results
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.identification import FitReport
from tissueid.identification.base import PREDICTS_NOTHING
from tissueid.records import Estimate

pytestmark = [pytest.mark.qt_log_level_fail("WARNING"), pytest.mark.qt_log_ignore("This plugin does not support")]


def restart(qtbot, open_panel, before=None):
    """Close a panel in the ordinary way, and open the next one on the same workspace."""
    if before is not None:
        before.save_state()
    panel = open_panel()
    panel.go_on()
    wait(qtbot, panel)
    return panel


def texts(panel):
    model = panel.results.model()
    return [
        [model.index(row, column).data() for column in range(model.columnCount())] for row in range(model.rowCount())
    ]


def test_the_table_is_there_again_after_a_restart(qtbot, open_panel, two):
    panel = restart(qtbot, open_panel)
    run(qtbot, panel, two)
    run(qtbot, panel, [chosen_of(two[0].path.with_name("gone.h5"))], "depth")
    run(qtbot, panel, two[:1], "wiener")
    later = restart(qtbot, open_panel, panel)
    assert len(later.results.outcomes) == 4
    assert texts(later) == texts(panel)
    for new, old in zip(later.results.outcomes, panel.results.outcomes, strict=True):
        assert (new.key, new.report, new.refused, new.findings) == (old.key, old.report, old.refused, old.findings)
        assert not new.changed
    assert later.population.parameter.count() == 0  # not drawn before it is looked at
    later.tabs.setCurrentWidget(later.population)
    assert len(later.population.shown.outcomes) == 3


def test_curves_are_fitted_again_when_they_are_asked_for(qtbot, open_panel, two):
    panel = restart(qtbot, open_panel)
    assert not panel.refit.isVisible()
    run(qtbot, panel, two)
    before = panel.results.outcomes
    later = restart(qtbot, open_panel, panel)
    assert later.refit.isVisible()
    assert "Refit" in later.results.outcomes[0].plots.panels["impulse"].missing
    press(qtbot, later.refit)
    wait(qtbot, later)
    assert not later.refit.isVisible()
    after = later.results.outcomes
    assert [outcome.key for outcome in after] == [outcome.key for outcome in before]
    for new, old in zip(after, before, strict=True):
        assert new.report.parameters == old.report.parameters
        curves = (outcome.plots.panels["impulse"].curves[0] for outcome in (new, old))
        np.testing.assert_array_equal(*(curve.y for curve in curves))
    assert len(later.past.table.findItems("LMS", Qt.MatchFlag.MatchExactly)) == 1


def test_a_file_that_changed_or_went_is_marked(qtbot, open_panel, strip, two):
    panel = restart(qtbot, open_panel)
    run(qtbot, panel, two)
    with two[0].path.open("ab") as file:
        file.write(b"\0")
    two[1].path.unlink()
    later = restart(qtbot, open_panel, panel)
    assert [outcome.changed for outcome in later.results.outcomes] == [True, True]
    tip = later.results.model().index(0, 0).data(3)
    assert shows(tip, "research.file_changed")
    press(qtbot, later.refit)
    wait(qtbot, later)
    _first, second = later.results.outcomes
    assert second.changed  # it cannot be fitted again, and stays as it was
    assert second.report is not None
    assert strip.said[-1][1]


def test_what_was_taken_out_stays_out_and_undo_brings_it_back(qtbot, open_panel, two):
    panel = restart(qtbot, open_panel)
    run(qtbot, panel, two)
    assert not panel.undo.isVisible()
    press(qtbot, panel.clear)
    assert panel.results.outcomes == ()
    press(qtbot, panel.undo)
    assert len(panel.results.outcomes) == 2
    assert not panel.undo.isVisible()
    press(qtbot, panel.clear)
    assert restart(qtbot, open_panel, panel).results.outcomes == ()


def test_a_panel_that_never_looked_keeps_the_file(qtbot, open_panel, two):
    panel = restart(qtbot, open_panel)
    run(qtbot, panel, two)
    panel.save_state()
    never = open_panel()
    run(qtbot, never, two[:1])
    assert len(restart(qtbot, open_panel, never).results.outcomes) == 2


def outcome_of(number, **changes):
    report = FitReport("lms", {"memory": 0.1}, 100, 4, math.nan, None, parameters={"mass_kg": Estimate(math.inf, None)})
    tests = (SelectedTest(Path(f"/nowhere/{number}.h5"), number, "calf", "P-1", "label", 1.7e9),)
    return dataclasses.replace(EngineOutcome("lms", {"memory": 0.1}, tests, ("force", "position"), report), **changes)


def test_only_the_owner_reads_it_and_what_is_no_number_stays_none(tmp_path):
    path = tmp_path / "new" / "results.jsonl"
    write_results(path, [outcome_of(1), outcome_of(2, options={"bad": object()})])
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    kept = read_results(path)
    (outcome,) = kept.outcomes
    assert math.isnan(outcome.report.vaf_percent)
    assert math.isnan(outcome.report.parameters["mass_kg"].value)
    assert outcome.tests == outcome_of(1).tests
    assert read_results(tmp_path / "none.jsonl").outcomes == ()


def test_messages_keep_their_codes_and_files_of_before_are_read(tmp_path):
    path = tmp_path / "results.jsonl"
    report = dataclasses.replace(outcome_of(1).report, warnings=(PREDICTS_NOTHING, "plain"))
    write_results(path, [outcome_of(1, report=report, refused=PREDICTS_NOTHING)])
    (outcome,) = read_results(path).outcomes
    assert codes((*outcome.report.warnings, outcome.refused)) == [PREDICTS_NOTHING.code, "", PREDICTS_NOTHING.code]
    line = json.loads(path.read_text())
    line["report"]["warnings"] = [str(text) for text in outcome.report.warnings]
    path.write_text(json.dumps(line) + "\n")
    (outcome,) = read_results(path).outcomes
    assert outcome.report.warnings == (PREDICTS_NOTHING, "plain")


def test_what_is_read_is_not_trusted(qtbot, tmp_path, open_panel, history):
    path = history.path.with_name("results.jsonl")
    write_results(path, [outcome_of(1)])
    good = path.read_bytes().strip()
    line = json.loads(good)
    hostile = [
        dict(line, tests=[]),
        dict(line, options={"x": {"deep": 1}}),
        dict(line, extra=1),
        dict(line, report=dict(line["report"], parameters={"mass_kg": ["much", None]})),
        dict(line, report=dict(line["report"], warnings=["w" * 6000])),
        dict(line, stamp=[1]),
    ]
    rubbish = [b"\xff\xfe", b"[" * 100_000, b"{" + b'"a":' * 200_000, b'{"engine": NaN}']
    path.write_bytes(b"\n".join([*rubbish, *(json.dumps(one).encode() for one in hostile), good, good[:50]]))
    kept = read_results(path)
    assert (len(kept.outcomes), kept.bad) == (1, 11)
    odd = dict(line, engine="moon", tests=[dict(line["tests"][0], label="<b>x", pseudonym="<img src=x>", path="a\0b")])
    path.write_bytes(json.dumps(odd).encode())
    panel = restart(qtbot, open_panel)
    assert panel.results.outcomes[0].engine == "moon"
    assert "<img" not in panel.results.model().index(0, 0).data(3)
    press(qtbot, panel.refit)
    wait(qtbot, panel)
    assert panel.results.outcomes[0].engine == "moon"


def test_thousands_are_written_and_read_in_seconds(tmp_path):
    outcomes = [outcome_of(number) for number in range(3000)]
    path = tmp_path / "results.jsonl"
    begin = time.perf_counter()
    write_results(path, outcomes)
    assert len(read_results(path).outcomes) == 3000
    assert time.perf_counter() - begin < 10.0


def test_the_recommended_engine_is_marked_in_both_tables(qtbot, panel, two):
    panel.verdicts.take_compared(["lms", "wiener"])
    panel.show_tests(two[:1])
    press(qtbot, panel.compare)
    wait(qtbot, panel)
    marked = [outcome.recommended for outcome in panel.results.outcomes]
    assert sum(marked) == 1
    model = panel.results.model()
    bold = [model.index(row, 0).data(6) is not None for row in range(2)]
    assert bold == marked
    standings = panel.verdicts.standings
    assert [standings.item(row, 0).font().bold() for row in range(standings.rowCount())] == [
        standings.item(row, 1).text() == "recommended" for row in range(standings.rowCount())
    ]
