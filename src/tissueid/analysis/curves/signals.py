"""Plots of recorded signals: against time, power spectra, distributions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis.curves.diagnostics import power_spectrum, runs
from tissueid.analysis.curves.plot import Array, Axis, Curve, Kind, Mark, Plot, histogram
from tissueid.analysis.curves.units import FREQUENCY, TIME, signal_axis
from tissueid.analysis.curves.validation import KINDS
from tissueid.configuration import has_depth
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.sessions import SIGNAL_UNITS, Test
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
    found = power_spectrum(display_unit(si_unit)[1] * values, sample_rate_hz)
    if found is None or not float(found[1][1:].max()) > 0.0:
        return None
    frequency_hz, density = (part[1:] for part in found)
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
        words = marked("surface of the tissue") if has_depth(test.configuration) else marked("where it began")
        surface_mm = 1e3 * test.surface_position_m
        level = Curve(np.zeros(1), np.array([surface_mm]), "", "text", "level")
        mark = Mark(seconds, words, surface_mm, "right", "text")
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


__all__ = [
    "COLOURS",
    "POWER_DENSITY",
    "PRELOAD",
    "TOO_SHORT",
    "density_axis",
    "density_curve",
    "distribution_plots",
    "has_samples",
    "lost_samples",
    "preload_span",
    "recording_plots",
    "recording_spectra",
    "spectrum_plot",
    "time_plot",
]
