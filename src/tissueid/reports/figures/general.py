"""Figures of any model: simulation of held-out samples, residual tests, and parameters against depth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from tissueid.analysis.curves.diagnostics import held_out_prediction
from tissueid.analysis.curves.plot import CONFIDENCE
from tissueid.analysis.scoring import effective_parameters
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, fixed, number
from tissueid.identification.base import Model
from tissueid.identification.validation.prediction import fit_noise, prediction_curve
from tissueid.identification.validation.residual_tests import ResidualTest, TestName, residual_tests
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports import captions
from tissueid.reports.depth_panels import depth_panels
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import diagonal, residual_cloud
from tissueid.reports.style import (
    BLUE,
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    MUTED,
    ORANGE,
    POINTS,
    SHADE,
    new_figure,
)
from tissueid.reports.validation_figures import prediction_figure
from tissueid.units import display_unit

_ANY: type[Model] = Model  # type: ignore[type-abstract]
_STRETCH_S = 0.25
"""Seconds of held-out samples that are drawn one by one; a comparison has one such figure for each engine."""

_BAND_POINTS = 48
"""Number of points with which a smooth band is drawn."""
_BAND_MISSED = 0.05
"""Largest error of that interpolation, as a share of the median band, for which a band counts as smooth."""

_SMALL_GAIN = 2.0
"""Points of VAF between one-step prediction and free run up to which the residual counts as uncorrelated."""

_TITLES: dict[TestName, str] = {
    "autocorrelation": marked("Its own past"),
    "input": marked("Input"),
    "feedback": marked("Later input"),
    "squared_input": marked("Input squared"),
    "squared_output": marked("Output squared"),
    "squared_speed": marked("Speed squared"),
    "cubed_output": marked("Output cubed"),
    "residual_size_input": marked("Its size, by input"),
    "residual_size_squared_input": marked("Its size, by input²"),
    "residual_input_product": marked("Its past times input"),
}


@figure(
    _ANY,
    "depth-profile",
    marked("Mass, damping and stiffness against depth"),
    marked(
        "Three panels against depth: mass, damping and stiffness with 95 % bars, and below the samples at each depth."
    ),
    group="nonlinear",
    place=30,
    applies=lambda subject: subject.profile is not None,
)
def depth_profile(subject: Subject[Model]) -> Drawn:
    """Draw mass, damping and stiffness against depth of one engine (Chen 2010, Figs. 5.9 to 5.11)."""
    profile = subject.profile
    if profile is None:
        raise UnusableInputError(Message("report.no_depth", "this model has no parameters against depth"))
    text = _(
        "What a small test at each depth would measure, with 95 % bars; below, the number of samples at each depth. "
        "Tissue should stiffen with depth, and damp more; the mass is mostly the instrument’s and should be constant."
    )
    ways = ""
    if np.any(profile.direction):
        ways = _("The way into the tissue and the way out have a colour and a marker each.")
    return depth_panels({subject.label: profile}, subject.surface_position_m), captions.joined(text, ways)


@figure(
    _ANY,
    "prediction",
    marked("Measured and predicted"),
    marked("Measured output as dots with the simulation of the model as a line, and the residual below."),
    group="validation",
    place=10,
)
def prediction(subject: Subject[Model]) -> Drawn:
    """Draw a stretch of held-out samples (Chen 2010, Figs. 3.10, 4.7 and 5.5a)."""
    run = held_out_prediction(subject.label, subject.analysis)
    return prediction_figure([run], _STRETCH_S), captions.prediction({subject.name: subject.analysis})


@figure(
    _ANY,
    "scatter",
    marked("Measured against predicted"),
    marked(
        "Cloud of measured against predicted output with its mean as a curve, and the diagonal of perfect agreement."
    ),
    group="validation",
    wide=False,
    place=12,
)
def scatter(subject: Subject[Model]) -> Drawn:
    """Draw all held-out samples (Chen 2010, Figs. 4.10 and 5.5b)."""
    run = held_out_prediction(subject.label, subject.analysis)
    unit, scale = display_unit(run.output_unit)
    predicted, measured = scale * run.predicted, scale * run.measured
    known = np.isfinite(predicted + measured)
    if known.sum() < 2:
        raise UnusableInputError(Message("report.nothing_held_out", "no held-out sample can be compared"))
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    residual_cloud(axes, predicted, measured, POINTS[0])
    both = np.concatenate([predicted[known], measured[known]])
    diagonal(axes, float(both.min()), float(both.max()))
    axes.set_xlabel(axis_label("predicted", unit))
    axes.set_ylabel(axis_label("measured", unit))
    return drawn, captions.scatter([run])


@figure(
    _ANY,
    "residual-tests",
    marked("Residual tests"),
    marked("Ten small panels: correlations of the residual over lags with bands, each with its verdict."),
    group="validation",
    place=14,
)
def residuals(subject: Subject[Model]) -> Drawn:
    """Draw the tests of the held-out residual, each with its bands and verdict."""
    analysis = subject.analysis
    found = residual_tests(subject.model, analysis.held_out_record, analysis.held_out)
    drawn = new_figure(FULL_WIDTH, 3.9)
    every = drawn.subplots(2, -(-len(found.tests) // 2))
    for axes, test in zip(every.flat, found.tests, strict=False):
        _test_panel(axes, test)
    for axes in every[-1]:
        axes.set_xlabel(_("Lag (ms)"))
    for axes in every[:, 0]:
        axes.set_ylabel(_("Correlation"))
    text = _(
        "Correlations of the held-out residual with signals that it should not depend on. Shaded: exceeded by one lag "
        "by chance in 5 % of cases; dashed: exceeded by any lag in 5 % of cases. ✓ passed, ✕ failed."
    )
    return drawn, captions.joined(text, captions.findings(found.findings))


_SHORTEST_LAG_MS = 1.0
"""Smallest width of the lag axis, ms: a model without memory has a single lag."""


def _test_panel(axes: Axes, test: ResidualTest) -> None:
    """Draw one test: correlation over lags, its bands, and the verdict as the title."""
    title = _(_TITLES.get(test.name, test.name.replace("_", " ")))
    if test.p_value is None or not np.isfinite(test.correlation).any():
        axes.set_title(f"– {title}")
        axes.set_axis_off()
        return
    lag_ms = 1e3 * test.lag_s
    order = np.argsort(lag_ms)
    lag_ms, values = lag_ms[order], test.correlation[order]
    band, overall = test.band[order], test.overall_band[order]
    some = np.unique(np.linspace(0, lag_ms.size - 1, _BAND_POINTS).astype(np.intp))
    missed = np.abs(np.interp(lag_ms, lag_ms[some], overall[some]) - overall)
    if float(np.nanmax(missed)) > _BAND_MISSED * float(np.nanmedian(overall)):
        some = np.arange(lag_ms.size)
    axes.fill_between(lag_ms[some], -band[some], band[some], color=SHADE, linewidth=0.0)
    for side in (-overall[some], overall[some]):
        axes.plot(lag_ms[some], side, color=MUTED, linewidth=0.8, linestyle=DASHES[1])
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.plot(lag_ms, values, color=BLUE if test.passed else ORANGE, linewidth=1.0)
    axes.set_xlim(float(lag_ms[0]), max(float(lag_ms[-1]), float(lag_ms[0]) + _SHORTEST_LAG_MS))
    top = 1.2 * max(float(np.nanmax(np.abs(values))), float(np.nanmedian(overall)))
    if np.isfinite(top) and top > 0.0:
        axes.set_ylim(-top, top)
    axes.locator_params(nbins=4)
    chance = "p < 0.001" if test.p_value < 1e-3 else f"p = {number(test.p_value, 2)}"
    axes.set_title(f"{'✓' if test.passed else '✕'} {title}\n{chance}", fontsize=8.5)


@figure(
    _ANY,
    "horizon",
    marked("Prediction by horizon"),
    marked("Variance accounted for against prediction horizon, falling to the level of the free run."),
    group="validation",
    wide=False,
    place=13,
)
def horizon(subject: Subject[Model]) -> Drawn:
    """Draw the score of n-step prediction on the held-out part, with that of the free run."""
    analysis, model = subject.analysis, subject.model
    noise = fit_noise(model, analysis.record, analysis.fit_part)
    curve = prediction_curve(model, analysis.held_out_record, noise, part=analysis.held_out)
    ahead_ms = 1e3 * curve.horizon_s
    drawn = new_figure(HALF_WIDTH, 3.3)
    axes = drawn.subplots()
    half = CONFIDENCE * np.where(np.isfinite(curve.vaf_std_percent), curve.vaf_std_percent, 0.0)
    low, high = curve.vaf_percent - half, np.minimum(curve.vaf_percent + half, 100.0)
    axes.fill_between(ahead_ms, low, high, color=BLUE, alpha=0.22, linewidth=0.0, label=_("95 % band"))
    axes.plot(ahead_ms, curve.vaf_percent, color=BLUE, marker="o", markersize=3.5, label=_("prediction"))
    free = curve.free_run_vaf_percent
    axes.axhline(free, color=ORANGE, linestyle=DASHES[1], label=_("free run"))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(_("Prediction horizon (ms)"))
    axes.set_ylabel(_("VAF, held out (%)"))
    bottom = max(min(0.0, free), float(np.min(low)))
    axes.set_ylim(bottom - 0.08 * (100.0 - bottom), 100.0 + 0.08 * (100.0 - bottom))
    axes.legend(loc="best")
    text = _(
        "The prediction uses the whole input, and the output up to the horizon. At short horizons past errors of the "
        "model predict the next ones; at long horizons only the simulation remains, with {free} %."
    ).format(free=fixed(free, 1))
    return drawn, captions.joined(text, _gain_of_prediction(float(curve.vaf_percent[0]) - free, subject))


def _gain_of_prediction(points: float, subject: Subject[Model]) -> str:
    if points <= _SMALL_GAIN:
        return _("The two differ little: the residual is nearly uncorrelated in time.")
    return _(
        "The difference of {points} points is slow errors: dynamics that {count} parameters do not describe."
    ).format(points=fixed(points, 1), count=fixed(effective_parameters(subject.model.report), 0))
