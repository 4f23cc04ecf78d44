"""The command line and the window fit and compare engines alike."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from reports.synthetic_sitting import make_session, make_test

from tissueid.app.jobs import JobControl
from tissueid.app.views.researcher.batch import run
from tissueid.app.views.researcher.engine_outcome import AnalysisHistory, AnalysisTask
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.cli import main
from tissueid.errors import CancelledError
from tissueid.procedures.control import Control
from tissueid.procedures.identification import ComparePlan, run_comparison
from tissueid.sessions import write_session

ENGINES = ("lms", "spectral", "volterra")
SCORES = ("vaf_percent", "vaf_validation_percent", "aicc", "n_parameters", "n_samples")


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("comparison") / "s.h5"
    write_session(path, make_session(make_test(seconds=1.5)))
    return path


def test_the_same_scores_and_recommendation(session_file: Path, tmp_path: Path):
    answer = tmp_path / "answer.json"
    assert main(["compare", str(session_file), "--engines", ",".join(ENGINES), "--json", str(answer)]) == 0
    command = json.loads(answer.read_text(encoding="utf-8"))
    control = JobControl()
    task = AnalysisTask(kind="compare", engines=ENGINES, tests=(SelectedTest(session_file, 1),))
    window = run(task, AnalysisHistory(tmp_path / "history.jsonl"), "2026-01-01T00:00:00Z", control)
    assert window.problems == ()
    assert len(window.outcomes) == len(command["engines"])
    for ours, theirs in zip(window.outcomes, command["engines"], strict=True):
        assert (ours.engine, ours.refused or None) == (theirs["engine"], theirs["refused"])
        if ours.report is not None:
            shown = ours.report.as_dict()
            assert [shown[name] for name in SCORES] == [theirs[name] for name in SCORES]
    recommended = [outcome.engine for outcome in window.outcomes if outcome.recommended]
    assert recommended == [command["recommendation"]["engine"]]
    assert control.fraction is not None
    assert control.fraction > 0.9


def test_the_same_fit_with_the_same_options(session_file: Path, tmp_path: Path):
    answer = tmp_path / "answer.json"
    fit = ["identify", str(session_file), "--engine", "wiener", "--option", "degree=3", "--memory", "0.05"]
    assert main([*fit, "--json", str(answer)]) == 0
    command = json.loads(answer.read_text(encoding="utf-8"))
    task = AnalysisTask(
        engines=("wiener",),
        options={"degree": 3, "memory": 0.05},
        tests=(SelectedTest(session_file, 1),),
    )
    window = run(task, AnalysisHistory(tmp_path / "history.jsonl"), "2026-01-01T00:00:00Z", JobControl())
    (outcome,) = window.outcomes
    assert outcome.report is not None
    shown = outcome.report.as_dict()
    assert [shown[name] for name in SCORES] == [command[name] for name in SCORES]
    assert shown["parameters"] == command["parameters"]


def test_a_cancelled_comparison_writes_nothing(session_file: Path, tmp_path: Path):
    class Impatient(Control):
        def __init__(self) -> None:
            self.steps: list[str] = []

        def progress(self, fraction: float | None, step: str) -> None:
            self.steps.append(step)

        def cancelled(self) -> bool:
            return "spectral" in self.steps

    page, control = tmp_path / "page.html", Impatient()
    with pytest.raises(CancelledError):
        run_comparison(ComparePlan(session=session_file, engines=ENGINES, page=page), control)
    assert control.steps == ["lms", "lms", "spectral"]
    assert not page.exists()
