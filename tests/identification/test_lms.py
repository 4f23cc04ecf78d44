"""Least mean squares: the thesis' equations, honest standard deviations, gaps, and held-out simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import refused, says
from identification import simulated
from scipy import linalg, signal

from tissueid.identification import validate, validated
from tissueid.identification.engines.lms import Lms
from tissueid.identification.preparation import band_filtered, detrended
from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.linear_record(20)


def broadband(*seed: int, n: int = 4000, noise: float = 0.0, pole: float = 0.0) -> tuple[Record, np.ndarray]:
    """White force through a known kernel of 40 lags at 1 kHz; the kernel is per sample."""
    rng = simulated.generator(*seed)
    u = rng.standard_normal(n)
    k = np.arange(40)
    kernel = np.exp(-k / 8.0) * np.cos(k / 5.0)
    e = signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 500))[500:]
    return Record(u + 2.0, signal.lfilter(kernel, [1.0], u) + noise * e + 7.0, 1000.0), kernel


def test_impulse_response_is_eq_3_2(record: Record):
    model = Lms(taper=0.0).fit(record)
    x, y = record.input - record.input.mean(), record.output - record.output.mean()
    n, lags = len(record), 250
    auto = np.correlate(x, x, "full")[n - 1 : n - 1 + lags] / n
    cross = np.correlate(y, x, "full")[n - 1 : n - 1 + lags] / n
    expected = record.sample_rate_hz * np.linalg.solve(linalg.toeplitz(auto), cross)
    np.testing.assert_allclose(model.impulse_response, expected, atol=1e-7 * np.max(np.abs(expected)))
    np.testing.assert_allclose(model.lag_s, np.arange(lags) / 2000.0)


@pytest.mark.parametrize("cut", [6000, 5963, 6100])
def test_a_record_cut_off_in_mid_motion_leaves_no_lag_far_off(record: Record, cut: int):
    model = Lms().fit(record, slice(0, cut))
    off = model.impulse_response - model.second_order.system.impulse_response(model.lag_s)
    assert np.max(np.abs(off / model.impulse_response_std)) < 5.0


def test_the_recursion_and_the_pseudo_inverse_agree_where_r_is_well_conditioned():
    record, kernel = broadband(21)
    fast = Lms(memory=0.04).fit(record)
    dense = Lms(memory=0.04, method="svd").fit(record)
    scale = np.linalg.norm(dense.impulse_response)
    assert np.linalg.norm(fast.impulse_response - dense.impulse_response) < 1e-10 * scale
    np.testing.assert_allclose(fast.impulse_response / 1000.0, kernel, atol=0.05)
    assert fast.report.details["condition_number"] >= dense.report.details["condition_number"] > 1.0


def test_the_pseudo_inverse_drops_what_the_tolerance_says(record: Record):
    rough = Lms(method="svd").fit(record)
    smooth = Lms(method="svd", tolerance=1e-3).fit(record)
    assert np.std(np.diff(smooth.impulse_response)) < np.std(np.diff(rough.impulse_response))
    assert smooth.report.vaf_percent > 99.0


@pytest.mark.parametrize("pole", [0.0, 0.9])
@pytest.mark.soak
def test_standard_deviation_of_each_lag_is_the_spread_of_repeats(pole: float):
    found, reported = [], []
    for run in range(80):
        record, _ = broadband(22, run, n=2000, noise=0.5, pole=pole)
        model = Lms(memory=0.04).fit(record)
        found.append(model.impulse_response)
        reported.append(model.impulse_response_std)
    ratio = np.mean(reported, axis=0) / np.std(found, axis=0, ddof=1)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.07)
    assert np.all((ratio > 0.7) & (ratio < 1.4))


def test_parameters_and_both_vafs_are_reported(record: Record):
    report = Lms().fit(record).report
    simulated.near(
        report.parameters,
        0.01,
        mass_kg=simulated.MASS,
        damping_n_s_per_m=simulated.DAMPING,
        stiffness_n_per_m=simulated.STIFFNESS,
    )
    assert report.vaf_percent == pytest.approx(99.98, abs=0.02)
    assert report.details["vaf_parametric_percent"] == pytest.approx(99.99, abs=0.02)
    assert report.n_parameters == 251
    assert report.n_samples == 8000 - 249
    assert report.warnings == ()


def test_held_out_simulation(record: Record):
    model = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None))
    assert model.report.n_samples == 6000 - 249
    assert model.report.vaf_validation_percent > 99.9
    other = simulated.linear_record(20, 1)
    assert validate(model, other).vaf_percent > 99.9


def test_a_part_in_the_middle_is_fitted_alone(record: Record):
    spoiled = Record(
        record.input,
        np.where(np.arange(8000) < 2000, 0.0, np.where(np.arange(8000) >= 7000, 1.0, record.output)),
        record.sample_rate_hz,
    )
    model = Lms().fit(spoiled, slice(2000, 7000))
    assert model.report.vaf_percent > 99.9
    assert model.report.n_samples == 5000  # the inputs before the part are its memory


def test_a_preload_does_no_harm():
    record = simulated.linear_record(23)
    force = np.concatenate([np.full(1000, 3.0), record.input])
    settled = np.full(1000, 0.012)
    rest = Record(force, np.concatenate([settled, record.output]), record.sample_rate_hz)
    assert Lms().fit(rest).report.vaf_percent > 99.5


def test_gaps_are_skipped_and_told(record: Record):
    # what rests on a missing input may be anything
    u = simulated.changed(record.input, (np.s_[3000:3011], np.nan))
    y = simulated.changed(record.output, (np.s_[3000:3011], np.nan), (np.s_[3011:3200], 5.0))
    report = Lms().fit(Record(u, y, record.sample_rate_hz)).report
    assert report.n_samples == 8000 - 249 - 11 - 249
    assert report.vaf_percent > 99.9
    assert any(says(text, "record.lost_samples", lost=11, length=8000) for text in report.warnings)
    assert report.parameters["mass_kg"].value == pytest.approx(simulated.MASS, rel=0.01)


@pytest.mark.parametrize(("seconds", "wrong", "last"), [(4.0, 0.04, 0.04), (0.5, 0.25, 0.1)])
def test_the_last_lags_carry_nothing_of_their_own(seconds: float, wrong: float, last: float):
    """Known truth, 25 dB of coloured noise. With a ridge of 1e-5 and no further lags: 18 to 40 %, and 83 to 251 %."""
    n = round(seconds * simulated.RATE)
    for seed in range(3):
        record = simulated.linear_record(61, seed, snr_db=25.0, colour=0.98)
        response = Lms().fit(record, slice(0, n)).impulse_response
        truth = SecondOrder(simulated.MASS, simulated.DAMPING, simulated.STIFFNESS).impulse_response(
            np.arange(response.size) / simulated.RATE
        )
        assert np.linalg.norm(response - truth) < wrong * np.linalg.norm(truth)
        assert np.max(np.abs(response[-20:])) < last * np.max(truth)


def test_segments_are_averaged_and_ill_conditioned_ones_rejected():
    """White noise is well conditioned; a stretch of a sine is not (C.1.1)."""
    rng = simulated.generator(61)
    u = rng.standard_normal(8000)
    u[4000:5500] = np.sin(0.2 * np.arange(1500))
    h = np.exp(-np.arange(20) / 5.0)
    record = Record(u, np.convolve(u, h)[:8000] + 0.05 * rng.standard_normal(8000), 1000.0)
    model = Lms(memory=0.03, segment=0.5, most_condition=100.0).fit(record)
    assert (model.report.details["segments"], model.report.details["rejected_segments"]) == (26.0, 5.0)
    error = model.impulse_response[:20] / 1000.0 - h
    assert np.max(np.abs(error)) < 0.06
    refused(lambda: Lms(memory=0.03, segment=0.5, most_condition=1.5).fit(record), "lms.too_few_segments")


def test_the_coefficients_of_the_impulse_response_are_those_of_mass_damping_and_stiffness():
    parameters = Lms().fit(simulated.linear_record(62)).report.parameters
    true = SecondOrder(simulated.MASS, simulated.DAMPING, simulated.STIFFNESS).impulse_coefficients(1.0)
    for name, value in zip(("a1_m_per_n_s", "a2_rad_per_s", "a3_per_s"), true, strict=True):
        found = parameters[name]
        assert found.value == pytest.approx(value, rel=0.01), name
        assert abs(found.value - value) < 4.0 * found.std, name


def test_a_drift_is_removed_and_a_band_kept():
    true = simulated.linear_record(63)
    t = np.arange(len(true)) / true.sample_rate_hz
    drifting = replace(true, output=true.output + 2e-3 * (t - t.mean()))
    for values in (detrended(drifting).input, detrended(drifting).output):
        assert np.polyfit(t, values, 1)[0] == pytest.approx(0.0, abs=1e-10)
    assert detrended(drifting).output.mean() == pytest.approx(drifting.output.mean())
    assert Lms().fit(detrended(drifting)).report.vaf_percent > 99.9 > Lms().fit(drifting).report.vaf_percent
    hum = replace(true, output=true.output + 2e-4 * np.sin(2.0 * np.pi * 320.0 * t))
    passed = band_filtered(hum, None, 200.0)
    assert Lms().fit(passed).report.vaf_percent > 99.5 > Lms().fit(hum).report.vaf_percent
    stiffness = Lms().fit(passed).report.parameters["stiffness_n_per_m"]
    assert stiffness.value == pytest.approx(simulated.STIFFNESS, rel=0.02)
    refused(lambda: band_filtered(true, 200.0, 2.0), "record.band")
