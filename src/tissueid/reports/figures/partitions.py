"""Figures of partitions of depth and direction: their limits and their kernels (Chen 2010, ch. 5)."""

from __future__ import annotations

from itertools import pairwise
from typing import cast

import numpy as np
from matplotlib.axes import Axes

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.kernels import kernels_by_depth
from tissueid.analysis.curves.plot import CONFIDENCE, Surface, thin
from tissueid.analysis.curves.units import kernel_unit
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, fixed
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import depth_bar, depth_colours, diagonal, residual_cloud
from tissueid.reports.plot_renderer import draw_kernel
from tissueid.reports.style import DASHES, FULL_WIDTH, MUTED, POINTS, SHADE, new_figure
from tissueid.units import display_unit

_WAYS = {1: marked("into the tissue"), -1: marked("out of the tissue"), 0: marked("as fitted")}
_STRETCH_S = 4.0
"""Seconds of the output that are drawn."""


@figure(
    PartitionedModel,
    "partitions",
    marked("Output and its partitions"),
    marked("Left: output over time with the partitions of depth as bands. Right: histogram of the samples in each."),
    group="record",
    place=50,
)
def partitions(subject: Subject[PartitionedModel]) -> Drawn:
    """Draw the output with the limits of the partitions (Chen 2010, Fig. 5.4a)."""
    model, record = subject.model, subject.record
    unit, scale = display_unit(record.output_unit)
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
    left.set_xlabel(_("Time (s)"))
    left.set_ylabel(axis_label(record.output_name, unit))
    seen = scale * model.partitions.filtered(record.output)[subject.analysis.fit_part]
    seen = seen[np.isfinite(seen)]
    counts = np.histogram(seen, points)[0]
    for low, high, count, colour in zip(points[:-1], points[1:], counts, colours, strict=True):
        right.barh(0.5 * (low + high), count, 0.92 * (high - low), color=colour)
    right.set_xlabel(_("Samples"))
    return drawn, _(
        "{count} partitions of depth, deep at the bottom; each has its own kernels. The outermost are unbounded. The "
        "smallest partition has {least} samples, for {lags} lags."
    ).format(count=model.partitions.depths, least=int(counts.min()), lags=model.lag_s.size)


@figure(
    PartitionedModel,
    "kernels",
    marked("Kernels by depth"),
    marked("Kernels against lag as curves coloured by depth, one panel for each direction."),
    group="nonlinear",
    place=26,
)
def kernels(subject: Subject[PartitionedModel]) -> Drawn:
    """Draw the fitted kernels, coloured by depth (Chen 2010, Fig. 5.4b)."""
    model, record = subject.model, subject.record
    unit, scale = kernel_unit(record)
    out_unit, out_scale = display_unit(record.output_unit)
    drawn = new_figure(FULL_WIDTH, 3.7)
    ways = [way for way in (0, 1, -1) if np.any(model.direction == way)]
    panels = [(model.kernels[model.direction == way], model.kernels_std[model.direction == way], way) for way in ways]
    every = drawn.subplots(1, 2, sharey=len(ways) == 2)
    for axes, (rows, std, way) in zip(every, panels, strict=False):
        _curves(axes, 1e3 * model.lag_s, scale * rows, scale * std)
        axes.set_title(_(_WAYS[way]))
    if len(ways) == 1:
        _curves(every[1], 1e3 * model.lag_s, scale * model.operating_kernels, None)
        every[1].set_title(_("about the mean input"))
    every[0].set_ylabel(_("Kernel ({unit})").format(unit=unit))
    low, high = out_scale * model.breakpoints_m[0], out_scale * model.breakpoints_m[-1]
    depth_bar(every[1], float(low), float(high), axis_label(record.output_name, out_unit))
    text = _(
        "Contribution of the input at each lag to the output, by the depth at that lag; 95 % bands of the shallowest "
        "and the deepest. Deeper tissue should respond less and faster."
    )
    used = ""
    if len(ways) == 1:
        used = _("Mass, damping and stiffness are computed from the kernels about the mean input (right).")
    return drawn, captions.joined(text, used)


def _curves(axes: Axes, lag_ms: Array, rows: Array, std: Array | None) -> None:
    """Draw kernels (K, lags) as curves from shallow to deep, the first and the last with bands."""
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    colours = depth_colours(len(rows))
    for place, (kernel, colour) in enumerate(zip(rows, colours, strict=True)):
        if std is not None and place in (0, len(rows) - 1):
            half = CONFIDENCE * np.where(np.isfinite(std[place]), std[place], 0.0)
            axes.fill_between(lag_ms, kernel - half, kernel + half, color=colour, alpha=0.15, linewidth=0.0)
        axes.plot(lag_ms, kernel, color=colour, linewidth=1.3)
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel(_("Lag (ms)"))


@figure(
    PartitionedModel,
    "kernel-image",
    marked("Kernels over lag and depth"),
    marked("Image of the kernels over lag and depth, and the same as a surface."),
    group="nonlinear",
    place=27,
)
def kernel_image(subject: Subject[PartitionedModel]) -> Drawn:
    """Draw the kernels about the mean input as an image and as a surface (Chen 2010, Figs. 5.5c and d)."""
    model, record = subject.model, subject.record
    plot = kernels_by_depth(model, record)
    drawn = new_figure(FULL_WIDTH, 4.0)
    draw_kernel(drawn, plot)
    surface = cast(Surface, plot.surface)
    lag_ms, rows = surface.x, surface.values
    peaks = lag_ms[np.argmax(np.abs(rows), axis=1)]
    return drawn, _(
        "The kernels about the mean input, deep at the bottom of the image. Orange is positive. In a Wiener system all "
        "peaks lie at one lag and only their height changes; where the parameters change independently, they move: "
        "here from {shallow} ms at the shallowest partition to {deep} ms at the deepest."
    ).format(shallow=fixed(float(peaks[0]), 1), deep=fixed(float(peaks[-1]), 1))


@figure(
    PartitionedModel,
    "scheduled",
    marked("Scheduled by measured depth, and free run"),
    marked("Clouds of measured against modelled held-out output: scheduled by measured depth, and free run."),
    group="validation",
    place=60,
)
def scheduled(subject: Subject[PartitionedModel]) -> Drawn:
    """Draw the residual nonlinearity of the scheduled and of the free run (Chen 2010, Fig. 5.5b)."""
    analysis, model = subject.analysis, subject.model
    record, part = analysis.held_out_record, analysis.held_out
    unit, scale = display_unit(record.output_unit)
    measured = scale * record.output[part]
    if np.isfinite(measured).sum() < 2:
        raise UnusableInputError(captions.NO_HELD_OUT_OUTPUT)
    runs = (
        (_("scheduled by measured depth"), model.simulate_scheduled(record)[part]),
        (_("free run, by its own depth"), model.simulate(record.input)[part]),
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
    return drawn, _(
        "All held-out samples. Scheduled by the measured depth (left), the model uses part of what it predicts: "
        "{scheduled} % is not a simulation score. The free run (right) uses the input alone: {free} %."
    ).format(scheduled=fixed(report.vaf_scheduled_percent, 1), free=fixed(report.vaf_validation_percent, 1))
