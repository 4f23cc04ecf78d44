"""Fits of the chain to recordings of the simulated laboratory with known parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_records import changed, observed, recorded, scenario

from tissueid.errors import CancelledError
from tissueid.gap.dataset import Purpose
from tissueid.gap.decision import errors
from tissueid.gap.fit_tasks import Task, refit
from tissueid.gap.fitting import SLOPE_STEP_S, Differences, Fit, LinearRefit, fit, predict, re_estimate
from tissueid.gap.parameters import WITHIN_STDS, parametrise
from tissueid.gap.preparation import prepare
from tissueid.gap.thresholds import LIMITS
from tissueid.twin.catalogue import effect
from tissueid.twin.effect import Effect, Parameter


@cache
def baseline(name: str = "", *, full: bool = False) -> Fit:
    return fit(observed(name, 4 if full else 3, full=full))


@pytest.mark.parametrize("full", [False, True])
def test_without_an_effect_a_refit_leaves_the_noise(full):
    found = errors(baseline(full=full), Purpose.FIT, Purpose.CHOICE, Purpose.CHECK)
    assert {item.channel for item in found} == {"voltage", "current", "position"}
    for item in found:
        assert item.square / item.noise**2 == pytest.approx(1.0, abs=0.3)


def test_the_true_figures_are_found():
    figures, found = scenario().figures, baseline()
    instrument = found.parameters.instrument(found.theta)
    met = found.parameters.tissue_of(found.theta, observed().tests[0])
    assert instrument.amplifier_gain == pytest.approx(figures.amplifier_gain, rel=2e-3)
    assert instrument.resistance_ohm == pytest.approx(figures.resistance_ohm, rel=2e-3)
    depth = np.array([0.5, 1.0, 1.2]) * figures.depth_m
    truth = figures.stiffness_n_per_m * np.exp(figures.stiffness_rate_per_m * depth) * depth
    result = met.stiffness_n_per_m * np.exp(met.stiffness_growth_per_m * depth) * depth
    scale = instrument.force_constant_n_per_a / figures.force_constant_n_per_a
    weight = found.value("weight_n") / scale - figures.weight_n
    assert result / scale - weight == pytest.approx(truth, rel=0.02)


def test_an_effect_is_part_of_the_noise_only_once_added():
    before = baseline("dry_friction")
    after = fit(observed("dry_friction"), [effect("dry_friction")], near=before)
    position = next(item for item in errors(before, Purpose.CHECK) if item.channel == "position")
    assert position.ratio > 30.0
    assert after.cost < 0.1 * before.cost
    for item in errors(after, Purpose.CHECK):
        assert item.ratio < 1.5


def test_whole_tests_that_are_held_out_are_predicted_as_well():
    found, seen = baseline(full=True), observed("", 4, full=True)
    assert not seen.tests[3].serving(Purpose.FIT).any()
    for test, predicted in zip(seen.tests, found.predictions, strict=True):
        assert {name: values.shape for name, values in predicted.items()} == dict.fromkeys(
            seen.channels, test.command.shape
        )


def test_errors_of_the_surfaces_are_fitted_where_tests_do_not_begin_at_them():
    wrong_m = 1.5e-4
    tests = [
        replace(test, surface_position_m=test.surface_position_m - wrong_m)
        for test in recorded("", 4, 3000, full=True).tests
    ]
    found = fit(prepare(replace(recorded("", 4, 3000, full=True), tests=tuple(tests))))
    # A deeper surface and a stiffer tissue differ little, so that the prior keeps part of the error.
    assert found.value("surface_shift_m") == pytest.approx(wrong_m, rel=0.4)
    assert found.value("spring_shift_m") == pytest.approx(wrong_m, rel=0.15)
    for item in errors(found, Purpose.CHECK):
        assert item.square / item.noise**2 == pytest.approx(1.0, abs=0.3)
    assert not {"surface_shift_m", "spring_shift_m"} & set(baseline(full=True).parameters.index)


def test_a_fit_to_one_test_starts_a_fit_to_all():
    seen = observed("", 4, full=True)
    one = fit(replace(seen, tests=seen.tests[1:2]), near=baseline(full=True))
    again = fit(seen, near=one)
    assert one.residuals.size < again.residuals.size
    assert again.cost == pytest.approx(baseline(full=True).cost, rel=1e-3)


def test_predictions_are_those_of_the_vector():
    found = baseline()
    again = predict(found.parameters, found.theta)
    assert np.array_equal(again[0]["position"], found.predictions[0]["position"])


def test_the_cost_is_residuals_and_priors():
    found = baseline()
    prior, std = found.parameters.array("prior"), found.parameters.array("prior_std")
    off = (found.theta - prior) / std
    assert found.cost == pytest.approx(float(found.residuals @ found.residuals + off @ off), rel=1e-9)
    serving = int(observed().tests[0].serving(Purpose.FIT).sum())
    assert found.residuals.shape == (3 * serving,)
    assert found.jacobian.shape == (3 * serving, len(found.parameters.coordinates))


def test_bounds_hold_where_the_truth_lies_beyond():
    wrong = replace(recorded().instrument, coil_resistance_ohm=9.0, moving_mass_kg=0.15)
    found = fit(prepare(replace(recorded(), instrument=wrong)))
    assert np.all(found.theta >= found.parameters.array("low"))
    assert np.all(found.theta <= found.parameters.array("high"))
    spread = wrong.calibration_relative_uncertainty
    assert found.value("resistance_ohm") == pytest.approx(WITHIN_STDS * spread)


def test_bounds_of_an_effect_hold():
    chosen = effect("directional_damping")
    found = fit(observed("dry_friction"), [chosen], near=baseline("dry_friction"))
    values = found.parameters.effect_values(found.theta, chosen, 1)
    for parameter, value in zip(chosen.parameters, values, strict=True):
        assert parameter.low * (1 - 1e-9) - 1e-12 <= value <= parameter.high * (1 + 1e-9) + 1e-12


def test_parameters_without_influence_stay_at_their_prior():
    still = replace(recorded(full=True), tests=recorded(full=True).tests[:1])
    found = fit(prepare(still))
    by_name = {item.name: item for item in found.parameters.coordinates}
    for name in ("inductance_h", "resistance_ohm", "amplifier_gain"):
        item = by_name[name]
        assert abs(found.value(name) - item.prior) < 0.5 * item.prior_std


def test_a_better_calibration_binds_the_instrument():
    sure = replace(recorded().instrument, calibration_relative_uncertainty=1e-5)
    found = fit(prepare(replace(recorded(), instrument=sure)))
    assert abs(found.value("resistance_ohm")) <= 1.001 * WITHIN_STDS * 1e-5
    assert found.cost > 2.0 * baseline().cost


def test_the_same_twice():
    one, other = baseline("dry_friction"), fit(observed("dry_friction"))
    assert np.array_equal(one.theta, other.theta)
    assert one.cost == other.cost


def test_cancelled():
    with pytest.raises(CancelledError):
        fit(observed(), cancelled=lambda: True)


def test_no_more_steps_than_allowed():
    assert fit(observed("dry_friction"), most_steps=2).steps <= 2


def test_differences_are_what_an_effect_changes():
    chosen = effect("dry_friction")
    before = baseline()
    added, _ = Differences(before).at(chosen, chosen.starts[0])
    parameters = parametrise(observed(), [chosen])
    theta = parameters.array("start")
    for name, place in before.parameters.index.items():
        theta[parameters.index[name]] = before.value(name)
        assert before.theta[place] == before.value(name)
    without = predict(before.parameters, before.theta, step_s=SLOPE_STEP_S)[0]
    moved = predict(parameters, theta, step_s=SLOPE_STEP_S)[0]["current"] - without["current"]
    serving = observed().tests[0].serving(Purpose.FIT)
    size = int(serving.sum())
    # Channels are in the order voltage, current, position.
    assert added[size : 2 * size] == pytest.approx(moved[serving] / observed().noise["current"], abs=1e-6)


def test_per_test_parameters_of_held_out_tests_are_not_fitted():
    session = recorded(samples=3000, full=True)
    numbers = [test.number for test in session.tests if test.kind == "stochastic"]
    seen = prepare(session, fit=numbers[:1], check=numbers[:2])
    assert not seen.tests[1].serving(Purpose.FIT).any()
    parameters = parametrise(seen, [effect("physiological_motion")])
    own = [name for name in parameters.index if name.startswith("physiological_motion.pulse_cosine_1_m")]
    assert own == [f"physiological_motion.pulse_cosine_1_m@{numbers[0]}"]
    assert f"physiological_motion.pulse_cosine_1_m@{numbers[1]}" in parameters.constants


def test_per_test_parameters_of_held_out_tests_are_estimated_after_the_fit():
    session = recorded(samples=3000, full=True)
    numbers = [test.number for test in session.tests if test.kind == "stochastic"]
    seen, one = prepare(session, fit=numbers[:1], check=numbers[:2]), effect("physiological_motion")
    again = re_estimate(fit(seen, [one], near=fit(seen), most_steps=2), most_steps=1)
    fresh = again.parameters.re_estimate(one, predict(again.parameters.without(one.name), again.theta))
    own = [name for name in fresh.constants if name.endswith(f"@{numbers[1]}")]
    assert len(own) == len(one.parameters)
    assert {name: again.parameters.constants[name] for name in own} == {name: fresh.constants[name] for name in own}
    result = predict(again.parameters, again.theta)[1]
    np.testing.assert_array_equal(again.predictions[1]["position"], result["position"])


def test_estimates_are_kept_when_a_fit_continues():
    asked = []

    def estimate_from_record(signals, rate):
        asked.append(rate)
        return {"late_s": 1e-3 * len(asked)}

    late = Parameter("late_s", "s", 0.0, 0.0, 1.0, per_test=True, fixed=True)
    about = ("read", "sensing", "", "", "", "", (late,), ((0.0,),))
    one = Effect(*about, recording=lambda given, values: given, estimate_from_record=estimate_from_record)
    first = parametrise(observed(), [one])
    assert parametrise(observed(), [one, effect("sensor_lag")], continued=first).constants == {"read.late_s@1": 1e-3}
    assert len(asked) == 1
    assert parametrise(observed(), [one], continued=parametrise(observed())).constants == {"read.late_s@1": 2e-3}


def test_lost_samples_are_re_estimated_with_the_fitted_rest():
    session = recorded()
    position = session.tests[0].signals["position"]
    at, lost = 2311, 3
    slipped = np.r_[position[:at], position[at + lost :], np.full(lost, np.nan)]
    one, seen = effect("dropped_samples"), prepare(changed(session, position=slipped))
    first = fit(seen, [one], near=fit(seen))
    again = re_estimate(first)
    values = again.parameters.effect_values(again.theta, one, 1)
    assert [(int(sample), int(gone)) for sample, gone in zip(values[1::2], values[2::2], strict=True) if gone] == [
        (at, lost)
    ]
    assert again.cost <= first.cost
    for item in errors(again, Purpose.CHECK):
        assert item.ratio < 1.3


def two_tests() -> Fit:
    session = recorded(samples=3000, full=True)
    numbers = [test.number for test in session.tests if test.kind == "stochastic"]
    seen = prepare(session, fit=numbers[:2])
    return fit(seen, [effect("physiological_motion")], near=fit(seen), most_steps=2)


def test_a_linear_refit_test_by_test_is_that_of_all_columns():
    found = two_tests()
    coordinates, size = found.parameters.coordinates, found.residuals.size
    one, other = (test for test in found.parameters.dataset.tests if test.serving(Purpose.FIT).any())
    first = 3 * int(one.serving(Purpose.FIT).sum())
    places = {one.number: slice(first), other.number: slice(first, size)}
    columns = np.zeros((size, len(coordinates)))
    for k, item in enumerate(coordinates):
        rows = places.get(item.test, slice(size))
        columns[rows, k] = found.jacobian[rows, k]
    columns /= np.linalg.norm(columns, axis=0)
    changes = np.random.default_rng(2).normal(size=(size, 3))
    expected = changes - columns @ np.linalg.lstsq(columns, changes, rcond=1e-7)[0]
    np.testing.assert_allclose(LinearRefit(found).surviving(changes), expected, atol=2e-3)
    without = np.linalg.norm(LinearRefit(found, "physiological_motion").surviving(columns), axis=0)
    own = np.array([name.startswith("physiological_motion.") for name in found.parameters.index])
    assert without[~own].max() < 1e-5
    assert without[own].max() > 0.1


def test_a_short_fit_keeps_the_estimates_of_the_fit_near_it():
    found = two_tests()
    name, start = "physiological_motion", effect("physiological_motion").starts[0]
    drag = effect("quadratic_drag")
    task = Task(found.parameters.dataset, (name, drag.name), (start, drag.starts[0]), found, 2)
    kept = refit(task).fit.parameters.constants
    rates = [item for item in found.parameters.constants if "_hz@" in item]
    assert rates
    assert {item: kept[item] for item in rates} == {item: found.parameters.constants[item] for item in rates}
    longer = refit(replace(task, most_steps=LIMITS.steps_to_re_estimate)).fit.parameters.constants
    assert {item: longer[item] for item in rates} != {item: kept[item] for item in rates}


def test_effects_without_re_estimates_are_unchanged():
    found = baseline()
    assert re_estimate(found) is found
