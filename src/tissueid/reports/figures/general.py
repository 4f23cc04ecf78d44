"""Figures of any model: its simulation of unseen samples, what it leaves over, and parameters against depth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from tissueid.analysis.scoring import effective_parameters
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.validation.prediction import fit_noise, prediction_curve
from tissueid.identification.validation.residual_tests import ResidualTest, TestName, residual_tests
from tissueid.reports import captions
from tissueid.reports.depth_panels import depth_panels
from tissueid.reports.diagnostics import CONFIDENCE, held_out_prediction
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
from tissueid.wording import axis_label, fixed, number, people_unit

_ANY: type[Model] = Model  # type: ignore[type-abstract]
_STRETCH_S = 0.25
"""Of held-out samples that are drawn one by one; a page with every engine has one such figure for each."""

_BAND_POINTS = 48
"""So many points draw a band that is smooth,"""
_BAND_MISSED = 0.05
"""which one is that straight lines between them miss by less than this share of it."""

_TITLES: dict[TestName, str] = {
    "autocorrelation": "Its own past",
    "input": "Input",
    "feedback": "Later input",
    "squared_input": "Input squared",
    "squared_output": "Output squared",
    "squared_speed": "Speed squared",
    "cubed_output": "Output cubed",
    "residual_size_input": "Its size, by input",
    "residual_size_squared_input": "Its size, by input²",
    "residual_input_product": "Its past times input",
}


@figure(
    _ANY,
    "depth-profile",
    "Mass, damping and stiffness against depth",
    "Three panels against depth: mass, damping and stiffness with 95 % bars, and below them the samples at each depth.",
    group="nonlinear",
    place=30,
    applies=lambda subject: subject.profile is not None,
)
def depth_profile(subject: Subject[Model]) -> Drawn:
    """Mass, damping and stiffness against depth of one engine (Chen 2010, Figs. 5.9 to 5.11)."""
    profile = subject.profile
    if profile is None:
        raise UnusableInputError("this model holds no depth")
    text = (
        "What a small test at each depth would measure, with 95 % bars; below, how many samples speak for it. Tissue "
        "should stiffen with depth, and damp more; the mass is mostly the instrument’s and should stay."
    )
    if np.any(profile.direction):
        text += " The way into the tissue and the way out have a colour and a marker each."
    return depth_panels({subject.label: profile}, subject.surface_position_m), text


@figure(
    _ANY,
    "prediction",
    "Measured and predicted",
    "Measured output as dots with the simulation of the model as a line, and the residual below.",
    group="validation",
    place=10,
)
def prediction(subject: Subject[Model]) -> Drawn:
    """A stretch of held-out samples (Chen 2010, Figs. 3.10, 4.7 and 5.5a)."""
    run = held_out_prediction(subject.label, subject.analysis)
    return prediction_figure([run], _STRETCH_S), captions.prediction({subject.name: subject.analysis})


@figure(
    _ANY,
    "scatter",
    "Measured against predicted",
    "Cloud of measured against predicted output with its middle as a curve, and the diagonal of perfect agreement.",
    group="validation",
    wide=False,
    place=12,
)
def scatter(subject: Subject[Model]) -> Drawn:
    """All held-out samples (Chen 2010, Figs. 4.10 and 5.5b)."""
    run = held_out_prediction(subject.label, subject.analysis)
    unit, scale = people_unit(run.output_unit)
    predicted, measured = scale * run.predicted, scale * run.measured
    known = np.isfinite(predicted + measured)
    if known.sum() < 2:
        raise UnusableInputError("no held-out sample can be compared")
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
    "What the model leaves over",
    "Ten small panels: correlations of the residual over lags with bands, each with its verdict.",
    group="validation",
    place=14,
)
def residuals(subject: Subject[Model]) -> Drawn:
    """Tests of the held-out residual, each with its bands and verdict."""
    analysis = subject.analysis
    found = residual_tests(subject.model, analysis.held_out_record, analysis.held_out)
    drawn = new_figure(FULL_WIDTH, 3.9)
    every = drawn.subplots(2, -(-len(found.tests) // 2))
    for axes, test in zip(every.flat, found.tests, strict=False):
        _test_panel(axes, test)
    for axes in every[-1]:
        axes.set_xlabel("Lag (ms)")
    for axes in every[:, 0]:
        axes.set_ylabel("Correlation")
    text = (
        "What is left of the held-out part, against what it should not know of. Shaded: what one lag exceeds one time "
        "in twenty by chance; dashed: what any lag does. ✓ passes, ✕ does not. "
    )
    said = "; ".join(found.findings)
    return drawn, f"{text}{said[:1].upper()}{said[1:]}."


def _test_panel(axes: Axes, test: ResidualTest) -> None:
    """One test: correlation over lags, its bands, and the verdict as the title."""
    title = _TITLES.get(test.name, test.name.replace("_", " "))
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
    axes.set_xlim(float(lag_ms[0]), float(lag_ms[-1]))
    top = 1.2 * max(float(np.nanmax(np.abs(values))), float(np.nanmedian(overall)))
    if np.isfinite(top) and top > 0.0:
        axes.set_ylim(-top, top)
    axes.locator_params(nbins=4)
    chance = "p < 0.001" if test.p_value < 1e-3 else f"p = {number(test.p_value, 2)}"
    axes.set_title(f"{'✓' if test.passed else '✕'} {title}\n{chance}", fontsize=8.5)


@figure(
    _ANY,
    "horizon",
    "Prediction by how far ahead",
    "Variance accounted for against prediction horizon, falling to the level of the free run.",
    group="validation",
    wide=False,
    place=13,
)
def horizon(subject: Subject[Model]) -> Drawn:
    """n-step prediction on the held-out part, with the free run that it comes down to."""
    analysis, model = subject.analysis, subject.model
    noise = fit_noise(model, analysis.record, analysis.fit_part)
    curve = prediction_curve(model, analysis.held_out_record, noise, part=analysis.held_out)
    ahead_ms = 1e3 * curve.horizon_s
    drawn = new_figure(HALF_WIDTH, 3.3)
    axes = drawn.subplots()
    half = CONFIDENCE * np.where(np.isfinite(curve.vaf_std_percent), curve.vaf_std_percent, 0.0)
    low, high = curve.vaf_percent - half, np.minimum(curve.vaf_percent + half, 100.0)
    axes.fill_between(ahead_ms, low, high, color=BLUE, alpha=0.22, linewidth=0.0, label="95 % band")
    axes.plot(ahead_ms, curve.vaf_percent, color=BLUE, marker="o", markersize=3.5, label="prediction")
    free = curve.free_run_vaf_percent
    axes.axhline(free, color=ORANGE, linestyle=DASHES[1], label="free run")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("How far ahead (ms)")
    axes.set_ylabel("VAF, held out (%)")
    bottom = max(min(0.0, free), float(np.min(low)))
    axes.set_ylim(bottom - 0.08 * (100.0 - bottom), 100.0 + 0.08 * (100.0 - bottom))
    axes.legend(loc="best")
    return drawn, (
        "Told the output up to so long ago, beside the whole input. At short horizons the model’s own errors so far "
        f"foretell the next ones; far ahead only the simulation is left, with {fixed(free, 1)} %. "
        f"{_gap(float(curve.vaf_percent[0]) - free, subject)}"
    )


def _gap(points: float, subject: Subject[Model]) -> str:
    parameters = fixed(effective_parameters(subject.model.report), 0)
    if points > 2.0:
        return f"The {fixed(points, 1)} points between are slow errors: dynamics that {parameters} parameters lack."
    return "There is little between the two: what the model leaves over hardly hangs together."
