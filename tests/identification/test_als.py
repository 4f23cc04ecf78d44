"""Adaptive least squares: the thesis' loop, steps that run away, the course over time and its order by depth."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from coded import refused, says
from identification import simulated
from scipy import signal

from tissueid.identification import validated
from tissueid.identification.engines.als import Als
from tissueid.identification.engines.lms import Lms
from tissueid.records import Record, joined

LAGS = 30


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.wiener_record(80)


broadband = partial(simulated.broadband, n=3000, noise=0.05)


def plain(record: Record, lags: int, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Eqs. 6.6-6.8 as they stand, from the first complete memory: errors, and the response after each sample."""
    x, y = record.input - record.input.mean(), record.output - record.output.mean()
    h = np.zeros(lags)
    errors, course = [], []
    for n in range(lags - 1, x.size):
        t = x[n - lags + 1 : n + 1][::-1]
        error = y[n] - h @ t
        h = h + factor * error * t
        errors.append(error)
        course.append(h)
    return np.array(errors), np.array(course)


def test_a_change_factor_is_the_thesis_loop():
    record = broadband(81)
    errors, course = plain(record, LAGS, 1e-3)
    model = Als(memory=0.03, change_factor=1e-3).fit(record)
    np.testing.assert_allclose(model.impulse_response / 1000.0, course.mean(axis=0), atol=1e-12)
    there = np.round(model.trajectory_s * 1000.0).astype(int) - (LAGS - 1)
    np.testing.assert_allclose(model.trajectory / 1000.0, course[there], atol=1e-12)
    np.testing.assert_allclose(model.trajectory_position, record.output[there + LAGS - 1])
    tracking = 100.0 * (1.0 - np.var(errors) / np.var(record.output[LAGS - 1 :]))
    assert model.report.details["vaf_tracking_percent"] == pytest.approx(tracking, abs=1e-6)
    assert model.report.details["n_parameters_tracking"] == LAGS * errors.size
    assert model.report.n_parameters == LAGS + 1


def test_responses_are_averaged_by_depth():
    record = broadband(82)
    _, course = plain(record, LAGS, 1e-3)
    model = Als(memory=0.03, change_factor=1e-3, levels=4).fit(record)
    y = record.output[LAGS - 1 :]
    edges = np.quantile(y, [0.25, 0.5, 0.75])
    np.testing.assert_allclose(model.depth_edges, edges)
    for level in range(4):
        there = np.searchsorted(edges, y) == level
        np.testing.assert_allclose(model.depth_response[level] / 1000.0, course[there].mean(axis=0), atol=1e-12)
        assert model.depth_position[level] == pytest.approx(y[there].mean())
        assert model.depth_support[level] == there.sum()
    x = record.input - record.input.mean()
    by_level = np.array([signal.lfilter(h / 1000.0, [1.0], x) for h in model.depth_response])
    expected = model.output_mean + by_level[np.searchsorted(edges, record.output), np.arange(len(record))]
    np.testing.assert_allclose(model.simulate_scheduled(record), expected, atol=1e-9)
    assert model.depth_profile() is None


def test_the_step_knows_no_units_and_no_power():
    record = broadband(83)
    other = Record(1e3 * record.input, 1e-4 * record.output, 1000.0)
    ours, theirs = Als(memory=0.03).fit(record), Als(memory=0.03).fit(other)
    np.testing.assert_allclose(theirs.impulse_response * 1e7, ours.impulse_response, rtol=1e-6, atol=1e-8)
    assert theirs.report.vaf_percent == pytest.approx(ours.report.vaf_percent, abs=1e-6)


@pytest.mark.parametrize("step", [0.05, 0.2, 0.5, 1.0])
def test_a_linear_system_is_learnt(step: float):
    record = broadband(84, n=8000)
    live = Als(memory=0.03, step=step).start(1000.0)
    live.batch(record.input, record.output)
    np.testing.assert_allclose(live.impulse_response / 1000.0, simulated.KERNEL, atol=0.1)
    model = Als(memory=0.03, step=step).fit(record)
    assert model.report.details["vaf_tracking_percent"] > 90.0
    assert model.report.vaf_percent > 98.0


def test_it_follows_a_system_that_changes_and_says_what_is_no_free_run(record: Record):
    model = validated(Als().fit(record, slice(0, 6000)), record, slice(6000, None))
    line = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    report = model.report
    assert line.vaf_validation_percent - 3.0 < report.vaf_validation_percent < 99.0
    assert report.vaf_scheduled_percent > report.vaf_validation_percent  # the curve bends, so the depth helps
    assert report.parameters["stiffness_n_per_m"].std is not None
    gained = Als(step=0.9).fit(record, slice(0, 6000)).report.details["vaf_tracking_percent"]
    assert gained > report.details["vaf_tracking_percent"]


def test_records_are_fitted_together_and_nothing_reaches_across():
    parts = [broadband(86, k, n=700) for k in range(3)]
    together = joined(parts)
    report = Als(memory=0.03).fit(together).report
    assert report.n_samples == 3 * (700 - 29)
    wild = Record(np.where(np.isnan(together.input), 1e6, together.input), together.output, 1000.0)
    assert report.vaf_percent > 97.0 > Als(memory=0.03).fit(wild).report.vaf_percent


@pytest.mark.parametrize("factor", [0.07, 0.5])
def test_a_change_factor_beyond_the_bound_is_refused(factor: float):
    refused(lambda: Als(memory=0.03, change_factor=factor).fit(broadband(87)), "als.unstable_factor", factor=factor)


def test_a_step_of_two_is_no_option():
    refused(lambda: Als.from_options({"step": 2.0}), "option.refused", option="step")


def test_without_an_operating_point_the_means_are_found_under_way():
    record = broadband(90, n=6000)
    y = simulated.changed(record.output, (np.s_[:50], np.nan))
    live = Als(memory=0.03).start(1000.0)
    errors = live.batch(record.input, y)
    assert np.std(errors[-1000:]) < 0.15 * np.std(record.output)
    model = live.model()
    assert model.input_mean == pytest.approx(np.mean(record.input))
    assert model.simulate(np.full(60, 2.0))[-1] == pytest.approx(7.0, abs=0.05)


def test_running_away_is_noticed_live_and_the_last_good_response_kept():
    record = broadband(88, n=3000)
    louder = np.where(np.arange(3000) < 2000, 1.0, 4.0)  # the step is stable until the input grows
    u, y = louder * (record.input - 2.0), louder * (record.output - 7.0)
    live = Als(memory=0.03, change_factor=0.03).start(1000.0, input_mean=0.0, output_mean=0.0)
    live.batch(u[:2000], y[:2000])
    assert live.warning is None
    good = live.impulse_response
    errors = live.batch(u[2000:], y[2000:])
    assert says(live.warning, "als.diverged", which="change_factor", step=0.03)
    assert "\n" not in live.warning
    assert np.linalg.norm(live.impulse_response - good) < 0.3 * np.linalg.norm(good)
    assert np.all(np.isfinite(errors))
    assert np.std(errors[-500:]) < 0.3 * np.std(y[-500:])
    assert live.warning in live.model().report.warnings


def test_running_away_within_a_record_is_refused():
    record = broadband(88, 1, n=3000)
    louder = np.where(np.arange(3000) < 2000, 0.05, 4.0)  # on average the step is below the bound
    loud = Record(louder * (record.input - 2.0), louder * (record.output - 7.0), 1000.0)
    refused(lambda: Als(memory=0.03, change_factor=0.012).fit(loud), "als.diverged", which="change_factor", step=0.012)
