"""Figures of the Wiener cascade: static nonlinearity, stiffness along it, and how the iteration settled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.nonlinearity import linear_output, wiener_nonlinearity
from tissueid.analysis.curves.plot import Curve
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, fixed, label_and_unit, number
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.language import _, marked
from tissueid.records import Record
from tissueid.reports.captions import SINGLE_PASS
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.style import (
    DASHES,
    FULL_WIDTH,
    INK,
    MUTED,
    SERIES,
    drawing,
    new_figure,
)
from tissueid.units import display_unit


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
    drawn = nonlinearity_figure(model, record, subject.analysis.fit_part, surface)
    return drawn, _nonlinearity_caption(model, record, surface)


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
    return iterations_figure(subject.model), _iterations_caption(subject.model)


@drawing
def nonlinearity_figure(
    model: WienerModel, record: Record, part: slice | None = None, surface_position_m: float = float("nan")
) -> Figure:
    """Draw the static nonlinearity (Chen 2010, Fig. 3.8, Eq. 3.26) and the stiffness along it (Eq. 3.27).

    Args:
        model: the cascade.
        record: input and output; the points are its received samples.
        part: which of them were fitted.
        surface_position_m: position of the tissue surface, m; NaN if unknown.

    Raises:
        UnusableInputError: no sample lies where the model can be run.
    """
    plot = wiener_nonlinearity(model, record, part)
    z, measured = linear_output(model, record, part)
    figure = new_figure(FULL_WIDTH, 3.7)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    near = measured.min() - surface_position_m < 0.6 * np.ptp(measured)
    if near and record.output_name == "position":
        scale = display_unit(record.output_unit)[1]
        level = Curve(np.zeros(1), np.array([scale * surface_position_m]), marked("surface"), "muted", "level")
        plot = replace(plot, parts=(*plot.parts, level))
    draw_plot(left, plot, title=False)
    _stiffness_panel(right, model, record, np.quantile(z, (0.005, 0.995)), surface_position_m)
    return figure


def _stiffness_panel(axes: Axes, model: WienerModel, record: Record, ends: Array, surface_position_m: float) -> None:
    """Inverse slope of the nonlinearity against depth, over the range that holds 99 % of the samples."""
    low, high = model.nonlinearity.monotone_range
    z = np.linspace(max(low, float(ends[0])), min(high, float(ends[1])), 200)
    slope = np.abs(model.nonlinearity.slope(z))
    clear = slope > 1e-3 * slope.max()
    in_scale = display_unit(record.input_unit)[1]
    out_unit, out_scale = display_unit(record.output_unit)
    origin = surface_position_m if np.isfinite(surface_position_m) and record.output_name == "position" else 0.0
    depth = out_scale * (model.nonlinearity(z) - origin)
    axes.plot(depth[clear], in_scale / slope[clear], color=SERIES[2], linewidth=1.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(axis_label("depth_below_the_surface" if origin else record.output_name, out_unit))
    mechanical = (record.input_unit, record.output_unit) == ("N", "m")
    inverse = _("Inverse slope ({unit})").format(unit=f"{record.input_unit}/{record.output_unit}")
    axes.set_ylabel(_("Stiffness (N/m)") if mechanical else inverse)


@drawing
def iterations_figure(model: WienerModel) -> Figure:
    """Draw the convergence of the Wiener iteration: VAF, and parameters relative to the last (Chen 2010, Fig. 3.9).

    Raises:
        UnusableInputError: there was only one pass.
    """
    history = model.history
    if len(history) < 2:
        raise UnusableInputError(SINGLE_PASS)
    passes = [item.iteration for item in history]
    figure = new_figure(FULL_WIDTH, 2.9)
    left, right = figure.subplots(1, 2)
    for scores, label, colour, dash in (
        ([item.nonlinear_vaf_percent for item in history], _("cascade, against the output"), SERIES[1], DASHES[0]),
        (
            [item.linear_vaf_percent for item in history],
            _("linear stage, against its own target"),
            SERIES[0],
            DASHES[1],
        ),
    ):
        left.plot(passes, scores, color=colour, linestyle=dash, marker="o", markersize=3.5, label=label)
    left.set_ylabel(_("VAF (%)"))
    left.margins(y=0.25)
    left.legend(loc="best")
    drawn = 0
    for name, last in history[-1].parameters.items():
        values = np.array([item.parameters.get(name, np.nan) for item in history])
        if not np.all(np.isfinite(values)) or last == 0.0 or np.ptp(values) == 0.0:
            continue
        right.plot(
            passes,
            values / last,
            color=(*SERIES, INK, MUTED)[drawn % 6],
            linestyle=DASHES[drawn % len(DASHES)],
            marker="os^DvP"[drawn % 6],
            markersize=3.5,
            label=_(label_and_unit(name)[0]),
        )
        drawn += 1
    right.axhline(1.0, color=MUTED, linewidth=0.8)
    right.set_ylabel(_("Parameter over its last value"))
    if drawn:
        right.legend(loc="best", ncols=2)
    for axes in (left, right):
        axes.axvline(model.chosen, color=MUTED, linewidth=1.0, linestyle=DASHES[2])
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
        axes.set_xlabel(_("Pass"))
    return figure


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
