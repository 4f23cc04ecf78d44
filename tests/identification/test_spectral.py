"""Welch spectra against scipy, Bode diagrams against known systems, standard deviations against repeats."""

from __future__ import annotations

import numpy as np
import pytest
from coded import refused
from identification import simulated
from scipy import signal

from tissueid.identification import validated
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.spectral import Spectral
from tissueid.identification.preparation import prepare
from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record

BAND = slice(4, 95)  # 8 to 188 Hz in bins of 2 Hz


@pytest.fixture(scope="module")
def record() -> Record:
    return simulated.linear_record(30)


@pytest.mark.parametrize(("taper", "overlap"), [("hann", 0.5), ("boxcar", 0.0), ("blackman", 0.75)])
def test_spectra_are_scipys(record: Record, taper: str, overlap: float):
    spectra = Spectral.from_options({"taper": taper, "overlap": overlap}).fit(record).spectra
    x, y = record.input - record.input.mean(), record.output - record.output.mean()
    options = {
        "fs": 2000.0,
        "window": signal.get_window(taper, 1000),
        "nperseg": 1000,
        "noverlap": int(1000 * overlap),
        "detrend": False,
    }
    frequency, input_psd = signal.welch(x, **options)
    np.testing.assert_allclose(spectra.frequency_hz, frequency)
    np.testing.assert_allclose(spectra.input_psd, input_psd, rtol=1e-9, atol=1e-25)
    np.testing.assert_allclose(spectra.output_psd, signal.welch(y, **options)[1], rtol=1e-9, atol=1e-30)
    np.testing.assert_allclose(spectra.coherence, signal.coherence(x, y, **options)[1], atol=1e-6)
    expected = signal.csd(x, y, **options)[1] / input_psd
    np.testing.assert_allclose(spectra.response[BAND], expected[BAND], rtol=1e-7)


def test_bode_diagram_of_a_known_system(record: Record):
    spectra = Spectral().spectra(prepare(record, None, 0.125))
    truth = SecondOrder(simulated.MASS, simulated.DAMPING, simulated.STIFFNESS).frequency_response(
        spectra.frequency_hz[BAND]
    )
    np.testing.assert_allclose(spectra.magnitude[BAND], np.abs(truth), rtol=0.06)
    np.testing.assert_allclose(spectra.phase_rad[BAND], np.unwrap(np.angle(truth)), atol=0.06)
    assert np.mean(spectra.coherence[BAND]) > 0.98


@pytest.mark.soak
def test_random_errors_are_the_spread_of_repeats():
    magnitude, phase, told_magnitude, told_phase = [], [], [], []
    for run in range(60):
        spectra = Spectral().fit(simulated.linear_record(31, run, snr_db=15.0)).spectra
        magnitude.append(spectra.magnitude[BAND])
        phase.append(np.angle(spectra.response[BAND]))
        told_magnitude.append(spectra.magnitude_std[BAND])
        told_phase.append(spectra.phase_std_rad[BAND])
    low = slice(0, 30)  # where 15 dB still leaves coherence: the formula is of first order
    spread = np.std(magnitude, axis=0, ddof=1)[low]
    assert np.mean(np.mean(told_magnitude, axis=0)[low] / spread) == pytest.approx(1.0, abs=0.15)
    spread = np.std(np.unwrap(phase, axis=0), axis=0, ddof=1)[low]
    assert np.mean(np.mean(told_phase, axis=0)[low] / spread) == pytest.approx(1.0, abs=0.15)


def test_unrelated_signals_pass_the_coherence_floor_one_time_in_twenty():
    above = []
    for run in range(20):
        rng = simulated.generator(32, run)
        record = Record(rng.standard_normal(8000), rng.standard_normal(8000), 2000.0)
        spectra = Spectral().fit(record).spectra
        above.append(np.mean(spectra.coherence[2:-2] > spectra.coherence_floor))
    assert np.mean(above) == pytest.approx(0.05, abs=0.015)


def test_simulation_holds_its_own_against_lms(record: Record):
    spectral = validated(Spectral().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    lms = validated(Lms().fit(record, slice(0, 6000)), record, slice(6000, None)).report
    assert spectral.vaf_validation_percent > lms.vaf_validation_percent - 0.3
    assert spectral.parameters["stiffness_n_per_m"].value == pytest.approx(simulated.STIFFNESS, rel=0.01)


def test_segments_lie_between_gaps(record: Record):
    u = simulated.changed(record.input, (np.s_[2500:2507], np.nan))
    y = simulated.changed(record.output, (6000, np.nan))
    model = Spectral().fit(Record(u, y, 2000.0))
    # 2500, 3493 and 1999 samples without a gap hold 4, 5 and 2 segments of 1000 by half overlap
    assert model.spectra.averages == pytest.approx(11 * 14.26 / 15, rel=0.06)
    assert np.mean(model.spectra.coherence[BAND]) > 0.98
    assert model.report.vaf_percent > 99.5


def test_too_few_segments_are_refused(record: Record):
    refused(lambda: Spectral(window=3.0).fit(record), "spectral.too_few_segments", count=1, window=3.0)
    refused(lambda: Spectral(window=0.1).fit(record), "spectral.window_shorter_than_memory", window=0.1, memory=0.125)
