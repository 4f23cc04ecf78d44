"""Noise models and predictions n steps ahead, against theory and a plain loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import refused
from identification import simulated
from identification import simulated_validation as systems
from scipy import signal

from tissueid.identification.validation.prediction import (
    Autoregression,
    fit_autoregression,
    fit_noise,
    predict_ahead,
    prediction_curve,
)
from tissueid.records import Record

POLES = np.array([1.5, -0.7])


def second_order_noise(*seed: int, n: int) -> np.ndarray:
    return signal.lfilter([0.1], [1.0, *-POLES], simulated.generator(*seed).standard_normal(n + 500))[500:]


def noisy(*seed: int, n: int = 20000) -> Record:
    record = systems.record(*seed, n=n, noise=0.0)
    return replace(record, output=record.output + second_order_noise(*seed, 1, n=n))


@pytest.fixture(scope="module")
def record() -> Record:
    return noisy(80)


@pytest.fixture(scope="module")
def model(record: Record) -> systems.Fir:
    return systems.PlainFir().fit(record, slice(0, 15000))


@pytest.fixture(scope="module")
def noise(model: systems.Fir, record: Record) -> Autoregression:
    return fit_noise(model, record, slice(0, 15000))


def test_the_noise_model_is_found(noise: Autoregression):
    assert noise.order == pytest.approx(2, abs=1)
    np.testing.assert_allclose(noise.coefficients[:2], POLES, atol=0.03)
    assert noise.innovation_std == pytest.approx(0.1, rel=0.02)


def test_white_noise_has_no_memory():
    found = fit_autoregression(simulated.generator(81).standard_normal(4000) + 3.0)
    assert found.order <= 1
    assert found.mean == pytest.approx(3.0, abs=0.06)
    assert found.innovation_std == pytest.approx(1.0, abs=0.04)


def test_the_order_and_coefficients_are_those_of_plain_least_squares():
    e = second_order_noise(82, n=3000)
    found = fit_autoregression(e, max_order=6)
    centred = e - e.mean()
    rows = np.arange(found.order, e.size)
    plain = np.linalg.lstsq(centred[rows[:, None] - np.arange(1, found.order + 1)], centred[rows], rcond=None)[0]
    np.testing.assert_allclose(found.coefficients, plain, rtol=1e-6)


def test_no_row_of_the_noise_model_reaches_across_a_gap():
    pieces = [second_order_noise(83, k, n=400) for k in range(10)]
    holed = np.concatenate([np.append(piece, np.nan) for piece in pieces])
    found = fit_autoregression(holed, max_order=2)
    np.testing.assert_allclose(found.coefficients, POLES, atol=0.05)
    rows, target = [], []
    centred = holed - np.nanmean(holed)
    for n in range(2, holed.size):
        if np.isfinite(centred[n - 2 : n + 1]).all():
            rows.append([centred[n - 1], centred[n - 2]])
            target.append(centred[n])
    np.testing.assert_allclose(found.coefficients, np.linalg.lstsq(np.array(rows), target, rcond=None)[0], rtol=1e-6)


def test_error_variance_at_each_horizon_is_what_theory_says(model: systems.Fir, record: Record, noise: Autoregression):
    psi = np.zeros(60)
    psi[0], psi[1] = 1.0, POLES[0]
    for k in range(2, 60):
        psi[k] = POLES @ psi[k - 2 : k][::-1]
    horizons = [1, 2, 3, 5, 8, 20, 50]
    theory = 0.1 * np.sqrt(np.cumsum(psi**2))[np.array(horizons) - 1]
    curve = prediction_curve(model, record, noise, horizons, slice(15000, None))
    np.testing.assert_allclose(curve.expected_error_std, theory, rtol=0.03)
    np.testing.assert_allclose(curve.error_std, theory, rtol=0.06)
    assert np.all(np.diff(curve.vaf_percent) < curve.vaf_std_percent[1:])
    assert curve.vaf_percent[-1] == pytest.approx(curve.free_run_vaf_percent, abs=0.1)
    np.testing.assert_allclose(curve.horizon_s, np.array(horizons) / systems.RATE)


def test_a_prediction_is_the_recursion_written_out(model: systems.Fir, record: Record, noise: Autoregression):
    horizon, at = 4, 300
    residual = record.output - model.simulate(record.input) - noise.mean
    past = list(residual[at - horizon - noise.order + 1 : at - horizon + 1])
    for _ in range(horizon):
        past.append(float(noise.coefficients @ np.array(past[::-1])[: noise.order]))
    expected = model.simulate(record.input)[at] + noise.mean + past[-1]
    assert predict_ahead(model, record, horizon, noise)[at] == pytest.approx(expected, abs=1e-12)


def test_a_prediction_sees_nothing_later(model: systems.Fir, record: Record, noise: Autoregression):
    horizon, at = 3, 400
    later = simulated.changed(record.output, (np.s_[at - horizon + 1 :], 99.0))
    ours = predict_ahead(model, record, horizon, noise)
    np.testing.assert_array_equal(
        predict_ahead(model, replace(record, output=later), horizon, noise)[: at + 1], ours[: at + 1]
    )


def test_where_the_past_is_unknown_the_prediction_is_the_free_run(
    model: systems.Fir, record: Record, noise: Autoregression
):
    y = simulated.changed(record.output, (1000, np.nan))
    predicted = predict_ahead(model, replace(record, output=y), 2, noise)
    free = model.simulate(record.input) + noise.mean
    np.testing.assert_allclose(predicted[1002 : 1002 + noise.order], free[1002 : 1002 + noise.order])
    assert predicted[1002 + noise.order] != free[1002 + noise.order]
    np.testing.assert_allclose(predicted[: systems.LAGS], free[: systems.LAGS])
    assert np.isfinite(predicted).all()


def test_the_deviation_of_a_vaf_is_its_spread():
    reported, found = [], []
    for run in range(40):
        rng = simulated.generator(84, run)
        u = signal.lfilter([1.0], [1.0, -0.8], rng.standard_normal(3000))
        model = systems.fir(systems.KERNEL, 0.0, 0.0, 10**6)
        record = Record(u, model.simulate(u) + 2.0 * systems.coloured(rng, 3000, 0.9), systems.RATE)
        curve = prediction_curve(model, record, fit_noise(model, record), [1])
        reported.append(curve.vaf_std_percent[0])
        found.append(curve.vaf_percent[0])
    assert np.mean(reported) == pytest.approx(np.std(found, ddof=1), rel=0.35)


def test_refusals_are_one_line(model: systems.Fir, record: Record, noise: Autoregression):
    refused(lambda: predict_ahead(model, record, 0, noise), "engine.horizon", horizon=0)
    refused(lambda: prediction_curve(model, record, noise, []), "prediction.no_horizon")
    refused(lambda: prediction_curve(model, record, noise, [1], slice(0, 10)), "score.no_sample")
    refused(lambda: fit_noise(model, record, slice(0, 300), max_order=30), "noise_model.too_few_residuals", order=30)
    refused(lambda: predict_ahead(model, replace(record, sample_rate_hz=500.0), 1, noise), "engine.other_sample_rate")


@pytest.mark.parametrize("n", [100, 400, 1000])
def test_a_short_signal_without_gaps_carries_a_noise_model(n: int):
    signal = np.random.Generator(np.random.PCG64(n)).standard_normal(n)
    assert fit_autoregression(signal).order <= n // 20


def test_a_handful_of_residuals_is_refused():
    refused(lambda: fit_autoregression(np.arange(15.0)), "noise_model.too_few_residuals")
