"""Scores, against their formulas written out, and against brute force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from coded import refused
from hypothesis import given
from hypothesis import strategies as st
from identification import simulated

from tissueid.identification import FitReport, Model, aic, aicc, vaf_percent, validate, validated
from tissueid.identification.base import PREDICTS_NOTHING, Array
from tissueid.identification.engines.lms import Lms
from tissueid.identification.preparation import complete_windows, scored_samples
from tissueid.identification.validation import score
from tissueid.records import Record


@dataclass(frozen=True, eq=False)
class Delay(Model):
    """y[n] = 2 u[n - 4], and a schedule that is always right."""

    def simulate(self, u: Array) -> Array:
        return np.concatenate([np.zeros(4), 2.0 * u[:-4]])

    def simulate_scheduled(self, record: Record) -> Array | None:
        return record.output


def delay() -> Delay:
    report = FitReport(engine="delay", options={}, n_samples=0, n_parameters=1, vaf_percent=0.0)
    return Delay(report=report, sample_rate_hz=100.0, memory_samples=5)


def record(n: int = 400) -> Record:
    u = simulated.generator(1).standard_normal(n)
    return Record(u, np.concatenate([np.full(4, 9.0), 2.0 * u[:-4]]), 100.0)


def test_vaf_is_eq_3_13_and_ignores_an_offset():
    rng = simulated.generator(2)
    y, e = rng.standard_normal(500), 0.3 * rng.standard_normal(500)
    expected = 100.0 * (1.0 - np.std(e) ** 2 / np.std(y) ** 2)
    assert vaf_percent(y, y - e) == pytest.approx(expected, abs=1e-12)
    assert vaf_percent(y, y - e + 5.0) == pytest.approx(expected, abs=1e-9)
    assert vaf_percent(y, -y) == pytest.approx(-300.0)


def test_vaf_leaves_out_what_is_unknown():
    y = np.array([1.0, 2.0, np.nan, 4.0, 5.0])
    model = np.array([1.1, np.nan, 3.0, 4.1, 4.8])
    assert vaf_percent(y, model) == vaf_percent(y[[0, 3, 4]], model[[0, 3, 4]])
    assert np.isnan(vaf_percent(np.ones(5), np.ones(5)))


def test_information_criteria_are_eqs_3_14_to_3_16():
    residuals = simulated.generator(3).standard_normal(200)
    rss, n, k = float(np.sum(residuals**2)), 200, 7
    expected = 2 * k + n * (np.log(2 * np.pi * rss / n) + 1)
    assert aic(residuals, k) == pytest.approx(expected)
    assert aicc(residuals, k) == pytest.approx(expected + 2 * k * (k + 1) / (n - k - 1))
    with_gaps = np.concatenate([residuals, np.full(50, np.nan)])
    assert aicc(with_gaps, k) == pytest.approx(aicc(residuals, k))
    assert np.isnan(aicc(residuals[:8], k))
    assert aic(np.zeros(5), k) == -np.inf


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(1, 12))
def test_complete_windows_against_brute_force(finite: list[bool], length: int):
    mask = np.array(finite)
    expected = [n + 1 >= length and bool(mask[n + 1 - length : n + 1].all()) for n in range(mask.size)]
    np.testing.assert_array_equal(complete_windows(mask, length), expected)


def test_validation_leaves_out_the_memory_after_the_start_and_after_gaps():
    whole = record()
    assert validate(delay(), whole).vaf_percent == pytest.approx(100.0)
    assert validate(delay(), whole).n_samples == 396

    # what rests on the missing input may be anything
    u = simulated.changed(whole.input, (100, np.nan))
    y = simulated.changed(whole.output, (np.s_[200:203], np.nan), (np.s_[100:105], 50.0))
    holed = Record(u, y, 100.0)
    result = validate(delay(), holed)
    assert result.vaf_percent == pytest.approx(100.0)
    assert result.n_samples == 396 - 5 - 3


def test_validation_scores_the_part_and_runs_from_the_start():
    whole = record()
    result = validate(delay(), whole, slice(300, None))
    assert result.n_samples == 100
    assert result.vaf_percent == pytest.approx(100.0)
    assert result.nrmse_percent == pytest.approx(0.0)
    refused(lambda: validate(delay(), whole, slice(0, 3)), "score.no_sample")


def test_offset_counts_in_nrmse_and_not_in_vaf():
    whole = record()
    result = score(whole, delay().simulate(whole.input) + 2.0, scored_samples(whole, 5))
    assert result.vaf_percent == pytest.approx(100.0)
    assert result.offset == pytest.approx(-2.0)
    assert result.nrmse_percent == pytest.approx(100.0 * 2.0 / np.std(whole.output[4:]))


def test_validated_fills_the_report_and_the_schedule_apart():
    whole = record()
    noisy = Record(whole.input, whole.output + simulated.generator(4).standard_normal(400), 100.0)
    report = validated(delay(), noisy, slice(200, None)).report
    assert report.vaf_validation_percent == pytest.approx(validate(delay(), noisy, slice(200, None)).vaf_percent)
    assert report.vaf_validation_percent < 95.0
    assert report.vaf_scheduled_percent == pytest.approx(100.0)


def test_another_rate_is_refused():
    whole = record()
    refused(
        lambda: validate(delay(), Record(whole.input, whole.output, 200.0)), "engine.other_sample_rate", given=200.0
    )


def unrelated(seed: int, share: float = 0.0) -> Record:
    """A position of which the force explains a share; the rest answers another force of the same spectrum."""
    rng = simulated.generator(9, seed)
    force, position = simulated.second_order(rng)
    _, other = simulated.second_order(rng)
    position, other = position / position.std(), other / other.std()
    return Record(force, np.sqrt(share) * position + np.sqrt(1.0 - share) * other, simulated.RATE)


def fitted(record: Record, memory: float) -> FitReport:
    part, rest = slice(0, 6000), slice(6000, len(record))
    return validated(Lms(memory=memory).fit(record, part), record, rest).report


@pytest.mark.parametrize("memory", [pytest.param(0.02, marks=pytest.mark.soak), 0.125])
def test_a_fit_to_unrelated_motion_predicts_nothing(memory: float):
    reports = [fitted(unrelated(seed), memory) for seed in range(20)]
    assert sum(report.predicts_nothing for report in reports) >= 18  # at 5 %, more than 2 of 20 come to 8 %
    marked = next(report for report in reports if report.predicts_nothing)
    assert (marked.reportable_parameters, PREDICTS_NOTHING in marked.warnings) == ({}, True)
    answer = marked.as_dict()
    assert (answer["predicts_nothing"], set(answer["parameters"])) == (True, set(marked.parameters))


def test_a_fit_that_explains_a_third_of_the_motion_predicts():
    for seed in range(6):
        report = fitted(unrelated(seed, 0.33), 0.02)
        assert (report.predicts_nothing, report.reportable_parameters) == (False, report.parameters)
        assert PREDICTS_NOTHING not in report.warnings


@pytest.mark.parametrize("period", [8, 10, 12])
def test_shifts_that_repeat_a_periodic_input_do_not_refuse_the_right_model(period: int):
    phase = 2.0 * np.pi * np.arange(4000) / period
    u = np.sin(phase) + 0.5 * np.sin(2.0 * phase + 1.0)
    y = delay().simulate(u) + simulated.generator(10).standard_normal(4000)
    report = validated(delay(), Record(u, y, 100.0), slice(3000, None)).report
    assert (report.predicts_nothing, report.validation_p_value) == (False, 1 / 40)
    drift = np.linspace(0.0, 3.0, 4000)  # the other way round: a drift is no answer to a periodic input
    assert validated(delay(), Record(drift + 0.1 * u, drift[::-1] + y, 100.0)).report.predicts_nothing


def test_the_mark_of_a_fit_goes_with_the_samples_that_it_is_judged_on():
    model = delay().with_validation(-3.0, 0.5)
    assert (model.report.predicts_nothing, model.report.warnings) == (True, (PREDICTS_NOTHING,))
    again = model.with_validation(80.0, 0.001)
    assert (again.report.predicts_nothing, again.report.warnings) == (False, ())
    assert not delay().report.predicts_nothing  # it was never judged
