"""What is shown of a running test: against known systems, early on, and with gaps."""

from __future__ import annotations

import numpy as np
import pytest
from coded import refused, says
from identification import simulated

from tissueid.identification.engines.als import Als
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.rls import Rls
from tissueid.identification.engines.spectral import Spectral
from tissueid.identification.live.live_view import METHODS, LiveView, Method, start_identifier, view
from tissueid.identification.live.stopping import precision
from tissueid.messages import code_of
from tissueid.procedures.test_plan import LIVE_METHODS
from tissueid.records import Record

RATE = simulated.RATE


def looked(method: Method, record: Record) -> LiveView:
    identifier = start_identifier(method, RATE)
    identifier.batch(record.input, record.output)
    return view(identifier, [precision(record[:n]) for n in (2000, 4000, len(record))])


@pytest.mark.parametrize("method", METHODS)
def test_a_linear_tissue_shows_itself(method: Method):
    record = simulated.linear_record(190)
    shown = looked(method, record)
    assert (shown.method, shown.seconds, shown.missing) == (method, 4.0, "")
    assert shown.vaf_percent > 99.0
    mass, damping, stiffness = simulated.MASS, simulated.DAMPING, simulated.STIFFNESS
    assert 2.0 <= shown.bode.frequency_hz[0] <= 4.0
    assert 180.0 < shown.bode.frequency_hz[-1] < 260.0
    s = 2j * np.pi * shown.bode.frequency_hz
    truth = 1.0 / (mass * s**2 + damping * s + stiffness)
    inside = shown.bode.frequency_hz < 100.0
    tolerance = 0.25 if method == "als" else 0.05  # an average over what was not learnt yet
    np.testing.assert_allclose(shown.bode.magnitude[inside], np.abs(truth)[inside], rtol=tolerance)
    np.testing.assert_allclose(shown.bode.phase_rad[inside], np.unwrap(np.angle(truth))[inside], atol=tolerance)
    assert np.min(shown.bode.coherence[inside]) > 0.95
    assert 0.0 < shown.bode.coherence_floor < 0.5
    spectra = Spectral().fit(record).spectra
    np.testing.assert_allclose(shown.spectra.frequency_hz, spectra.frequency_hz[1:])
    np.testing.assert_allclose(shown.spectra.input_psd, spectra.input_psd[1:], rtol=1e-6)
    np.testing.assert_allclose(shown.spectra.output_psd, spectra.output_psd[1:], rtol=1e-6)
    reach = float(np.ptp(shown.curve.curve_x))
    assert np.max(np.abs(shown.curve.measured - shown.curve.predicted)) < 0.05 * reach
    assert np.max(np.abs(shown.curve.curve_y - shown.curve.curve_x)) < 0.05 * reach
    assert shown.depths.share.sum() == pytest.approx(1.0)
    assert shown.depths.edges[[0, -1]] == pytest.approx([record.output.min(), record.output.max()])
    assert shown.parameters["stiffness"].value == pytest.approx(stiffness, rel=0.01)
    assert shown.course.seconds.tolist() == [1.0, 2.0, 4.0]
    assert shown.course.values.shape == shown.course.std.shape == (3, 3)
    assert shown.course.std[0, 2] > shown.course.std[2, 2]


def test_a_plan_offers_every_method():
    assert tuple(LIVE_METHODS) == METHODS


def test_the_response_is_that_of_the_engine():
    """Sliding and recursive: response and band; adaptive: the average response."""
    record = simulated.linear_record(191, snr_db=20.0)
    exact = looked("sliding", record), Lms().fit(record)
    np.testing.assert_allclose(exact[0].impulse_response, exact[1].impulse_response, atol=1e-6)
    np.testing.assert_allclose(exact[0].impulse_response_std, exact[1].impulse_response_std, rtol=1e-5)
    assert exact[0].vaf_percent == pytest.approx(exact[1].report.vaf_percent, abs=1e-6)
    recursive = looked("rls", record), Rls().fit(record)
    std = recursive[1].impulse_response_std
    assert np.max(np.abs(recursive[0].impulse_response - recursive[1].impulse_response) / std) < 0.5
    np.testing.assert_allclose(recursive[0].impulse_response_std, std, rtol=0.1)
    adaptive = looked("als", record), Als().fit(record)
    assert adaptive[0].impulse_response_std is None
    assert adaptive[0].vaf_percent == pytest.approx(adaptive[1].report.vaf_percent, abs=0.5)


@pytest.mark.parametrize("method", METHODS)
def test_a_curve_of_the_tissue_is_seen(method: Method):
    """The exponential of Eq. 3.26: over the range of the prediction its slope falls to a known share."""
    shown = looked(method, simulated.wiener_record(192))
    x, y = shown.curve.curve_x, shown.curve.curve_y
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    assert last < 0.4 * first
    assert np.all(np.diff(shown.curve.predicted) > 0.0)
    assert np.max(np.abs(np.interp(shown.curve.predicted, x, y) - shown.curve.measured)) < 0.05 * np.ptp(y)


@pytest.mark.parametrize("method", METHODS)
def test_before_there_is_enough_it_says_so(method: Method):
    record = simulated.linear_record(193)
    identifier = start_identifier(method, RATE)
    assert says(view(identifier).missing, "record.empty")
    identifier.batch(record.input[:100], record.output[:100])
    shown = view(identifier)
    assert code_of(shown.missing) == "record.shorter_than_memory"
    assert (shown.impulse_response.size, shown.bode, shown.curve, shown.vaf_percent) == (0, None, None, None)
    assert shown.spectra is None
    assert (shown.parameters, shown.second_order, shown.course.values.shape) == ({}, None, (0, 3))
    identifier.batch(record.input[100:600], record.output[100:600])
    shown = view(identifier)
    assert shown.impulse_response.size == 250
    assert shown.bode is None
    assert says(shown.missing, "online.short_for_coherence", segments=3.0, memory=0.125)


@pytest.mark.parametrize("method", METHODS)
def test_gaps_are_left_out(method: Method):
    record = simulated.linear_record(194)
    u, y = record.input.copy(), record.output.copy()
    u[3000], y[6000:6010] = np.nan, np.nan
    shown = looked(method, Record(u, y, RATE))
    assert shown.vaf_percent > 99.0
    assert np.all(np.isfinite(shown.bode.magnitude))
    assert shown.parameters["stiffness"].value == pytest.approx(simulated.STIFFNESS, rel=0.01)


def test_looking_changes_nothing():
    record = simulated.linear_record(195)
    for method in METHODS:
        one, other = start_identifier(method, RATE), start_identifier(method, RATE)
        for first in range(0, 3000, 500):
            some = slice(first, first + 500)
            one.batch(record.input[some], record.output[some])
            other.batch(record.input[some], record.output[some])
            view(one)
        np.testing.assert_array_equal(view(one).impulse_response, view(other).impulse_response)


def test_no_such_method():
    refused(lambda: start_identifier("magic", RATE), "online.unknown_method", method="magic")
