"""Answers of a sealed check beside its scenarios: kept as they come, read again, and damaged ones refused."""

from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import UnusableInputError
from tissueid.gap import blind_check
from tissueid.gap.blind_check import Piece, answers
from tissueid.gap.kept_answers import Begun, begin, begun_in, keep_answer, kept_answer
from tissueid.gap.workers import Alone

ANSWER = {"verdict": "no_gap", "gap": {"before": 0.1, "closed": float("nan")}, "where": {}, "ranking": []}
ANSWER["combination"] = []
DRAW = Begun(3, 7, 0.5, "ab" * 32)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Scenarios that were diagnosed, in order; the second one breaks off."""
    names: list[str] = []

    def diagnosed(piece: Piece) -> dict:
        names.append(piece.name)
        if names == ["a", "b"]:
            raise KeyboardInterrupt
        return ANSWER | {"in_sample": piece.name, "oracle": np.float64(0.25)}

    monkeypatch.setattr(blind_check.Piece, "diagnosed", diagnosed)
    return names


def test_an_interrupted_check_goes_on_where_it_was(tmp_path: Path, asked: list[str]):
    with pytest.raises(KeyboardInterrupt):
        answers(tmp_path, ["a", "b", "c"], Alone(), keep=True)
    assert sorted(path.name for path in (tmp_path / "answers").iterdir()) == ["a.json"]
    told: list[int] = []
    found = answers(tmp_path, ["a", "b", "c"], Alone(), lambda: told.append(1), keep=True)
    assert asked == ["a", "b", "b", "c"]
    assert list(found) == ["a", "b", "c"]
    assert len(told) == 3
    assert found["a"]["in_sample"] == "a"
    assert found["a"]["oracle"] == 0.25
    assert np.isnan(found["a"]["gap"]["closed"])


def test_answers_with_an_effect_taken_out_are_others(tmp_path: Path, asked: list[str]):
    answers(tmp_path, ["a"], Alone(), keep=True)
    answers(tmp_path, ["a"], Alone(), without=lambda name: ("dry_friction",), keep=True)
    assert asked == ["a", "a"]
    assert {path.stem for path in (tmp_path / "answers").iterdir()} == {"a", "a-without-dry_friction"}


def test_nothing_is_kept_that_nobody_asked_for(tmp_path: Path, asked: list[str]):
    answers(tmp_path, ["a"], Alone())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"verdict": "no_gap"}', "[" * 100_000])
def test_a_damaged_answer_is_refused_in_one_line(tmp_path: Path, text: str):
    keep_answer(tmp_path, "a", ANSWER)
    (tmp_path / "answers" / "a.json").write_text(text)
    with pytest.raises(UnusableInputError, match="delete it, and it is asked again") as caught:
        kept_answer(tmp_path, "a")
    assert "\n" not in str(caught.value)


def test_a_check_says_what_it_is(tmp_path: Path):
    with pytest.raises(UnusableInputError, match="leave --resume out"):
        begun_in(tmp_path)
    begin(tmp_path, DRAW)
    assert begun_in(tmp_path) == DRAW
    begin(tmp_path, Begun(3, 7, 0.5, "ab" * 32, software="0.0.0"))
    with pytest.raises(UnusableInputError, match="answers of two versions are no one score"):
        begun_in(tmp_path)
    (tmp_path / "answers" / "check.json").write_text('{"n": "many"}')
    with pytest.raises(UnusableInputError, match="does not say which check it is"):
        begun_in(tmp_path)


def test_a_folder_that_cannot_be_written(tmp_path: Path):
    (tmp_path / "answers").write_text("in the way")
    with pytest.raises(UnusableInputError, match="cannot write"):
        begin(tmp_path, DRAW)
