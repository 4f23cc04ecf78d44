"""Figures of engines by depth: parameter curves with bands, static force, partitions and their kernels."""

from __future__ import annotations

from typing import cast

import numpy as np

from tissueid.analysis.curves.depth import dpn_plots, static_force_plot
from tissueid.analysis.curves.kernels import kernel_curves, kernels_by_depth, partition_plots
from tissueid.analysis.curves.plot import Array, Bars, Surface, is_mechanical
from tissueid.analysis.curves.validation import ROLES, cloud_plot
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification.engines.dpn import DpnModel
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, FigureSubject, figure
from tissueid.reports.plot_renderer import column_figure, draw_kernel, draw_over_samples, row_figure
from tissueid.reports.style import FULL_WIDTH, new_figure

_STEPS = 160


@figure(
    DpnModel,
    "depth-profile",
    marked("Mass, damping and stiffness against depth"),
    marked("Curves of mass, damping and stiffness against depth with 95 % bands, and the distribution of depths."),
    group="nonlinear",
    place=30,
)
def curves(subject: FigureSubject[DpnModel]) -> Drawn:
    """Draw M(y), B(y) and K(y) with their bands over the visited depths."""
    model = subject.model
    position, origin = _visited(subject)
    known = model.known
    *plots, samples = dpn_plots(model, position, subject.surface_position_m)
    drawn = new_figure(FULL_WIDTH, 4.3)
    draw_over_samples(drawn, plots, samples, key=True)
    middle = np.array([float(np.median(known.position))])
    at, stiffness = fixed(1e3 * (float(middle[0]) - origin), 2), known.stiffness(middle)
    return drawn, _(
        "Curves with pointwise 95 % bands; below, the number of samples at each depth: where there are few, the bands "
        "widen. At the median of {at} mm the tangent stiffness is {stiffness} N/m. Damping that differs between the "
        "way in and the way out is drawn as two curves."
    ).format(at=at, stiffness=fixed(float(stiffness.value[0]), 0))


@figure(
    DpnModel,
    "static-force",
    marked("Static force against depth"),
    marked("Force of the tissue at rest against depth, with its 95 % band, over the measured force and position."),
    group="nonlinear",
    wide=False,
    place=32,
)
def static_force(subject: FigureSubject[DpnModel]) -> Drawn:
    """Draw F(y), the integral of the tangent stiffness, over the samples."""
    record = subject.record[subject.analysis.fit_part]
    plot = static_force_plot(subject.model, record, _visited(subject)[0], subject.surface_position_m)
    return column_figure([plot], 3.9), _(
        "The force that holds the probe at each depth, with its 95 % band, and the samples: their loops about the "
        "curve are inertia and damping. A curve that bends upwards means that the tissue stiffens."
    )


def _visited(subject: FigureSubject[DpnModel]) -> tuple[Array, float]:
    """Return positions (k,), m, over the central part of the visited range, and the origin of depth, m.

    Raises:
        UnusableInputError: the input is not a force, or the output is not a position.
    """
    if not is_mechanical(subject.record):
        raise UnusableInputError(
            "report.not_mechanical",
            "mass, damping and stiffness need a force as the input and a position as the output",
        )
    low, high = subject.model.known.central()
    origin = subject.surface_position_m if np.isfinite(subject.surface_position_m) else 0.0
    return np.linspace(low, high, _STEPS), origin


@figure(
    PartitionedModel,
    "partitions",
    marked("Output and its partitions"),
    marked("Left: output over time with the partitions of depth as bands. Right: histogram of the samples in each."),
    group="record",
    place=50,
)
def partitions(subject: FigureSubject[PartitionedModel]) -> Drawn:
    """Draw the output with the limits of the partitions (Chen 2010, Fig. 5.4a)."""
    model = subject.model
    output, samples = partition_plots(model, subject.record, subject.analysis.fit_part)
    drawn = row_figure((output, samples), 3.3, widths=(4.0, 1.0))
    least = min(float(bars.height[0]) for bars in samples.parts if isinstance(bars, Bars))
    return drawn, _(
        "{count} partitions of depth, deep at the bottom; each has its own kernels. The outermost are unbounded. The "
        "smallest partition has {least} samples, for {lags} lags."
    ).format(count=model.partitions.depths, least=int(least), lags=model.lag_s.size)


@figure(
    PartitionedModel,
    "kernels",
    marked("Kernels by depth"),
    marked("Kernels against lag as curves coloured by depth, one panel for each direction."),
    group="nonlinear",
    place=26,
)
def kernels(subject: FigureSubject[PartitionedModel]) -> Drawn:
    """Draw the fitted kernels, coloured by depth (Chen 2010, Fig. 5.4b)."""
    drawn = row_figure(kernel_curves(subject.model, subject.record), 3.7)
    text = _(
        "Contribution of the input at each lag to the output, by the depth at that lag; 95 % bands of the shallowest "
        "and the deepest. Deeper tissue should respond less and faster."
    )
    used = ""
    if np.all(subject.model.direction == 0):
        used = _("Mass, damping and stiffness are computed from the kernels about the mean input (right).")
    return drawn, captions.joined(text, used)


@figure(
    PartitionedModel,
    "kernel-image",
    marked("Kernels over lag and depth"),
    marked("Image of the kernels over lag and depth, and the same as a surface."),
    group="nonlinear",
    place=27,
)
def kernel_image(subject: FigureSubject[PartitionedModel]) -> Drawn:
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
def scheduled(subject: FigureSubject[PartitionedModel]) -> Drawn:
    """Draw the residual nonlinearity of the scheduled and of the free run (Chen 2010, Fig. 5.5b)."""
    analysis, model = subject.analysis, subject.model
    record, part = analysis.held_out_record, analysis.held_out
    measured = record.output[part]
    if np.isfinite(measured).sum() < 2:
        raise UnusableInputError(captions.NO_HELD_OUT_OUTPUT)
    runs = (
        (_("scheduled by measured depth"), model.simulate_scheduled(record)[part]),
        (_("free run, by its own depth"), model.simulate(record.input)[part]),
    )
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    plots = [
        cloud_plot(modelled, measured, record.output_unit, label, colour, ends=(low, high))
        for (label, modelled), colour in zip(runs, ROLES, strict=False)
    ]
    drawn = row_figure(plots, 3.7)
    report = model.report
    return drawn, _(
        "All held-out samples. Scheduled by the measured depth (left), the model uses part of what it predicts: "
        "{scheduled} % is not a simulation score. The free run (right) uses the input alone: {free} %."
    ).format(scheduled=fixed(report.vaf_scheduled_percent, 1), free=fixed(report.vaf_validation_percent, 1))
