"""Figures of any model: simulation of held-out samples, residual tests, and parameters against depth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from tissueid.analysis.curves.validation import (
    cloud_plot,
    held_out_prediction,
    horizon_plot,
    prediction_plots,
    residual_test_plot,
)
from tissueid.analysis.scoring import effective_parameters
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number
from tissueid.identification.base import Model
from tissueid.identification.validation.prediction import fit_noise, prediction_curve
from tissueid.identification.validation.residual_tests import ResidualTest, residual_tests
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, FigureSubject, figure
from tissueid.reports.plot_renderer import column_figure, depth_panels, draw_plot, row_figure
from tissueid.reports.style import (
    FULL_WIDTH,
    new_figure,
)

_ANY: type[Model] = Model  # type: ignore[type-abstract]
_STRETCH_S = 0.25
"""Seconds of held-out samples that are drawn one by one; a comparison has one such figure for each engine."""

_SMALL_GAIN = 2.0
"""Points of VAF between one-step prediction and free run up to which the residual counts as uncorrelated."""


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
def depth_profile(subject: FigureSubject[Model]) -> Drawn:
    """Draw mass, damping and stiffness against depth of one engine (Chen 2010, Figs. 5.9 to 5.11)."""
    profile = subject.profile
    if profile is None:
        raise UnusableInputError("report.no_depth", "this model has no parameters against depth")
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
def prediction(subject: FigureSubject[Model]) -> Drawn:
    """Draw a stretch of held-out samples (Chen 2010, Figs. 3.10, 4.7 and 5.5a)."""
    run = held_out_prediction(subject.label, subject.analysis)
    drawn = column_figure(prediction_plots([run], _STRETCH_S), 4.2, wide=True, heights=(2.2, 1.0), over=True)
    return drawn, captions.prediction({subject.name: subject.analysis})


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
def scatter(subject: FigureSubject[Model]) -> Drawn:
    """Draw all held-out samples (Chen 2010, Figs. 4.10 and 5.5b)."""
    run = held_out_prediction(subject.label, subject.analysis)
    drawn = row_figure([cloud_plot(run.predicted, run.measured, run.output_unit, x="predicted")], 3.9)
    return drawn, captions.scatter([run])


@figure(
    _ANY,
    "residual-tests",
    marked("Residual tests"),
    marked("Ten small panels: correlations of the residual over lags with bands, each with its verdict."),
    group="validation",
    place=14,
)
def residuals(subject: FigureSubject[Model]) -> Drawn:
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


def _test_panel(axes: Axes, test: ResidualTest) -> None:
    """Draw one test, with its verdict as the title."""
    plot = residual_test_plot(test)
    title = translated(plot.title)
    if not plot.parts or test.p_value is None:
        axes.set_title(f"– {title}")
        axes.set_axis_off()
        return
    draw_plot(axes, plot, title=False)
    axes.set_xlabel("")
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
def horizon(subject: FigureSubject[Model]) -> Drawn:
    """Draw the score of n-step prediction on the held-out part, with that of the free run."""
    analysis, model = subject.analysis, subject.model
    noise = fit_noise(model, analysis.record, analysis.fit_part)
    curve = prediction_curve(model, analysis.held_out_record, noise, part=analysis.held_out)
    drawn, free = column_figure([horizon_plot(curve)], 3.3), curve.free_run_vaf_percent
    text = _(
        "The prediction uses the whole input, and the output up to the horizon. At short horizons past errors of the "
        "model predict the next ones; at long horizons only the simulation remains, with {free} %."
    ).format(free=fixed(free, 1))
    return drawn, captions.joined(text, _gain_of_prediction(float(curve.vaf_percent[0]) - free, subject))


def _gain_of_prediction(points: float, subject: FigureSubject[Model]) -> str:
    if points <= _SMALL_GAIN:
        return _("The two differ little: the residual is nearly uncorrelated in time.")
    return _(
        "The difference of {points} points is slow errors: dynamics that {count} parameters do not describe."
    ).format(points=fixed(points, 1), count=fixed(effective_parameters(subject.model.report), 0))
