"""Figures of cascades: the blocks in signal order, each with its curve (Chen 2010, Fig. 3.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.ticker import MaxNLocator

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.nonlinearity import central_span, curve_std
from tissueid.analysis.curves.plot import CONFIDENCE
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, label_and_unit
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.style import BLUE, DASHES, FULL_WIDTH, INK, MUTED, ORANGE, SERIES, drawing, new_figure
from tissueid.units import display_unit

_STRUCTURES = {
    "linear": marked("a linear system"),
    "wiener": marked("linear dynamics, then a curve (Wiener, LN)"),
    "hammerstein": marked("a curve, then linear dynamics (Hammerstein, NL)"),
    "lnl": marked("a curve between two linear systems (LNL)"),
    "nln": marked("linear dynamics between two curves (NLN)"),
}


@dataclass(frozen=True, eq=False)
class Block:
    """A block of a cascade: title, axis labels, and a curve (k,) with a standard deviation (k,) or None."""

    title: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    std: Array | None
    dynamic: bool


@drawing
def block_diagram(blocks: list[Block], source: str, drain: str) -> Figure:
    """Draw blocks from left to right with arrows between them, and the names of input and output."""
    drawn = new_figure(FULL_WIDTH, 3.2)
    every = drawn.subplots(1, len(blocks), squeeze=False)[0]
    for axes, block in zip(every, blocks, strict=True):
        colour = BLUE if block.dynamic else ORANGE
        if block.dynamic:
            axes.axhline(0.0, color=MUTED, linewidth=0.8)
        if block.std is not None:
            half = CONFIDENCE * np.where(np.isfinite(block.std), block.std, 0.0)
            axes.fill_between(block.x, block.y - half, block.y + half, color=colour, alpha=0.22, linewidth=0.0)
        axes.plot(block.x, block.y, color=colour, linewidth=1.8)
        axes.set_xlabel(block.x_label)
        axes.set_ylabel(block.y_label)
        axes.set_title(block.title, loc="center")
        for side in ("top", "right"):
            axes.spines[side].set_visible(True)
    layout = drawn.get_layout_engine()
    if isinstance(layout, ConstrainedLayoutEngine):
        layout.set(rect=(0.085, 0.02, 0.83, 0.96), wspace=0.16)
    drawn.draw_without_rendering()
    drawn.set_layout_engine("none")
    _draw_connections(drawn, list(every), source, drain)
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
    place=12,
)
def hammerstein(subject: Subject[HammersteinModel]) -> Drawn:
    """Draw the two blocks of a Hammerstein cascade."""
    model, record = subject.model, subject.record
    unit, scale = display_unit(record.output_unit)
    u = central_span(subject.fitted_input)
    std = curve_std(model.nonlinearity, u, model.nonlinearity_covariance)
    blocks = [
        Block(
            _("static"),
            axis_label(record.input_name, display_unit(record.input_unit)[0]),
            axis_label("inner_signal", unit),
            u * display_unit(record.input_unit)[1],
            scale * model.nonlinearity(u),
            None if std is None else scale * std,
            dynamic=False,
        ),
        _kernel_block(_("linear"), model.kernel, model.kernel_std, model.lag_s, model.sample_rate_hz),
    ]
    scaled = _("The kernel sums to one; the curve carries the unit. Tissue that stiffens flattens the curve.")
    if not model.steady_gain:
        scaled = _(
            "The kernel has no steady gain; its root sum of squares is one, and the curve carries the unit. Tissue "
            "that stiffens flattens the curve."
        )
    return block_diagram(blocks, _(record.input_name), _(record.output_name)), captions.joined(
        _("The blocks in signal order, with 95 % bands."), scaled, captions.findings(model.report.findings)
    )


@figure(
    WienerModel,
    "blocks",
    marked("Structure: linear dynamics, then a curve"),
    marked("Block diagram from left to right: the impulse response, and the static curve after it."),
    group="nonlinear",
    place=15,
)
def wiener(subject: Subject[WienerModel]) -> Drawn:
    """Draw the two blocks of a Wiener cascade (Chen 2010, Fig. 3.6)."""
    model, record = subject.model, subject.record
    unit, scale = display_unit(record.output_unit)
    in_unit, in_scale = display_unit(record.input_unit)
    z = central_span(model.linear_output(record.input)[subject.analysis.fit_part])
    lag_s = np.arange(model.kernel.size) / model.sample_rate_hz
    blocks = [
        _kernel_block(_("linear"), model.kernel, None, lag_s, model.sample_rate_hz),
        Block(
            _("static"),
            axis_label("inner_signal", in_unit),
            axis_label(record.output_name, unit),
            in_scale * z,
            scale * model.nonlinearity(z),
            None,
            dynamic=False,
        ),
    ]
    return block_diagram(blocks, _(record.input_name), _(record.output_name)), _(
        "The blocks in signal order. The kernel sums to one; the curve converts the load after the linear stage to a "
        "position. Tissue that stiffens flattens the curve."
    )


@figure(
    CascadeModel,
    "blocks",
    marked("Structure: the blocks that the record supports"),
    marked("Block diagram from left to right: linear and static blocks of the chosen structure, each with its curve."),
    group="nonlinear",
    place=14,
)
def cascade(subject: Subject[CascadeModel]) -> Drawn:
    """Draw the blocks of the chosen structure."""
    model, record = subject.model, subject.record
    in_unit, in_scale = display_unit(record.input_unit)
    out_unit, out_scale = display_unit(record.output_unit)
    rate = model.sample_rate_hz
    blocks: list[Block] = []
    driven = record.input - model.input_mean
    first_scale = out_scale if model.structure == "linear" else 1.0
    if model.inner is not None:
        u = central_span(subject.fitted_input)
        last = model.outer is None
        y = model.inner(u) * (out_scale if last else 1.0)
        label = axis_label("inner_signal", out_unit if last else "")
        blocks.append(
            Block(_("static"), axis_label(record.input_name, in_unit), label, in_scale * u, y, None, dynamic=False)
        )
        driven = model.inner(record.input)
    blocks.append(
        _kernel_block(
            _("linear"), first_scale * model.first_kernel, first_scale * model.first_kernel_std, model.lag_s, rate
        )
    )
    if model.outer is not None:
        inside = convolve_at_rest(model.first_kernel, driven)
        z = central_span(inside[subject.analysis.fit_part])
        last_name = record.output_name if model.second_kernel is None else "inner_signal"
        offset = model.offset if model.second_kernel is None else 0.0
        y = out_scale * (model.outer(z) + offset)
        label = axis_label(last_name, out_unit)
        blocks.append(Block(_("static"), axis_label("inner_signal", ""), label, z, y, None, dynamic=False))
    if model.second_kernel is not None:
        blocks.append(_kernel_block(_("linear"), model.second_kernel, model.second_kernel_std, model.lag_s, rate))
    text = _("Chosen structure: {structure}. Bands: 95 % of the kernels.").format(
        structure=_(_STRUCTURES[model.structure])
    )
    doubt = ""
    if model.choice is not None and not model.choice.confident:
        doubt = _("The record supports other structures about as well: see the findings.")
    return block_diagram(blocks, _(record.input_name), _(record.output_name)), captions.joined(
        text, doubt, captions.findings(model.report.findings)
    )


@figure(
    HammersteinModel,
    "iterations",
    marked("Convergence of the Hammerstein iteration"),
    marked("Variance accounted for by pass, and the parameters of the linear stage relative to their last value."),
    group="nonlinear",
    place=22,
)
def iterations(subject: Subject[HammersteinModel]) -> Drawn:
    """Draw VAF and parameters of the linear stage by pass (as Chen 2010, Fig. 3.9).

    Raises:
        UnusableInputError: there was only one pass.
    """
    model = subject.model
    if len(model.history) < 2:
        raise UnusableInputError(captions.SINGLE_PASS)
    passes = [one.iteration for one in model.history]
    drawn = new_figure(FULL_WIDTH, 2.7)
    left, right = drawn.subplots(1, 2)
    left.plot(passes, [one.nonlinear_vaf_percent for one in model.history], color=BLUE, marker="o", markersize=3.5)
    left.set_ylabel(_("VAF (%)"))
    left.margins(y=0.25)
    for (name, last), colour, marker in zip(model.history[-1].parameters.items(), SERIES, "os^D", strict=False):
        values = np.array([one.parameters.get(name, np.nan) for one in model.history])
        if last != 0.0 and np.isfinite(values).all():
            right.plot(
                passes, values / last, color=colour, marker=marker, markersize=3.5, label=_(label_and_unit(name)[0])
            )
    right.set_ylabel(_("Parameter / final value"))
    if right.lines:
        right.legend(loc="best")
    for axes in (left, right):
        axes.axvline(model.chosen, color=MUTED, linewidth=1.0, linestyle=DASHES[2])
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
        axes.set_xlabel(_("Pass"))
    kept = _("Pass {chosen} (dotted) was kept.")
    if model.refined:
        kept = _("Pass {chosen} (dotted) was kept, then all parameters were refined jointly.")
    return drawn, captions.joined(
        _("The curves should level off within a few passes."), kept.format(chosen=model.chosen)
    )


def _kernel_block(title: str, kernel: Array, std: Array | None, lag_s: Array, rate: float) -> Block:
    """Return a linear block with its impulse response per second."""
    spread = None if std is None else rate * std
    return Block(title, _("Lag (ms)"), _("Impulse response (1/s)"), 1e3 * lag_s, rate * kernel, spread, dynamic=True)
