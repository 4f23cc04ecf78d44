"""Figures of localized linear tests: levels of a stepped record, and the dynamics at each (Chen 2010, 3.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from tissueid.analysis.curves.plot import thin
from tissueid.analysis.curves.units import kernel_unit, ratio_unit
from tissueid.formatting import axis_label, fixed
from tissueid.identification.localized import LevelFit, LocalizedModel
from tissueid.language import _, marked
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import depth_bar, depth_colours
from tissueid.reports.style import DASHES, FULL_WIDTH, MUTED, SERIES, frequency_axis, log_axis, new_figure
from tissueid.units import display_unit

_BELOW = 0.3
"""Lower end of a Bode diagram as a multiple of the lowest natural frequency."""
_ABOVE = 6.0
"""Upper end of a Bode diagram as a multiple of the highest natural frequency."""


def _by_depth(model: LocalizedModel) -> list[LevelFit]:
    return sorted(model.levels, key=lambda one: one.position)


@figure(
    LocalizedModel,
    "levels",
    marked("Levels found in the record"),
    marked("Input and output over time, with each level as a line coloured by its depth."),
    group="record",
    place=50,
)
def levels(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw the levels found in the record (Chen 2010, Fig. 3.12)."""
    model, record = subject.model, subject.record
    drawn = new_figure(FULL_WIDTH, 3.9)
    every = drawn.subplots(2, 1, sharex=True)
    found = _by_depth(model)
    colours = depth_colours(len(found))
    for axes, name, si_unit, values, trace, of in (
        (every[0], record.input_name, record.input_unit, record.input, SERIES[1], "force"),
        (every[1], record.output_name, record.output_unit, record.output, SERIES[2], "position"),
    ):
        unit, scale = display_unit(si_unit)
        axes.plot(*thin(record.time, scale * values), color=trace, linewidth=0.5, alpha=0.5)
        for one, colour in zip(found, colours, strict=True):
            span = record.time[[one.level.first, one.level.end - 1]]
            axes.plot(span, [scale * float(getattr(one, of))] * 2, color=colour, linewidth=3.0, solid_capstyle="butt")
        axes.set_ylabel(axis_label(name, unit))
    every[1].set_xlabel(_("Time (s)"))
    every[1].set_xlim(float(record.time[0]), float(record.time[-1]))
    drawn.align_ylabels()
    least = min(one.samples for one in found)
    return drawn, _(
        "{count} levels; each has its own linear fit, which begins one memory length after the step. Lines: mean of "
        "each level, coloured from shallow to deep. The shortest level has {least} usable samples."
    ).format(count=len(found), least=least)


@figure(
    LocalizedModel,
    "impulse-responses",
    marked("Impulse response at each level"),
    marked("Left: impulse responses against lag, coloured by depth. Right: each divided by its area."),
    group="linear",
    place=50,
)
def impulse_responses(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw impulse responses by level, unscaled and divided by their area (Chen 2010, Fig. 3.12a)."""
    model, record = subject.model, subject.record
    found = _by_depth(model)
    unit, scale = kernel_unit(record)
    slowest = min(one.fit.system.natural_frequency_rad_per_s for one in found)
    time_s = np.linspace(0.0, 4.0 * np.pi / slowest, 400)
    drawn = new_figure(FULL_WIDTH, 3.7)
    left, right = drawn.subplots(1, 2)
    for one, colour in zip(found, depth_colours(len(found)), strict=True):
        response = one.fit.sign * one.fit.system.impulse_response(time_s)
        dash = DASHES[1] if one.level.direction < 0 else DASHES[0]
        left.plot(1e3 * time_s, scale * response, color=colour, linestyle=dash, linewidth=1.3)
        right.plot(1e3 * time_s, response * one.fit.sign * one.fit.system.stiffness, color=colour, linestyle=dash)
    for axes in (left, right):
        axes.axhline(0.0, color=MUTED, linewidth=0.8)
        axes.set_xlabel(_("Lag (ms)"))
        axes.set_xlim(0.0, 1e3 * float(time_s[-1]))
    left.set_ylabel(_("Impulse response ({unit})").format(unit=unit))
    right.set_ylabel(_("Divided by its area (1/s)"))
    _bar(subject, right, found)
    return drawn, _(
        "Deeper tissue should respond less and faster. Divided by its area (right), a response shows the dynamics "
        "alone: in a Wiener system all curves would coincide. Dashed: levels reached by moving out of the tissue."
    )


@figure(
    LocalizedModel,
    "bode",
    marked("Bode diagram at each level"),
    marked("Magnitude and phase against frequency of the linear system at each level, coloured by depth."),
    group="linear",
    place=52,
)
def bode(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw the compliance by level (Chen 2010, Fig. 3.13)."""
    model, record = subject.model, subject.record
    found = _by_depth(model)
    per_unit, scale = ratio_unit(record)
    natural = np.array([one.fit.system.natural_frequency_rad_per_s for one in found]) / (2.0 * np.pi)
    highest = min(_ABOVE * float(natural.max()), 0.5 * record.sample_rate_hz)
    frequency_hz = np.geomspace(_BELOW * float(natural.min()), highest, 300)
    drawn = new_figure(FULL_WIDTH, 3.7)
    left, right = drawn.subplots(1, 2)
    for one, colour in zip(found, depth_colours(len(found)), strict=True):
        response = scale * one.fit.sign * one.fit.system.frequency_response(frequency_hz)
        dash = DASHES[1] if one.level.direction < 0 else DASHES[0]
        left.plot(frequency_hz, np.abs(response), color=colour, linestyle=dash)
        right.plot(frequency_hz, np.degrees(np.unwrap(np.angle(response))), color=colour, linestyle=dash)
    log_axis(left)
    left.set_ylabel(_("Magnitude ({unit})").format(unit=per_unit))
    right.set_ylabel(_("Phase (°)"))
    for axes in (left, right):
        frequency_axis(axes, float(frequency_hz[0]), float(frequency_hz[-1]))
    _bar(subject, right, found)
    low, high = (fixed(float(one), 1) for one in (natural[0], natural[-1]))
    return drawn, _(
        "The magnitude at low frequencies is one over the stiffness: it falls with depth, while the natural frequency "
        "rises, here from {low} Hz at the shallowest level to {high} Hz at the deepest."
    ).format(low=low, high=high)


def _bar(subject: Subject[LocalizedModel], axes: Axes, found: list[LevelFit]) -> None:
    """Add the colour bar of depths to a panel."""
    unit, scale = display_unit(subject.record.output_unit)
    low, high = scale * found[0].position, scale * found[-1].position
    depth_bar(axes, low, high, axis_label(subject.record.output_name, unit))
