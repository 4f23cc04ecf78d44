"""Scores of a blind check, on answers made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tissueid_lab.blind_check.scoring import (
    FULL,
    SINGLE,
    TAKEN_OUT,
    Answered,
    BlindScore,
    Label,
    Measured,
    Rate,
    constant_answer_share,
    in_sample,
    permuted,
    score_of,
)

STAGES = {"dry_friction": "mechanics", "sensor_lag": "sensing", "eddy_currents": "coil", "slew_rate": "drive"}
UNLISTED = "slew_rate"


def case(
    true: str = "dry_friction",
    ranking: str = "dry_friction",
    verdict: str = "effect",
    probability: float = 0.8,
    **others: Any,
) -> Answered:
    """Return a case whose top candidate is named, unless ``named`` is given."""
    effects, ranked = tuple(true.split()), ranking.split()
    result = {
        "before": 0.1,
        "after": 0.02,
        "floor": 0.01,
        "closed": 0.9,
        "announced": 0.92,
    } | others.get("gap", {})
    alike = others.get("alike", [])
    named = others.get("named", ranked[:1] if verdict == "effect" else [])
    answer = {
        "verdict": verdict,
        "gap": result,
        "where": {"stage": others.get("stage", STAGES.get(effects[0] if effects else "", "mechanics"))},
        "ranking": [{"effect": name, "probability": probability, "indistinguishable": alike} for name in ranked],
        "combination": named,
        "in_sample": others.get("in_sample"),
        "survive_alone": others.get("survive_alone", []),
    }
    label = Label(effects, tuple(STAGES[name] for name in effects), tuple(name != UNLISTED for name in effects), False)
    return Answered(others.get("name", "scenario-0001"), label, answer, others.get("oracle"))


def rate(score: BlindScore, what: str) -> Rate:
    return next(item for item in score.rates if item.what == what)


def figure(score: BlindScore, what: str) -> Measured:
    return next(item for item in score.figures if item.what.startswith(what))


def test_wilsons_interval():
    # Newcombe, Statistics in Medicine 17 (1998) 857, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for hits, cases, low, high in [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (1, 29, 0.0061, 0.1718)]:
        assert Rate("", hits, cases, 0.5).interval == pytest.approx((low, high), abs=1e-4)
    assert Rate("", 0, 20, 0.5).interval == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert np.isnan(Rate("", 0, 0, 0.5).interval).all()


def test_targets_are_reached_or_not():
    assert Rate("", 9, 10, 0.9).reached is True
    assert Rate("", 8, 10, 0.9).reached is False
    assert Rate("", 1, 10, 0.05, at_least=False).reached is False
    assert Rate("", 0, 10, 0.05, at_least=False).reached is True
    assert Rate("", 0, 0, 0.9).reached is None
    assert np.isnan(Rate("", 0, 0, 0.9).share)
    assert Measured("", 0.9, 4, 0.8).reached is True
    assert Measured("", 0.9, 4, 0.8, at_least=False).reached is False
    assert Measured("", 0.9, 4).reached is None
    assert Measured("", 0.9, 0, 0.8).reached is None


def test_targets_of_full_sessions_are_higher():
    assert FULL.top1 > SINGLE.top1
    assert FULL.wrong_and_sure < SINGLE.wrong_and_sure


def test_single_effects_are_named():
    cases = [
        case(),
        case(ranking="sensor_lag dry_friction", alike=["dry_friction"]),
        case(ranking="sensor_lag eddy_currents dry_friction"),
        case(ranking="sensor_lag", verdict="unexplained", stage="sensing"),
    ]
    score = score_of(cases, SINGLE)
    assert (rate(score, "top-1").hits, rate(score, "top-1").cases) == (1, 4)
    assert rate(score, "top-1 including inseparable effects").hits == 2
    assert rate(score, "top-3").hits == 3
    assert rate(score, "stage").hits == 3
    assert rate(score, "known effect: unexplained").hits == 1
    assert rate(score, "gap missed").hits == 0
    assert rate(score, "top-1").target == SINGLE.top1
    assert score.confusion == {"dry_friction": {"dry_friction": 1, "sensor_lag": 2, "unexplained": 1}}


def test_a_missed_gap_and_an_empty_ranking():
    score = score_of([case(ranking="", verdict="no_gap")], SINGLE)
    assert rate(score, "gap missed").share == 1.0
    assert rate(score, "top-3").hits == 0


def test_gaps_that_do_not_survive_the_refit_do_not_count():
    score = score_of([case(gap={"before": 0.0115})], SINGLE)
    assert rate(score, "top-1").cases == 0
    assert rate(score_of([case(gap={"before": None})], SINGLE), "top-1").cases == 0


def test_unknown_effects_should_be_unexplained_with_the_right_stage():
    cases = [case(UNLISTED, verdict="unexplained"), case(UNLISTED, stage="mechanics")]
    score = score_of(cases, SINGLE)
    result = rate(score, "unknown effect: unexplained")
    assert (result.hits, result.cases) == (1, 2)
    assert (rate(score, "stage").hits, rate(score, "stage").cases) == (1, 2)
    assert rate(score, "top-1").cases == 0


def test_wrong_names_count_where_they_are_sure():
    wrong = {"ranking": "sensor_lag"}
    cases = [case(**wrong, probability=0.95), case(**wrong, probability=0.85), case(probability=0.99)]
    result = rate(score_of(cases, SINGLE), "wrong name at 90 % or more")
    assert (result.hits, result.cases) == (1, 3)


def test_false_alarms():
    cases = [case("", ranking="", verdict="no_gap"), case("", verdict="unexplained"), case("")]
    result = rate(score_of(cases, SINGLE), "false alarms without effect")
    assert (result.hits, result.cases) == (2, 3)


def test_pairs_are_scored_by_f1_of_the_named_set():
    cases = [
        case("dry_friction sensor_lag", named=["dry_friction", "sensor_lag"]),
        case("dry_friction sensor_lag", named=["dry_friction"]),
        case("dry_friction sensor_lag", named=["eddy_currents"]),
    ]
    result = figure(score_of(cases, SINGLE), "pairs")
    # 3 hits, 4 named, 6 true.
    assert result.value == pytest.approx(2 * 3 / (4 + 6))
    assert result.cases == 3
    assert np.isnan(figure(score_of([], SINGLE), "pairs").value)


def test_targets_of_pairs_need_a_gap_of_each_effect():
    pair, both = "dry_friction sensor_lag", ["dry_friction", "sensor_lag"]
    cases = [
        case(pair, named=both, survive_alone=[True, True]),
        case(pair, named=["dry_friction"], survive_alone=[True, False]),
        case(pair, named=["dry_friction"]),
    ]
    score = score_of(cases, SINGLE)
    asked, all_pairs = figure(score, "pairs"), figure(score, "the same")
    assert (asked.value, asked.cases, asked.target) == (pytest.approx(2 * 3 / (3 + 4)), 2, SINGLE.pairs)
    assert (all_pairs.value, all_pairs.cases, all_pairs.target) == (pytest.approx(2 * 4 / (4 + 6)), 3, None)


def test_closed_relative_to_what_the_true_form_closes():
    half = float(np.sqrt(0.01**2 + (0.5**2) * (0.1**2 - 0.01**2)))
    cases = [case(oracle=0.01), case(oracle=half, gap={"closed": 0.4})]
    assert cases[0].best_closed == pytest.approx(1.0)
    assert cases[1].best_closed == pytest.approx(0.5)
    score = score_of(cases, SINGLE)
    assert figure(score, "closed share relative to the true model, median").value == pytest.approx(0.85)
    assert figure(score, "closed share relative to the true model, 10th").value == pytest.approx(0.81)
    assert figure(score, "predicted minus").value == pytest.approx(0.5 * (0.02 + 0.52))


def test_calibration_error_and_brier_score():
    cases = [case(probability=0.95)] * 3 + [case(ranking="sensor_lag", probability=0.95)]
    cases += [case(probability=0.35), case(ranking="sensor_lag", probability=0.35)]
    score = score_of(cases, SINGLE)
    expected = (4 * abs(0.95 - 0.75) + 2 * abs(0.35 - 0.5)) / 6
    assert figure(score, "expected calibration error").value == pytest.approx(expected)
    brier = (3 * 0.05**2 + 0.95**2 + 0.65**2 + 0.35**2) / 6
    assert figure(score, "Brier").value == pytest.approx(brier)
    certain = score_of([case(probability=1.0)], SINGLE)
    assert figure(certain, "expected calibration error").value == 0.0


def test_few_exact_probabilities_show_a_calibration_error():
    def exact(*probabilities: float) -> float:
        score = score_of([case(probability=value) for value in probabilities], SINGLE)
        return figure(score, "calibration error of exact probabilities").value

    assert exact(1.0, 0.0) == 0.0
    # One answer at a half is off by a half, whether right or not; of many, about half are right.
    assert exact(0.5) == pytest.approx(0.5)
    assert exact(*[0.5] * 100) == pytest.approx(0.5 * np.sqrt(2.0 / np.pi / 100), rel=0.1)


def test_risk_grows_as_more_is_answered():
    cases = [case(probability=0.9), case(probability=0.8), case(ranking="sensor_lag", probability=0.2)]
    result = np.array(score_of(cases, SINGLE).risk_coverage)
    assert result == pytest.approx(np.array([(1 / 3, 0.0), (2 / 3, 0.0), (1.0, 1 / 3)]))


def test_failures_are_listed_one_per_line():
    cases = [
        case(name="good"),
        case(name="wrong", ranking="sensor_lag"),
        case("", name="alarm", verdict="unexplained"),
        case("", name="quiet", verdict="no_gap"),
        case(UNLISTED, name="unknown", verdict="unexplained"),
        case(UNLISTED, name="claimed"),
        case(name="stage", stage="sensing"),
        case(name="small", gap={"before": 0.011}, verdict="no_gap"),
        case(name="small and wrong", gap={"before": 0.011}, ranking="sensor_lag"),
    ]
    result = score_of(cases, SINGLE).failures
    assert [line.split(":")[0] for line in result] == ["wrong", "alarm", "claimed", "stage", "small and wrong"]
    assert "dry_friction; diagnosed as sensor_lag" in result[0]
    assert all("\n" not in line for line in result)


def test_no_cases_at_all():
    score = score_of([], SINGLE)
    assert all(item.reached is None for item in score.rates)
    assert score.failures == ()


def test_controls():
    cases = [case(in_sample="dry_friction"), case("sensor_lag", "sensor_lag", in_sample="dry_friction")]
    assert constant_answer_share(cases) == 0.5
    assert constant_answer_share(cases, "sensor_lag") == 0.5
    assert in_sample(cases) == 0.5
    assert np.isnan(constant_answer_share([]))
    assert np.isnan(in_sample([]))


def test_permuted_answers_keep_the_set_of_labels():
    cases = [case(true, true) for true in ("dry_friction", "sensor_lag", "eddy_currents") * 10]
    dealt = permuted(cases, 3)
    assert [item.answer for item in dealt] == [item.answer for item in cases]
    assert sorted(item.label.effects for item in dealt) == sorted(item.label.effects for item in cases)
    assert permuted(cases, 3) == dealt != permuted(cases, 4)
    assert rate(score_of(cases, SINGLE), "top-1").share == 1.0
    assert rate(score_of(dealt, SINGLE), "top-1").share < 0.7


def test_the_score_holds_its_controls():
    cases = [case(true, true, in_sample="dry_friction") for true in ("dry_friction", "sensor_lag") * 10]
    chance, habit, searched = score_of(cases, SINGLE).controls
    assert 0.35 < chance.value < 0.65
    assert (habit.value, searched.value) == (0.5, 0.5)
    assert {chance.cases, habit.cases, searched.cases} == {20}
    assert all(np.isnan(item.value) and item.reached is None for item in score_of([], SINGLE).controls)


def test_answers_without_the_true_effect_are_scored():
    again = [case(verdict="unexplained"), case(verdict="unexplained", stage="drive"), case(ranking="sensor_lag")]
    result = score_of([case()], SINGLE, again)
    assert (rate(result, TAKEN_OUT).hits, rate(result, TAKEN_OUT).cases) == (2, 3)
    assert (rate(result, "of these the right stage").hits, rate(result, "of these the right stage").cases) == (1, 2)
    assert TAKEN_OUT not in {item.what for item in score_of([case()], SINGLE).rates}
