"""Scores of sets of effects, on answers made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid_lab.blind_check.scoring import Answered, BlindScore, Label
from tissueid_lab.blind_check.set_scoring import score_of_later_sessions, score_of_sets

OWN = ("viscoelasticity", "added_mass")


def case(name: str, hidden: str, named: str, closed: float | None, before: float = 0.11) -> Answered:
    """Return a case; its oracle is the floor, so that the true set closes everything."""
    effects = (*OWN, *hidden.split())
    label = Label(effects, ("tissue",) * len(effects), (True,) * len(effects), False, tuple(hidden.split()), "arm")
    gap = {"before": before, "floor": 0.1, "closed": closed, "announced": closed}
    verdict = "effect" if named else "unexplained"
    return Answered(name, label, {"verdict": verdict, "gap": gap, "combination": named.split(), "ranking": []}, 0.1)


CASES = [
    case("a", "", "viscoelasticity added_mass", 0.9, 0.2),
    case("b", "sensor_lag", "viscoelasticity dry_friction", 0.6, 0.2),
    case("c", "sensor_lag mains_hum", "", None, 0.2),
]


def figure(score: BlindScore, *begins: str) -> float:
    return next(item.value for item in score.figures if item.what.startswith(begins))


def test_sets_are_scored_by_all_named_effects():
    score = score_of_sets(CASES)
    # 3 hits of 4 named and 9 true effects
    assert figure(score, "precision") == pytest.approx(3 / 4)
    assert figure(score, "recall") == pytest.approx(3 / 9)
    assert figure(score, "F1 of the named set") == pytest.approx(6 / 13)
    assert figure(score, "named effects that are not there") == pytest.approx(1 / 3)


def test_sets_are_scored_by_the_number_of_hidden_effects_and_for_these_alone():
    score = score_of_sets(CASES)
    assert figure(score, "F1 of the named set without") == 1.0
    assert figure(score, "F1 of the named set with one") == pytest.approx(2 / 5)
    assert figure(score, "F1 of the named set with two") == 0.0
    assert figure(score, "F1 of the hidden") == 0.0
    right = score_of_sets([case("d", "sensor_lag", "sensor_lag tissue_hysteresis", 0.5)])
    assert figure(right, "F1 of the hidden") == 1.0


def test_an_answer_without_a_name_has_closed_nothing():
    score = score_of_sets(CASES)
    assert figure(score, "closed share relative to the true set, median") == pytest.approx(0.6)
    assert figure(score, "closed share relative to the true set, 10th") == pytest.approx(0.12)
    flat = score_of_sets([case("e", "", "", None, 0.1)])
    assert np.isnan(figure(flat, "closed share relative to the true set, median"))


def test_failures_name_what_is_missing_and_what_is_not_there():
    failures = score_of_sets(CASES).failures
    assert len(failures) == 2
    assert "missing added_mass + sensor_lag; not there dry_friction" in failures[0]


def test_without_cases_nothing_is_scored():
    score = score_of_sets([])
    assert all(item.cases == 0 and np.isnan(item.value) for item in score.figures)


def later(name: str, hidden: str, verdict: str, *ranked: str, before: float = 0.2, alone: bool = True) -> Answered:
    found = case(name, hidden, "", None, before)
    named = list(ranked[: 1 if alone else 2]) if verdict == "effect" else []
    ranking = [{"effect": effect, "probability": 0.9} for effect in ranked]
    found.answer.update(verdict=verdict, ranking=ranking, combination=named, accepted=[*OWN, "cogging"])
    return found


def test_later_sessions_are_scored_by_the_new_effect_and_by_false_alarms():
    score = score_of_later_sessions(
        [
            later("a", "sensor_lag", "effect", "sensor_lag", "latency"),
            later("b", "sensor_lag", "effect", "sensor_lag", "latency", alone=False),
            later("c", "sensor_lag", "unexplained", "latency"),
            later("d", "sensor_lag", "no_gap", before=0.1),
            later("e", "", "no_gap", before=0.1),
            later("f", "", "effect", "latency"),
        ]
    )
    first, alarms = score.rates
    assert (first.hits, first.cases, first.target) == (2, 3, 0.95)
    assert (alarms.hits, alarms.cases, alarms.reached) == (1, 2, False)
    assert figure(score, "new effect, also") == pytest.approx(2 / 4)
    assert figure(score, "new effect: named, and nothing") == pytest.approx(1 / 3)
    assert figure(score, "new effect: unexplained") == pytest.approx(1 / 3)
    assert figure(score, "new effect: no gap") == pytest.approx(1 / 4)
    assert figure(score, "accepted effects") == 1.0
    assert [line.split(" ")[0] for line in score.failures] == ["b", "c", "d", "f"]
