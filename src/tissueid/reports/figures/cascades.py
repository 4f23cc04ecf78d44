"""Figures of cascades: the blocks in the order of the signal, each with its curve (Chen 2010, Fig. 3.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import FancyArrowPatch, Rectangle
from matplotlib.ticker import MaxNLocator

from tissueid.errors import UnusableInputError
from tissueid.identification.cascades.curves import curve_slopes
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.reports.diagnostics import CONFIDENCE, Array
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.style import BLUE, DASHES, FULL_WIDTH, INK, MUTED, ORANGE, SERIES, drawing, new_figure
from tissueid.wording import axis_label, named_unit, people_unit

_STRUCTURES = {
    "linear": "a linear system",
    "wiener": "linear dynamics, then a curve (Wiener, LN)",
    "hammerstein": "a curve, then linear dynamics (Hammerstein, NL)",
    "lnl": "a curve between two linear systems (LNL)",
    "nln": "linear dynamics between two curves (NLN)",
}


@dataclass(frozen=True, eq=False)
class Block:
    """A block of a cascade: its title, the axes' labels, and its curve (k,) with a deviation (k,) or None."""

    title: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    std: Array | None
    dynamic: bool


@drawing
def block_diagram(blocks: list[Block], source: str, drain: str) -> Figure:
    """Blocks from left to right with arrows between them, and the names of what goes in and comes out."""
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
    _wires(drawn, list(every), source, drain)
    return drawn


def _wires(drawn: Figure, every: list[Axes], source: str, drain: str) -> None:
    """Frames about the blocks, and arrows into, between and out of them."""
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
    "Structure: a curve, then linear dynamics",
    "Block diagram from left to right: the static curve of the input, and the impulse response that follows it.",
    group="nonlinear",
    place=12,
)
def hammerstein(subject: Subject[HammersteinModel]) -> Drawn:
    """The two blocks of a Hammerstein cascade."""
    model, record = subject.model, subject.record
    unit, scale = people_unit(record.output_unit)
    u = _span(subject.fitted_input)
    std = _curve_std(model.nonlinearity, u, model.nonlinearity_covariance)
    blocks = [
        Block(
            "static",
            axis_label(record.input_name, people_unit(record.input_unit)[0]),
            axis_label("passed on", unit),
            u * people_unit(record.input_unit)[1],
            scale * model.nonlinearity(u),
            None if std is None else scale * std,
            dynamic=False,
        ),
        _kernel_block("linear", model.kernel, model.kernel_std, model.lag_s, model.sample_rate_hz),
    ]
    gain = "sums to one" if model.steady_gain else "has no steady gain, and a root-sum-square of one"
    return block_diagram(blocks, record.input_name, record.output_name), (
        f"What the cascade does to the {record.input_name}, in the order of the signal, with 95 % bands. "
        f"The kernel {gain}; the curve carries the unit. Tissue that stiffens flattens the curve. "
        f"{_findings(model.report.findings)}"
    )


@figure(
    WienerModel,
    "blocks",
    "Structure: linear dynamics, then a curve",
    "Block diagram from left to right: the impulse response, and the static curve that follows it.",
    group="nonlinear",
    place=15,
)
def wiener(subject: Subject[WienerModel]) -> Drawn:
    """The two blocks of a Wiener cascade (Chen 2010, Fig. 3.6)."""
    model, record = subject.model, subject.record
    unit, scale = people_unit(record.output_unit)
    in_unit, in_scale = people_unit(record.input_unit)
    z = _span(model.linear_output(record.input)[subject.analysis.fit_part])
    lag_s = np.arange(model.kernel.size) / model.sample_rate_hz
    blocks = [
        _kernel_block("linear", model.kernel, None, lag_s, model.sample_rate_hz),
        Block(
            "static",
            axis_label("passed on", in_unit),
            axis_label(record.output_name, unit),
            in_scale * z,
            scale * model.nonlinearity(z),
            None,
            dynamic=False,
        ),
    ]
    return block_diagram(blocks, record.input_name, record.output_name), (
        "What the cascade does, in the order of the signal. The kernel sums to one; the curve turns the load that it "
        "passes on into a position. Tissue that stiffens flattens the curve."
    )


