"""Figures of Volterra kernels: the kernels, contribution of each order, smoothing (Chen 2010, 4.2 and 4.3)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import cast

import numpy as np

from tissueid.analysis.curves.depth import dpn_plots, static_force_plot
from tissueid.analysis.curves.kernels import (
    NO_KERNELS,
    contribution_plots,
    impulse_contribution_plot,
    kernel_and_spectrum,
    kernel_curves,
    kernels_by_depth,
    partition_plots,
    second_order_kernel,
    spacing_plot,
    third_order_slices,
)
from tissueid.analysis.curves.linear import first_kernel_plot
from tissueid.analysis.curves.plot import CONFIDENCE, Array, Bars, Surface, is_mechanical
from tissueid.analysis.curves.validation import (
    ROLES,
    Prediction,
    cloud_plot,
    held_out_prediction,
    prediction_plots,
    scatter_plots,
)
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, number, with_unit
from tissueid.identification.engines.dpn import DpnModel
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.validation import vaf_percent
from tissueid.identification.volterra.regressors import THESIS_SIGMA
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, FigureSubject, figure
from tissueid.reports.plot_renderer import column_figure, draw_grid, draw_kernel, draw_over_samples, row_figure
from tissueid.reports.style import FULL_WIDTH, new_figure
from tissueid.units import display_unit

_HEIGHT = 2.0
"""Height of the impulse of Eq. 4.15 in standard deviations of the input."""


@figure(
    VolterraModel,
    "first-kernel",
    marked("First-order kernel"),
    marked("First-order kernel against lag with its 95 % band, and the second-order linear system as a dashed curve."),
    group="linear",
    wide=False,
    order=60,
)
def first_kernel(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw h1 with its band (Chen 2010, Figs. 4.6a and 4.12)."""
    model = subject.model
    if model.kernel1 is None:
        raise UnusableInputError(NO_KERNELS)
    return column_figure([first_kernel_plot(model, subject.record)], 3.9), _(
        "Close to an impulse response, at {lags} lags. It differs from the best linear system (dashed) by what the "
        "higher orders describe. It should decay before the last lag, and the band should be narrow there."
    ).format(lags=model.lag_s.size)


