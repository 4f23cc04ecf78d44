"""Figures of predictions on held-out data and of their residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis.curves.diagnostics import (
    STRETCH_S,
    Prediction,
    autocorrelation,
    cross_correlation,
    readable_stretch,
)
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label
from tissueid.language import _
from tissueid.messages import Message
from tissueid.reports.style import (
    DASHES,
    FULL_WIDTH,
    INK,
    MUTED,
    POINTS,
    SERIES,
    SHADE,
    drawing,
    new_figure,
)
from tissueid.units import display_unit

_MOST_POINTS = 3000
_LEAST_SAMPLES = 32


@drawing
def prediction_figure(predictions: Sequence[Prediction], seconds: float = STRETCH_S) -> Figure:
    """Draw measured and simulated output over a stretch of held-out data, and residuals (Chen 2010, Fig. 3.10).

    Raises:
        UnusableInputError: there is nothing to compare.
    """
    first = _comparable(predictions)
    stretch = readable_stretch(first, seconds)
    unit, scale = display_unit(first.output_unit)
    figure = new_figure(FULL_WIDTH, 4.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    time_s = first.time_s[stretch]
    upper.plot(
        time_s,
        scale * first.measured[stretch],
        color=INK,
        linestyle="none",
        marker=".",
        markersize=3.0,
        label=_("measured"),
    )
    lower.axhline(0.0, color=MUTED, linewidth=0.8)
    for prediction, colour, dash in zip(predictions, SERIES, DASHES, strict=False):
        upper.plot(time_s, scale * prediction.predicted[stretch], color=colour, linestyle=dash, label=prediction.label)
        lower.plot(time_s, scale * prediction.residual[stretch], color=colour, linestyle=dash, linewidth=1.0)
    upper.set_ylabel(axis_label(first.output_name, unit))
    lower.set_ylabel(axis_label("residual", unit))
    lower.set_xlabel(_("Time (s)"))
    lower.set_xlim(float(time_s[0]), float(time_s[-1]))
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=1 + len(predictions), borderaxespad=0.2)
    figure.align_ylabels()
    return figure


@drawing
def scatter_figure(predictions: Sequence[Prediction]) -> Figure:
    """Draw measured against simulated output over the whole held-out part, one panel per engine.

    Raises:
        UnusableInputError: there is nothing to compare.
    """
    first = _comparable(predictions)
    unit, scale = display_unit(first.output_unit)
    figure = new_figure(FULL_WIDTH, 3.3)
    every = figure.subplots(1, max(2, len(predictions)), sharex=True, sharey=True, squeeze=False)[0]
    known = [np.isfinite(prediction.residual) for prediction in predictions]
    measured = np.concatenate([p.measured[mask] for p, mask in zip(predictions, known, strict=True)])
    ends = scale * np.array([measured.min(), measured.max()])
    margin = 0.06 * float(np.ptp(ends)) or 1e-6
    for axes, prediction, mask, colour in zip(every, predictions, known, POINTS, strict=False):
        some = np.flatnonzero(mask)
        some = some[:: max(1, -(-some.size // _MOST_POINTS))]
        axes.plot(
            scale * prediction.predicted[some],
            scale * prediction.measured[some],
            color=colour,
            linestyle="none",
            marker=".",
            markersize=3.0,
            markeredgewidth=0.0,
            alpha=0.5,
            rasterized=True,
        )
        axes.plot(ends, ends, color=INK, linewidth=1.0, linestyle=DASHES[1])
        axes.set_title(prediction.label)
        axes.set_xlabel(axis_label("predicted", unit))
        axes.set_xlim(ends[0] - margin, ends[1] + margin)
        axes.set_ylim(ends[0] - margin, ends[1] + margin)
        axes.set_box_aspect(1.0)
    every[0].set_ylabel(axis_label("measured", unit))
    for axes in every[len(predictions) :]:
        axes.set_visible(False)
    return figure


@drawing
def residuals_figure(predictions: Sequence[Prediction]) -> Figure:
    """Draw the autocorrelation of the held-out residuals and their correlation with the input, with 95 % bands.

    Raises:
        UnusableInputError: there is nothing to correlate.
    """
    first = _comparable(predictions)
    lags = max(2, min(first.memory_samples, first.measured.size // 4))
    lag_ms = 1e3 * np.arange(lags + 1) / first.sample_rate_hz
    figure = new_figure(FULL_WIDTH, 3.0)
    left, right = figure.subplots(1, 2)
    limit = 0.0
    for prediction, colour, dash in zip(predictions, SERIES, DASHES, strict=False):
        correlation, band = autocorrelation(prediction.residual, lags)
        if prediction is first:
            left.axhspan(-band, band, color=SHADE, zorder=0, label=_("95 % band of white noise"))
        left.plot(lag_ms[1:], correlation[1:], color=colour, linestyle=dash, linewidth=1.1, label=prediction.label)
        two_sided, values, half_width = cross_correlation(prediction.input, prediction.residual, lags)
        right.plot(1e3 * two_sided / prediction.sample_rate_hz, values, color=colour, linestyle=dash, linewidth=1.1)
        for side in (-half_width, half_width):
            right.axhline(side, color=colour, linestyle=dash, linewidth=0.8, alpha=0.7)
        limit = max(limit, 1.25 * half_width, 1.1 * float(np.abs(values).max()))
    for axes in (left, right):
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
    left.set_xlabel(_("Lag (ms)"))
    left.set_xlim(0.0, float(lag_ms[-1]))
    left.set_ylabel(_("Residual autocorrelation"))
    left.legend(loc="upper right")
    right.set_xlabel(_("Lag of the residual behind the input (ms)"))
    right.set_xlim(-float(lag_ms[-1]), float(lag_ms[-1]))
    right.set_ylim(-limit, limit)
    right.set_ylabel(_("Input to residual"))
    return figure


def _comparable(predictions: Sequence[Prediction]) -> Prediction:
    """The first prediction, once it is clear that each has something to compare.

    Raises:
        UnusableInputError: there is no prediction, or one has too few samples that were received and simulated.
    """
    if not predictions:
        raise UnusableInputError(Message("report.not_validated", "no engine was validated on this test"))
    for prediction in predictions:
        residual = prediction.residual[np.isfinite(prediction.residual)]
        if residual.size < _LEAST_SAMPLES or not float(np.ptp(residual)) > 0.0:
            raise UnusableInputError(
                Message(
                    "report.held_out_too_short",
                    "the held-out part has too few samples to judge {engine}",
                    engine=prediction.label,
                )
            )
    return predictions[0]
