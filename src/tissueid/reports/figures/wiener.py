"""Figures of the Wiener cascade: static nonlinearity, stiffness along it, and how the iteration settled."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.nonlinearity import iteration_plots, stiffness_plot, wiener_nonlinearity
from tissueid.formatting import fixed, number
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.language import _, marked
from tissueid.records import Record
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import row_figure


@figure(
    WienerModel,
    "nonlinearity",
    marked("Static nonlinearity and stiffness"),
    marked("Left: measured output against predicted linear output with a fitted curve. Right: stiffness by depth."),
    group="nonlinear",
    place=10,
    standard=Wiener.name,
    short=True,
)
def _nonlinearity(subject: Subject[WienerModel]) -> Drawn:
    model, record, surface = subject.model, subject.record, subject.surface_position_m
    part = subject.analysis.fit_part
    plots = wiener_nonlinearity(model, record, part, surface), stiffness_plot(model, record, part, surface)
    return row_figure(plots, 3.7, widths=(1.35, 1.0)), _nonlinearity_caption(model, record, surface)


@figure(
    WienerModel,
    "iterations",
    marked("How the Wiener iteration settled"),
    marked("Left: variance accounted for by pass. Right: each parameter relative to its last value by pass."),
    group="nonlinear",
    place=20,
    standard=Wiener.name,
)
def _iterations(subject: Subject[WienerModel]) -> Drawn:
    return row_figure(iteration_plots(subject.model), 2.9), _iterations_caption(subject.model)


def _nonlinearity_caption(model: WienerModel, record: Record, surface_position_m: float) -> str:
    """Under the static nonlinearity."""
    text = [
        _(
            "Left: the points should follow one rising curve; their spread about it is what a static curve cannot "
            "explain. Tissue that stiffens flattens the curve."
        )
    ]
    slope = _("Right: the stiffness is the inverse of its slope.")
    z = model.linear_output(record.input)
    z = z[np.isfinite(z)]
    if z.size and (record.input_unit, record.output_unit) == ("N", "m"):
        slopes = model.nonlinearity.slope(np.quantile(z, (0.005, 0.995)))
        if np.all(slopes > 0.0):
            shallow, deep = (number(1.0 / slope, 3) for slope in slopes)
            slope = _(
                "Right: the stiffness is the inverse of its slope, here from {shallow} to {deep} N/m over the depths "
                "visited."
            )
            if slopes[1] > slopes[0]:
                slope = _(
                    "Right: the stiffness is the inverse of its slope, here from {shallow} to {deep} N/m over the "
                    "depths visited; tissue does not soften with depth, so look for drift in the signals."
                )
            slope = slope.format(shallow=shallow, deep=deep)
    text.append(slope)
    if np.isfinite(surface_position_m) and record.output_name == "position":
        surface = _("The surface of the tissue is at {place} mm on the actuator.")
        text.append(surface.format(place=fixed(1e3 * surface_position_m, 2)))
    return " ".join(text)


def _iterations_caption(model: WienerModel) -> str:
    """Under the history of the Wiener iteration."""
    kept = _("Pass {chosen} (dotted) was kept, by its simulation error.")
    if model.refined:
        kept = _("Pass {chosen} (dotted) was kept, by its simulation error, and then refined jointly.")
    scored = _(
        "The linear stage is scored against the output that it was fitted to, which from the second pass "
        "on is the measured output taken back through the nonlinearity."
    )
    return " ".join([_("The passes should level off within a few."), kept.format(chosen=model.chosen), scored])