@figure(
    VolterraModel,
    "second-kernel",
    marked("Second-order kernel"),
    marked("Symmetric image of the second-order kernel over two lags, and the same kernel as a surface."),
    group="nonlinear",
    order=60,
)
def second_kernel(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw h2 as an image and as a surface (Chen 2010, Figs. 4.3, 4.6b and 4.9)."""
    model = subject.model
    plot = second_order_kernel(model, subject.record)
    drawn = new_figure(FULL_WIDTH, 4.1)
    draw_kernel(drawn, plot).set_box_aspect(1.0)
    kernel = cast(Surface, plot.surface).values
    text = _(
        "Joint effect of two past inputs. Blue is negative: together they move the tissue less than the sum of both "
        "alone, as where it stiffens with depth. A rounded peak swept in both directions indicates a Wiener system, a "
        "ridge along the diagonal alone a Hammerstein system, a narrow peak with side lobes parameters that change "
        "with depth independently."
    )
    largest = _("The largest value here is positive.")
    if float(kernel.flat[np.argmax(np.abs(kernel))]) < 0.0:
        largest = _("The largest value here is negative.")
    outside = ""
    if model.kernel2_std is not None:
        share = float(np.mean(np.abs(np.asarray(model.kernel2)) > CONFIDENCE * model.kernel2_std))
        outside = _("{percent} % of the kernel lies outside its own 95 % band about zero.").format(
            percent=fixed(100.0 * share, 0)
        )
    return drawn, captions.joined(text, largest, outside)


@figure(
    VolterraModel,
    "third-kernel",
    marked("Third-order kernel"),
    marked("Slices of the third-order kernel over two lags, each at another third lag."),
    group="nonlinear",
    order=64,
    applies=lambda subject: subject.model.kernel3 is not None,
)
def third_kernel(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw slices of the third-order kernel at a few values of its third lag."""
    drawn = row_figure(third_order_slices(subject.model, subject.record), 2.7)
    return drawn, _(
        "Joint effect of three past inputs, one slice for each of a few third lags, on one scale. Blue is negative. "
        "The kernel is symmetric in all three lags."
    )


@figure(
    VolterraModel,
    "impulse-contributions",
    marked("Impulse response by contributions"),
    marked("Curves against lag: first-order, second-order and total response to an impulse."),
    group="nonlinear",
    wide=False,
    order=66,
)
def impulse_contributions(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw the contribution of each order to the response to an impulse (Chen 2010, Eq. 4.15 and Fig. 4.3)."""
    model = subject.model
    height = _HEIGHT * float(np.nanstd(subject.fitted_input))
    drawn = column_figure([impulse_contribution_plot(model, subject.record, height)], 3.9)
    lasts = fixed(1e3 * model.lag_spacing / model.sample_rate_hz, 1)
    in_unit, in_scale = display_unit(subject.record.input_unit)
    return drawn, _(
        "Response to an input {height} above the operating point ({deviations} standard deviations) for {lasts} ms: "
        "the first order, and the diagonals of the higher orders. Where tissue stiffens, the second order reduces the "
        "response."
    ).format(height=with_unit(number(in_scale * height, 3), in_unit), deviations=number(_HEIGHT), lasts=lasts)


@figure(
    VolterraModel,
    "contributions",
    marked("Residual nonlinearity by contribution"),
    marked("Clouds of measured against modelled output: first order alone, with the diagonal of the second, and all."),
    group="nonlinear",
    order=68,
)
def contributions(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw the residual nonlinearity as orders are added (Chen 2010, Figs. 4.3 and 4.10)."""
    plots = contribution_plots(subject.model, subject.record, subject.analysis.fit_part)
    drawn = row_figure(plots, 3.7 if len(plots) < 4 else 3.1)
    return drawn, _(
        "A bend about the diagonal is a nonlinearity that is not described; each panel adds kernels to the previous "
        "one. The line is the mean of the cloud. Samples of the fitted part."
    )


_STRETCH_S = 0.25
"""Seconds of held-out samples that are drawn."""
_RAW, _FILTERED = marked("raw"), marked("filtered")


def _has_second(subject: FigureSubject[VolterraModel]) -> bool:
    return subject.model.kernel2 is not None


@figure(
    VolterraModel,
    "processing",
    marked("Second-order kernel, raw and smoothed"),
    marked("Images of the second-order kernel and below each the magnitude of its two-dimensional Fourier transform."),
    group="nonlinear",
    order=61,
    applies=_has_second,
)
def processing(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw the raw and smoothed kernels in time and frequency (Chen 2010, Figs. 4.8, 4.9, 4.13 and 4.15)."""
    models = _strategies(subject)
    columns = [kernel_and_spectrum(label, model, subject.record) for label, model in models]
    drawn = new_figure(FULL_WIDTH, 5.4)
    draw_grid(drawn, list(zip(*columns, strict=True)))
    scores = [
        f"{_(run.label)} {fixed(vaf_percent(run.measured, run.predicted), 1)} %" for run in _held_out_runs(subject)
    ]
    return drawn, _(
        "Upper row: the kernel by plain least squares, after a two-dimensional Gaussian filter, and of the model; each "
        "has its own scale. Lower row: magnitude of the Fourier transform; values near the edges are noise. Held-out "
        "variance accounted for: {scores}."
    ).format(scores=", ".join(scores))


@figure(
    VolterraModel,
    "processing-output",
    marked("Output with raw and smoothed kernels"),
    marked("Measured held-out output as dots with the simulations of the raw and the smoothed kernels as lines."),
    group="validation",
    order=70,
    applies=_has_second,
)
def processing_output(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw the simulations over a stretch of held-out samples (Chen 2010, Figs. 4.7 and 4.11)."""
    plots = prediction_plots(_held_out_runs(subject), _STRETCH_S)[:1]
    drawn = column_figure(plots, 3.0, wide=True, over=True)
    return drawn, _(
        "A stretch of held-out data. Where the filtered kernel differs from the raw one, the filter removed more than "
        "noise."
    )


@figure(
    VolterraModel,
    "processing-residual",
    marked("Residual nonlinearity with raw and smoothed kernels"),
    marked("Clouds of measured against modelled held-out output for the raw and the smoothed kernels."),
    group="validation",
    order=72,
    applies=_has_second,
)
def processing_residual(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw the residual nonlinearity before and after smoothing (Chen 2010, Fig. 4.10)."""
    drawn = row_figure(scatter_plots(_held_out_runs(subject), x="modelled", mean=True), 3.7)
    return drawn, _("All held-out samples. Smoothing should not make the clouds wider or more bent.")


@figure(
    VolterraModel,
    "spacing",
    marked("Input at the spacing of the lags"),
    marked("Power spectra of the input sampled at several rates; a white input is level up to the end of its curve."),
    group="record",
    wide=False,
    order=60,
)
def spacing(subject: FigureSubject[VolterraModel]) -> Drawn:
    """Draw spectra of the input at several sample rates (Chen 2010, Fig. 4.8)."""
    drawn = column_figure([spacing_plot(subject.model, subject.fitted_input, subject.record.input_unit)], 3.9)
    return drawn, _(
        "Each lag of a kernel can be estimated where the input is white at the spacing of the lags: level up to half "
        "the rate (dotted). Where the curve falls before that, neighbouring lags cannot be separated and the plain "
        "kernel is noise."
    )


@lru_cache(maxsize=2)
def _strategies(subject: FigureSubject[VolterraModel]) -> tuple[tuple[str, VolterraModel], ...]:
    """Return the raw kernel, the filtered one, and the model itself where it is neither.

    Raises:
        UnusableInputError: the record does not determine the plain least-squares fit.
    """
    model = subject.model
    if model.unfiltered is not None:
        return (_RAW, model.unfiltered), (_FILTERED, model)
    rate = model.sample_rate_hz
    plain = Volterra(
        method="exact",
        order=2,
        memory=model.lag_s.size * model.lag_spacing / rate,
        downsample=model.lag_spacing,
        smoothing=THESIS_SIGMA,
    ).fit(subject.record, subject.analysis.fit_part)
    assert plain.unfiltered is not None
    strategies: tuple[tuple[str, VolterraModel], ...] = ((_RAW, plain.unfiltered), (_FILTERED, plain))
    method = str(model.report.options.get("method", "as fitted"))
    return strategies if method == "exact" else (*strategies, ({"laguerre": "Laguerre"}.get(method, method), model))


def _held_out_runs(subject: FigureSubject[VolterraModel]) -> list[Prediction]:
    return [held_out_prediction(label, replace(subject.analysis, model=model)) for label, model in _strategies(subject)]


_STEPS = 160


@figure(
    DpnModel,
    "depth-profile",
    marked("Mass, damping and stiffness against depth"),
    marked("Curves of mass, damping and stiffness against depth with 95 % bands, and the distribution of depths."),
    group="nonlinear",
    order=30,
)
def curves(subject: FigureSubject[DpnModel]) -> Drawn:
    """Draw M(y), B(y) and K(y) with their bands over the visited depths."""
    model = subject.model
    position, origin = _visited(subject)
    estimated = model.estimated
    *plots, samples = dpn_plots(model, position, subject.surface_position_m)
    drawn = new_figure(FULL_WIDTH, 4.3)
    draw_over_samples(drawn, plots, samples, key=True)
    middle = np.array([float(np.median(estimated.position))])
    at, stiffness = fixed(1e3 * (float(middle[0]) - origin), 2), estimated.stiffness(middle)
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
    order=32,
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
    low, high = subject.model.estimated.central()
    origin = subject.surface_position_m if np.isfinite(subject.surface_position_m) else 0.0
    return np.linspace(low, high, _STEPS), origin


@figure(
    PartitionedModel,
    "partitions",
    marked("Output and its partitions"),
    marked("Left: output over time with the partitions of depth as bands. Right: histogram of the samples in each."),
    group="record",
    order=50,
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
    order=26,
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
    order=27,
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
    order=60,
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
