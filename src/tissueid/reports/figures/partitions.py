"""Figures of partitions of depth and direction: where depth is cut, and the kernels of the parts (Chen 2010, ch. 5)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from tissueid.errors import UnusableInputError
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.reports.diagnostics import CONFIDENCE, Array, thin
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import depth_bar, depth_colours, diagonal, residual_cloud, surface, uneven_image
from tissueid.reports.style import DASHES, FULL_WIDTH, MUTED, POINTS, SHADE, new_figure
from tissueid.reports.units import kernel_unit
from tissueid.wording import axis_label, fixed, people_unit

_WAYS = {1: "into the tissue", -1: "out of it", 0: ""}
_STRETCH_S = 4.0


@figure(
    PartitionedModel,
    "partitions",
    "Output and its partitions",
    "Output over time with the partitions of depth as bands, and beside it a histogram of the samples in each.",
    group="record",
    place=50,
)
def partitions(subject: Subject[PartitionedModel]) -> Drawn:
    """Where the output is cut (Chen 2010, Fig. 5.4a)."""
    model, record = subject.model, subject.record
    unit, scale = people_unit(record.output_unit)
    points = scale * model.breakpoints_m
    drawn = new_figure(FULL_WIDTH, 3.3)
    left, right = drawn.subplots(1, 2, sharey=True, width_ratios=(4.0, 1.0))
    shown = slice(0, round(_STRETCH_S * record.sample_rate_hz))
    first = subject.analysis.fit_part.indices(len(record))[0]
    time_s, output = record.time[first:][shown], record.output[first:][shown]
    for axes in (left, right):
        for place, (low, high) in enumerate(pairwise(points)):
            if place % 2:
                axes.axhspan(low, high, color=SHADE, zorder=0)
        for point in points:
            axes.axhline(point, color=MUTED, linewidth=0.8, linestyle=DASHES[2])
    colours = depth_colours(model.partitions.depths)
    left.plot(*thin(time_s, scale * output), color=colours[-1], linewidth=0.7)
    left.set_xlim(float(time_s[0]), float(time_s[-1]))
    left.invert_yaxis()
    left.set_xlabel("Time (s)")
    left.set_ylabel(axis_label(record.output_name, unit))
    seen = scale * model.partitions.filtered(record.output)[subject.analysis.fit_part]
    seen = seen[np.isfinite(seen)]
    counts = np.histogram(seen, points)[0]
    for low, high, count, colour in zip(points[:-1], points[1:], counts, colours, strict=True):
        right.barh(0.5 * (low + high), count, 0.92 * (high - low), color=colour)
    right.set_xlabel("Samples")
    return drawn, (
        f"{model.partitions.depths} stretches of depth, deep at the bottom; each has kernels of its own. The outer "
        f"ones go on without end. The fewest samples in one are {int(counts.min())}, for {model.lag_s.size} lags."
    )


@figure(
    PartitionedModel,
    "kernels",
    "Kernels by depth",
    "Kernels against lag as curves coloured by depth, one panel for each direction.",
    group="nonlinear",
    place=26,
)
def kernels(subject: Subject[PartitionedModel]) -> Drawn:
    """The kernels as they are fitted, coloured by depth (Chen 2010, Fig. 5.4b)."""
    model, record = subject.model, subject.record
    unit, scale = kernel_unit(record)
    out_unit, out_scale = people_unit(record.output_unit)
    drawn = new_figure(FULL_WIDTH, 3.7)
    ways = [way for way in (0, 1, -1) if np.any(model.direction == way)]
    panels = [(model.kernels[model.direction == way], model.kernels_std[model.direction == way], way) for way in ways]
    every = drawn.subplots(1, 2, sharey=len(ways) == 2)
    for axes, (rows, std, way) in zip(every, panels, strict=False):
        _curves(axes, 1e3 * model.lag_s, scale * rows, scale * std)
        axes.set_title(_WAYS[way] if way else "as fitted")
    if len(ways) == 1:
        _curves(every[1], 1e3 * model.lag_s, scale * model.operating_kernels, None)
        every[1].set_title("about the mean input")
    every[0].set_ylabel(f"Kernel ({unit})")
    low, high = out_scale * model.breakpoints_m[0], out_scale * model.breakpoints_m[-1]
    depth_bar(every[1], float(low), float(high), axis_label(record.output_name, out_unit))
    text = (
        "What an input at each lag adds to the output, by the depth that the output had then; bands of 95 % on the "
        "shallowest and the deepest. Deeper tissue should answer less, and sooner. "
    )
    if len(ways) == 1:
        text += "Kernels about the mean input (right) are those from which mass, damping and stiffness are read."
    return drawn, text


def _curves(axes: Axes, lag_ms: Array, rows: Array, std: Array | None) -> None:
    """Kernels (K, lags) as curves from shallow to deep, the first and the last with bands."""
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    colours = depth_colours(len(rows))
    for place, (kernel, colour) in enumerate(zip(rows, colours, strict=True)):
        if std is not None and place in (0, len(rows) - 1):
            half = CONFIDENCE * np.where(np.isfinite(std[place]), std[place], 0.0)
            axes.fill_between(lag_ms, kernel - half, kernel + half, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(lag_ms, kernel, color=colour, linewidth=1.3)
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel("Lag (ms)")


@figure(
    PartitionedModel,
    "kernel-image",
    "Kernels over lag and depth",
    "Image of the kernels over lag and depth, and the same as a surface.",
    group="nonlinear",
    place=27,
)
def kernel_image(subject: Subject[PartitionedModel]) -> Drawn:
    """The kernels about the mean input as an image and as a surface (Chen 2010, Figs. 5.5c and d)."""
    model, record = subject.model, subject.record
    if model.partitions.depths < 2 or model.lag_s.size < 3:
        raise UnusableInputError("an image takes two partitions and three lags")
    unit, scale = kernel_unit(record)
    out_unit, out_scale = people_unit(record.output_unit)
    points = out_scale * model.breakpoints_m
    lag_ms, rows = 1e3 * model.lag_s, scale * model.operating_kernels
    drawn = new_figure(FULL_WIDTH, 4.0)
    axes = drawn.add_subplot(1, 2, 1)
    uneven_image(axes, lag_ms, points, rows, f"Kernel ({unit})")
    axes.invert_yaxis()
    axes.set_xlabel("Lag (ms)")
    axes.set_ylabel(axis_label(record.output_name, out_unit))
    relief = surface(drawn, (1, 2, 2), lag_ms, 0.5 * (points[1:] + points[:-1]), rows)
    relief.set_xlabel("Lag (ms)")
    relief.set_ylabel(axis_label(record.output_name, out_unit))
    peaks = lag_ms[np.argmax(np.abs(rows), axis=1)]
    return drawn, (
        "The kernels about the mean input, deep at the bottom of the image. Orange is positive. In a Wiener system all "
        "peaks lie at one lag and only their height changes; where each parameter changes in its own way they move: "
        f"here from {fixed(float(peaks[0]), 1)} ms at the shallowest to {fixed(float(peaks[-1]), 1)} ms at the deepest."
    )


@figure(
    PartitionedModel,
    "scheduled",
    "What is left, told the depth and not",
    "Clouds of measured against modelled held-out output: with the measured depth as the schedule, and free-running.",
    group="validation",
    place=60,
)
def scheduled(subject: Subject[PartitionedModel]) -> Drawn:
    """Residual nonlinearity of the scheduled and of the free run (Chen 2010, Fig. 5.5b)."""
    analysis, model = subject.analysis, subject.model
    record, part = analysis.held_out_record, analysis.held_out
    unit, scale = people_unit(record.output_unit)
    measured = scale * record.output[part]
    if np.isfinite(measured).sum() < 2:
        raise UnusableInputError("no held-out output was received")
    runs = (
        ("told the measured depth", model.simulate_scheduled(record)[part]),
        ("free run, by its own depth", model.simulate(record.input)[part]),
    )
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    drawn = new_figure(FULL_WIDTH, 3.7)
    for place, (axes, (label, modelled)) in enumerate(zip(drawn.subplots(1, 2), runs, strict=True)):
        residual_cloud(axes, scale * modelled, measured, POINTS[place])
        diagonal(axes, low, high)
        axes.set_title(label)
        axes.set_xlabel(axis_label("modelled", unit))
        axes.set_ylabel(axis_label("measured", unit))
    report = model.report
    return drawn, (
        "All held-out samples. Told the depth at which each sample was measured, the model knows part of what it is "
        f"to tell: {fixed(report.vaf_scheduled_percent, 1)} % on the left is no simulation. The right has the input "
        f"alone: {fixed(report.vaf_validation_percent, 1)} %."
    )
