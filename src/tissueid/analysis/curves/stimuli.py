"""Plots of a designed stimulus: time series, amplitudes, spectrum and autocorrelation with their targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.plot import Array, Axis, Curve, Mark, Plot, histogram, steps
from tissueid.analysis.curves.signals import PRELOAD, density_axis, density_curve, preload_span
from tissueid.analysis.curves.units import FREQUENCY, LAG, TIME
from tissueid.errors import UnusableInputError
from tissueid.formatting import superscript
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli import Stimulus
from tissueid.stimuli.interchange import InterchangeResult
from tissueid.stimuli.kinds.multisine import Multisine

ZOOM_S = 0.2
"""Length, s, of the stretch that is drawn sample by sample."""
_EMPTY = 1e-9
"""Share of the largest amplitude at which smaller lines are drawn: they contain only rounding."""
_BINS = (8, 50)
_ROOM = 1.4
"""Height of the axes of a distribution, as a multiple of its largest density, with room for the key."""
_PLAYED, _INTENDED, _TARGET = marked("played"), marked("intended"), marked("target")


def _signal(unit: str) -> tuple[Axis, str]:
    """Return axis and colour of the played signal; a signal has the same colour in all figures."""
    return (Axis(marked("Voltage"), unit), "measured") if unit == "V" else (Axis(marked("Force"), unit), "model")


def stimulus_plots(stimulus: Stimulus) -> tuple[Plot, Plot]:
    """Return the whole stimulus over time, and a stretch of it sample by sample."""
    axis, colour = _signal(stimulus.unit)
    time_s = np.arange(len(stimulus)) / stimulus.sample_rate_hz
    begins = stimulus.preload_s
    ends = min(begins + ZOOM_S, stimulus.seconds)
    part = slice(round(begins * stimulus.sample_rate_hz), round(ends * stimulus.sample_rate_hz) + 1)
    whole = Plot(
        "",
        replace(TIME, limits=(0.0, stimulus.seconds)),
        axis,
        (
            *([preload_span(begins)] if begins > 0.0 else []),
            Curve(time_s, stimulus.values, "", colour, width=0.55),
        ),
        marks=(Mark(0.0, PRELOAD),) if begins > 0.0 else (),
    )
    near = Curve(*steps(1e3 * time_s[part], stimulus.values[part]), "", colour, width=0.85)
    return whole, Plot("", Axis(TIME.label, "ms", limits=(1e3 * begins, 1e3 * ends)), axis, (near,))


def amplitude_plots(values: Array, unit: str, intended: Array | None = None) -> tuple[Plot, Plot]:
    """Return histogram and cumulative distribution of values (n,) and of the intended ones (k,), both in ``unit``.

    The intended amplitudes are counted in the same bins, so that binary and stepped distributions are compared
    correctly (Chen 2010, Fig. 6.1).

    Raises:
        UnusableInputError: the values do not vary.
    """
    if not float(np.ptp(values)) > 0.0:
        raise UnusableInputError("report.constant_stimulus", "the stimulus is constant and has no distribution")
    both = values if intended is None else np.concatenate([values, intended])
    axis, colour = _signal(unit)
    bins = np.linspace(both.min(), both.max(), int(np.clip(np.sqrt(values.size), *_BINS)) + 1)
    left = [histogram(values, bins, colour, _PLAYED)]
    right = [Curve(*_shares(values), _PLAYED, colour, width=1.2)]
    if intended is not None:
        left.append(replace(histogram(intended, bins, "text", _INTENDED, "dashed"), width=0.85))
        right.append(Curve(*_shares(intended), _INTENDED, "text", "dashed", width=0.85))
    top = _ROOM * max(float(curve.y.max()) for curve in left)
    return (
        Plot("", axis, density_axis(unit, top), tuple(left)),
        Plot("", axis, Axis(marked("Samples below"), "%"), tuple(right)),
    )


def _shares(values: Array) -> tuple[Array, Array]:
    """Return values in order, and the share of samples below each, %."""
    return np.sort(values), 100.0 * (np.arange(values.size) + 0.5) / values.size


def power_plot(
    values: Array,
    sample_rate_hz: float,
    unit: str,
    target: tuple[Array, Array] | None = None,
    edges: Sequence[tuple[float, str]] = (),
) -> Plot:
    """Return the power spectral density of values (n,) about their mean, and a target (Chen 2010, Fig. 6.1).

    Args:
        values: the stimulus without its preload.
        sample_rate_hz: its sample rate.
        unit: N or V.
        target: frequencies, Hz, and one-sided densities of any scale; they are scaled to the power of the values.
        edges: frequencies, Hz, to mark, each with its label.

    Raises:
        UnusableInputError: the values are constant or too few for a spectrum.
    """
    axis, colour = _signal(unit)
    played = density_curve(values, sample_rate_hz, unit, _PLAYED, colour, width=0.85)
    if played is None or not float(np.ptp(values)) > 0.0:
        raise UnusableInputError(
            "report.no_stimulus_spectrum", "the stimulus is constant or too short for a power spectrum"
        )
    parts, floor = [played], float(played.y.min())
    if target is not None:
        wanted_hz, wanted = target
        wanted = wanted * (float(np.var(values)) / float(np.trapezoid(wanted, wanted_hz)))
        kept = (wanted > floor) & (wanted_hz >= played.x[0])
        parts.append(Curve(wanted_hz[kept], wanted[kept], _TARGET, "text", "dashed", width=0.85))
    parts += [Curve(np.array([edge_hz]), np.zeros(1), "", "muted", "position", width=0.7) for edge_hz, _label in edges]
    label = Message("stimulus.power_density", "{signal}, power density ({unit}²/Hz)", signal=axis.label, unit=unit)
    return Plot(
        "",
        replace(FREQUENCY, limits=(float(played.x[0]), 0.5 * sample_rate_hz)),
        Axis(label, log=True, limits=(0.5 * floor, 10.0 * float(played.y.max()))),
        tuple(parts),
        marks=tuple(
            Mark(edge_hz, text, align="left" if place == len(edges) - 1 else "right")
            for place, (edge_hz, text) in enumerate(edges)
        ),
    )


def autocorrelation_plots(found: Array, sample_rate_hz: float, target: Array | None = None) -> tuple[Plot, ...]:
    """Return the normalised autocorrelation (lags,) from lag 0 with its target (lags,), and their difference if any."""
    lag_ms: Array = 1e3 / sample_rate_hz * np.arange(found.size, dtype=np.float64)
    lag = replace(LAG, limits=(0.0, float(lag_ms[-1])))
    above = Plot("", lag, Axis(marked("Autocorrelation"), zero=True), (Curve(lag_ms, found, _PLAYED, width=0.85),))
    if target is None:
        return (replace(above, parts=(replace(above.curves[0], name=""),)),)
    difference = found - target
    largest = float(np.max(np.abs(difference), initial=0.0))
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    unit, scale = (f"×10{superscript(exponent)}", 10.0**exponent) if exponent < -1 else ("", 1.0)
    aim = Curve(lag_ms, target, _TARGET, "text", "dashed", width=0.85)
    below = Axis(marked("Difference"), unit, zero=True)
    return (
        replace(above, parts=(*above.parts, aim)),
        Plot("", lag, below, (Curve(lag_ms, difference / scale, width=0.6),)),
    )


def swaps_plot(search: InterchangeResult | None) -> Plot:
    """Return the sum of squared differences of the autocorrelation against accepted swaps (Chen 2010, Fig. 6.2b).

    Raises:
        UnusableInputError: nothing was swapped.
    """
    if search is None or search.history.shape[0] < 2:
        raise UnusableInputError("report.no_swaps", "no swap was needed: the initial sequence met the target")
    swaps, error = search.history[:, 1], search.history[:, 2]
    limits = (0.5 * min(float(error.min()), search.tolerance), 2.0 * float(error.max()))
    return Plot(
        "",
        Axis(marked("Accepted swaps"), limits=(0.0, float(swaps[-1]))),
        Axis(marked("Sum of squared differences"), log=True, limits=limits),
        (
            Curve(swaps, error),
            Curve(np.zeros(1), np.array([search.tolerance]), marked("tolerance"), "text", "level"),
        ),
    )


def line_plot(multisine: Multisine, stimulus: Stimulus) -> Plot:
    """Return the amplitude of the lines of one period: driven, detection and not driven, with the notches shaded.

    Raises:
        UnusableInputError: the stimulus is shorter than a period.
    """
    period = multisine.period
    if len(stimulus) < period:
        raise UnusableInputError("report.short_period", "the stimulus is shorter than one period")
    one = stimulus.values[-period:]
    amplitude = 2.0 / period * np.abs(np.fft.rfft(one - one.mean()))
    driven, detection = multisine.driven_lines(), multisine.detection_lines()
    highest = int(driven[-1])
    shown = min(amplitude.size - 1, max(highest + 10, round(1.25 * highest)))
    rest = np.setdiff1d(np.arange(1, shown + 1), np.concatenate([driven, detection]))
    floor = _EMPTY * float(amplitude[driven].max())
    colour, other = ("model", "measured") if stimulus.unit == "N" else ("measured", "model")
    parts = [Curve(np.array(multisine.notches, np.float64).ravel(), np.zeros(0), "", "muted", "spans", opacity=0.1)]
    parts += [
        Curve(
            multisine.resolution_hz * lines.astype(np.float64), np.maximum(amplitude[lines], floor),
            name, role, "points", width=0.8, marker=marker,
        )
        for lines, name, role, marker in (
            (driven, marked("driven"), colour, "o"),
            (detection, marked("detection"), other, "^"),
            (rest, marked("not driven"), "muted", "."),
        )
        if lines.size
    ]  # fmt: skip
    return Plot(
        "",
        replace(FREQUENCY, log=False, limits=(0.0, (shown + 1) * multisine.resolution_hz)),
        Axis(marked("Amplitude"), stimulus.unit, log=True, limits=(0.3 * floor, 30.0 * float(amplitude.max()))),
        tuple(parts),
    )


__all__ = [
    "ZOOM_S",
    "amplitude_plots",
    "autocorrelation_plots",
    "line_plot",
    "power_plot",
    "stimulus_plots",
    "swaps_plot",
]
