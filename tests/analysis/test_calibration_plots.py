"""Plots of calibrations, as the page Instrument draws them."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from coded import coded

from tissueid.analysis.curves.calibration_plots import line_plots, residual_plot, stroke_plot, trend_plot
from tissueid.calibration.comparison import Residuals, Trend
from tissueid.errors import UnusableInputError

NOW = datetime(2026, 6, 1, tzinfo=UTC)


def test_residuals_are_shown_in_small_units_evenly_about_zero():
    plot = residual_plot(Residuals("Current", np.array([1.0, 2.0]), np.array([1e-3, -2e-3]), "V", "A"))
    (points,) = plot.curves
    np.testing.assert_allclose(points.y, [1.0, -2.0])
    assert (plot.x.unit, plot.y.unit, plot.y.zero) == ("V", "mA", True)
    assert plot.y.limits == pytest.approx((-2.3, 2.3))


def test_a_line_has_its_readings_and_crosses_for_outliers():
    x, off = np.array([1.0, 2.0, 3.0]), np.array([1e-3, 5e-3, -1e-3])
    found = Residuals("Current", x, off, "V", "A", ("Voltage", "Current"), 0.1 * x + off, off > 2e-3)
    left, right = line_plots(found)
    line, points, crosses = left.curves
    np.testing.assert_allclose((line.x, line.y), ([1.0, 3.0], [0.1, 0.3]))
    np.testing.assert_allclose(points.x, [1.0, 3.0])
    np.testing.assert_allclose((crosses.x, crosses.y), ([2.0], [0.205]))
    assert (left.x.label, left.y.label, right.y.unit, crosses.marker) == ("Voltage", "Current", "mA", "X")
    with pytest.raises(UnusableInputError, check=coded("report.no_readings")):
        line_plots(replace(found, reading=None))


def test_a_trend_stands_over_the_days_before_today_with_its_deviation():
    dates = (NOW - timedelta(days=10), NOW - timedelta(days=2))
    found = Trend("coil_resistance_ohm", "ohm", dates, np.array([12.0, 12.2]), np.array([0.1, np.nan]), None)
    line, points = trend_plot(found, NOW).curves
    np.testing.assert_allclose(line.x, [-10.0, -2.0])
    np.testing.assert_allclose((line.low, line.high), ([11.9, 12.2], [12.1, 12.2]))
    np.testing.assert_allclose(points.y, line.y)


def sweep(mass=None, region=(0.004, 0.027)):
    table = {"position_m": (0.01, 0.005), "mass_kg": (0.08, 0.07), "mass_std_kg": (0.001, 0.002)}
    ends = {f"linear_region_{end}_m": SimpleNamespace(value=at) for end, at in zip(("min", "max"), region, strict=True)}
    return SimpleNamespace(tables={"sweep": table} if mass is None else {}, quantities=ends)


def test_sweeps_have_a_colour_each_a_band_and_a_shaded_linear_region():
    plot = stroke_plot("mass", [sweep(), sweep(mass="none")], ["measured", "model"])
    spans = [curve for curve in plot.curves if curve.kind == "spans"]
    assert {curve.colour for curve in spans} == {"measured", "model"}
    np.testing.assert_allclose(spans[0].x, [4.0, 27.0])
    (line,) = (curve for curve in plot.curves if curve.kind == "line")
    np.testing.assert_allclose((line.x, line.y, line.low), ([5.0, 10.0], [70.0, 80.0], [68.0, 79.0]))
    assert stroke_plot("vaf", [sweep()], ["measured"]).missing
