"""Figures of recorded signals: time series, power spectra, distributions."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tissueid.analysis.curves.diagnostics import Array, power_spectrum, runs
from tissueid.analysis.curves.plot import thin
from tissueid.configuration import has_depth
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label
from tissueid.language import _
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.reports.style import (
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    INK,
    LOST,
    MUTED,
    PAPER,
    SERIES,
    SHADE,
    drawing,
    frequency_axis,
    log_axis,
    new_figure,
)
from tissueid.sessions import SIGNAL_UNITS, Test
from tissueid.units import display_unit

_COLOURS = {"voltage": SERIES[0], "force": SERIES[1], "current": SERIES[1], "position": SERIES[2]}
"""Colours of signals, the same in all figures."""
_MOST_LOST_RUNS = 400
"""Largest number of marked stretches of lost samples; neighbours are merged beyond it."""


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


@drawing
def signals_figure(test: Test, held_out_s: tuple[float, float] | None = None) -> Figure:
    """Voltage, force and position over time (Chen 2010, Fig. 2.13): preload shaded, lost samples marked.

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
        raise UnusableInputError(Message("report.no_signals", "no voltage, current, force or position was received"))
    figure = new_figure(FULL_WIDTH, 0.7 + 1.45 * len(panels))
    time_s = np.arange(test.samples) / test.sample_rate_hz
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, names in zip(every, panels, strict=True):
        _signal_panel(axes, test, names, time_s)
    if np.isfinite(test.surface_position_m) and panels[-1] == ["position"]:
        words = _("surface of the tissue") if has_depth(test.configuration) else _("where it began")
        _mark_surface(every[-1], 1e3 * test.surface_position_m, words)
    _mark_times(list(every), test, held_out_s)
    every[-1].set_xlim(0.0, test.samples / test.sample_rate_hz)
    every[-1].set_xlabel(_("Time (s)"))
    figure.align_ylabels()
    return figure


def _signal_panel(axes: Axes, test: Test, names: list[str], time_s: Array) -> None:
    unit, scale = display_unit(SIGNAL_UNITS[names[0]])
    labels = {"command": _("asked for"), "voltage": _("measured across the coil")}
    for name in names:
        thinned = thin(time_s, scale * test.signals[name])
        axes.plot(*thinned, color=_COLOURS.get(name, MUTED), linewidth=0.7, label=labels.get(name))
    axes.set_ylabel(axis_label("voltage" if names[0] == "command" else names[0], unit))
    if len(names) > 1:
        low, high = axes.get_ylim()
        axes.set_ylim(low - 0.2 * (high - low), high)
        axes.legend(loc="lower right", ncols=2, frameon=True, facecolor=PAPER, edgecolor="none", framealpha=0.85)


def _mark_surface(axes: Axes, surface_mm: float, words: str) -> None:
    axes.axhline(surface_mm, color=INK, linewidth=1.0, linestyle=DASHES[1])
    axes.annotate(
        words,
        (1.0, surface_mm),
        (-4, 3),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        fontsize=8.5,
    )


def _mark_times(every: list[Axes], test: Test, held_out_s: tuple[float, float] | None) -> None:
    top = every[0]
    seconds = test.samples / test.sample_rate_hz
    preload = min(test.preload_s, seconds)
    for axes in every:
        if preload > 0.0:
            axes.axvspan(0.0, preload, color=SHADE, zorder=0)
        if held_out_s is not None:
            axes.axvline(held_out_s[0], color=MUTED, linewidth=1.0, linestyle=DASHES[2])
    above: dict[str, Any] = {
        "xycoords": ("data", "axes fraction"),
        "textcoords": "offset points",
        "color": MUTED,
        "fontsize": 8.5,
    }
    if preload > 0.04 * seconds:
        top.annotate(_("preload"), (0.0, 1.0), (0, 3), **above)
    if held_out_s is not None:
        top.annotate(_("fitted"), (preload, 1.0), (0, 3), **above)
        top.annotate(_("held out"), (held_out_s[0], 1.0), (0, 3), **above)
    stretches = runs(lost_samples(test))
    if len(stretches) > _MOST_LOST_RUNS:
        joined = np.array_split(np.array(stretches), _MOST_LOST_RUNS)
        stretches = [(int(some[0, 0]), int(some[-1, 1])) for some in joined]
    for axes in every:
        for first, end in stretches:
            axes.axvspan(
                (first - 0.5) / test.sample_rate_hz, (end - 0.5) / test.sample_rate_hz, color=LOST, alpha=0.35, lw=0.8
            )
    if stretches:
        top.annotate(
            _("■ not received"),
            (1.0, 1.0),
            (0, 3),
            ha="right",
            **(above | {"xycoords": "axes fraction", "color": LOST}),
        )


