"""Plots of a diagnosis, as reports and window draw them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.gap.diagnosis_content import GapProfile, GapSpectrum, SignalOverlay
from tissueid.gap.diagnosis_plots import (
    overlay_plots,
    profile_plot,
    profile_values,
    spectrum_lines,
    spectrum_plot,
)

F = np.array([5.0, 10.0, 20.0])


def test_a_spectrum_is_shown_in_micrometres_per_root_hertz_down_to_a_tenth_of_the_noise():
    power = {name: np.array([1e-6, 1e-8, 1e-20]) for name in ("recorded", "residual", "linear", "even", "odd")}
    lines = spectrum_lines(SimpleNamespace(channel="position", noise=np.full(3, 1e-12), **power))
    np.testing.assert_allclose(lines["recorded"], [1e3, 1e2, np.nan])
    plot = spectrum_plot(GapSpectrum("position", F, lines, ((4.0, 6.0), (15.0, 25.0))))
    assert (plot.x.log, plot.y.log, plot.y.unit) == (True, True, "µm/√Hz")
    shade, recorded, *_rest = plot.curves
    assert (shade.kind, shade.x.tolist()) == ("spans", [4.0, 6.0, 15.0, 25.0])
    np.testing.assert_array_equal(recorded.y, lines["recorded"])


def test_errors_of_a_profile_stand_at_the_middle_of_their_bins():
    found = SimpleNamespace(
        edges=1e-3 * np.array([0.0, 2.0, 4.0, 6.0]),
        error=np.array([1.0, np.nan, 3.0]),
        above=np.array([False, False, True]),
    )
    profile = profile_values("depth_m", found)
    middle, error = profile.middle, profile.error
    np.testing.assert_allclose((middle, error), ([1.0, 5.0], [1.0, 3.0]))
    plot = profile_plot("depth_m", profile)
    assert (plot.x.unit, plot.y.unit, plot.y.log) == ("mm", "× noise", False)
    assert plot.curve("above noise").x.tolist() == [5.0]
    assert profile_plot("depth_m", replace(profile, error=30.0 * error)).y.log
    assert profile_plot("time_s", GapProfile(np.zeros(0), np.zeros(0), np.zeros(0, bool))).missing


@pytest.mark.parametrize("fitted", [True, False])
def test_an_overlay_has_the_band_of_the_noise_and_only_fitted_curves(fitted):
    after = F if fitted else None
    signal, left = overlay_plots(SignalOverlay("current", F, F, F + 1.0, after, F - 1.0, after, 2.0))
    assert [curve.name for curve in signal.curves] == ["recorded", "before"] + ["after"] * fitted
    assert (signal.y.unit, left.y.unit) == ("A", "mA")
    low, high = left.curves[-2:]
    np.testing.assert_allclose((low.y, high.y), (np.full(2, -3.92), np.full(2, 3.92)))
