"""Figures of cascades: the blocks in signal order, static nonlinearity, how an iteration settled (Chen 2010, 3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import FancyArrowPatch, Rectangle

from tissueid.analysis.curves.nonlinearity import (
    cascade_blocks,
    hammerstein_blocks,
    iteration_plots,
    stiffness_plot,
    wiener_blocks,
    wiener_nonlinearity,
)
from tissueid.analysis.curves.plot import Plot
from tissueid.formatting import fixed, number
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.language import _, marked
from tissueid.records import Record
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, FigureSubject, figure
from tissueid.reports.plot_renderer import draw_row, row_figure
from tissueid.reports.style import FULL_WIDTH, INK, drawing, new_figure

_STRUCTURES = {
    "linear": marked("a linear system"),
    "wiener": marked("linear dynamics, then a curve (Wiener, LN)"),
    "hammerstein": marked("a curve, then linear dynamics (Hammerstein, NL)"),
    "lnl": marked("a curve between two linear systems (LNL)"),
    "nln": marked("linear dynamics between two curves (NLN)"),
}


@drawing
def block_diagram(blocks: Sequence[Plot], record: Record) -> Figure:
    """Draw blocks from left to right with arrows between them, and the names of input and output of a record."""
    drawn = new_figure(FULL_WIDTH, 3.2)
    every = draw_row(drawn, blocks)
    layout = drawn.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        layout.set(rect=(0.085, 0.02, 0.83, 0.96), wspace=0.16)
    drawn.draw_without_rendering()
    drawn.set_layout_engine("none")
    _draw_connections(drawn, every, _(record.input_name), _(record.output_name))
    return drawn


def _draw_connections(drawn: Figure, every: list[Axes], source: str, drain: str) -> None:
    """Draw frames around the blocks, and arrows into, between and out of them."""
    back = drawn.transFigure.inverted()
    extents = [axes.get_tightbbox() or axes.bbox for axes in every]
    frames = [extent.transformed(back).padded(0.008, 0.02) for extent in extents]
    low, high = min(frame.y0 for frame in frames), max(frame.y1 for frame in frames)
    level = 0.5 * (low + high)
    for frame in frames:
        drawn.add_artist(
            Rectangle(
                (frame.x0, low), frame.width, high - low, transform=drawn.transFigure, fill=False, edgecolor=INK, lw=1.0
            )
        )
    starts = [0.005, *(frame.x1 for frame in frames)]
    ends = [*(frame.x0 for frame in frames), 0.995]
    for start, end in zip(starts, ends, strict=True):
        drawn.add_artist(
            FancyArrowPatch(
                (start, level),
                (end, level),
                transform=drawn.transFigure,
                arrowstyle="-|>",
                mutation_scale=11.0,
                color=INK,
                linewidth=1.2,
                shrinkA=0.0,
                shrinkB=0.0,
            )
        )
    drawn.text(0.005, level + 0.03, source, ha="left", va="bottom", fontsize=8.5)
    drawn.text(0.995, level + 0.03, drain, ha="right", va="bottom", fontsize=8.5)


@figure(
    HammersteinModel,
    "blocks",
    marked("Structure: a curve, then linear dynamics"),
    marked("Block diagram from left to right: the static curve of the input, and the impulse response after it."),
    group="nonlinear",
    order=12,
)
def hammerstein(subject: FigureSubject[HammersteinModel]) -> Drawn:
    """Draw the two blocks of a Hammerstein cascade."""
    model, record = subject.model, subject.record
    blocks = hammerstein_blocks(model, record, subject.analysis.fit_part)
    scaled = _("The kernel sums to one; the curve carries the unit. Tissue that stiffens flattens the curve.")
    if not model.steady_gain:
        scaled = _(
            "The kernel has no steady gain; its root sum of squares is one, and the curve carries the unit. Tissue "
            "that stiffens flattens the curve."
        )
    return block_diagram(blocks, record), captions.joined(
        _("The blocks in signal order, with 95 % bands."), scaled, captions.findings(model.report.findings)
    )


@figure(
    WienerModel,
    "blocks",
    marked("Structure: linear dynamics, then a curve"),
    marked("Block diagram from left to right: the impulse response, and the static curve after it."),
    group="nonlinear",
    order=15,
)
def wiener(subject: FigureSubject[WienerModel]) -> Drawn:
    """Draw the two blocks of a Wiener cascade (Chen 2010, Fig. 3.6)."""
    record = subject.record
    blocks = wiener_blocks(subject.model, record, subject.analysis.fit_part)
    return block_diagram(blocks, record), _(
        "The blocks in signal order. The kernel sums to one; the curve converts the load after the linear stage to a "
        "position. Tissue that stiffens flattens the curve."
    )


@figure(
    CascadeModel,
    "blocks",
    marked("Structure: the blocks that the record supports"),
    marked("Block diagram from left to right: linear and static blocks of the chosen structure, each with its curve."),
    group="nonlinear",
    order=14,
)
def cascade(subject: FigureSubject[CascadeModel]) -> Drawn:
    """Draw the blocks of the chosen structure."""
    model, record = subject.model, subject.record
    blocks = cascade_blocks(model, record, subject.analysis.fit_part)
    text = _("Chosen structure: {structure}. Bands: 95 % of the kernels.").format(
        structure=_(_STRUCTURES[model.structure])
    )
    doubt = ""
    if model.choice is not None and not model.choice.confident:
        doubt = _("The record supports other structures about as well: see the findings.")
    return block_diagram(blocks, record), captions.joined(text, doubt, captions.findings(model.report.findings))


@figure(
    HammersteinModel,
    "iterations",
    marked("Convergence of the Hammerstein iteration"),
    marked("Variance accounted for by pass, and the parameters of the linear stage relative to their last value."),
    group="nonlinear",
    order=22,
)
def iterations(subject: FigureSubject[HammersteinModel]) -> Drawn:
    """Draw VAF and parameters of the linear stage by pass (as Chen 2010, Fig. 3.9).

    Raises:
        UnusableInputError: there was only one pass.
    """
    model = subject.model
    drawn = row_figure(iteration_plots(model), 2.7)
    kept = _("Pass {chosen} (dotted) was kept.")
    if model.refined:
        kept = _("Pass {chosen} (dotted) was kept, then all parameters were refined jointly.")
    return drawn, captions.joined(
        _("The curves should level off within a few passes."), kept.format(chosen=model.chosen)
    )


@figure(
    WienerModel,
    "nonlinearity",
    marked("Static nonlinearity and stiffness"),
    marked("Left: measured output against predicted linear output with a fitted curve. Right: stiffness by depth."),
    group="nonlinear",
    order=10,
    standard=Wiener.name,
    short=True,
)
def _nonlinearity(subject: FigureSubject[WienerModel]) -> Drawn:
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
    order=20,
    standard=Wiener.name,
)
def _iterations(subject: FigureSubject[WienerModel]) -> Drawn:
    model = subject.model
    kept = _("Pass {chosen} (dotted) was kept, by its simulation error.")
    if model.refined:
        kept = _("Pass {chosen} (dotted) was kept, by its simulation error, and then refined jointly.")
    scored = _(
        "The linear stage is scored against the output that it was fitted to, which from the second pass "
        "on is the measured output taken back through the nonlinearity."
    )
    text = [_("The passes should level off within a few."), kept.format(chosen=model.chosen), scored]
    return row_figure(iteration_plots(model), 2.9), " ".join(text)


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
