"""Thresholds fitted to decisions of one laboratory, on grounds made by hand and on a small check."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tissueid.errors import UnusableInputError
from tissueid.gap.decision import Grounds, Tried, decide
from tissueid.gap.thresholds import Thresholds
from tissueid_lab.blind_check.threshold_fit import Decided, changed, fit_thresholds, read_decided, scores

NOTHING = frozenset()
NAMES = {"a": "eddy_currents", "b": "inductance_position"}
"""Two effects of one stage, of which one can stand for an error in the form of the other."""


def tried(effects: str, score: float, closed: float) -> Tried:
    return Tried(tuple(map(NAMES.__getitem__, effects)), score, score, closed, strict=False)


def case(true: str, *items: Tried, left_out: bool = False) -> Decided:
    alone = len(true) == 1 or left_out
    return Decided(Grounds(4.0, items), frozenset(map(NAMES.__getitem__, true)), alone, left_out)


def a_single(share: float, true: str) -> Decided:
    """An effect whose form is a little wrong, so that a second one takes ``share`` of the gap to the noise."""
    return case(true, tried("a", 0.6, 0.99 - share), tried("b", 3.5, 0.1), tried("ab", 0.05, 0.99))


CASES = [
    *(a_single(0.01, "a") for _ in range(3)),
    *(a_single(0.2, "ab") for _ in range(3)),
    case("", tried("a", 1.8, 0.72), tried("b", 1.9, 0.7), left_out=True),
    case("b", tried("b", 0.5, 0.9), tried("a", 3.0, 0.2)),
]


def test_a_second_name_that_closes_little_is_left_out_and_one_that_closes_much_is_kept():
    found = fit_thresholds(CASES, Thresholds())
    assert [decide(item.grounds, found) for item in CASES] == [item.true for item in CASES]
    assert 0.79 < found.structural <= 0.98


def test_a_wrong_name_weighs_more_than_an_abstention():
    # One right and one wrong name with the same figures: none is named.
    items = tried("a", 1.2, 0.75), tried("b", 3.0, 0.1)
    left_out = case("", *items, left_out=True)
    other = case("a", tried("b", 1.2, 0.75), tried("a", 3.0, 0.1))
    found = fit_thresholds([case("a", *items), other, left_out], Thresholds())
    assert decide(case("a", *items).grounds, found) == NOTHING


def test_figures_of_decisions():
    kept = scores(CASES, replace(Thresholds(), structural=2.0, explained_closed=0.7))
    cut = scores(CASES, changed(changed(Thresholds(), "structural", 0.9), "explained_closed", 0.75))
    assert kept["single effect named, nothing else"] == (pytest.approx(0.25), 4)
    assert cut["single effect named, nothing else"] == (1.0, 4)
    assert kept["several effects: F1"] == cut["several effects: F1"] == (1.0, 3)
    assert kept["effect left out of the library: nothing named"] == (0.0, 1)
    assert cut["effect left out of the library: nothing named"] == (1.0, 1)
    assert kept["named effects that are not there, per scenario"] == (pytest.approx(3 / 7), 7)
    assert cut["named effects that are not there, per scenario"] == (0.0, 7)
    assert cut["single effect first"] == (1.0, 4)


def test_a_folder_without_answers_is_refused(tmp_path):
    (tmp_path / "labels.json").write_text(
        '{"scenario-0001": {"effects": [], "stages": [], "listed": [], "full": false}}'
    )
    (tmp_path / "scenario-0001.json").write_text("{}")
    with pytest.raises(UnusableInputError, match="no grounds"):
        read_decided(tmp_path)
