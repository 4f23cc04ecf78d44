"""Plots of predictions on held-out data and of their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from tissueid.analysis.curves.diagnostics import (
    STRETCH_S,
    Prediction,
    autocorrelation,
    cross_correlation,
    readable_stretch,
)
from tissueid.analysis.curves.plot import CONFIDENCE, Array, Axis, Curve, Kind, Plot, cloud
from tissueid.analysis.curves.units import LAG, TIME, signal_axis
from tissueid.errors import UnusableInputError
from tissueid.identification.validation.prediction import PredictionCurve
from tissueid.identification.validation.residual_tests import ResidualTest, TestName
from tissueid.language import marked
from tissueid.units import display_unit

ROLES = ("measured", "model", "good", "check")
"""Colours of several engines in one plot."""
KINDS: tuple[Kind, ...] = get_args(Kind)[:4]
"""Line styles of several engines in one plot."""
_LEAST_SAMPLES = 32
_BINS = 24
_LEAST_FOR_MEAN = 100
_MARGIN = 0.06
"""Space between points and the limits of their axes, as a share of their range."""
_BAND_POINTS = 48
"""Number of points with which a smooth band is drawn."""
_BAND_MISSED = 0.05
"""Largest error of that interpolation, as a share of the median band, for which a band counts as smooth."""
_SHORTEST_LAG_MS = 1.0
"""Smallest width of the lag axis, ms: a model without memory has a single lag."""
_TITLES: dict[TestName, str] = {
    "autocorrelation": marked("Its own past"),
    "input": marked("Input"),
    "feedback": marked("Later input"),
    "squared_input": marked("Input squared"),
    "squared_output": marked("Output squared"),
    "squared_speed": marked("Speed squared"),
    "cubed_output": marked("Output cubed"),
    "residual_size_input": marked("Its size, by input"),
    "residual_size_squared_input": marked("Its size, by input²"),
    "residual_input_product": marked("Its past times input"),
}
_ZERO = np.zeros(1)


def prediction_plots(predictions: Sequence[Prediction], seconds: float = STRETCH_S) -> tuple[Plot, Plot]:
    """Return measured and simulated output over a stretch of held-out data, and residuals (Chen 2010, Fig. 3.10).

    Raises:
        UnusableInputError: there is nothing to compare.
    """
    first = comparable(predictions)
    part, scale = readable_stretch(first, seconds), display_unit(first.output_unit)[1]
    time_s = first.time_s[part]
    upper = [Curve(time_s, scale * first.measured[part], marked("measured"), "text", "points", width=1.3)]
    lower = []
    for run, colour, kind in zip(predictions, ROLES, KINDS, strict=False):
        upper.append(Curve(time_s, scale * run.predicted[part], run.label, colour, kind))
        lower.append(Curve(time_s, scale * run.residual[part], "", colour, kind, width=0.8))
    time = Axis(TIME.label, TIME.unit, limits=(float(time_s[0]), float(time_s[-1])))
    residual = Axis(marked("Residual"), display_unit(first.output_unit)[0], zero=True)
    return (
        Plot("", time, signal_axis(first.output_name, first.output_unit), tuple(upper)),
        Plot("", time, residual, tuple(lower)),
    )


def scatter_plots(predictions: Sequence[Prediction], *, x: str = "predicted", mean: bool = False) -> tuple[Plot, ...]:
    """Return measured against simulated output over the whole held-out part, a plot for each engine.

    ``x`` and ``mean`` as in :func:`cloud_plot`.

    Raises:
        UnusableInputError: there is nothing to compare.
    """
    comparable(predictions)
    every = [run.measured[np.isfinite(run.residual)] for run in predictions]
    ends = min(float(values.min()) for values in every), max(float(values.max()) for values in every)
    return tuple(
        cloud_plot(run.predicted, run.measured, run.output_unit, run.label, colour, x=x, ends=ends, mean=mean)
        for run, colour in zip(predictions, ROLES, strict=False)
    )


def cloud_plot(
    modelled: Array,
    measured: Array,
    si_unit: str,
    title: str = "",
    colour: str = "measured",
    *,
    x: str = "modelled",
    ends: tuple[float, float] | None = None,
    mean: bool = True,
) -> Plot:
    """Return measured against modelled output, (n,) each in ``si_unit``, with the diagonal of perfect agreement.

    Args:
        modelled: abscissa.
        measured: ordinate.
        si_unit: unit of both.
        title: what stands above.
        colour: colour of the points.
        x: name of the abscissa.
        ends: smallest and largest value of both axes; None for those of the points.
        mean: whether the mean of the cloud is drawn as a curve.

    Raises:
        UnusableInputError: fewer than two points are known.
    """
    scale = display_unit(si_unit)[1]
    known = np.isfinite(modelled) & np.isfinite(measured)
    if known.sum() < 2:
        raise UnusableInputError("report.nothing_held_out", "no held-out sample can be compared")
    across, along = scale * modelled[known], scale * measured[known]
    both = np.array([np.minimum(across, along).min(), np.maximum(across, along).max()])
    low, high = both.tolist() if ends is None else (scale * ends[0], scale * ends[1])
    parts = [cloud(across, along, colour)]
    if mean and across.size > _LEAST_FOR_MEAN:
        parts.append(Curve(*running_mean(across, along), "", "text", width=1.2))
    parts.append(Curve(np.array([low, high]), np.array([low, high]), "", "muted", "dashed", width=0.8))
    margin = _MARGIN * (high - low) or 1e-6
    limits, unit = (low - margin, high + margin), display_unit(si_unit)[0]
    across_axis, along_axis = (signal_axis(name, si_unit).label for name in (x, "measured"))
    return Plot(
        title, Axis(across_axis, unit, limits=limits), Axis(along_axis, unit, limits=limits), tuple(parts), square=True
    )


def running_mean(x: Array, y: Array, bins: int = _BINS) -> tuple[Array, Array]:
    """Return mean x and mean y in bins of x with equal counts, (k,) each: the curve through a cloud."""
    known = np.isfinite(x) & np.isfinite(y)
    order = np.argsort(x[known])
    parts = [part for part in np.array_split(order, bins) if part.size]
    across, along = x[known], y[known]
    return np.array([across[p].mean() for p in parts]), np.array([along[p].mean() for p in parts])


def correlation_plots(predictions: Sequence[Prediction]) -> tuple[Plot, Plot]:
    """Return autocorrelation of the held-out residuals and their correlation with the input, with 95 % bands.

    Raises:
        UnusableInputError: there is nothing to correlate.
    """
    first = comparable(predictions)
    lags = max(2, min(first.memory_samples, first.measured.size // 4))
    lag_ms: Array = 1e3 / first.sample_rate_hz * np.arange(lags + 1, dtype=np.float64)
    limit = 0.0
    left, right = [], []
    for run, colour, kind in zip(predictions, ROLES, KINDS, strict=False):
        correlation, band = autocorrelation(run.residual, lags)
        if run is first:
            ends = np.array([0.0, lag_ms[-1]])
            left.append(
                Curve(
                    ends, np.zeros(2), "", "muted", "line", np.full(2, -band), np.full(2, band),
                    marked("95 % band of white noise"), width=0.6, opacity=0.5,
                )
            )  # fmt: skip
        left.append(Curve(lag_ms[1:], correlation[1:], run.label, colour, kind, width=0.85))
        two_sided, values, half_width = cross_correlation(run.input, run.residual, lags)
        behind_ms = np.asarray(1e3 * two_sided / run.sample_rate_hz, np.float64)
        right.append(Curve(behind_ms, values, "", colour, kind, width=0.85))
        sides = (np.array([side]) for side in (-half_width, half_width))
        right += [Curve(_ZERO, side, "", colour, "level", width=0.8, opacity=0.7) for side in sides]
        limit = max(limit, 1.25 * half_width, 1.1 * float(np.abs(values).max()))
    reach = float(lag_ms[-1])
    behind = Axis(marked("Lag of the residual behind the input"), "ms", limits=(-reach, reach))
    return (
        Plot("", Axis(LAG.label, LAG.unit, limits=(0.0, reach)), Axis(marked("Residual autocorrelation")), tuple(left)),
        Plot("", behind, Axis(marked("Input to residual"), limits=(-limit, limit), zero=True), tuple(right)),
    )


def horizon_plot(found: PredictionCurve) -> Plot:
    """Return VAF of predictions against their horizon with a 95 % band, and that of the free run."""
    half = CONFIDENCE * np.where(np.isfinite(found.vaf_std_percent), found.vaf_std_percent, 0.0)
    low, high = found.vaf_percent - half, np.minimum(found.vaf_percent + half, 100.0)
    free = found.free_run_vaf_percent
    bottom = max(min(0.0, free), float(np.min(low)))
    margin = 0.08 * (100.0 - bottom)
    ahead = Curve(1e3 * found.horizon_s, found.vaf_percent, marked("prediction"), low=low, high=high, marker="o")
    return Plot(
        "",
        Axis(marked("Prediction horizon"), "ms", log=True),
        Axis(marked("VAF, held out"), "%", limits=(bottom - margin, 100.0 + margin)),
        (
            replace(ahead, band=marked("95 % band")),
            Curve(_ZERO, np.array([free]), marked("free run"), "model", "level"),
        ),
    )


def residual_test_plot(test: ResidualTest) -> Plot:
    """Return a residual test over lags with its bands; without lags if it could not be made.

    The band of one lag is shaded, the band of all lags dashed.
    """
    title = _TITLES.get(test.name, test.name.replace("_", " "))
    if test.p_value is None or not np.isfinite(test.correlation).any():
        return Plot(title, LAG, Axis())
    order = np.argsort(test.lag_s)
    lag_ms, values = 1e3 * test.lag_s[order], test.correlation[order]
    band, overall = test.band[order], test.overall_band[order]
    some = np.unique(np.linspace(0, lag_ms.size - 1, _BAND_POINTS).astype(np.intp))
    missed = np.abs(np.interp(lag_ms, lag_ms[some], overall[some]) - overall)
    if float(np.nanmax(missed)) > _BAND_MISSED * float(np.nanmedian(overall)):
        some = np.arange(lag_ms.size)
    zero = np.zeros(some.size)
    parts = [Curve(lag_ms[some], zero, "", "muted", "line", -band[some], band[some], width=0.5, opacity=0.5)]
    parts += [Curve(lag_ms[some], side, "", "muted", "dashed", width=0.6) for side in (-overall[some], overall[some])]
    parts.append(Curve(lag_ms, values, "", "measured" if test.passed else "model", width=0.8))
    ends = float(lag_ms[0]), max(float(lag_ms[-1]), float(lag_ms[0]) + _SHORTEST_LAG_MS)
    top = 1.2 * max(float(np.nanmax(np.abs(values))), float(np.nanmedian(overall)))
    limits = (-top, top) if np.isfinite(top) and top > 0.0 else None
    return Plot(title, Axis(LAG.label, LAG.unit, limits=ends), Axis("", limits=limits), tuple(parts))


def comparable(predictions: Sequence[Prediction]) -> Prediction:
    """Return the first prediction, once it is clear that each has something to compare.

    Raises:
        UnusableInputError: there is no prediction, or one has too few samples that were received and simulated.
    """
    if not predictions:
        raise UnusableInputError("report.not_validated", "no engine was validated on this test")
    for prediction in predictions:
        residual = prediction.residual[np.isfinite(prediction.residual)]
        if residual.size < _LEAST_SAMPLES or not float(np.ptp(residual)) > 0.0:
            raise UnusableInputError(
                "report.held_out_too_short",
                "the held-out part has too few samples to judge {engine}",
                engine=prediction.label,
            )
    return predictions[0]


__all__ = [
    "KINDS",
    "ROLES",
    "cloud_plot",
    "comparable",
    "correlation_plots",
    "horizon_plot",
    "prediction_plots",
    "residual_test_plot",
    "running_mean",
    "scatter_plots",
]