@figure(
    CascadeModel,
    "blocks",
    "Structure: the blocks that the record speaks for",
    "Block diagram from left to right: the linear and static blocks of the chosen structure, each with its curve.",
    group="nonlinear",
    place=14,
)
def cascade(subject: Subject[CascadeModel]) -> Drawn:
    """The blocks of the chosen structure, in their order."""
    model, record = subject.model, subject.record
    in_unit, in_scale = people_unit(record.input_unit)
    out_unit, out_scale = people_unit(record.output_unit)
    rate = model.sample_rate_hz
    blocks: list[Block] = []
    driven = record.input - model.input_mean
    first_scale = out_scale if model.structure == "linear" else 1.0
    if model.inner is not None:
        u = _span(subject.fitted_input)
        last = model.outer is None
        y = model.inner(u) * (out_scale if last else 1.0)
        label = axis_label("passed on", out_unit if last else "")
        blocks.append(
            Block("static", axis_label(record.input_name, in_unit), label, in_scale * u, y, None, dynamic=False)
        )
        driven = model.inner(record.input)
    blocks.append(
        _kernel_block(
            "linear", first_scale * model.first_kernel, first_scale * model.first_kernel_std, model.lag_s, rate
        )
    )
    if model.outer is not None:
        inside = convolve_at_rest(model.first_kernel, driven)
        z = _span(inside[subject.analysis.fit_part])
        last_name = record.output_name if model.second_kernel is None else "passed on"
        offset = model.offset if model.second_kernel is None else 0.0
        y = out_scale * (model.outer(z) + offset)
        label = axis_label(last_name, out_unit)
        blocks.append(Block("static", "Passed on", label, z, y, None, dynamic=False))
    if model.second_kernel is not None:
        blocks.append(_kernel_block("linear", model.second_kernel, model.second_kernel_std, model.lag_s, rate))
    text = f"The record was described as {_STRUCTURES[model.structure]}, with 95 % bands of the kernels. "
    if model.choice is not None and not model.choice.confident:
        text += "It does not speak for this structure alone: see the findings. "
    return block_diagram(blocks, record.input_name, record.output_name), text + _findings(model.report.findings)


@figure(
    HammersteinModel,
    "iterations",
    "How the Hammerstein iteration settled",
    "Variance accounted for by pass, and the parameters of the linear stage relative to their last value.",
    group="nonlinear",
    place=22,
)
def iterations(subject: Subject[HammersteinModel]) -> Drawn:
    """VAF and parameters of the linear stage by pass (as Chen 2010, Fig. 3.9).

    Raises:
        UnusableInputError: there was one pass only.
    """
    model = subject.model
    if len(model.history) < 2:
        raise UnusableInputError("the iteration made a single pass")
    passes = [one.iteration for one in model.history]
    drawn = new_figure(FULL_WIDTH, 2.7)
    left, right = drawn.subplots(1, 2)
    left.plot(passes, [one.nonlinear_vaf_percent for one in model.history], color=BLUE, marker="o", markersize=3.5)
    left.set_ylabel("VAF (%)")
    left.margins(y=0.25)
    for (name, last), colour, marker in zip(model.history[-1].parameters.items(), SERIES, "os^D", strict=False):
        values = np.array([one.parameters.get(name, np.nan) for one in model.history])
        if last != 0.0 and np.isfinite(values).all():
            right.plot(passes, values / last, color=colour, marker=marker, markersize=3.5, label=named_unit(name)[0])
    right.set_ylabel("Over its last value")
    if right.lines:
        right.legend(loc="best")
    for axes in (left, right):
        axes.axvline(model.chosen, color=MUTED, linewidth=1.0, linestyle=DASHES[2])
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
        axes.set_xlabel("Pass")
    refined = ", and then refined jointly" if model.refined else ""
    return drawn, f"The passes should level off within a few. Pass {model.chosen} (dotted) was kept{refined}."


def _kernel_block(title: str, kernel: Array, std: Array | None, lag_s: Array, rate: float) -> Block:
    """A linear block by its impulse response, per second."""
    spread = None if std is None else rate * std
    return Block(title, "Lag (ms)", "Impulse response (per s)", 1e3 * lag_s, rate * kernel, spread, dynamic=True)


def _span(values: Array) -> Array:
    """Even steps over the central 99 % of what was received.

    Raises:
        UnusableInputError: nothing was received.
    """
    known = values[np.isfinite(values)]
    if known.size < 2:
        raise UnusableInputError("no sample lies where the cascade can be run")
    low, high = np.quantile(known, (0.005, 0.995))
    return np.linspace(float(low), float(high), 200)


def _curve_std(curve: StaticNonlinearity, x: Array, covariance: Array) -> Array | None:
    """Standard deviation (k,) of a curve at x (k,) from the covariance (p, p) of its coefficients."""
    if not np.isfinite(covariance).all():
        return None
    slopes = curve_slopes(curve, x)  # (p, k)
    return np.asarray(np.sqrt(np.maximum(np.einsum("pk,pq,qk->k", slopes, covariance, slopes), 0.0)))


def _findings(findings: tuple[str, ...]) -> str:
    return " ".join(f"{said[:1].upper()}{said[1:]}." for said in findings)
