"""Figures of the smoothing of a second-order kernel: filter, regularisation, spacing (Chen 2010, 4.3)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from tissueid.analysis.curves.kernels import kernel_and_spectrum, spacing_plot
from tissueid.analysis.curves.validation import Prediction, held_out_prediction, prediction_plots, scatter_plots
from tissueid.formatting import fixed
from tissueid.identification.engines.volterra import Volterra
from tissueid.identification.validation import vaf_percent
from tissueid.identification.volterra.lag_grid import THESIS_SIGMA
from tissueid.identification.volterra.model import VolterraModel
from tissueid.language import _, marked
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, draw_grid, row_figure
from tissueid.reports.style import FULL_WIDTH, new_figure

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
    place=70,
    applies=_has_second,
)
def processing_output(subject: Subject[VolterraModel]) -> Drawn:
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
    place=72,
    applies=_has_second,
)
def processing_residual(subject: Subject[VolterraModel]) -> Drawn:
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
    place=60,
)
def spacing(subject: Subject[VolterraModel]) -> Drawn:
    """Draw spectra of the input at several sample rates (Chen 2010, Fig. 4.8)."""
    drawn = column_figure([spacing_plot(subject.model, subject.fitted_input, subject.record.input_unit)], 3.9)
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
        smoothing=THESIS_SIGMA,
    ).fit(subject.record, subject.analysis.fit_part)
    assert plain.unfiltered is not None
    found: tuple[tuple[str, VolterraModel], ...] = ((_RAW, plain.unfiltered), (_FILTERED, plain))
    method = str(model.report.options.get("method", "as fitted"))
    return found if method == "exact" else (*found, ({"laguerre": "Laguerre"}.get(method, method), model))


def _held_out_runs(subject: Subject[VolterraModel]) -> list[Prediction]:
    return [held_out_prediction(label, replace(subject.analysis, model=model)) for label, model in _strategies(subject)]
