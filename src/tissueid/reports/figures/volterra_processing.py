"""Figures of the smoothing of a second-order kernel: filter, regularisation, spacing (Chen 2010, 4.3)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import cast

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.diagnostics import held_out_prediction, power_spectrum
from tissueid.analysis.curves.kernels import second_order_kernel
from tissueid.analysis.curves.plot import Axis, Plot, Surface
from tissueid.analysis.curves.units import LAG
from tissueid.analysis.curves.validation import ROLES, cloud_plot, prediction_plots
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed
from tissueid.identification.base import Model
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.validation import vaf_percent
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports import captions
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, draw_plot, row_figure
from tissueid.reports.style import (
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    MUTED,
    SERIES,
    frequency_axis,
    log_axis,
    new_figure,
)
from tissueid.units import display_unit

_SPREAD = 15.0
"""Standard deviation of the filter in samples of the kernel's transform, as in the thesis."""
_STRETCH_S = 0.25
"""Seconds of held-out samples that are drawn."""
_RAW, _FILTERED = marked("raw"), marked("filtered")


def _has_second(subject: Subject[VolterraModel]) -> bool:
    return subject.model.kernel2 is not None


@figure(
    VolterraModel,
    "processing",
    marked("Second-order kernel, raw and smoothed"),
    marked("Images of the second-order kernel and below each the magnitude of its two-dimensional Fourier transform."),
    group="nonlinear",
    place=61,
    applies=_has_second,
)
def processing(subject: Subject[VolterraModel]) -> Drawn:
    """Draw the raw and smoothed kernels in time and frequency (Chen 2010, Figs. 4.8, 4.9, 4.13 and 4.15)."""
    models = _strategies(subject)
    drawn = new_figure(FULL_WIDTH, 5.4)
    every = drawn.subplots(2, len(models), squeeze=False)
    rate = subject.model.sample_rate_hz / subject.model.lag_spacing
    frequency_hz = np.fft.fftshift(np.fft.fftfreq(subject.model.lag_s.size, 1.0 / rate))
    frequency = Axis(marked("Frequency"), "Hz")
    scores = []
    for (label, model), upper, lower in zip(models, every[0], every[1], strict=True):
        plot = second_order_kernel(model, subject.record)
        surface = cast(Surface, plot.surface)
        magnitude = np.abs(np.fft.fftshift(np.fft.fft2(surface.values)))
        magnitude /= magnitude.max()
        draw_plot(upper, Plot(label, LAG, LAG, (replace(surface, name=""),)))
        spectrum = Surface(frequency_hz, frequency_hz, magnitude, marked("relative to maximum"), signed=False)
        draw_plot(lower, Plot("", frequency, frequency, (spectrum,)))
        for axes in (upper, lower):
            axes.set_box_aspect(1.0)
        scores.append(f"{_(label)} {fixed(_held_out_vaf(subject, model), 1)} %")
    for axes in every[:, 1:].flat:
        axes.set_ylabel("")
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
    place=70,
    applies=_has_second,
)
def processing_output(subject: Subject[VolterraModel]) -> Drawn:
    """Draw the simulations over a stretch of held-out samples (Chen 2010, Figs. 4.7 and 4.11)."""
    runs = [held_out_prediction(label, _analysis_of(subject, model)) for label, model in _strategies(subject)]
    drawn = column_figure(prediction_plots(runs, _STRETCH_S)[:1], 3.0, wide=True, over=True)
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
    place=72,
    applies=_has_second,
)
def processing_residual(subject: Subject[VolterraModel]) -> Drawn:
    """Draw the residual nonlinearity before and after smoothing (Chen 2010, Fig. 4.10)."""
    runs = [held_out_prediction(label, _analysis_of(subject, model)) for label, model in _strategies(subject)]
    measured = runs[0].measured
    known = np.isfinite(measured)
    if not known.any():
        raise UnusableInputError(captions.NO_HELD_OUT_OUTPUT)
    ends = float(measured[known].min()), float(measured[known].max())
    plots = [
        cloud_plot(run.predicted, run.measured, run.output_unit, run.label, colour, ends=ends)
        for run, colour in zip(runs, ROLES, strict=False)
    ]
    drawn = row_figure(plots, 3.7)
    return drawn, _("All held-out samples. Smoothing should not make the clouds wider or more bent.")


@figure(
    VolterraModel,
    "spacing",
    marked("Input at the spacing of the lags"),
    marked("Power spectra of the input sampled at several rates; a white input is level up to the end of its curve."),
    group="record",
    wide=False,
    place=60,
)
def spacing(subject: Subject[VolterraModel]) -> Drawn:
    """Draw spectra of the input at several sample rates (Chen 2010, Fig. 4.8)."""
    model = subject.model
    unit, scale = display_unit(subject.record.input_unit)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    steps = sorted({1, model.lag_spacing, max(2, 2 * model.lag_spacing)})
    lowest, top = np.inf, 0.0
    for step, colour, dash in zip(steps, SERIES, DASHES, strict=False):
        rate = model.sample_rate_hz / step
        found = power_spectrum(scale * subject.fitted_input[::step], rate)
        if found is None:
            continue
        frequency_hz, density = found
        label = _("{rate} Hz (the lags)") if step == model.lag_spacing else "{rate} Hz"
        label = label.format(rate=fixed(rate, 0))
        axes.plot(frequency_hz[1:], density[1:], color=colour, linestyle=dash, label=label)
        axes.axvline(0.5 * rate, color=MUTED, linewidth=0.8, linestyle=DASHES[2])
        lowest, top = min(lowest, float(frequency_hz[1])), max(top, float(density[1:].max()))
    if not top > 0.0:
        raise UnusableInputError(
            Message("report.no_spectrum", "the fitted part is too short, or has too many gaps, for a power spectrum")
        )
    frequency_axis(axes, lowest, 0.5 * model.sample_rate_hz)
    axes.set_ylim(1e-7 * top, 3.0 * top)
    log_axis(axes)
    axes.set_ylabel(_("Power spectral density ({unit}²/Hz)").format(unit=unit))
    axes.legend(loc="lower left")
    return drawn, _(
        "Each lag of a kernel can be estimated where the input is white at the spacing of the lags: level up to half "
        "the rate (dotted). Where the curve falls before that, neighbouring lags cannot be separated and the plain "
        "kernel is noise."
    )


@lru_cache(maxsize=2)
def _strategies(subject: Subject[VolterraModel]) -> tuple[tuple[str, VolterraModel], ...]:
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
        smoothing=_SPREAD,
    ).fit(subject.record, subject.analysis.fit_part)
    assert plain.unfiltered is not None
    found: tuple[tuple[str, VolterraModel], ...] = ((_RAW, plain.unfiltered), (_FILTERED, plain))
    method = str(model.report.options.get("method", "as fitted"))
    return found if method == "exact" else (*found, ({"laguerre": "Laguerre"}.get(method, method), model))


def _held_out_vaf(subject: Subject[VolterraModel], model: VolterraModel) -> float:
    run = held_out_prediction("", _analysis_of(subject, model))
    return vaf_percent(run.measured, run.predicted)


def _analysis_of(subject: Subject[VolterraModel], model: Model) -> Analysis:
    return replace(subject.analysis, model=model)
