"""``tissueid readings`` as people and scripts meet it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from analysis import simulated_steps as steps
from reports.synthetic_sitting import make_session, make_test
from shell import answer

from tissueid.cli import main
from tissueid.sessions import Test, write_session


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Test 1 is stochastic, test 2 a step with one cycle."""
    record = steps.step_record(np.random.default_rng(0))
    time = np.arange(len(record)) / record.sample_rate_hz
    signals = {"time": time, "force": record.input, "position": record.output}
    step = Test(number=2, kind="step_hold", signals=signals, sample_rate_hz=record.sample_rate_hz)
    path = tmp_path_factory.mktemp("readings") / "session.h5"
    write_session(path, make_session(make_test(1, seconds=2.5), step))
    return path


def test_the_answer_and_the_page_hold_both_ways(session_file: Path, capsys: pytest.CaptureFixture[str]):
    page = session_file.with_name("readings.html")
    arguments = ["readings", str(session_file), "--engine", "lms", "--draws", "2", "--report", str(page)]
    found = answer(capsys, *arguments)
    assert (found["recorded"]["test"], found["model"]["test"], found["model"]["engine"]) == (2, 1, "lms")
    assert found["recorded"]["readings"]["ue_m"]["std"] > 0.0
    assert found["model"]["readings"]["ue_m"]["std"] > 0.0
    assert found["note_messages"][0]["code"] == "readings.not_comparable"
    text = page.read_text("utf-8")
    assert text.count("<svg") >= 2
    assert "Research use only" in text
    assert "not comparable" in text


def test_a_stochastic_test_gives_its_model_alone(session_file: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["readings", str(session_file), "--test", "1", "--engine", "lms", "--draws", "0", "--json", "-"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["step"]["recorded"] is False
    assert found["recorded"]["readings"]["ue_m"]["value"] is None
    assert found["model"]["readings"]["ue_m"]["value"] > 0.0


@pytest.mark.parametrize(
    "arguments",
    [("--test", "9"), ("--fit-test", "9"), ("--engine", "none"), ("--draws", "-1"), ("--memory", "-1")],
)
def test_bad_input_gives_one_line(session_file: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]):
    assert main(["readings", str(session_file), *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
