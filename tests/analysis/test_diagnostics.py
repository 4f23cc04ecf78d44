from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tissueid.analysis.curves.plot import thin
from tissueid.analysis.curves.validation import autocorrelation, cross_correlation, power_edge, power_spectrum, runs

REPEATS, N, LAGS = 300, 1500, 60


def colour(rng: np.random.Generator, pole: float) -> np.ndarray:
    return signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(N + 200))[200:]


def test_white_residuals_leave_their_band_one_time_in_twenty() -> None:
    rng = np.random.default_rng(1)
    outside = []
    for _ in range(REPEATS):
        values, band = autocorrelation(rng.standard_normal(N), LAGS)
        assert values[0] == pytest.approx(1.0)
        assert band == pytest.approx(1.96 / np.sqrt(N))
        outside.append(np.mean(np.abs(values[1:]) > band))
    assert np.mean(outside) == pytest.approx(0.05, abs=0.006)


@pytest.mark.parametrize(("pole_u", "pole_e"), [(0.0, 0.0), (0.9, 0.0), (0.9, 0.8), (0.95, 0.95), (-0.7, 0.7)])
def test_unrelated_signals_leave_their_band_one_time_in_twenty(pole_u: float, pole_e: float) -> None:
    rng = np.random.default_rng(2)
    outside = []
    for _ in range(REPEATS):
        lags, values, band = cross_correlation(colour(rng, pole_u), colour(rng, pole_e), LAGS)
        assert lags[0] == -LAGS
        assert lags[-1] == LAGS
        outside.append(np.mean(np.abs(values) > band))
    assert np.mean(outside) == pytest.approx(0.05, abs=0.02)


def test_gaps_are_left_out_of_correlations() -> None:
    rng = np.random.default_rng(3)
    values = colour(rng, 0.9)
    whole, _ = autocorrelation(values, 20)
    values[rng.random(N) < 0.2] = np.nan
    holed, band = autocorrelation(values, 20)
    assert np.allclose(holed, whole, atol=0.06)
    assert band > 1.96 / np.sqrt(N)
    u = rng.standard_normal(N)
    u[100:150] = np.nan
    delayed = np.concatenate([np.zeros(7), u[:-7]])
    lags, related, _ = cross_correlation(u, delayed, 20)
    assert lags[np.nanargmax(related)] == 7


def test_thinning_keeps_the_extremes_and_the_gaps() -> None:
    time_s = np.arange(100_000) / 2000.0
    values = np.sin(time_s)
    values[54_321] = 9.0
    values[70_000:71_000] = np.nan
    thin_time, thinned = thin(time_s, values, columns=500)
    assert thinned.size <= 1000
    assert thin_time.size == thinned.size
    assert np.nanmax(thinned) == 9.0
    assert np.nanmin(thinned) == np.nanmin(values)
    assert thin_time[np.nanargmax(thinned)] == pytest.approx(time_s[54_321], abs=0.11)
    assert np.isnan(thinned[(thin_time > 35.15) & (thin_time < 35.35)]).all()
    assert thin(time_s[:10], values[:10])[1].size == 10


def test_power_spectrum_holds_the_variance_and_skips_gaps() -> None:
    rng = np.random.default_rng(4)
    values = 3.0 + 0.5 * rng.standard_normal(20_000)
    frequency_hz, density = power_spectrum(values, 1000.0)
    assert np.sum(density) * frequency_hz[1] == pytest.approx(0.25, rel=0.05)
    values[5000:5100] = np.nan
    _, holed = power_spectrum(values, 1000.0)
    assert np.sum(holed) * frequency_hz[1] == pytest.approx(0.25, rel=0.05)
    values[np.arange(20_000) % 700 == 0] = np.nan
    _, holed = power_spectrum(values, 1000.0)
    assert np.sum(holed) * frequency_hz[1] == pytest.approx(0.25, rel=0.1)
    assert power_spectrum(values[:40], 1000.0) is None
    assert power_spectrum(np.full(1000, np.nan), 1000.0) is None


@pytest.mark.parametrize("samples", [4000, 400_000])
def test_white_noise_has_a_flat_spectrum_whose_integral_is_its_variance(samples: int) -> None:
    values = np.random.default_rng(5).normal(0.0, 2.0, samples)
    frequency_hz, density = power_spectrum(values, 2000.0)
    assert density[1:].mean() * 1000.0 == pytest.approx(4.0, rel=0.1)
    assert frequency_hz[-1] == 1000.0
    ends = density[-1] / density[-20:-1].mean()
    assert ends == pytest.approx(1.0, abs=0.2) or samples < 10_000


def test_slow_records_have_a_spectrum() -> None:
    values = np.random.default_rng(5).normal(0.0, 2.0, 2000)
    frequency_hz, _ = power_spectrum(values, 20.0)
    assert frequency_hz[1] == 20.0 / 64.0


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.02])
def test_power_edge_is_the_cut_off(noise: float) -> None:
    rng = np.random.default_rng(5)
    low_pass = signal.butter(8, 200.0, fs=2000.0, output="sos")
    values = signal.sosfilt(low_pass, rng.standard_normal(8000)) + noise * rng.standard_normal(8000)
    frequency_hz, density = power_spectrum(values, 2000.0)
    assert 190.0 < power_edge(frequency_hz, density) < 240.0
    assert power_edge(frequency_hz, np.zeros_like(density)) == frequency_hz[-1]


def test_runs() -> None:
    assert runs(np.array([True, False, True, True])) == [(0, 1), (2, 4)]
    assert runs(np.zeros(3, dtype=bool)) == []
