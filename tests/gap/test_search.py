"""The search on laboratory records: which candidate wins, which may take part, progress, and how it is stopped."""

from __future__ import annotations

from functools import cache

import pytest
from gap_records import changed, observed, recorded

from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fitting import Cancelled
from tissueid.gap.observing import observe
from tissueid.gap.scoring import Candidate
from tissueid.gap.search import Found, Progress, Search, applicable
from tissueid.gap.workers import Alone
from tissueid.twin.catalogue import all_effects, effect

CANDIDATES = ("dry_friction", "directional_damping", "sensor_lag")
SAMPLES = 3000


@cache
def found(name: str) -> Found:
    search = Search(observed(name), Alone(), CANDIDATES)
    return search.singles(search.baseline())


@pytest.mark.parametrize("name", ["dry_friction", "directional_damping"])
def test_the_right_effect_is_best_scored(name):
    told = found(name)
    assert told.candidates[0].effects == (name,)
    assert told.candidates[0].score < 0.2 < 3.0 < told.baseline.score
    scores = [item.score for item in told.candidates]
    assert scores == sorted(scores)


def test_only_the_candidates_take_part():
    assert {item.effect for item in found("dry_friction").signatures} == set(CANDIDATES)
    assert {name for item in found("dry_friction").candidates for name in item.effects} <= set(CANDIDATES)


def test_without_the_right_one_nothing_explains():
    told = diagnose(observed("dry_friction", samples=SAMPLES), Alone(), candidates=("sensor_lag",))
    assert told.verdict == "unexplained"
    assert told.combination == ()


def test_a_diagnosis_names_the_effect():
    told = diagnose(observed("dry_friction"), Alone(), candidates=CANDIDATES)
    assert (told.verdict, told.combination, told.where.stage) == ("effect", ("dry_friction",), "mechanics")
    assert told.ranking[0].effect == "dry_friction"
    assert told.ranking[0].probability > 0.9
    assert told.gap.closed > 0.95
    low, high = told.gap.closed_ci
    assert low <= told.gap.closed <= high
    assert told.gap.floor <= told.gap.after < told.gap.before
    assert sum(item.probability for item in told.ranking) <= 1.0


def test_a_known_effect_is_part_of_the_baseline():
    told = diagnose(observed("dry_friction", samples=SAMPLES), Alone(), known=("dry_friction",), candidates=CANDIDATES)
    assert told.found.baseline.effects == ("dry_friction",)
    assert (told.verdict, told.combination) == ("no_gap", ())
    assert all(len(set(item.effects)) == len(item.effects) for item in told.found.candidates)
    assert "dry_friction" not in {item.effect for item in told.ranking}


def test_progress_runs_from_nothing_to_all():
    steps: list[Progress] = []
    search = Search(observed("dry_friction", samples=SAMPLES), Alone(), CANDIDATES, steps.append)
    search.singles(search.baseline())
    assert steps[0] == Progress("baseline", 0, 1)
    assert all(0 <= step.done <= step.total for step in steps)
    last = {step.what: step for step in steps}
    assert all(step.done == step.total for step in last.values())
    assert last["screening"].total == len(CANDIDATES)


@pytest.mark.parametrize("after", [0, 1, 6])
def test_cancelled(after):
    steps: list[Progress] = []
    search = Search(
        observed("dry_friction", samples=SAMPLES),
        Alone(),
        CANDIDATES,
        steps.append,
        cancelled=lambda: len(steps) > after,
    )
    with pytest.raises(Cancelled):
        search.singles(search.baseline())


def test_what_was_not_recorded_rules_effects_out():
    everything = observed()
    assert all(applicable(everything, item) for item in all_effects().values())
    no_voltage = observe(changed(recorded(), voltage=None))
    assert no_voltage.channels == ("current", "position")
    assert not applicable(no_voltage, effect("amplifier_deadband"))
    assert applicable(no_voltage, effect("dry_friction"))
    position_alone = observe(changed(recorded(), voltage=None, current=None))
    assert not applicable(position_alone, effect("eddy_currents"))
    assert applicable(position_alone, effect("dry_friction"))


def test_the_same_twice():
    search = Search(observed("dry_friction"), Alone(), CANDIDATES)
    again = search.singles(search.baseline())
    assert [(item.effects, item.score) for item in again.candidates] == [
        (item.effects, item.score) for item in found("dry_friction").candidates
    ]


def test_a_leader_that_fills_the_chain_has_no_partners():
    full = Candidate(("cogging", "end_stop", "latency", "reflex"), found("dry_friction").baseline.fit, (), ())
    search = Search(observed("dry_friction"), Alone(), CANDIDATES)
    assert search.partners(found("dry_friction").baseline, [full]) == ()


def test_candidates_that_do_not_exist_find_nothing():
    search = Search(observed("dry_friction", samples=SAMPLES), Alone(), ("no_such_effect",))
    assert search.singles(search.baseline()).candidates == ()


def test_a_special_case_begins_where_its_general_form_ended():
    general = ("directional_friction", "dry_friction")
    search = Search(observed("dry_friction", samples=SAMPLES), Alone(), general)
    told = search.singles(search.baseline())
    by_name = {item.effects[-1]: item for item in told.candidates}
    assert set(by_name) == set(general)
    # What is a special case fits no better than the general form, and here nearly as well.
    assert by_name["dry_friction"].score == pytest.approx(by_name["directional_friction"].score, abs=0.05)


def test_a_pair_is_named_among_near_relations():
    # Beside eddy currents, which pass for a delay, the general form of friction leads at first.
    alike = ("directional_friction", "dry_friction", "latency", "eddy_currents")
    told = diagnose(observed("dry_friction+latency", seed=5, samples=SAMPLES), Alone(), candidates=alike)
    assert set(told.combination) == {"dry_friction", "latency"}
    assert told.gap.closed > 0.9


def test_coarse_steps_are_named_beside_another_effect():
    candidates = ("clock_skew", "quantization", "sensor_nonlinearity")
    told = diagnose(observed("clock_skew+quantization", seed=3, samples=SAMPLES), Alone(), candidates=candidates)
    assert set(told.combination) == {"clock_skew", "quantization"}


def test_a_second_round_loses_nothing_of_the_first():
    search = Search(observed("dry_friction", samples=SAMPLES), Alone(), ("sensor_lag", "tissue_stiffening"))
    first = search.singles(search.baseline())
    then = search.further(first)
    before = {item.effects: item.score for item in first.candidates}
    after = {item.effects: item.score for item in then.candidates}
    assert set(after) >= set(before)
    assert all(after[effects] <= score for effects, score in before.items())
