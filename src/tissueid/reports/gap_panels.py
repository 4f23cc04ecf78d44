"""The pictures of a diagnosis: the chain, where the gap lies, the ranking, and recorded against simulated."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from numpy.typing import NDArray

from tissueid.analysis.curves.plot import Axis, Plot, Surface
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label
from tissueid.gap.dataset import DatasetTest
from tissueid.gap.diagnosis import Diagnosis
from tissueid.gap.error_regions import ErrorRegions, Profile, Spectrum
from tissueid.gap.scoring import Candidate
from tissueid.gap.statement import effect_title, ordered_candidates
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.reports.gap_chain import draw_chain
from tissueid.reports.panel_sheet import Panel, missing_panel
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.style import BLUE, DASHES, GREEN, INK, MUTED, ORANGE, SHADE, frequency_axis, log_axis
from tissueid.sessions import SIGNAL_UNITS
from tissueid.twin.effect import STAGE_NAMES
from tissueid.units import fine_unit

FloatArray = NDArray[np.float64]

_SIGNALS = {
    "voltage": (marked("Voltage (V)"), 1.0),
    "current": (marked("Current (A)"), 1.0),
    "position": (marked("Position (mm)"), 1e3),
}
_OVERLAY_S = 0.25
_UNSEEN = 0.95
"""A stretch that no fit has seen is held out to this share: its ends may lie a sample or two off."""
_MOVES = 0.5
"""A signal moves where its deviation is at least this share of the upper quartile over all stretches."""
_LISTED = 8


def gap_panels(found: Diagnosis) -> Iterator[Panel]:
    """All pictures of a diagnosis."""
    regions = found.where.regions
    yield Panel(
        "chain",
        _("The chain and the stage at fault"),
        _("Stages from command to recorded numbers; at fault: {stages}.").format(
            stages=", ".join(_(STAGE_NAMES[stage]) for stage in found.at_fault) or _("none")
        ),
        _(
            "Each stage is given what was measured upstream of it and refitted within its calibration; its share is "
            "what it still leaves, as the logarithm of error over noise. The deeper the colour, the larger the share."
        ),
        lambda figure: draw_chain(figure, found),
        height=2.5,
    )
    if not regions.profiles:
        yield missing_panel("where", _("Where the gap lies"), _("nothing was left to look at"))
        return
    of = _(regions.channel)
    yield Panel(
        "frequency",
        _("By frequency"),
        _(
            "Power of {channel} and of what the baseline leaves of it against frequency, with its linear, even and odd "
            "parts."
        ).format(channel=of),
        _(
            "What the refitted baseline leaves, and of it the parts that are coherent with the command (linear), with "
            "its square (even) and with its cube (odd). Shaded: bands that stand above the noise."
        ),
        lambda figure: draw_spectrum(figure, _spectrum(found), regions.bands_hz),
        height=3.4,
    )
    yield Panel(
        "depth",
        _("By depth"),
        _("Error of {channel} against depth, and the noise.").format(channel=of),
        _(
            "Root-mean-square error as a multiple of the noise (what the sensors' noise alone leaves: 1, dashed). "
            "Full dots stand above it with significance."
        ),
        lambda figure: draw_profile(figure, regions.profiles["depth_m"], 1e3, _("Depth (mm)")),
        wide=False,
        height=2.9,
    )
    yield Panel(
        "speed",
        _("By speed and direction"),
        _("Error of {channel} against velocity, and the noise.").format(channel=of),
        _("The same against velocity; positive is into the tissue."),
        lambda figure: draw_profile(figure, regions.profiles["velocity_m_s"], 1e3, _("Velocity (mm/s)")),
        wide=False,
        height=2.9,
    )
    yield Panel(
        "surface",
        _("Over depth and velocity"),
        _("Mean residual of {channel} as an image over depth and velocity.").format(channel=of),
        _(
            "What is left on average, as a multiple of the noise: a force that goes with depth shows as columns, "
            "friction as an upper and a lower half (restoring-force surface)."
        ),
        lambda figure: draw_surface(figure, found),
        wide=False,
        height=3.2,
    )
    yield Panel(
        "time",
        _("In the course of the test"),
        _("Error of {channel} against time, and the noise.").format(channel=of),
        _(
            "Root-mean-square error as a multiple of the noise by quarter second; full dots stand above it with "
            "significance."
        ),
        lambda figure: draw_profile(figure, regions.profiles["time_s"], 1.0, _("Time (s)")),
        wide=False,
        height=3.2,
    )
    yield from _more_profiles(regions, of)
    if candidates := ordered_candidates(found):
        yield Panel(
            "ranking",
            _("Candidates"),
            _("Probability and closed share of each candidate effect."),
            _(
                "Left: probability that a candidate is the cause. Right: the share of the gap that it closes on "
                "held-out data, with 95 %. The same colour: candidates that this data cannot separate."
            ),
            lambda figure: draw_ranking(figure, found),
            height=0.9 + 0.28 * min(len(candidates), _LISTED),
        )
    yield Panel(
        "overlay",
        _("Before and after"),
        _("Recorded signals with the simulation before and after the effect was added, and both residuals below."),
        _(
            "A quarter of a second that was held out of the fit: of those in which the signal moves, "
            "that with the largest error. Below: recorded less simulated; dotted: what noise alone would leave."
        ),
        lambda figure: draw_overlay(figure, found),
        height=5.0,
    )


def _more_profiles(regions: ErrorRegions, of: str) -> Iterator[Panel]:
    """Along what not every test has: a current, a stimulus whose size changes, the mains."""
    where = (
        (
            "current_a",
            "current",
            _("By current"),
            1.0,
            _("Current (A)"),
            _("The same against the current of the coil."),
        ),
        (
            "amplitude_n",
            "amplitude",
            _("By the amplitude of the stimulus"),
            1.0,
            _("Amplitude of the last 0.1 s (N)"),
            _("The same against the root mean square of what was played in the last tenth of a second, as a force."),
        ),
        (
            "mains_phase_rad",
            "mains",
            _("By the phase of the mains"),
            180.0 / np.pi,
            _("Phase (°) at {hertz} Hz").format(hertz=f"{regions.mains_hz:.2f}"),
            _("The same against the phase of the mains from the start of the test: the mains shows in what is left."),
        ),
    )
    for name, key, heading, scale, label, caption in where:
        if name in regions.profiles:
            yield Panel(
                key,
                heading,
                _("Error of {channel}, {heading}, and the noise.").format(channel=of, heading=heading),
                caption,
                partial(draw_profile, found=regions.profiles[name], scale=scale, label=label),
                wide=False,
                height=2.9,
            )


def draw_spectrum(figure: FigureBase, found: Spectrum, bands_hz: tuple[tuple[float, float], ...]) -> None:
    """Amplitude densities of a residual and its parts."""
    axes = figure.subplots(1, 1)
    unit, scale = fine_unit(SIGNAL_UNITS[found.channel])
    for low, high in bands_hz:
        axes.axvspan(low, high, color=SHADE, zorder=0)
    lines = (
        (found.recorded, _("recorded"), MUTED, DASHES[0], 0.9),
        (found.residual, _("left by the baseline"), INK, DASHES[0], 1.5),
        (found.linear, _("linear"), BLUE, DASHES[1], 1.1),
        (found.even, _("even"), ORANGE, DASHES[2], 1.1),
        (found.odd, _("odd"), GREEN, DASHES[3], 1.1),
        (found.noise, _("noise alone"), MUTED, DASHES[1], 1.1),
    )
    least = 0.1 * scale * float(np.sqrt(found.noise[0]))
    for power, label, colour, dashes, width in lines:
        values = scale * np.sqrt(power)
        values = np.where(values >= least, values, np.nan)
        axes.plot(found.frequency_hz, values, color=colour, linestyle=dashes, linewidth=width, label=label)
    # Room for the legend above the lines.
    axes.set_ylim(least, 20.0 * scale * float(np.sqrt(found.recorded.max())))
    log_axis(axes)
    frequency_axis(axes, float(found.frequency_hz[0]), float(found.frequency_hz[-1]))
    axes.set_ylabel(axis_label(found.channel, f"{unit}/√Hz"))
    axes.legend(loc="upper right", ncols=3)


def draw_profile(figure: FigureBase, found: Profile, scale: float, label: str) -> None:
    """Error along something, as a multiple of the noise floor."""
    axes = figure.subplots(1, 1)
    middle = 0.5 * scale * (found.edges[1:] + found.edges[:-1])
    known = np.isfinite(found.error)
    axes.axhline(1.0, color=MUTED, linewidth=1.0, linestyle=DASHES[1])
    axes.plot(middle[known], found.error[known], color=BLUE, linewidth=0.9, alpha=0.6)
    for chosen, filled in ((known & found.above, True), (known & ~found.above, False)):
        axes.plot(
            middle[chosen],
            found.error[chosen],
            color=BLUE,
            linestyle="none",
            marker="o",
            markersize=4.5,
            markerfacecolor=BLUE if filled else "none",
        )
    top = float(np.max(found.error[known], initial=1.0))
    if top > 20.0:
        axes.set_ylim(0.5, 2.0 * top)
        log_axis(axes)
    else:
        axes.set_ylim(0.0, 1.1 * top)
    axes.set_xlabel(label)
    axes.set_ylabel(_("Error (× noise)"))


def draw_surface(figure: FigureBase, found: Diagnosis) -> None:
    """Mean residual over depth and velocity.

    Raises:
        UnusableInputError: too little was visited.
    """
    surface = found.where.regions.surface
    if surface is None:
        raise UnusableInputError(Message("report.no_surface", "too little of depth and velocity was visited"))
    values = Surface(1e3 * surface.depth_m, 1e3 * surface.velocity_m_s, surface.residual, marked("Residual"), "× noise")
    draw_plot(figure.subplots(1, 1), Plot("", Axis(marked("Depth"), "mm"), Axis(marked("Velocity"), "mm/s"), (values,)))


def draw_ranking(figure: FigureBase, found: Diagnosis) -> None:
    """Probability and closed share of the leading candidates."""
    left, right = figure.subplots(1, 2, sharey=True)
    shown = ordered_candidates(found)[:_LISTED]
    rows = np.arange(len(shown))
    alike = {shown[0].effect, *shown[0].indistinguishable}
    colours = [ORANGE if item.effect in alike else BLUE for item in shown]
    left.barh(rows, [100.0 * item.probability for item in shown], color=colours, height=0.62, alpha=0.85)
    for row, item, colour in zip(rows, shown, colours, strict=True):
        if not np.isfinite(item.closed):
            continue
        low, high = (100.0 * np.clip(end, -1.0, 1.0) for end in item.closed_ci)
        right.plot([low, high], [row, row], color=colour, linewidth=1.6)
        right.plot([100.0 * max(item.closed, -1.0)], [row], color=colour, marker="o", markersize=4.5)
    left.set_yticks(rows, [translated(effect_title(item.effect)) for item in shown])
    left.invert_yaxis()
    left.set_xlim(0.0, 100.0)
    left.set_xlabel(_("Probability (%)"))
    right.axvline(0.0, color=MUTED, linewidth=0.9)
    right.set_xlim(min(0.0, right.get_xlim()[0]), 102.0)
    right.set_xlabel(_("Closed (%)"))
    for axes in (left, right):
        axes.grid(visible=False, axis="y")


def draw_overlay(figure: FigureBase, found: Diagnosis) -> None:
    """Recorded and simulated over a stretch that was not fitted, for the signals that show it most.

    Raises:
        UnusableInputError: every sample was fitted.
    """
    regions = found.where.regions
    test, first, last = largest_held_out_error(found, regions.channel)
    channels = [name for name in found.dataset.channels if name != "voltage" or regions.channel == "voltage"][:3]
    grid = figure.subplots(2, len(channels), sharex=True, squeeze=False, gridspec_kw={"height_ratios": (3, 2)})
    shown = slice(first, last)
    time = np.arange(first, last) / test.sample_rate_hz
    after = found.best if found.best is not None and found.verdict != "no_gap" else None
    for (above, below), name in zip(grid.T, channels, strict=True):
        label, scale = _SIGNALS[name]
        unit, fine = fine_unit(SIGNAL_UNITS[name])
        recorded = test.signals[name][shown]
        above.plot(time, scale * recorded, color=INK, linestyle="none", marker=".", markersize=2.2, label=_("recorded"))
        for candidate, words, colour, dashes in (
            (found.found.baseline, _("before"), ORANGE, DASHES[1]),
            (after, _("after"), BLUE, DASHES[0]),
        ):
            if candidate is None:
                continue
            simulated = simulated_signal(candidate, test, name)[shown]
            above.plot(time, scale * simulated, color=colour, linestyle=dashes, linewidth=1.0, label=words)
            left = fine * (recorded - simulated)
            below.plot(time, left, color=colour, linewidth=0.9)
        _floor(below, fine * found.dataset.noise[name])
        above.set_ylabel(_(label))
        below.set_ylabel(_("Left over ({unit})").format(unit=unit))
        below.set_xlabel(_("Time (s)"))
    grid[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)


def _floor(axes: Axes, noise: float) -> None:
    for sign in (-1.96, 1.96):
        axes.axhline(sign * noise, color=MUTED, linewidth=0.9, linestyle=DASHES[2])


def _spectrum(found: Diagnosis) -> Spectrum:
    regions = found.where.regions
    return next(item for item in regions.spectra if item.channel == regions.channel)


def simulated_signal(candidate: Candidate, test: DatasetTest, name: str) -> FloatArray:
    """Return a signal of a test simulated by a candidate, shape (n,), SI."""
    tests = candidate.fit.parameters.dataset.tests
    place = next(k for k, item in enumerate(tests) if item.number == test.number)
    return candidate.fit.predictions[place][name]


def largest_held_out_error(found: Diagnosis, channel: str) -> tuple[DatasetTest, int, int]:
    """Return the test, first sample and end of the held-out block with the largest error of the baseline.

    Blocks in which the signal is almost constant are ignored: they show an offset at most.

    Raises:
        UnusableInputError: there is none.
    """
    tried: list[tuple[float, float, DatasetTest, int, int]] = []
    for test in found.dataset.tests:
        if test.quiet and len(found.dataset.tests) > 1:
            continue
        held = test.purpose > 1
        size = max(8, round(_OVERLAY_S * test.sample_rate_hz))
        error = (test.signals[channel] - simulated_signal(found.found.baseline, test, channel)) / found.dataset.noise[
            channel
        ]
        for start in range(0, max(1, error.size - size + 1), max(1, size // 2)):
            inside = held[start : start + size] & np.isfinite(error[start : start + size])
            if held[start : start + size].mean() < _UNSEEN or not inside.any():
                continue
            worth = float(np.sqrt(np.mean(error[start : start + size][inside] ** 2)))
            moved = float(np.std(test.signals[channel][start : start + size][inside]))
            tried.append((worth, moved, test, start, min(start + size, error.size)))
    if not tried:
        raise UnusableInputError(Message("report.all_fitted", "every sample was fitted"))
    least = _MOVES * float(np.quantile([item[1] for item in tried], 0.75))
    return max((item for item in tried if item[1] >= least), key=lambda item: item[0])[2:]
