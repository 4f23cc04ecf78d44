"""Numbers for figures, plots of predictions on held-out data, measured and simulated output, residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    KINDS,
    LAG,
    TIME,
    Array,
    Axis,
    Curve,
    Plot,
    cloud,
    signal_axis,
    thin,
)
from tissueid.errors import UnusableInputError
from tissueid.identification.validation.prediction import PredictionCurve
from tissueid.identification.validation.residual_tests import ResidualTest, TestName
from tissueid.language import marked
from tissueid.units import display_unit

STRETCH_S = 0.5
_WINDOW_S = 0.5
_LEAST_WINDOW = 64
"""Samples of a window where ``_WINDOW_S`` has fewer, as in records of slow machines."""
_SEGMENTS = 4
_SHORTEST_WINDOW = 16
_MOST_WINDOWS, _PIECES = 256, 32
"""Length, in windows, from which as much of a record is averaged, in pieces that are evenly spread."""


@dataclass(frozen=True)
class Prediction:
    """Held-out part of an analysis: measured, and simulated from the input alone.

    Arrays have shape (n,), SI; ``time_s`` counts from the start of the test. NaN where a sample was not received
    or the model cannot know. ``label`` names the engine.
    """

    label: str
    time_s: Array
    input: Array
    measured: Array
    predicted: Array
    sample_rate_hz: float
    output_name: str
    output_unit: str
    memory_samples: int

    @property
    def residual(self) -> Array:
        """Return measured minus predicted, shape (n,)."""
        return self.measured - self.predicted


def held_out_prediction(label: str, analysis: Analysis, start_s: float = 0.0) -> Prediction:
    """Return the held-out part of a free run of the model over its validation record.

    Args:
        label: name of the engine, for the legend.
        analysis: the fitted model and its data.
        start_s: when the record starts within its test, which is the length of the preload.
    """
    record, part = analysis.held_out_record, analysis.held_out
    return Prediction(
        label=label,
        time_s=start_s + record.time[part],
        input=record.input[part],
        measured=record.output[part],
        predicted=analysis.model.simulate(record.input)[part],
        sample_rate_hz=record.sample_rate_hz,
        output_name=record.output_name,
        output_unit=record.output_unit,
        memory_samples=analysis.model.memory_samples,
    )


def readable_stretch(prediction: Prediction, seconds: float = STRETCH_S) -> slice:
    """Return the first stretch of ``seconds`` with the largest number of comparable samples."""
    comparable = np.isfinite(prediction.residual)
    length = min(comparable.size, max(2, round(seconds * prediction.sample_rate_hz)))
    count = np.convolve(comparable, np.ones(length), "valid")
    start = int(np.argmax(count))
    return slice(start, start + length)


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and one-past-last index of every run of True in a mask of shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def power_spectrum(values: Array, sample_rate_hz: float) -> tuple[Array, Array] | None:
    """Return frequencies, Hz, and one-sided power density of a signal (n,), by Welch's method with a Hann window.

    Segments of half a second that overlap by half are averaged, without those that hold a gap, over pieces of a very
    long record. The mean is removed. The window shrinks for a short record. None when nothing is left to average.
    """
    length = min(max(round(_WINDOW_S * sample_rate_hz), _LEAST_WINDOW), values.size // _SEGMENTS)
    if length < _SHORTEST_WINDOW:
        return None
    whole = values.size <= _MOST_WINDOWS * length
    piece = values.size if whole else _MOST_WINDOWS // _PIECES * length
    segments = [
        values[begin + start : begin + start + length]
        for begin in np.linspace(0, values.size - piece, 1 if whole else _PIECES).astype(np.intp)
        for first, end in runs(np.isfinite(values[begin : begin + piece]))
        for start in range(first, end - length + 1, length // 2)
    ]
    if not segments:
        return None
    stacked = np.array(segments)  # (segments, length)
    taper = signal.get_window("hann", length)
    power = np.mean(np.abs(fft.rfft((stacked - stacked.mean()) * taper, axis=1)) ** 2, axis=0)
    density = np.asarray(2.0 * power / (sample_rate_hz * (taper @ taper)), dtype=np.float64)
    return fft.rfftfreq(length, 1.0 / sample_rate_hz), density


def power_edge(frequency_hz: Array, density: Array, share: float = 0.99) -> float:
    """Return the frequency, Hz, below which a share of the power lies; arrays have shape (bins,).

    What counts is the power beyond the median density, which is the sensor's noise where the signal fills less than
    half of the band, and takes as much from every frequency where it fills more. The mean is left out.
    """
    total = np.cumsum(np.maximum(density[1:] - np.median(density), 0.0))
    if total.size == 0 or not total[-1] > 0.0:
        return float(frequency_hz[-1])
    return float(frequency_hz[1:][np.searchsorted(total, share * total[-1])])


def autocorrelation(values: Array, lags: int) -> tuple[Array, float]:
    """Return the normalised autocorrelation at lags 0 .. lags, (lags + 1,), and the half width of its 95 % band.

    The band is that of white noise, 1.96 / sqrt(N), N the number of received samples; NaN are left out of the sums,
    and each lag is divided by the number of pairs that it has.
    """
    correlation, pairs = _pair_means(values, values, lags)
    return correlation / correlation[0], CONFIDENCE / float(np.sqrt(max(pairs[0], 1.0)))


def cross_correlation(u: Array, e: Array, lags: int) -> tuple[Array, Array, float]:
    """Correlate input u (n,) with residual e (n,): return lags (2 lags + 1,), values, half width of the band.

    At a positive lag the input comes first. The band holds 95 % of the values for unrelated signals that each have
    a colour of their own: the variance is sum(rho_u rho_e) / N (Bartlett 1955, Box and Jenkins 1970).
    """
    later, pairs = _pair_means(u, e, lags)
    earlier, _ = _pair_means(e, u, lags)
    reach = max(lags, u.size // 4)
    own_u, _ = _pair_means(u, u, reach)
    own_e, _ = _pair_means(e, e, reach)
    scale = float(np.sqrt(own_u[0] * own_e[0]))
    products = own_u * own_e / scale**2
    variance = max(1e-3, float(products[0] + 2.0 * products[1:].sum())) / max(pairs[0], 1.0)
    values = np.concatenate([earlier[:0:-1], later]) / scale
    return np.arange(-lags, lags + 1, dtype=np.float64), values, CONFIDENCE * float(np.sqrt(variance))


def _pair_means(x: Array, y: Array, lags: int) -> tuple[Array, Array]:
    """Return mean of x[i] y[i + lag] over received pairs, and their number; both (lags + 1,)."""
    known_x, known_y = np.isfinite(x), np.isfinite(y)
    x = np.where(known_x, x - np.mean(x[known_x]), 0.0)
    y = np.where(known_y, y - np.mean(y[known_y]), 0.0)
    length = fft.next_fast_len(x.size + lags, real=True)

    def products(first: Array, second: Array) -> Array:
        spectrum = np.conj(fft.rfft(first, length)) * fft.rfft(second, length)
        return np.asarray(fft.irfft(spectrum, length)[: lags + 1], dtype=np.float64)

    pairs = np.round(products(known_x.astype(np.float64), known_y.astype(np.float64)))
    return products(x, y) / np.maximum(pairs, 1.0), pairs


ROLES = ("measured", "model", "good", "check")
"""Colours of several engines in one plot."""
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
    finite = np.isfinite(modelled) & np.isfinite(measured)
    if finite.sum() < 2:
        raise UnusableInputError("report.nothing_held_out", "no held-out sample can be compared")
    across, along = scale * modelled[finite], scale * measured[finite]
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
    finite = np.isfinite(x) & np.isfinite(y)
    order = np.argsort(x[finite])
    parts = [part for part in np.array_split(order, bins) if part.size]
    across, along = x[finite], y[finite]
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
    auto, cross = [], []
    for run, colour, kind in zip(predictions, ROLES, KINDS, strict=False):
        correlation, band = autocorrelation(run.residual, lags)
        if run is first:
            ends = np.array([0.0, lag_ms[-1]])
            auto.append(
                Curve(
                    ends, np.zeros(2), "", "muted", "line", np.full(2, -band), np.full(2, band),
                    marked("95 % band of white noise"), width=0.6, opacity=0.5,
                )
            )  # fmt: skip
        auto.append(Curve(lag_ms[1:], correlation[1:], run.label, colour, kind, width=0.85))
        two_sided, values, half_width = cross_correlation(run.input, run.residual, lags)
        behind_ms = np.asarray(1e3 * two_sided / run.sample_rate_hz, np.float64)
        cross.append(Curve(behind_ms, values, "", colour, kind, width=0.85))
        sides = (np.array([side]) for side in (-half_width, half_width))
        cross += [Curve(_ZERO, side, "", colour, "level", width=0.8, opacity=0.7) for side in sides]
        limit = max(limit, 1.25 * half_width, 1.1 * float(np.abs(values).max()))
    reach = float(lag_ms[-1])
    behind = Axis(marked("Lag of the residual behind the input"), "ms", limits=(-reach, reach))
    return (
        Plot("", Axis(LAG.label, LAG.unit, limits=(0.0, reach)), Axis(marked("Residual autocorrelation")), tuple(auto)),
        Plot("", behind, Axis(marked("Input to residual"), limits=(-limit, limit), zero=True), tuple(cross)),
    )


def horizon_plot(prediction: PredictionCurve) -> Plot:
    """Return VAF of predictions against their horizon with a 95 % band, and that of the free run."""
    half = CONFIDENCE * np.where(np.isfinite(prediction.vaf_std_percent), prediction.vaf_std_percent, 0.0)
    low, high = prediction.vaf_percent - half, np.minimum(prediction.vaf_percent + half, 100.0)
    free = prediction.free_run_vaf_percent
    bottom = max(min(0.0, free), float(np.min(low)))
    margin = 0.08 * (100.0 - bottom)
    ahead = Curve(
        1e3 * prediction.horizon_s, prediction.vaf_percent, marked("prediction"), low=low, high=high, marker="o"
    )
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


_COLUMNS = 3000
"""Columns of a thinned curve: more than any screen is wide. Shorter records are kept sample by sample."""
_UNSEEN_S = 0.4
"""Length of the held-out motion that is shown, s: enough periods to judge by eye, few enough to distinguish."""


def output_plots(analysis: Analysis) -> tuple[Plot, Plot]:
    """Return measured and simulated output, and the residual, against time on held-out data.

    The simulation is the free run. A faint curve is that of the simulation scheduled by the measured output, for
    engines that have one.

    Raises:
        UnusableInputError: no held-out sample was both received and simulated.
    """
    prediction = held_out_prediction("", analysis)
    record, (unit, scale) = analysis.held_out_record, display_unit(prediction.output_unit)
    scheduled = analysis.model.simulate_scheduled(record)
    if not np.isfinite(prediction.residual).any():
        raise UnusableInputError("research.no_held_out", "no held-out sample was both received and simulated")
    measured = Curve(
        *thin(prediction.time_s, scale * prediction.measured, _COLUMNS), marked("broad and pale: measured")
    )
    outputs, residuals = [prediction.predicted], [prediction.residual]
    if scheduled is not None:
        outputs.append(scheduled[analysis.held_out])
        residuals.append(prediction.measured - scheduled[analysis.held_out])
    time = Axis(marked("Time from the start of the record"), "s")
    upper, lower = (
        [
            Curve(
                *thin(prediction.time_s, scale * values, _COLUMNS),
                marked("faint: scheduled by the measured output") if index else "",
                "model",
                opacity=0.5 if index else 1.0,
                width=0.8,
            )
            for index, values in enumerate(every)
        ]
        for every in (outputs, residuals)
    )
    difference = marked("Measured less simulated")
    return (
        Plot(
            marked("Measured and simulated output, held out"),
            time,
            signal_axis(prediction.output_name, prediction.output_unit),
            (measured, *upper),
        ),
        Plot(difference, time, Axis(difference, unit), tuple(lower)),
    )


def unseen_motion(analyses: Mapping[str, Analysis], engines: tuple[str, ...]) -> Plot:
    """Return a short stretch of held-out output, measured and as simulated by the first of some engines that was run.

    Raises:
        UnusableInputError: none of them was run.
    """
    name = next((name for name in engines if name in analyses), None)
    if name is None:
        raise UnusableInputError("report.no_free_run", "no model could be run on motion that it had not seen")
    prediction = held_out_prediction(name, analyses[name])
    part = readable_stretch(prediction, _UNSEEN_S)
    time_s, scale = prediction.time_s[part] - prediction.time_s[part][0], display_unit(prediction.output_unit)[1]
    return Plot(
        marked("Unseen motion"),
        Axis(marked("Time"), "s"),
        signal_axis(prediction.output_name, prediction.output_unit),
        (
            Curve(time_s, scale * prediction.measured[part], marked("measured"), "measured", opacity=0.5, width=2.0),
            Curve(time_s, scale * prediction.predicted[part], marked("predicted"), "model", width=0.8),
        ),
    )
