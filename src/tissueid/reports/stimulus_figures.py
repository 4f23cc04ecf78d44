"""Figures of a designed stimulus: time series, amplitudes, spectrum and autocorrelation with their targets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from tissueid.analysis.curves.diagnostics import Array, power_spectrum
from tissueid.analysis.curves.plot import thin
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.formatting import superscript
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.reports.style import (
    BLUE,
    DASHES,
    INK,
    MUTED,
    ORANGE,
    SHADE,
    frequency_axis,
    log_axis,
)
from tissueid.stimuli import Stimulus
from tissueid.stimuli.interchange import InterchangeResult
from tissueid.stimuli.kinds.multisine import Multisine

ZOOM_S = 0.2
"""Length, s, of the stretch that is drawn sample by sample."""

_LOWEST_SHARE = 1e-9
"""Share of the largest power density below which nothing is drawn: leakage of the window, or rounding."""

_EMPTY = 1e-9
"""Share of the largest amplitude at which smaller lines are drawn: they contain only rounding."""


def _signal(unit: str) -> tuple[str, str]:
    """Return name and colour of the played signal; a signal has the same colour in all figures."""
    return (_("Voltage"), BLUE) if unit == "V" else (_("Force"), ORANGE)


def draw_time_series(figure: FigureBase, stimulus: Stimulus, device: DeviceDescription) -> None:
    """Draw the whole stimulus, and a stretch of it sample by sample; the right axis converts newtons to volts."""
    name, colour = _signal(stimulus.unit)
    whole, near = figure.subplots(2, 1)
    time_s = np.arange(len(stimulus)) / stimulus.sample_rate_hz
    whole.plot(*thin(time_s, stimulus.values), color=colour, linewidth=0.7)
    whole.set_xlim(0.0, stimulus.seconds)
    begins = stimulus.preload_s
    if begins > 0.0:
        whole.axvspan(0.0, begins, color=SHADE, zorder=0)
        note = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "color": MUTED, "fontsize": 8.5}
        whole.annotate(_("preload"), (0.0, 1.0), (0, 3), **note)
    ends = min(begins + ZOOM_S, stimulus.seconds)
    part = slice(round(begins * stimulus.sample_rate_hz), round(ends * stimulus.sample_rate_hz) + 1)
    near.plot(1e3 * time_s[part], stimulus.values[part], color=colour, linewidth=1.1, drawstyle="steps-post")
    near.set_xlim(1e3 * begins, 1e3 * ends)
    whole.set_xlabel(_("Time (s)"))
    near.set_xlabel(_("Time (ms)"))
    per_newton = device.voltage_for_force(1.0)
    for axes in (whole, near):
        axes.set_ylabel(f"{name} ({stimulus.unit})")
        if stimulus.unit == "N":
            other = axes.secondary_yaxis("right", functions=(lambda n: n * per_newton, lambda v: v / per_newton))
            other.set_ylabel(_("Command (V)"))
        else:
            other = axes.secondary_yaxis("right", functions=(lambda v: v / per_newton, lambda n: n * per_newton))
            other.set_ylabel(_("Force at rest (N)"))
        other.spines["right"].set_visible(True)


def draw_amplitudes(figure: FigureBase, values: Array, unit: str, intended: Array | None = None) -> None:
    """Draw histogram and cumulative distribution of values (n,) and of the intended ones (k,), both in ``unit``.

    The intended amplitudes are counted in the same bins, so that binary and stepped distributions are compared
    correctly (Chen 2010, Fig. 6.1).

    Raises:
        UnusableInputError: the values do not vary.
    """
    low, high = float(values.min()), float(values.max())
    if not high > low:
        raise UnusableInputError(
            Message("report.constant_stimulus", "the stimulus is constant and has no distribution")
        )
    if intended is not None:
        low, high = min(low, float(intended.min())), max(high, float(intended.max()))
    name, colour = _signal(unit)
    left, right = figure.subplots(1, 2)
    bins = np.linspace(low, high, int(np.clip(np.sqrt(values.size), 8, 50)) + 1)
    left.hist(
        values, bins=bins.tolist(), density=True, color=colour, alpha=0.4, histtype="stepfilled", label=_("played")
    )
    share = (np.arange(values.size) + 0.5) / values.size
    right.plot(np.sort(values), 100.0 * share, color=colour, linewidth=1.6, label=_("played"))
    if intended is not None:
        wanted, _edges = np.histogram(intended, bins=bins, density=True)
        left.stairs(wanted, bins, color=INK, linestyle=DASHES[1], linewidth=1.1, label=_("intended"))
        intended_share = (np.arange(intended.size) + 0.5) / intended.size
        right.plot(
            np.sort(intended),
            100.0 * intended_share,
            color=INK,
            linestyle=DASHES[1],
            linewidth=1.1,
            label=_("intended"),
        )
    left.set_ylim(bottom=0.0, top=1.22 * left.get_ylim()[1])
    left.set_ylabel(_("Density (1/{unit})").format(unit=unit))
    right.set_ylabel(_("Samples below (%)"))
    for axes in (left, right):
        axes.set_xlabel(f"{name} ({unit})")
    left.legend(loc="upper left", ncols=2)


def draw_power(
    figure: FigureBase,
    values: Array,
    sample_rate_hz: float,
    unit: str,
    target: tuple[Array, Array] | None = None,
    edges: Sequence[tuple[float, str]] = (),
) -> None:
    """Draw the power spectral density of values (n,) about their mean, and a target (Chen 2010, Fig. 6.1).

    Args:
        figure: the figure to draw into.
        values: the stimulus without its preload.
        sample_rate_hz: its sample rate.
        unit: N or V.
        target: frequencies, Hz, and one-sided densities of any scale; they are scaled to the power of the values.
        edges: frequencies, Hz, to mark, each with its label.

    Raises:
        UnusableInputError: the values are constant or too few for a spectrum.
    """
    found = power_spectrum(values, sample_rate_hz)
    if found is None or not float(np.ptp(values)) > 0.0:
        raise UnusableInputError(
            Message("report.no_stimulus_spectrum", "the stimulus is constant or too short for a power spectrum")
        )
    name, colour = _signal(unit)
    axes = figure.subplots()
    frequency_hz, density = (array[1:] for array in found)
    drawn = density > _LOWEST_SHARE * density.max()
    axes.plot(frequency_hz[drawn], density[drawn], color=colour, linewidth=1.1, label=_("played"))
    floor = float(density[drawn].min())
    if target is not None:
        wanted_hz, wanted = target
        wanted = wanted * (float(np.var(values)) / float(np.trapezoid(wanted, wanted_hz)))
        kept = (wanted > floor) & (wanted_hz >= frequency_hz[0])
        axes.plot(wanted_hz[kept], wanted[kept], color=INK, linestyle=DASHES[1], linewidth=1.1, label=_("target"))
    frequency_axis(axes, float(frequency_hz[0]), float(frequency_hz[-1]))
    axes.set_ylim(0.5 * floor, 30.0 * float(density.max()))
    log_axis(axes)
    for place, (edge_hz, label) in enumerate(edges):
        axes.axvline(edge_hz, color=MUTED, linewidth=0.8, linestyle=DASHES[2])
        last = place == len(edges) - 1
        axes.annotate(
            label,
            (edge_hz, 1.0),
            (3 if last else -3, -11),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="left" if last else "right",
            color=MUTED,
            fontsize=8.0,
        )
    axes.set_ylabel(
        translated(
            Message("stimulus.power_density", "{signal}, power density ({unit}²/Hz)", signal=Verbatim(name), unit=unit)
        )
    )
    axes.legend(loc="lower left")


def draw_autocorrelation(figure: FigureBase, found: Array, sample_rate_hz: float, target: Array | None = None) -> None:
    """Draw the normalised autocorrelation (lags,) from lag 0, its target (lags,), and their difference."""
    lag_ms = 1e3 * np.arange(found.size) / sample_rate_hz
    if target is None:
        axes = figure.subplots()
        _correlation(axes, lag_ms, found)
        axes.set_xlabel(_("Lag (ms)"))
        return
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.5, 1.0))
    _correlation(above, lag_ms, found)
    above.plot(lag_ms, target, color=INK, linestyle=DASHES[1], linewidth=1.1, label=_("target"))
    above.legend(loc="upper right")
    difference = found - target
    power, scale = _decade(difference)
    below.axhline(0.0, color=MUTED, linewidth=0.8)
    below.plot(lag_ms, difference / scale, color=BLUE, linewidth=0.8)
    below.set_ylabel(_("Difference") + power)
    below.set_xlabel(_("Lag (ms)"))
    figure.align_ylabels()


def _correlation(axes: Axes, lag_ms: NDArray[np.floating], found: Array) -> None:
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.plot(lag_ms, found, color=BLUE, linewidth=1.1, label=_("played"))
    axes.set_xlim(0.0, float(lag_ms[-1]))
    axes.set_ylabel(_("Autocorrelation"))


def _decade(values: Array) -> tuple[str, float]:
    """Return the suffix of an axis label and the power of ten to divide values by, such as (" (×10⁻³)", 1e-3)."""
    largest = float(np.max(np.abs(values), initial=0.0))
    exponent = int(np.floor(np.log10(largest))) if largest > 0.0 else 0
    return (f" (×10{superscript(exponent)})", 10.0**exponent) if exponent < -1 else ("", 1.0)


def draw_swaps(figure: FigureBase, search: InterchangeResult | None) -> None:
    """Draw the sum of squared differences of the autocorrelation against accepted swaps (Chen 2010, Fig. 6.2b).

    Raises:
        UnusableInputError: nothing was swapped.
    """
    if search is None or search.history.shape[0] < 2:
        raise UnusableInputError(Message("report.no_swaps", "no swap was needed: the initial sequence met the target"))
    swaps, error = search.history[:, 1], search.history[:, 2]
    axes = figure.subplots()
    axes.plot(swaps, error, color=BLUE, linewidth=1.3)
    axes.axhline(search.tolerance, color=INK, linestyle=DASHES[1], linewidth=1.0, label=_("tolerance"))
    axes.set_xlim(0.0, float(swaps[-1]))
    axes.set_ylim(0.5 * min(float(error.min()), search.tolerance), 2.0 * float(error.max()))
    axes.set_xlabel(_("Accepted swaps"))
    axes.set_ylabel(_("Sum of squared differences"))
    log_axis(axes)
    axes.legend(loc="upper right")


def draw_lines(figure: FigureBase, multisine: Multisine, stimulus: Stimulus) -> None:
    """Draw the amplitude of the lines of one period: driven, detection and not driven, with the notches shaded.

    Raises:
        UnusableInputError: the stimulus is shorter than a period.
    """
    period = multisine.period
    if len(stimulus) < period:
        raise UnusableInputError(Message("report.short_period", "the stimulus is shorter than one period"))
    one = stimulus.values[-period:]
    amplitude = 2.0 / period * np.abs(np.fft.rfft(one - one.mean()))
    axes = figure.subplots()
    driven, detection = multisine.driven_lines(), multisine.detection_lines()
    highest = int(driven[-1])
    shown = min(amplitude.size - 1, max(highest + 10, round(1.25 * highest)))
    rest = np.setdiff1d(np.arange(1, shown + 1), np.concatenate([driven, detection]))
    floor = _EMPTY * float(amplitude[driven].max())
    for lines, label, colour, marker in (
        (driven, _("driven"), _signal(stimulus.unit)[1], "o"),
        (detection, _("detection"), BLUE if stimulus.unit == "N" else ORANGE, "^"),
        (rest, _("not driven"), MUTED, "."),
    ):
        if lines.size:
            heights = np.maximum(amplitude[lines], floor)
            axes.plot(lines * multisine.resolution_hz, heights, color=colour, linestyle="none", marker=marker,
                      markersize=3.5, markeredgewidth=0.0, label=label)  # fmt: skip
    for low, high in multisine.notches:
        axes.axvspan(low, high, color=SHADE, zorder=0)
    axes.set_xlim(0.0, (shown + 1) * multisine.resolution_hz)
    axes.set_ylim(0.3 * floor, 30.0 * float(amplitude.max()))
    log_axis(axes)
    axes.set_xlabel(_("Frequency (Hz)"))
    axes.set_ylabel(_("Amplitude ({unit})").format(unit=stimulus.unit))
    axes.legend(loc="center right")
