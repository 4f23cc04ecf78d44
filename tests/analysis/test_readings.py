"""Readings of commercial probes against closed-form truth: a standard linear solid and a second-order system."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from analysis import simulated_steps as steps
from coded import coded
from identification.simulated import DAMPING, MASS, STIFFNESS, linear_record

from tissueid.analysis import fit_split, split_records
from tissueid.analysis.decay_readings import (
    LocalSystem,
    recorded_release,
    system_decay,
    trace_figures,
)
from tissueid.analysis.device_readings import device_readings, local_system, model_readings, recorded_readings
from tissueid.analysis.step_readings import Reading, find_steps, recorded_points, step_readings
from tissueid.errors import UnusableInputError
from tissueid.identification import get_engine
from tissueid.identification.second_order import SecondOrder
from tissueid.messages import code_of
from tissueid.records import Record
from tissueid.reports.readings_page import impulse_decay, recorded_step_plot, step_plot
from tissueid.sessions import Test

FOREARM = SecondOrder(MASS, DAMPING, STIFFNESS)


def by_name(readings: tuple[Reading, ...]) -> dict[str, Reading]:
    return {one.definition.name: one for one in readings}


def recorded(record: Record) -> tuple[dict[str, Reading], dict[str, float]]:
    """Return readings and truth of one cycle with holds of 1 s."""
    course = find_steps(record.input, record.sample_rate_hz)
    points = recorded_points(record.output, course)
    since = points.times_s - course.cycles[0].rise / record.sample_rate_hz
    return by_name(step_readings(points)), steps.true_lengths(1.0, float(since[2]), float(since[4]))


def test_a_step_of_a_standard_linear_solid_gives_its_lengths_and_ratios() -> None:
    """300 seeds give a bias of at most 0.16 % and 92 to 99 % within 1.96 standard deviations."""
    inside, total, errors = 0, 0, []
    for seed in range(12):
        found, truth = recorded(steps.step_record(np.random.default_rng(seed), noise_m=2e-5))
        for name, true in truth.items():
            estimate = found[name].estimate
            assert estimate is not None
            assert estimate.std is not None
            inside += abs(estimate.value - true) < 1.96 * estimate.std
            total += 1
            errors.append(estimate.value / true - 1.0)
    assert inside / total > 0.85
    assert abs(np.mean(errors)) < 0.01
    assert found["r0_m"].value == found["uf_m"].value
    assert found["r8_m"].value == found["ua_m"].value


def test_drift_widens_the_later_readings() -> None:
    still, _ = recorded(steps.step_record(np.random.default_rng(1)))
    drifting, truth = recorded(steps.step_record(np.random.default_rng(1), drift_m_per_s=5e-6))
    for name in ("uf_m", "ua_m", "r2"):
        estimate = drifting[name].estimate
        assert estimate is not None
        assert estimate.std is not None
        assert still[name].estimate is not None
        assert estimate.std > 3.0 * still[name].estimate.std
        assert abs(estimate.value - truth[name]) < 1.96 * estimate.std


def test_cycles_are_compared_where_there_are_several() -> None:
    one, _ = recorded(steps.step_record(np.random.default_rng(0)))
    for name in ("r3_m", "r4_m", "r9_m"):
        assert one[name].estimate is None
        assert code_of(one[name].reason) == "readings.one_cycle"
    record = steps.step_record(np.random.default_rng(0), cycles=3)
    course = find_steps(record.input, record.sample_rate_hz)
    assert len(course.cycles) == 3
    found = by_name(step_readings(recorded_points(record.output, course)))
    assert found["r9_m"].value == pytest.approx(found["r3_m"].value - found["r0_m"].value, abs=1e-12)
    # Creep of the earlier cycles that has not recovered after 1 s: by superposition of closed-form steps.
    left = 3.0 * sum(steps.compliance(t) - steps.compliance(t - 1.0) for t in (3.0, 5.0))
    assert found["r9_m"].value == pytest.approx(left, abs=3e-6)


def test_the_release_in_two_steps_gives_no_recovery_and_says_so() -> None:
    from tissueid.stimuli.kinds.quasi_static import StepHold

    force = StepHold(seconds=4.0, force_min_n=1.0, force_max_n=4.0).build().values
    found = by_name(step_readings(recorded_points(steps.creep(force, 2000.0), find_steps(force, 2000.0))))
    assert found["ue_m"].value == pytest.approx(3.0 * steps.compliance(0.1), rel=2e-3)
    assert found["ur_m"].estimate is None
    assert code_of(found["ur_m"].reason) == "readings.slow_release"
    assert found["ua_m"].estimate is not None


def test_noise_is_no_step_and_a_short_baseline_has_no_uncertainty() -> None:
    with pytest.raises(UnusableInputError, check=coded("readings.no_step")):
        find_steps(linear_record(1).input, 2000.0)
    with pytest.raises(UnusableInputError, check=coded("readings.no_step")):
        find_steps(np.full(4000, 2.0), 2000.0)
    record = steps.step_record(np.random.default_rng(0))[slice(1900, None)]
    found, _ = recorded(record)
    assert found["ue_m"].estimate is not None
    assert found["ue_m"].estimate.std is None
    assert code_of(found["ue_m"].reason) == "readings.short_baseline"


def test_lost_samples_leave_out_what_they_hold() -> None:
    record = steps.step_record(np.random.default_rng(0))
    output = record.output.copy()
    output[2150:2300] = np.nan
    found, truth = recorded(replace(record, output=output))
    assert found["ue_m"].estimate is None
    assert code_of(found["ue_m"].reason) == "readings.not_received"
    assert found["uf_m"].value == pytest.approx(truth["uf_m"], rel=5e-3)


def test_closed_form_of_a_decay_is_that_of_the_published_formulas() -> None:
    light = SecondOrder(MASS, 0.25 * DAMPING, STIFFNESS)
    local = LocalSystem(light, None)
    found = by_name(system_decay(local))
    time, moved, acceleration = impulse_decay(local)
    fine = np.linspace(time[0], time[-1], 20001)
    published = trace_figures(fine, np.interp(fine, time, moved), np.interp(fine, time, acceleration), MASS)
    for name, value in published.items():
        assert found[name].value == pytest.approx(value, rel=0.02), name
    ratio = light.damping_ratio
    assert found["decrement"].value == pytest.approx(2.0 * math.pi * ratio / math.sqrt(1.0 - ratio**2))
    assert found["stiffness_n_per_m"].value == pytest.approx(STIFFNESS)


@pytest.mark.parametrize("engine", ["lms", "wiener"])
def test_a_fit_gives_the_decay_of_the_known_system(engine: str) -> None:
    """60 seeds of lms give a bias of at most 0.06 % and 93 to 100 % within 1.96 standard deviations."""
    analysis = fit_split(get_engine(engine)(), split_records([linear_record(3, snr_db=20.0, colour=0.5)]))
    local = local_system(analysis.model)
    assert local is not None
    found = by_name(system_decay(local))
    for name, true in by_name(system_decay(LocalSystem(FOREARM, None))).items():
        estimate = found[name].estimate
        assert estimate is not None
        assert estimate.std is not None
        assert true.value is not None
        assert abs(estimate.value - true.value) < 3.0 * estimate.std
        assert estimate.std < 0.05 * true.value


def test_an_overdamped_system_has_a_stiffness_only() -> None:
    found = by_name(system_decay(LocalSystem(SecondOrder(0.01, 50.0, 1000.0), np.diag([1e-4] * 3))))
    assert found["stiffness_n_per_m"].value == pytest.approx(1000.0)
    for name in ("frequency_hz", "decrement", "relaxation_s", "creep"):
        assert found[name].estimate is None
        assert code_of(found[name].reason) == "readings.overdamped"


def test_the_release_of_a_step_shows_frequency_and_decrement() -> None:
    rng = np.random.default_rng(4)
    light = SecondOrder(MASS, 0.3 * DAMPING, STIFFNESS)
    force = steps.step_record(rng, noise_m=0.0).input
    position = light.simulate(force - force[0], 2000.0) + 1e-6 * rng.standard_normal(force.size)
    course = find_steps(force, 2000.0)
    found = by_name(recorded_release(force, position, course).readings)
    true = by_name(system_decay(LocalSystem(light, None)))
    for name in ("frequency_hz", "decrement"):
        estimate = found[name].estimate
        assert estimate is not None
        assert estimate.std is not None
        assert estimate.value == pytest.approx(true[name].value, rel=0.02)
    assert code_of(found["stiffness_n_per_m"].reason) == "readings.no_mass"


def test_a_model_plays_the_same_step_with_the_uncertainty_of_its_fit() -> None:
    """A memory shorter than the hold leaves out the creep."""
    rng = np.random.default_rng(5)
    rate = 400.0
    force = 2.5 + rng.standard_normal(4000)
    position = 0.012 + steps.creep(force, rate, tau=0.05)
    record = Record(force, position + 2e-6 * rng.standard_normal(force.size), rate)
    step = steps.step_record(rng, rate=rate, hold_s=0.3, tau=0.05)
    course = find_steps(step.input, rate)
    truth = steps.true_lengths(0.3, tau=0.05)
    engine = get_engine("lms").from_options({"memory": 0.3})
    analysis = fit_split(engine, split_records([record]))
    found = by_name(model_readings(analysis, engine, step.input, course, draws=4).step)
    for name in ("ue_m", "uf_m", "ur_m", "ua_m"):
        estimate = found[name].estimate
        assert estimate is not None
        assert estimate.std is not None
        assert estimate.std > 0.0
        assert estimate.value == pytest.approx(truth[name], rel=0.03), name
    short = get_engine("lms").from_options({"memory": 0.125})
    found = by_name(model_readings(fit_split(short, split_records([record])), short, step.input, course, draws=0).step)
    assert found["uv_m"].estimate is None
    assert code_of(found["uv_m"].reason) == "readings.short_memory"
    assert found["ue_m"].estimate is not None
    assert found["ue_m"].estimate.std is None


def test_a_session_of_one_test_says_what_is_missing_and_draws_the_rest() -> None:
    record = steps.step_record(np.random.default_rng(2))
    signals = {"force": record.input, "position": record.output}
    test = Test(number=1, kind="step_hold", signals=signals, sample_rate_hz=2000.0)
    found = device_readings(test, None, get_engine("lms")())
    assert found.recorded is not None
    assert found.model is None
    answer = found.as_answer()
    assert answer["recorded"]["readings"]["ue_m"]["value"] is not None
    assert answer["model"]["readings"]["ue_m"]["reason_message"]["code"] == "readings.no_stochastic_test"
    assert {str(mark.text) for mark in step_plot(found).marks} == {"Ue", "Uv", "Uf", "Ur"}
    assert not recorded_step_plot(recorded_readings(test)).missing
    with pytest.raises(UnusableInputError, check=coded("readings.no_step_test", stimulus="step_hold")):
        device_readings(None, None, get_engine("lms")())
