"""Spectra: power and autocorrelation belong together, are those named, and impossible ones are refused."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from coded import coded
from scipy import integrate, signal

from tissueid.errors import UnusableInputError
from tissueid.stimuli.spectra import (
    AutocorrelationTable,
    Band,
    Butterworth,
    ExponentialDecay,
    PowerTable,
    SecondOrderSpectrum,
    Spectrum,
    White,
)

RATE = 2000.0
TRIANGLE = AutocorrelationTable((0.0, 0.01), (1.0, 0.0))
SLOPES = PowerTable((10.0, 50.0, 200.0, 300.0), (1.0, 4.0, 2.0, 0.0))
SMOOTH = (
    White(),
    Butterworth(200.0),
    Butterworth(30.0, order=3),
    ExponentialDecay(0.005),
    SecondOrderSpectrum(40.0, 0.3),
    TRIANGLE,
)


@pytest.mark.parametrize("spectrum", [*SMOOTH, Band(200.0), SLOPES], ids=repr)
def test_both_are_normalised(spectrum: Spectrum):
    spectrum.check(RATE)
    correlation, power = spectrum.autocorrelation(50, RATE), spectrum.power(100_000, RATE)
    assert correlation.shape == (51,)
    assert correlation[0] == 1.0
    assert np.max(np.abs(correlation)) <= 1.0
    assert np.min(power) >= 0.0
    assert np.mean(power) == pytest.approx(1.0, abs=1e-3)
    assert spectrum.power(15, RATE).shape == (8,)


@pytest.mark.parametrize("spectrum", SMOOTH, ids=repr)
def test_power_and_autocorrelation_are_a_pair(spectrum: Spectrum):
    n = 1 << 15
    whole = np.fft.irfft(spectrum.power(n, RATE), n)
    np.testing.assert_allclose(spectrum.autocorrelation(500, RATE), whole[:501], atol=1e-9)


def test_a_butterworth_is_what_the_filter_makes_of_white_noise():
    response = signal.sosfilt(signal.butter(8, 200.0, fs=RATE, output="sos"), np.eye(1, 6000)[0])
    expected = np.correlate(response, response, "full")[5999:6500]
    np.testing.assert_allclose(Butterworth(200.0).autocorrelation(500, RATE), expected / expected[0], atol=1e-12)


@pytest.mark.parametrize("spectrum", [SLOPES, Band(200.0), PowerTable((5.0, 6.0, 6.5), (0.0, 1.0, 0.0))], ids=repr)
def test_an_autocorrelation_is_the_integral_of_the_power(spectrum: Spectrum):
    f, s = ((0.0, 200.0), (1.0, 1.0)) if isinstance(spectrum, Band) else (spectrum.frequencies_hz, spectrum.densities)
    found = spectrum.autocorrelation(300, RATE)
    whole = np.trapezoid(s, f)
    for lag in (1, 7, 60, 300):
        expected = sum(
            integrate.quad(lambda x, w=2 * np.pi * lag / RATE: np.interp(x, f, s) * np.cos(w * x), a, b, limit=200)[0]
            for a, b in pairwise(f)
        )
        assert found[lag] == pytest.approx(expected / whole, abs=1e-9)


def test_the_forms_of_the_thesis():
    t = np.arange(101) / RATE
    np.testing.assert_allclose(ExponentialDecay(0.01).autocorrelation(100, RATE), np.exp(-100.0 * t), rtol=1e-12)
    w, z = 2.0 * np.pi * 16.0, 0.3
    expected = np.exp(-w * z * t) * np.cos(w * np.sqrt(1.0 - z**2) * t)
    np.testing.assert_allclose(SecondOrderSpectrum(16.0, 0.3).autocorrelation(100, RATE), expected, atol=1e-12)


def test_a_table_of_an_autocorrelation_gives_the_power_of_what_it_was_taken_from():
    lags = np.arange(400) / RATE
    taken = tuple(np.exp(-lags / 0.005))
    table = AutocorrelationTable(tuple(lags), taken)
    table.check(RATE)
    np.testing.assert_allclose(table.autocorrelation(399, RATE), taken, atol=1e-12)
    np.testing.assert_allclose(table.power(1000, RATE), ExponentialDecay(0.005).power(1000, RATE), atol=1e-9)
    assert table.autocorrelation(500, RATE)[400:].max() == 0.0
    assert table.power(200, RATE).mean() == pytest.approx(1.0, abs=0.1)  # longer than the record: comes round


def test_rounding_to_three_digits_does_not_make_an_autocorrelation_impossible():
    lags = np.arange(200) / RATE
    window = 1.0 - np.arange(200) / 200.0
    rounded = np.round(Band(200.0).autocorrelation(199, RATE) * window, 3)
    AutocorrelationTable(tuple(lags), tuple(rounded)).check(RATE)


@pytest.mark.parametrize(
    ("spectrum", "refusal"),
    [
        (
            Butterworth(1000.0),
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1000.0, needed=2000.0, sample_rate_hz=2000.0),
        ),
        (
            Butterworth(1e-4),
            coded("spectrum.low_cutoff", cutoff_hz=0.0001, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            Butterworth(1e-3),
            coded("spectrum.low_cutoff", cutoff_hz=0.001, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            Butterworth(0.05),
            coded("spectrum.low_cutoff", cutoff_hz=0.05, sample_rate_hz=2000.0, reason="spectrum.grid"),
        ),
        (
            Butterworth(1e-300),
            coded("spectrum.low_cutoff", cutoff_hz=1e-300, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (
            Butterworth(0.0159, order=1),
            coded("spectrum.low_cutoff", cutoff_hz=0.0159, sample_rate_hz=2000.0, reason="spectrum.settling"),
        ),
        (SecondOrderSpectrum(1e-300, 0.3), coded("spectrum.slow", natural_hz=1e-300, damping=0.3)),
        (SecondOrderSpectrum(40.0, 1e-9), coded("spectrum.slow", natural_hz=40.0, damping=1e-09)),
        (ExponentialDecay(1e-320), coded("spectrum.time_constant", time_constant_s=1e-320, limit=5000000)),
        (ExponentialDecay(1e6), coded("spectrum.time_constant", limit=5000000)),
        (AutocorrelationTable((0.0, 1e306), (1.0, 0.0)), coded("autocorrelation.long", limit=5000000)),
        (PowerTable((0.0, 1e308), (1.0, 0.0)), coded("spectrum.table_rate", highest=1e308, sample_rate_hz=2000.0)),
        (
            Band(1500.0),
            coded("spectrum.nyquist", what="a cutoff", frequency_hz=1500.0, needed=3000.0, sample_rate_hz=2000.0),
        ),
        (
            SecondOrderSpectrum(1000.0, 0.3),
            coded(
                "spectrum.nyquist",
                what="a natural frequency",
                frequency_hz=1000.0,
                needed=2000.0,
                sample_rate_hz=2000.0,
            ),
        ),
        (
            PowerTable((0.0, 1200.0), (1.0, 1.0)),
            coded("spectrum.table_rate", highest=1200.0, needed=2400.0, sample_rate_hz=2000.0),
        ),
        (
            AutocorrelationTable((0.0, 0.0005, 0.001), (1.0, 0.9, 0.0)),
            coded("autocorrelation.impossible", frequency=1000.0),
        ),
        (AutocorrelationTable((0.0, 0.01, 0.0101), (1.0, 1.0, 0.0)), coded("autocorrelation.impossible")),
        (AutocorrelationTable((0.0, 1e9), (1.0, 0.0)), coded("autocorrelation.long", limit=5000000)),
    ],
    ids=repr,
)
def test_what_no_sampled_signal_has_is_refused_in_one_line(spectrum: Spectrum, refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        spectrum.check(RATE)
    assert "\n" not in str(refused.value)


def test_the_least_cut_off_that_is_told_will_do():
    for order in (1, 8, 12):
        with pytest.raises(UnusableInputError, check=coded("spectrum.low_cutoff")) as refused:
            Butterworth(1e-6, order).check(RATE)
        least = float(f"{refused.value.message.values['least']:.3g}")
        Butterworth(least, order).check(RATE)


def test_a_gain_worked_out_in_pieces_is_the_gain():
    spectrum, n = Butterworth(5.0, order=4), 1 << 18
    low_pass = signal.butter(4, 5.0, fs=RATE, output="sos")
    _, response = signal.sosfreqz(low_pass, np.fft.rfftfreq(n, 1.0 / RATE), fs=RATE)
    power = spectrum.power(n, RATE)
    np.testing.assert_allclose(power / power[0], np.abs(response) ** 2 / np.abs(response[0]) ** 2, rtol=1e-12)


def test_power_that_ends_at_half_the_sample_rate_is_not_above_it():
    PowerTable((0.0, 1000.0), (1.0, 1.0)).check(RATE)
    PowerTable((0.0, 1000.0, 5000.0, 6000.0), (1.0, 0.0, 0.0, 0.0)).check(RATE)


@pytest.mark.parametrize(
    ("make", "refusal"),
    [
        (lambda: PowerTable((1.0, 2.0), (1.0,)), coded("spectrum.table_lengths", frequencies_hz=2, densities=1)),
        (lambda: PowerTable((), ()), coded("spectrum.table_lengths", frequencies_hz=0, densities=0)),
        (lambda: PowerTable((1.0, 1.0), (1.0, 1.0)), coded("spectrum.table_rise")),
        (lambda: PowerTable((-1.0, 1.0), (1.0, 1.0)), coded("spectrum.table_rise")),
        (lambda: PowerTable((1.0, 2.0, 3.0), (1.0, -0.5, 1.0)), coded("spectrum.negative", at=2.0, densities=-0.5)),
        (lambda: PowerTable((1.0, 2.0), (0.0, 0.0)), coded("spectrum.zero")),
        (lambda: PowerTable((0.0, 5e-324), (0.0, 5e-324)), coded("spectrum.scale", total=0.0)),
        (lambda: PowerTable((0.0, 100.0), (1e-311, 1e-311)), coded("spectrum.scale")),
        (lambda: PowerTable((0.0, 100.0), (1e308, 1e308)), coded("spectrum.scale")),
        (lambda: PowerTable((0.0, 1e-310, 100.0), (1.0, 2.0, 1.0)), coded("spectrum.scale", total=150.0)),
        (lambda: AutocorrelationTable((0.0,), (1.0,)), coded("autocorrelation.lengths", lags_s=1, correlations=1)),
        (lambda: AutocorrelationTable((0.0, 0.1), (1.0,)), coded("autocorrelation.lengths", lags_s=2, correlations=1)),
        (lambda: AutocorrelationTable((0.1, 0.2), (1.0, 0.5)), coded("autocorrelation.rise")),
        (lambda: AutocorrelationTable((0.0, 0.2, 0.1), (1.0, 0.5, 0.4)), coded("autocorrelation.rise")),
        (lambda: AutocorrelationTable((0.0, 0.1), (2.0, 0.5)), coded("autocorrelation.lag_zero", correlations=2.0)),
        (
            lambda: AutocorrelationTable((0.0, 0.1), (1.0, -1.5)),
            coded("autocorrelation.range", largest=0.1, value=-1.5),
        ),
    ],
)
def test_tables_that_are_none_are_refused_in_one_line(make, refusal):
    with pytest.raises(UnusableInputError, check=refusal) as refused:
        make()
    assert "\n" not in str(refused.value)
