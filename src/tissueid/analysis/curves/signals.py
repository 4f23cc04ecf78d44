"""Plots of recorded signals and of stimuli: over time, spectra, distributions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import (
    FREQUENCY,
    KINDS,
    LAG,
    TIME,
    Array,
    Axis,
    Curve,
    Kind,
    Mark,
    Plot,
    histogram,
    signal_axis,
    steps,
)
from tissueid.analysis.curves.validation import power_spectrum, runs
from tissueid.configuration import has_depth
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit, superscript
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.sessions import SIGNAL_UNITS, Test
from tissueid.stimuli import Stimulus
from tissueid.stimuli.interchange import InterchangeResult
from tissueid.stimuli.kinds.multisine import Multisine
from tissueid.units import display_unit

COLOURS = {"command": "muted", "voltage": "measured", "force": "model", "current": "model", "position": "good"}
"""Colours of signals, the same in all figures of a report."""
PRELOAD = marked("preload")
POWER_DENSITY = marked("Power spectral density")
TOO_SHORT = marked("Too few samples for a spectrum.")
_TIME = marked("Time from the start of the test")
_LEAST_SHARE = 1e-9
"""Share of the largest power density that is shown of a spectrum; lower values are rounding errors."""
_COLUMNS = 1000
"""Number of parts of a test in which lost samples are marked."""
_ROOM = 0.055
"""Width of the text over a preload, as a share of the test."""
_SHORT = 0.04
"""Share of a test below which its preload has no text."""
_LEAST_SAMPLES = 20
_BINS = (8, 60)
Lines = Sequence[tuple[Array, Array] | None]
"""Abscissa and ordinate of each test; None for a test without the signal."""


def time_plot(
    title: str, si_unit: str, lines: Lines, colours: Sequence[str], names: Sequence[str], ends_s: tuple[float, float]
) -> Plot:
    """Return one signal, in ``si_unit``, of several tests against time (s) between two times."""
    unit, scale = display_unit(si_unit)
    every = zip(lines, colours, names, strict=False)
    curves = [Curve(line[0], scale * line[1], name, colour, width=0.6) for line, colour, name in every if line]
    time = Axis(_TIME, "s", limits=ends_s)
    return Plot(title, time, Axis(title, unit), tuple(curves))


def density_curve(
    values: Array,
    sample_rate_hz: float,
    si_unit: str,
    name: str = "",
    colour: str = "measured",
    kind: Kind = "line",
    width: float = 1.0,
) -> Curve | None:
    """Return the power density of a signal (n,), in ``si_unit``, above zero frequency; None if it has none."""
    spectrum = power_spectrum(display_unit(si_unit)[1] * values, sample_rate_hz)
    if spectrum is None or not float(spectrum[1][1:].max()) > 0.0:
        return None
    frequency_hz, density = (part[1:] for part in spectrum)
    shown = density > _LEAST_SHARE * density.max()
    return Curve(frequency_hz[shown], density[shown], name, colour, kind, width=width)


def spectrum_plot(
    title: str, si_unit: str, signals: Sequence[tuple[Array, float] | None], colours: Sequence[str]
) -> Plot:
    """Return power densities of a signal of several tests: samples (n,) in ``si_unit`` with their rate (Hz)."""
    unit = display_unit(si_unit)[0]
    every = (
        density_curve(*signal, si_unit, colour=colour, width=0.8)
        for signal, colour in zip(signals, colours, strict=False)
        if signal
    )
    curves = tuple(curve for curve in every if curve)
    missing = TOO_SHORT if not curves and any(signals) else ""
    return Plot(title, FREQUENCY, Axis(title, f"{unit}²/Hz" if unit else "1/Hz", log=True), curves, missing=missing)


# -- one test ---------------------------------------------------------------------------------------------------------


def has_samples(test: Test, name: str) -> bool:
    """Return whether at least two samples of a signal were received."""
    return name in test.signals and int(np.isfinite(test.signals[name]).sum()) >= 2


def lost_samples(test: Test) -> NDArray[np.bool_]:
    """Return a mask (n,) of samples that were lost in any of the main signals."""
    mask = np.zeros(test.samples, dtype=np.bool_)
    for name in ("voltage", "current", "force", "position"):
        if has_samples(test, name):
            mask |= ~np.isfinite(test.signals[name])
    return mask


def preload_span(seconds: float) -> Curve:
    """Return the shade of a preload."""
    return Curve(np.array([0.0, seconds]), np.zeros(0), "", "muted", "spans", opacity=0.1)


def recording_plots(test: Test, held_out_s: tuple[float, float] | None = None) -> tuple[Plot, ...]:
    """Return voltage, force and position over time (Chen 2010, Fig. 2.13): preload shaded, lost samples marked.

    Args:
        test: the test; signals that it lacks are left out, and without a force the current stands for it.
        held_out_s: start and end, s, of the part that was not fitted.

    Raises:
        UnusableInputError: none of the signals to be drawn was received.
    """
    drive = [name for name in ("command", "voltage") if has_samples(test, name)]
    load = [name for name in ("force", "current") if has_samples(test, name)][:1]
    panels = [names for names in (drive, load, ["position"] if has_samples(test, "position") else []) if names]
    if not panels:
        raise UnusableInputError("report.no_signals", "no voltage, current, force or position was received")
    seconds = test.samples / test.sample_rate_hz
    spans, marks = _times(test, seconds, held_out_s)
    time_s, plots = np.arange(test.samples) / test.sample_rate_hz, []
    for names in panels:
        title = label_and_unit("voltage" if names == ["command"] else names[-1])[0]
        keys = (marked("asked for"), marked("measured across the coil")) if len(names) > 1 else ("",)
        lines, colours = [(time_s, test.signals[name]) for name in names], [COLOURS[name] for name in names]
        plot = time_plot(title, SIGNAL_UNITS[names[0]], lines, colours, keys, (0.0, seconds))
        plots.append(replace(plot, x=replace(plot.x, label=TIME.label), parts=(*spans, *plot.parts)))
    if panels[-1] == ["position"] and np.isfinite(test.surface_position_m):
        label = marked("surface of the tissue") if has_depth(test.configuration) else marked("where it began")
        surface_mm = 1e3 * test.surface_position_m
        level = Curve(np.zeros(1), np.array([surface_mm]), "", "text", "level")
        mark = Mark(seconds, label, surface_mm, "right", "text")
        plots[-1] = replace(plots[-1], parts=(*plots[-1].parts, level), marks=(mark,))
    plots[0] = replace(plots[0], marks=(*plots[0].marks, *marks))
    return tuple(plots)


def _times(test: Test, seconds: float, held_out_s: tuple[float, float] | None) -> tuple[list[Curve], list[Mark]]:
    """Return the marked times of a test, and their texts."""
    spans, marks = [], []
    preload = min(test.preload_s, seconds)
    if preload > 0.0:
        spans.append(preload_span(preload))
    fitted = preload
    if preload > _SHORT * seconds:
        marks.append(Mark(0.0, PRELOAD))
        fitted = max(preload, _ROOM * seconds)
    if held_out_s is not None:
        spans.append(Curve(np.array([held_out_s[0]]), np.zeros(1), "", "muted", "position", width=0.85))
        marks += [Mark(fitted, marked("fitted")), Mark(held_out_s[0], marked("held out"))]
    edges = np.unique(np.linspace(0, test.samples, _COLUMNS + 1).astype(np.intp))
    lost = runs(np.logical_or.reduceat(lost_samples(test), edges[:-1]))
    if lost:
        ends = (edges[np.ravel(lost)] - 0.5) / test.sample_rate_hz
        spans.append(Curve(ends, np.zeros(0), "", "poor", "spans", opacity=0.5))
        marks.append(Mark(seconds, marked("■ not received"), align="right", colour="poor"))
    return spans, marks


def recording_spectra(test: Test) -> Plot:
    """Return power spectral densities of voltage, force and position without the preload (Chen 2010, Fig. 3.2a).

    Raises:
        UnusableInputError: the test is too short or too full of gaps for a spectrum.
    """
    first, curves = round(test.preload_s * test.sample_rate_hz), []
    for name, kind in zip(("voltage", "force", "position"), KINDS, strict=False):
        if has_samples(test, name):
            unit = display_unit(SIGNAL_UNITS[name])[0]
            key = Message("plot.density_of", "{signal} ({unit}²/Hz)", signal=name, unit=unit)
            values = test.signals[name][first:]
            curves.append(density_curve(values, test.sample_rate_hz, SIGNAL_UNITS[name], key, COLOURS[name], kind))
    if not any(curves):
        raise UnusableInputError(
            "report.no_power_spectrum", "the test is too short, or has too many gaps, for a power spectrum"
        )
    return Plot("", FREQUENCY, Axis(POWER_DENSITY, log=True), tuple(curve for curve in curves if curve))


def distribution_plots(record: Record) -> tuple[Plot, Plot]:
    """Return distributions of input and output, with the Gaussians of their means and deviations (Chen 2010, Fig. 3.1).

    Raises:
        UnusableInputError: too few samples were received, or they do not vary.
    """
    return (
        _distribution(record.input, record.input_name, record.input_unit),
        _distribution(record.output, record.output_name, record.output_unit),
    )


def _distribution(values: Array, name: str, si_unit: str) -> Plot:
    axis = signal_axis(name, si_unit)
    values = display_unit(si_unit)[1] * values[np.isfinite(values)]
    spread = float(np.std(values)) if values.size else 0.0
    if values.size < _LEAST_SAMPLES or not spread > 1e-9 * float(np.max(np.abs(values))):
        raise UnusableInputError("report.no_variation", "the {name} has too few samples, or is constant", name=name)
    grid = np.linspace(values.min(), values.max(), 200)
    gaussian = np.exp(-0.5 * ((grid - values.mean()) / spread) ** 2) / (spread * np.sqrt(2.0 * np.pi))
    bars = histogram(values, int(np.clip(np.sqrt(values.size), *_BINS)), COLOURS.get(name, "muted"))
    curve = Curve(grid, gaussian, marked("Gaussian"), "text", "dashed", width=0.8)
    density = density_axis(axis.unit, 1.05 * float(max(bars.y.max(), gaussian.max())))
    return Plot("", axis, density, (bars, curve))


def density_axis(unit: str, top: float) -> Axis:
    """Return the ordinate, from zero to ``top``, of a probability density of values in a unit."""
    return Axis(marked("Density"), f"1/{unit}" if unit else "", limits=(0.0, top))


ZOOM_S = 0.2
"""Length, s, of the stretch that is drawn sample by sample."""
_EMPTY = 1e-9
"""Share of the largest amplitude at which smaller lines are drawn: they contain only rounding."""
_PLAYED_BINS = (8, 50)
_KEY_ROOM = 1.4
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
    bins = np.linspace(both.min(), both.max(), int(np.clip(np.sqrt(values.size), *_PLAYED_BINS)) + 1)
    histograms = [histogram(values, bins, colour, _PLAYED)]
    distributions = [Curve(*_shares(values), _PLAYED, colour, width=1.2)]
    if intended is not None:
        histograms.append(replace(histogram(intended, bins, "text", _INTENDED, "dashed"), width=0.85))
        distributions.append(Curve(*_shares(intended), _INTENDED, "text", "dashed", width=0.85))
    top = _KEY_ROOM * max(float(curve.y.max()) for curve in histograms)
    return (
        Plot("", axis, density_axis(unit, top), tuple(histograms)),
        Plot("", axis, Axis(marked("Samples below"), "%"), tuple(distributions)),
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
            Mark(edge_hz, text, align="left" if index == len(edges) - 1 else "right")
            for index, (edge_hz, text) in enumerate(edges)
        ),
    )


def autocorrelation_plots(correlation: Array, sample_rate_hz: float, target: Array | None = None) -> tuple[Plot, ...]:
    """Return the normalised autocorrelation (lags,) from lag 0 with its target (lags,), and their difference if any."""
    lag_ms: Array = 1e3 / sample_rate_hz * np.arange(correlation.size, dtype=np.float64)
    lag = replace(LAG, limits=(0.0, float(lag_ms[-1])))
    above = Plot(
        "", lag, Axis(marked("Autocorrelation"), zero=True), (Curve(lag_ms, correlation, _PLAYED, width=0.85),)
    )
    if target is None:
        return (replace(above, parts=(replace(above.curves[0], name=""),)),)
    difference = correlation - target
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
    last_period = stimulus.values[-period:]
    amplitude = 2.0 / period * np.abs(np.fft.rfft(last_period - last_period.mean()))
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