@drawing
def power_figure(test: Test) -> Figure:
    """Power spectral densities of voltage, force and position without the preload (Chen 2010, Fig. 3.2a).

    Raises:
        UnusableInputError: the test is too short or too full of gaps for a spectrum.
    """
    figure = new_figure(HALF_WIDTH, 3.3)
    axes = figure.subplots()
    first = round(test.preload_s * test.sample_rate_hz)
    low, high = np.inf, 0.0
    for name, dash in zip(("voltage", "force", "position"), DASHES, strict=False):
        if not has_samples(test, name):
            continue
        unit, scale = display_unit(SIGNAL_UNITS[name])
        found = power_spectrum(scale * test.signals[name][first:], test.sample_rate_hz)
        if found is None:
            continue
        frequency_hz, density = (values[1:] for values in found)
        drawn = density > 0.0
        axes.plot(
            frequency_hz[drawn], density[drawn], color=_COLOURS[name], linestyle=dash, label=f"{_(name)} ({unit}²/Hz)"
        )
        low, high = min(low, float(frequency_hz[0])), max(high, float(frequency_hz[-1]))
    if not high > 0.0:
        raise UnusableInputError(
            Message("report.no_power_spectrum", "the test is too short, or has too many gaps, for a power spectrum")
        )
    frequency_axis(axes, low, high)
    log_axis(axes)
    axes.set_ylabel(_("Power spectral density"))
    axes.legend(loc="lower left")
    return figure


@drawing
def distributions_figure(record: Record) -> Figure:
    """Distributions of input and output, each with the Gaussian of its mean and deviation (Chen 2010, Fig. 3.1).

    Raises:
        UnusableInputError: too few samples were received, or they do not vary.
    """
    figure = new_figure(FULL_WIDTH, 2.5)
    sides = (
        (record.input, record.input_name, record.input_unit),
        (record.output, record.output_name, record.output_unit),
    )
    for axes, (values, name, si_unit) in zip(figure.subplots(1, 2), sides, strict=True):
        unit, scale = display_unit(si_unit)
        values = scale * values[np.isfinite(values)]
        spread = float(np.std(values)) if values.size else 0.0
        if values.size < 20 or not spread > 1e-9 * float(np.max(np.abs(values))):
            raise UnusableInputError(
                Message("report.no_variation", "the {name} has too few samples, or is constant", name=name)
            )
        bins = int(np.clip(np.sqrt(values.size), 8, 60))
        axes.hist(values, bins=bins, density=True, color=_COLOURS.get(name, MUTED), alpha=0.4, histtype="stepfilled")
        grid = np.linspace(values.min(), values.max(), 200)
        gaussian = np.exp(-0.5 * ((grid - values.mean()) / spread) ** 2) / (spread * np.sqrt(2.0 * np.pi))
        axes.plot(grid, gaussian, color=INK, linewidth=1.0, linestyle=DASHES[1], label=_("Gaussian"))
        axes.set_xlabel(axis_label(name, unit))
        axes.set_ylabel(_("Density (1/{unit})").format(unit=unit) if unit else _("Density"))
        axes.set_ylim(bottom=0.0)
    figure.axes[0].legend(loc="upper left")
    return figure


def skewness(values: Array) -> float:
    """Return the skewness of the received samples of a signal (n,)."""
    centred = values[np.isfinite(values)]
    centred = centred - centred.mean()
    return float(np.mean(centred**3) / np.mean(centred**2) ** 1.5)
