from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from reports.synthetic_sitting import make_session, make_test

from tissueid.analysis import analyse
from tissueid.analysis.curves.results import record_plots
from tissueid.analysis.curves.signals import distribution_plots, recording_plots, recording_spectra, spectrum_plot
from tissueid.errors import UnusableInputError


def test_a_report_and_the_page_research_have_one_spectrum() -> None:
    test = make_test(seconds=2.0)
    first = round(test.preload_s * test.sample_rate_hz)
    played = test.signals["position"][first:]
    (page,) = spectrum_plot("Position", "m", [(played, test.sample_rate_hz)], ["measured"]).curves
    report = recording_spectra(test).curves[-1]
    np.testing.assert_array_equal(page.x, report.x)
    np.testing.assert_array_equal(page.y, report.y)


def test_a_result_shows_voltage_spectra_and_coherence() -> None:
    test = make_test(seconds=2.0)
    found = record_plots(test, {"spectral": analyse(make_session(test), "spectral")})
    volts = test.signals["voltage"]
    drawn = [curve for curve in found.voltage.curves if curve.kind == "line"][-1]
    assert (drawn.y.min(), drawn.y.max()) == (volts.min(), volts.max())
    assert [curve.colour for curve in found.spectra.curves] == ["measured", "model", "good"]
    assert found.coherence.curves[-1].kind == "level"
    bare = record_plots(replace(test, signals={"position": test.signals["position"]}), {})
    assert bare.voltage.missing.code == "report.no_voltage"
    assert bare.coherence.missing.code == "report.no_transfer_function"


def test_lost_samples_and_times_are_marked() -> None:
    test = make_test(seconds=2.0)
    position = test.signals["position"].copy()
    position[[500, 501, 1800]] = np.nan
    plots = recording_plots(replace(test, signals=test.signals | {"position": position}), (1.5, 2.0))
    assert {str(mark.text) for mark in plots[0].marks} == {"preload", "fitted", "held out", "■ not received"}
    spans = [curve for curve in plots[1].curves if curve.kind == "spans" and curve.colour == "poor"]
    ends = (spans[0].x * test.sample_rate_hz).reshape(-1, 2)
    assert [bool(np.any((ends[:, 0] < at) & (at < ends[:, 1]))) for at in (500, 501, 1000, 1800)] == [
        True,
        True,
        False,
        True,
    ]
    with pytest.raises(UnusableInputError, check=coded("report.no_signals")):
        recording_plots(replace(test, signals={}))


def test_a_distribution_has_an_area_of_one() -> None:
    for plot in distribution_plots(make_test(seconds=2.0).record()):
        bars, gaussian = plot.curves
        assert np.trapezoid(bars.y, bars.x) == pytest.approx(1.0)
        assert np.trapezoid(gaussian.y, gaussian.x) == pytest.approx(1.0, abs=0.02)
