"""Stored answers of a blind check: stored one by one, reused, and refused where damaged."""

import os
from pathlib import Path

import numpy as np
import pytest
from coded import coded

from tissueid.errors import UnusableInputError
from tissueid.gap.answer import store_answer, stored_answer
from tissueid.gap.workers import SerialExecutor
from tissueid_lab.blind_check.answers import BlindScenario, CheckInProgress, answers, begin_check, check_in_progress

ANSWER = {"verdict": "no_gap", "gap": {"before": 0.1, "closed": float("nan")}, "where": {}, "ranking": []}
ANSWER["combination"] = []
DRAW = CheckInProgress(3, 7, 0.5, "ab" * 32)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of diagnosed scenarios, in order; the second diagnosis is interrupted."""
    names: list[str] = []

    def diagnosed(piece: BlindScenario) -> dict:
        names.append(piece.name)
        if names == ["a", "b"]:
            raise KeyboardInterrupt
        return ANSWER | {"in_sample": piece.name, "oracle": np.float64(0.25)}

    monkeypatch.setattr(BlindScenario, "diagnosed", diagnosed)
    return names


def test_an_interrupted_check_is_resumed(tmp_path: Path, asked: list[str]):
    with pytest.raises(KeyboardInterrupt):
        answers(tmp_path, ["a", "b", "c"], SerialExecutor(), keep=True)
    assert sorted(path.name for path in (tmp_path / "answers").iterdir()) == ["a.json"]
    result: list[object] = []
    found = answers(tmp_path, ["a", "b", "c"], SerialExecutor(), result.append, keep=True)
    assert asked == ["a", "b", "b", "c"]
    assert list(found) == ["a", "b", "c"]
    assert len(result) == 3
    assert found["a"]["in_sample"] == "a"
    assert found["a"]["oracle"] == 0.25
    assert np.isnan(found["a"]["gap"]["closed"])


def test_answers_without_an_effect_are_stored_separately(tmp_path: Path, asked: list[str]):
    answers(tmp_path, ["a"], SerialExecutor(), keep=True)
    answers(tmp_path, ["a"], SerialExecutor(), without={"a": ("dry_friction",)}, keep=True)
    assert asked == ["a", "a"]
    assert {path.stem for path in (tmp_path / "answers").iterdir()} == {"a", "a-without-dry_friction"}


def test_nothing_is_stored_without_a_request(tmp_path: Path, asked: list[str]):
    answers(tmp_path, ["a"], SerialExecutor())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_changed_answer_is_refused(tmp_path: Path):
    store_answer(tmp_path, "a", ANSWER)
    file = tmp_path / "answers" / "a.json"
    file.write_text(file.read_text().replace("no_gap", "effect"))
    with pytest.raises(UnusableInputError, check=coded("blind.unreadable_answer")):
        stored_answer(tmp_path, "a")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(UnusableInputError, check=coded("blind.unreadable_answer")):
        stored_answer(tmp_path, "a")


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"verdict": "no_gap"}', "[" * 100_000])
def test_a_damaged_answer_is_refused(tmp_path: Path, text: str):
    store_answer(tmp_path, "a", ANSWER)
    (tmp_path / "answers" / "a.json").write_text(text)
    path = str(tmp_path / "answers" / "a.json")
    with pytest.raises(UnusableInputError, check=coded("blind.unreadable_answer", path=path)):
        stored_answer(tmp_path, "a")


def test_a_check_in_progress_is_described(tmp_path: Path):
    with pytest.raises(UnusableInputError, check=coded("blind.no_check", folder=str(tmp_path))):
        check_in_progress(tmp_path)
    begin_check(tmp_path, DRAW)
    assert check_in_progress(tmp_path) == DRAW
    begin_check(tmp_path, CheckInProgress(3, 7, 0.5, "ab" * 32, software="0.0.0"))
    with pytest.raises(UnusableInputError, check=coded("blind.other_version", begun="0.0.0")):
        check_in_progress(tmp_path)
    store_answer(tmp_path, "check", {"n": "many"})
    with pytest.raises(UnusableInputError, check=coded("blind.damaged_check")):
        check_in_progress(tmp_path)


def test_a_folder_that_cannot_be_written(tmp_path: Path):
    (tmp_path / "answers").write_text("in the way")
    with pytest.raises(UnusableInputError, check=coded("blind.unwritable")):
        begin_check(tmp_path, DRAW)
