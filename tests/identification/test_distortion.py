"""Noise, even and odd distortion from multisines, against noise-free simulations of the same phases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, codes
from identification import simulated
from identification import simulated_validation as systems
from outside_data import REAL
from scipy import io

from tissueid.errors import UnusableInputError
from tissueid.identification.validation.distortion import Distortion, cut_periods, distortion, find_driven, find_period
from tissueid.records import Record

LINES = systems.grid(90)
BENT = {"even": 0.05, "odd": 0.03}
SILVERBOX = REAL / "SNLS80mV.mat"


def recorded(phases: int, noise: float = 0.02, periods: int = 3, bent: float = 0.0, **system: float) -> list[Record]:
    system = {**BENT, **system}
    return [systems.multisine(LINES, 91, k, periods=periods, noise=noise, bent=bent, **system) for k in range(phases)]


def response(bent: float = 0.0, phases: int = 60) -> np.ndarray:
    """Best linear approximation by averaging noise-free answers to other phases, at the driven lines."""
    answers = [systems.multisine(LINES, 92, k, periods=1, bent=bent, **BENT) for k in range(phases)]
    u, y = (
        np.array([np.fft.rfft(getattr(a, name)[-systems.PERIOD :])[LINES] for a in answers])
        for name in ("input", "output")
    )
    return np.mean(y * u.conj(), axis=0) / np.mean(np.abs(u) ** 2, axis=0)


def truth(linear: np.ndarray, phases: int, bent: float = 0.0) -> tuple[float, float]:
    """Even and odd distortion of these phases, noise-free: what their answers hold beyond the linear one."""
    band = np.arange(LINES[0], LINES[-1] + 1)
    power = np.zeros(band.size)
    for record in recorded(phases, 0.0, 1, bent):
        u, y = (np.fft.rfft(s[-systems.PERIOD :])[band] for s in (record.input, record.output))
        everywhere = np.interp(band, LINES, linear.real) + 1j * np.interp(band, LINES, linear.imag)
        power += 2.0 * np.abs(y - everywhere * u) ** 2 / systems.PERIOD**2 / phases
    return float(np.sqrt(power[band % 2 == 0].sum())), float(np.sqrt(power[band % 2 == 1].sum()))


def decibels(ratio: float) -> float:
    return 20.0 * float(np.log10(ratio))


@pytest.mark.parametrize("bent", [0.0, 0.02])
@pytest.mark.parametrize("phases", [1, 8])
def test_levels_are_within_one_decibel_of_the_truth(phases: int, bent: float):
    even, odd = truth(response(bent), phases, bent)
    found = distortion(recorded(phases, bent=bent))
    assert decibels(found.even_rms.value / even) == pytest.approx(0.0, abs=1.0)
    assert decibels(found.odd_rms.value / odd) == pytest.approx(0.0, abs=1.0)
    pole = np.abs(1.0 / (1.0 - 0.8 * np.exp(-2j * np.pi * np.arange(0, systems.PERIOD // 2) / systems.PERIOD))) ** 2
    share = pole[LINES[0] : LINES[-1] + 1].sum() / pole.sum()
    assert decibels(found.noise_rms.value / (0.02 * np.sqrt(share))) == pytest.approx(0.0, abs=0.5)


def test_the_lines_and_the_period_are_found():
    found = distortion(recorded(1))
    np.testing.assert_array_equal(found.driven.line, LINES)
    assert found.period == systems.PERIOD
    assert found.periods == 3
    odd = np.arange(1, LINES[-1] + 1, 2)
    np.testing.assert_array_equal(found.detection.line, np.setdiff1d(odd, LINES))
    assert np.all(found.even.line % 2 == 0)
    np.testing.assert_allclose(found.driven.frequency_hz, LINES * systems.RATE / systems.PERIOD)
    given = distortion(recorded(1), systems.PERIOD, list(LINES))
    np.testing.assert_array_equal(given.response, found.response)


def test_a_linear_system_shows_noise_alone():
    found = distortion(recorded(2, even=0.0, odd=0.0))
    for level in (found.even_rms, found.odd_rms):
        assert level.value < 0.25 * found.noise_rms.value


def test_even_and_odd_are_told_apart():
    even = distortion(recorded(1, noise=1e-4, odd=0.0))
    odd = distortion(recorded(1, noise=1e-4, even=0.0))
    assert even.relative_db(even.even_rms) > even.relative_db(even.odd_rms) + 30.0  # type: ignore[operator]
    assert odd.relative_db(odd.odd_rms) > (odd.relative_db(odd.even_rms) or -200.0) + 30.0  # type: ignore[operator]


def test_the_best_linear_approximation_and_its_deviations():
    linear = response(phases=200)
    off, noise, total = [], [], []
    for k in range(12):
        records = [systems.multisine(LINES, 94, k, m, periods=3, noise=0.02, **BENT) for m in range(4)]
        found = distortion(records)
        off.append(np.abs(found.response - linear) ** 2)
        noise.append(found.response_noise_std**2)
        total.append(found.response_total_std**2)
    assert np.sqrt(np.mean(total) / np.mean(off)) == pytest.approx(1.0, abs=0.15)
    assert np.mean(noise) < np.mean(total)


def test_one_realisation_takes_its_deviation_from_the_detection_lines():
    linear = response(phases=200)
    off, total = [], []
    for k in range(12):
        found = distortion(systems.multisine(LINES, 95, k, periods=3, noise=0.02, **BENT))
        off.append(np.abs(found.response - linear) ** 2)
        total.append(found.response_total_std**2)
    assert np.sqrt(np.mean(total) / np.mean(off)) == pytest.approx(1.0, abs=0.2)


def test_deviations_of_the_levels_hold():
    linear = response()
    apart = []
    for k in range(20):
        record = systems.multisine(LINES, 91, k, periods=3, noise=0.05, **BENT)
        band = np.arange(LINES[0], LINES[-1] + 1)
        clean = systems.multisine(LINES, 91, k, periods=1, **BENT)
        u, y = (np.fft.rfft(s[-systems.PERIOD :])[band] for s in (clean.input, clean.output))
        left = y - (np.interp(band, LINES, linear.real) + 1j * np.interp(band, LINES, linear.imag)) * u
        found = distortion(record)
        for level, parity in ((found.even_rms, 0), (found.odd_rms, 1)):
            exact = np.sqrt(2.0 * np.sum(np.abs(left[band % 2 == parity]) ** 2)) / systems.PERIOD
            apart.append((level.value - exact) / level.std)  # type: ignore[operator]
    assert 0.5 < np.std(apart) < 1.5


def test_a_period_with_a_gap_is_left_out():
    record = recorded(1, periods=4)[0]
    u = simulated.changed(record.input, (200 + systems.PERIOD + 50, np.nan))
    found = distortion(replace(record, input=u), systems.PERIOD)
    assert found.periods == 3


def test_a_drift_is_no_distortion():
    record = recorded(1, noise=1e-3, periods=4, even=0.0, odd=0.0)[0]
    drifting = replace(record, output=record.output + 0.5 * record.time)
    found = distortion(drifting)
    assert found.even_rms.value < 2e-3


def test_without_detection_lines_the_spread_of_phases_tells_the_odd_level():
    full = np.arange(1, systems.TOP, 2)
    one = systems.multisine(full, 96, periods=3, noise=0.02, **BENT)
    alone = distortion(one)
    assert alone.odd_rms is None
    assert "distortion.no_odd_level" in codes(alone.findings)
    assert np.isnan(alone.response_total_std).all()
    several = distortion([systems.multisine(full, 96, k, periods=3, noise=0.02, **BENT) for k in range(10)])
    single = distortion(recorded(10))
    assert decibels(several.odd_rms.value / single.odd_rms.value) == pytest.approx(0.0, abs=1.5)


def test_a_single_period_without_run_in_shows_no_noise():
    record = recorded(1, periods=1)[0]
    cut = replace(record, input=record.input[200:], output=record.output[200:])
    found = distortion(cut, systems.PERIOD, list(LINES), settling=0.0)
    assert found.noise_rms is None
    assert found.relative_db(found.noise_rms) is None
    assert "distortion.one_period" in codes(found.findings)
    with_run_in = distortion(record, systems.PERIOD, list(LINES))
    assert decibels(with_run_in.noise_rms.value / (0.02 * np.sqrt(0.4))) == pytest.approx(0.0, abs=2.5)  # as if white


def test_a_spur_far_above_the_stimulus_is_not_driven():
    power = np.full(1001, 1e-6)
    power[1:200:2] = 1.0
    power[855] = 0.1
    np.testing.assert_array_equal(find_driven(power), np.arange(1, 200, 2))


@pytest.mark.parametrize("period", [500, 733])
def test_the_period_of_a_smooth_signal_is_found(period: int):
    rng = simulated.generator(97, period)
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[1:8] = np.exp(2j * np.pi * rng.random(7))
    u = np.tile(np.fft.irfft(spectrum, period), 4)
    noisy = u + 0.02 * np.std(u) * rng.standard_normal(u.size)
    noisy[700:705] = np.nan
    assert find_period(noisy + 5.0) == pytest.approx(period, abs=1)
    assert find_period(u[: round(1.2 * period)]) == period


def test_refusals_are_one_line():
    record = recorded(1)[0]
    noise = simulated.generator(98).standard_normal(4000)
    full = np.fft.irfft(np.concatenate([[0], np.exp(1j * np.arange(300.0)), np.zeros(200)]), 1000)
    cases: list[tuple[str, object]] = [
        ("multisine.no_period", lambda: distortion(Record(noise, noise, 1000.0))),
        ("multisine.constant", lambda: distortion(Record(np.ones(4000), noise, 1000.0))),
        ("multisine.short", lambda: distortion(record, 9000)),
        ("multisine.not_odd", lambda: distortion(Record(np.tile(full, 4), np.tile(full, 4), 1000.0))),
        ("distortion.driven_lines", lambda: distortion(record, systems.PERIOD, [2, 4])),
        ("distortion.no_record", lambda: distortion([])),
        ("distortion.sample_rates", lambda: distortion([record, replace(record, sample_rate_hz=500.0)])),
        ("multisine.short_period", lambda: distortion(record, 20, None)),
    ]
    for code, refused in cases:
        with pytest.raises(UnusableInputError, check=coded(code)):
            refused()  # type: ignore[operator]


def test_cut_periods_count_from_the_end():
    cut = cut_periods(recorded(1)[0], systems.PERIOD, 0.1)
    assert cut.output.shape == (3, systems.PERIOD // 2 + 1)
    assert cut.tail.size == 100


@pytest.mark.skipif(not SILVERBOX.exists(), reason="the record is not here")
def test_a_circuit_with_a_hardening_spring_is_odd():
    data = io.loadmat(SILVERBOX)
    u, y = data["V1"].ravel(), data["V2"].ravel()
    starts = [40580 + 8693 * k for k in range(9)]
    found: Distortion = distortion([Record(u[s : s + 8585], y[s : s + 8585], 1e7 / 2**14) for s in starts])
    assert found.period == 8192
    np.testing.assert_array_equal(found.driven.line, np.arange(1, 2684, 2))
    levels = [found.relative_db(level) for level in (found.noise_rms, found.even_rms, found.odd_rms)]
    np.testing.assert_allclose(levels, [-47.6, -55.3, -18.2], atol=1.0)  # type: ignore[arg-type]
