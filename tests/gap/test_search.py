"""The search on laboratory records: best candidate, applicable effects, progress, cancellation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_records import changed, observed, recorded

from tissueid.errors import CancelledError
from tissueid.gap import diagnosis
from tissueid.gap.answer import as_answer
from tissueid.gap.decision import Candidate
from tissueid.gap.diagnosis import diagnose
from tissueid.gap.fit_tasks import Task, refit
from tissueid.gap.noise import rests
from tissueid.gap.preparation import prepare
from tissueid.gap.search import (
    Search,
    SearchProgress,
    SearchResult,
    applicable,
)
from tissueid.gap.thresholds import LIMITS, THRESHOLDS
from tissueid.gap.workers import SerialExecutor
from tissueid.twin.bus import MOST_EFFECTS
from tissueid.twin.catalogue import all_effects, effect

CANDIDATES = ("dry_friction", "directional_damping", "sensor_lag")
SAMPLES = 3000


@cache
def found(name: str) -> SearchResult:
    search = Search(observed(name), SerialExecutor(), CANDIDATES)
    return search.singles(search.baseline())


@pytest.mark.parametrize("name", ["dry_friction", "directional_damping"])
def test_the_right_effect_is_best_scored(name):
    result = found(name)
    assert result.candidates[0].effects == (name,)
    assert result.candidates[0].score < 0.2 < 3.0 < result.baseline.score
    scores = [item.score for item in result.candidates]
    assert scores == sorted(scores)


def test_only_the_candidates_take_part():
    assert {item.effect for item in found("dry_friction").signatures} == set(CANDIDATES)
    assert {name for item in found("dry_friction").candidates for name in item.effects} <= set(CANDIDATES)


def test_without_the_right_one_nothing_explains():
    seen, both = observed("dry_friction", samples=SAMPLES), ("dry_friction", "sensor_lag")
    result = diagnose(seen, SerialExecutor(), candidates=both, without=("dry_friction",))
    assert (result.verdict, result.combination) == ("unexplained", ())
    assert "gap.left_out" in {item.code for item in result.remarks}
    assert as_answer(result)["without"] == ["dry_friction"]
    assert [item["effect"] for item in as_answer(result)["ranking"]] == ["sensor_lag"]


def test_after_the_time_limit_no_further_step_begins():
    result = diagnose(
        observed("dry_friction", samples=SAMPLES), SerialExecutor(), candidates=("sensor_lag",), seconds=1e-9
    )
    assert {"leading candidates", "additions", "detection limits"} <= set(result.not_tried)
    assert [item.effect for item in result.ranking] == ["sensor_lag"]
    assert as_answer(result)["not_tried"] == list(result.not_tried)
    assert "gap.not_tried" in {item.code for item in result.remarks}


def test_an_explanation_that_the_check_contradicts_is_not_named(monkeypatch):
    monkeypatch.setattr(diagnosis, "confirmed", lambda *figures: False)
    result = diagnose(observed("dry_friction", samples=SAMPLES), SerialExecutor(), candidates=("dry_friction",))
    assert (result.verdict, result.combination, result.budget) == ("unexplained", (), None)
    assert "gap.not_confirmed" in {item.code for item in result.remarks}
    assert result.ranking[0].effect == "dry_friction"


def test_a_diagnosis_names_the_effect():
    result = diagnose(observed("dry_friction"), SerialExecutor(), candidates=CANDIDATES)
    assert (result.verdict, result.combination, result.where.stage) == ("effect", ("dry_friction",), "mechanics")
    assert result.ranking[0].effect == "dry_friction"
    assert result.ranking[0].probability > 0.9
    assert result.gap.closed > 0.95
    low, high = result.gap.closed_ci
    assert low <= result.gap.closed <= high
    assert result.gap.floor <= result.gap.after < result.gap.before
    assert sum(item.probability for item in result.ranking) <= 1.0


def test_a_known_effect_is_part_of_the_baseline():
    result = diagnose(
        observed("sensor_lag", samples=SAMPLES), SerialExecutor(), accepted=("sensor_lag",), candidates=CANDIDATES
    )
    assert result.search_result.baseline.effects == ("sensor_lag",)
    assert (result.verdict, result.combination) == ("no_gap", ())
    assert all(len(set(item.effects)) == len(item.effects) for item in result.search_result.candidates)
    assert "sensor_lag" not in {item.effect for item in result.ranking}


def test_progress_runs_from_nothing_to_all():
    steps: list[SearchProgress] = []
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), CANDIDATES, steps.append)
    search.singles(search.baseline())
    assert steps[0] == SearchProgress("baseline", 0, 1)
    assert all(0 <= step.done <= step.total for step in steps)
    last = {step.what: step for step in steps}
    assert all(step.done == step.total for step in last.values())
    assert last["screening"].total == len(CANDIDATES)


@pytest.mark.parametrize("after", [0, 1, 6])
def test_cancelled(after):
    steps: list[SearchProgress] = []
    search = Search(
        observed("dry_friction", samples=SAMPLES),
        SerialExecutor(),
        CANDIDATES,
        steps.append,
        cancelled=lambda: len(steps) > after,
    )
    with pytest.raises(CancelledError):
        search.singles(search.baseline())


def test_missing_signals_exclude_effects():
    everything = observed()
    assert all(applicable(everything, item) for item in all_effects().values())
    no_voltage = prepare(changed(recorded(), voltage=None))
    assert no_voltage.channels == ("current", "position")
    assert not applicable(no_voltage, effect("amplifier_deadband"))
    assert applicable(no_voltage, effect("dry_friction"))
    position_alone = prepare(changed(recorded(), voltage=None, current=None))
    assert not applicable(position_alone, effect("eddy_currents"))
    assert applicable(position_alone, effect("dry_friction"))


@pytest.mark.parametrize(
    ("name", "full", "tried"),
    [("dry_friction", True, False), ("physiological_motion", True, True), ("dry_friction", False, True)],
)
def test_motion_of_the_body_is_a_candidate_unless_the_probe_rests_in_quiet_tests(name, full, tried):
    search = Search(observed(name, samples=9000, full=full), SerialExecutor())
    assert ("physiological_motion" in search.names) is tried
    assert "dry_friction" in search.names


@pytest.mark.parametrize(
    ("moved", "resting"),
    [
        (lambda time: 0.0 * time, True),
        (lambda time: 2e-5 * np.sin(2.0 * np.pi * 0.15 * time), False),
        (lambda time: 1e-3 * np.exp(-time), False),
        (lambda time: np.where(time > 1e9, 0.0, np.nan), False),
    ],
)
def test_a_probe_rests_where_its_position_in_the_quiet_test_is_noise(moved, resting):
    still = observed("dry_friction", samples=9000, full=True)

    def with_motion(test):
        time = np.arange(test.command.size) / test.sample_rate_hz
        position = test.signals["position"] + (moved(time) if test.quiet else 0.0)
        return replace(test, signals={**test.signals, "position": position})

    assert rests(replace(still, tests=tuple(map(with_motion, still.tests)))) is resting


def test_a_position_in_steps_does_not_show_that_a_probe_rests():
    still = observed("dry_friction", samples=9000, full=True)
    step = 2e-5
    tests = [
        replace(test, signals={**test.signals, "position": step * np.round(test.signals["position"] / step)})
        for test in still.tests
    ]
    assert not rests(replace(still, tests=tuple(tests), noise={**still.noise, "position": step}))


def test_the_same_twice():
    search = Search(observed("dry_friction"), SerialExecutor(), CANDIDATES)
    again = search.singles(search.baseline())
    assert [(item.effects, item.score) for item in again.candidates] == [
        (item.effects, item.score) for item in found("dry_friction").candidates
    ]


def test_a_candidate_with_the_most_effects_gets_no_more():
    full = Candidate(tuple(all_effects())[:MOST_EFFECTS], found("dry_friction").baseline.fit, (), ())
    search = Search(observed("dry_friction"), SerialExecutor(), CANDIDATES)
    assert search.add_to([full]) == ()


def test_unknown_candidates_find_nothing():
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), ("no_such_effect",))
    assert search.singles(search.baseline()).candidates == ()


def test_a_special_case_starts_at_the_fit_of_its_general_form():
    general = ("directional_friction", "dry_friction")
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), general)
    result = search.singles(search.baseline())
    by_name = {item.effects[-1]: item for item in result.candidates}
    assert set(by_name) == set(general)
    # A special case fits no better than the general form, and here nearly as well.
    assert by_name["dry_friction"].score == pytest.approx(by_name["directional_friction"].score, abs=0.05)


@pytest.mark.soak
def test_a_pair_is_named_among_nested_models():
    # With eddy currents, which resemble a delay, the general form of friction leads at first.
    alike = ("directional_friction", "dry_friction", "latency", "eddy_currents")
    result = diagnose(observed("dry_friction+latency", seed=5, samples=SAMPLES), SerialExecutor(), candidates=alike)
    assert set(result.combination) == {"dry_friction", "latency"}
    assert result.gap.closed > 0.9


@pytest.mark.soak
def test_coarse_steps_are_named_in_a_pair():
    candidates = ("clock_skew", "quantization", "sensor_nonlinearity")
    result = diagnose(
        observed("clock_skew+quantization", seed=8, samples=SAMPLES), SerialExecutor(), candidates=candidates
    )
    assert set(result.combination) == {"clock_skew", "quantization"}


@pytest.mark.parametrize("full", [False, True])
def test_a_fit_from_a_weak_start_ends_at_the_minimum(full):
    seen = observed("dry_friction", samples=SAMPLES, full=full)
    search = Search(seen, SerialExecutor(), CANDIDATES)
    near = search.baseline().fit
    weak = effect("dry_friction").weak_starts[0]
    task = Task(search.dataset, ("dry_friction",), (weak,), near, 30)
    tracked, untracked = refit(replace(task, tracking_rad_s=(100.0,))), refit(task)
    assert tracked.score == pytest.approx(untracked.score, abs=0.02)
    assert tracked.fit.cost == pytest.approx(untracked.fit.cost, rel=0.01)


def test_each_set_without_a_member_is_fitted_once():
    steps: list[SearchProgress] = []
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), CANDIDATES, steps.append)
    near, names = search.baseline().fit, ("dry_friction", "sensor_lag")
    pair = refit(Task(search.dataset, names, tuple(effect(name).starts[0] for name in names), near, 6))
    first = search.remove_from(pair, names)
    steps.clear()
    assert all(one is other for one, other in zip(search.remove_from(pair, names[::-1]), first[::-1], strict=True))
    assert not steps


class Recorder(SerialExecutor):
    """Executor that keeps the fits that it was asked for."""

    def __init__(self) -> None:
        self.tasks: list[Task] = []

    def do(self, work, things, cancelled, done):
        self.tasks += [item for item in things if isinstance(item, Task)]
        return super().do(work, things, cancelled, done)


@pytest.mark.parametrize("hidden", ["directional_damping", "directional_damping+sensor_lag"])
def test_the_last_weak_start_is_on_the_surface_that_was_found_and_follows_where_much_is_left(hidden):
    session = recorded(hidden, samples=SAMPLES)
    first = session.tests[0]
    deeper = replace(first, surface_position_m=first.surface_position_m - 2e-4)
    recorder = Recorder()
    search = Search(prepare(replace(session, tests=(deeper,))), recorder, ("directional_damping", "added_mass"))
    baseline = search.baseline()
    assert abs(baseline.fit.value("surface_shift_m")) > 1e-5
    (found,) = search.tissue_set(baseline)
    then = search.tissue_set_again(baseline, found)
    shifts = [task.near.value("surface_shift_m") for task in recorder.tasks]
    assert shifts == [*[baseline.fit.value("surface_shift_m")] * 2, *([0.0] if "+" in hidden else [])]
    assert (found.score > THRESHOLDS.set_gain) == ("+" in hidden)
    assert then.fit.cost <= found.fit.cost


def test_a_set_without_a_clearly_needed_member_is_fitted_further_only_where_it_matters():
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), CANDIDATES)
    near, names = search.baseline().fit, ("dry_friction", "sensor_lag")
    pair = refit(Task(search.dataset, names, tuple(effect(name).starts[0] for name in names), near, 6))
    needed, needless = search.remove_from(pair, names, briefly=True)
    assert needed.score - pair.score > LIMITS.clearly_needed > needless.score - pair.score
    thorough = search.remove_from(pair, names)
    assert thorough[1] is needless
    assert thorough[0] is not needed
    assert thorough[0].fit.cost <= needed.fit.cost


def test_further_effects_are_tried_before_they_are_fitted():
    recorder = Recorder()
    more = (*CANDIDATES, "tissue_stiffening", "viscoelasticity", "tissue_hysteresis", "directional_friction")
    search = Search(observed("dry_friction", samples=SAMPLES), recorder, more)
    added = search.add_to([search.baseline()])
    trials = [task.names for task in recorder.tasks if task.most_steps == LIMITS.trial_steps]
    fitted = [task.names for task in recorder.tasks if task.most_steps == LIMITS.short_steps]
    assert len(set(trials)) == len(trials) > len(fitted) == LIMITS.fits
    assert fitted[: LIMITS.beam] == trials[: LIMITS.beam]
    assert set(fitted) <= set(trials)
    assert ("dry_friction",) in {item.effects for item in added}


def test_a_second_round_keeps_the_results_of_the_first():
    search = Search(observed("dry_friction", samples=SAMPLES), SerialExecutor(), ("sensor_lag", "tissue_stiffening"))
    first = search.singles(search.baseline())
    then = search.further(first)
    before = {item.effects: item.score for item in first.candidates}
    after = {item.effects: item.score for item in then.candidates}
    assert set(after) >= set(before)
    assert all(after[effects] <= score for effects, score in before.items())


def test_a_set_of_three_is_named_with_its_budget():
    names = {"dry_friction", "directional_damping", "latency"}
    record = observed("dry_friction+directional_damping+latency")
    result = diagnose(record, SerialExecutor(), candidates=(*names, "sensor_lag"))
    assert (result.verdict, set(result.combination)) == ("effect", names)
    budget = result.budget
    assert budget is not None
    assert {step.effect for step in budget.steps} == names
    assert budget.after == pytest.approx(result.gap.after, rel=0.02)
    assert (budget.before, budget.floor) == (result.gap.before, result.gap.floor)
    assert sum(step.added for step in budget.steps) == pytest.approx(1.0 - budget.remains)
    for step in budget.steps:
        assert step.added_ci[0] <= step.added <= step.added_ci[1]
        assert step.removed > 0.0
    answer = as_answer(result)
    assert {item["effect"] for item in answer["ranking"][:3]} == names
    assert [item["effect"] for item in answer["budget"]] == [step.effect for step in budget.steps]
    assert sum(item["closed_when_added"] for item in answer["budget"]) == pytest.approx(result.gap.closed, abs=0.02)
    assert answer["remains"]["share"] == budget.remains
    for item, step in zip(answer["budget"], budget.steps, strict=True):
        assert item["closed_when_removed_ci"] == list(step.removed_ci)
        assert not set(item["alternatives"]) & names
