"""Plots of the linear systems at the levels of a stepped record (Chen 2010, 3.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.linear import response_axes
from tissueid.analysis.curves.plot import Axis, Curve, Kind, Plot, depth_roles
from tissueid.analysis.curves.units import FREQUENCY, LAG, TIME, kernel_unit, ratio_unit, signal_axis
from tissueid.identification.localized import LevelFit, LocalizedModel
from tissueid.language import marked
from tissueid.records import Record
from tissueid.units import display_unit

_BELOW = 0.3
"""Lower end of a Bode diagram as a multiple of the lowest natural frequency."""
_ABOVE = 6.0
"""Upper end of a Bode diagram as a multiple of the highest natural frequency."""


def by_depth(model: LocalizedModel) -> list[LevelFit]:
    """Return the levels from the lowest position to the highest."""
    return sorted(model.levels, key=lambda one: one.position)


def level_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return input and output against time, with the mean of each level coloured by depth (Chen 2010, Fig. 3.12)."""
    found = by_depth(model)
    time = replace(TIME, limits=(float(record.time[0]), float(record.time[-1])))
    made = []
    for name, si_unit, values, colour, of in (
        (record.input_name, record.input_unit, record.input, "model", "force"),
        (record.output_name, record.output_unit, record.output, "good", "position"),
    ):
        scale = display_unit(si_unit)[1]
        parts = [Curve(record.time, scale * values, "", colour, width=0.4, opacity=0.5)]
        for one, role in zip(found, depth_roles(len(found)), strict=True):
            span = record.time[[one.level.first, one.level.end - 1]]
            parts.append(Curve(span, np.full(2, scale * float(getattr(one, of))), "", role, width=2.3))
        made.append(Plot("", time, signal_axis(name, si_unit), tuple(parts)))
    return made[0], made[1]


def level_impulse_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return impulse responses, and each divided by its area; a curve for each level (Chen 2010, Fig. 3.12a).

    Curves are coloured by depth; those of levels reached by moving out of the tissue are dashed.
    """
    found = by_depth(model)
    unit, scale = kernel_unit(record)
    slowest = min(one.fit.system.natural_frequency_rad_per_s for one in found)
    time_s = np.linspace(0.0, 4.0 * np.pi / slowest, 400)
    left, right = [], []
    for one, role in zip(found, depth_roles(len(found)), strict=True):
        response = one.fit.system.impulse_response(time_s)
        left.append(Curve(1e3 * time_s, scale * one.fit.sign * response, "", role, _kind(one)))
        right.append(Curve(1e3 * time_s, response * one.fit.system.stiffness, "", role, _kind(one)))
    lag = replace(LAG, limits=(0.0, 1e3 * float(time_s[-1])))
    return (
        Plot("", lag, Axis(marked("Impulse response"), unit, zero=True), tuple(left)),
        Plot(
            "", lag, Axis(marked("Divided by its area"), "1/s", zero=True), tuple(right), depths=_depths(model, record)
        ),
    )


def level_response_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return magnitude and phase of the compliance; a curve for each level, as above (Chen 2010, Fig. 3.13)."""
    found = by_depth(model)
    natural = np.array([one.fit.system.natural_frequency_rad_per_s for one in found]) / (2.0 * np.pi)
    highest = min(_ABOVE * float(natural.max()), 0.5 * record.sample_rate_hz)
    frequency_hz = np.geomspace(_BELOW * float(natural.min()), highest, 300)
    scale = ratio_unit(record)[1]
    left, right = [], []
    for one, role in zip(found, depth_roles(len(found)), strict=True):
        response = scale * one.fit.sign * one.fit.system.frequency_response(frequency_hz)
        left.append(Curve(frequency_hz, np.abs(response), "", role, _kind(one)))
        right.append(Curve(frequency_hz, np.degrees(np.unwrap(np.angle(response))), "", role, _kind(one)))
    frequency = replace(FREQUENCY, limits=(float(frequency_hz[0]), float(frequency_hz[-1])))
    magnitude, phase = response_axes(record)
    return (
        Plot("", frequency, magnitude, tuple(left)),
        Plot("", frequency, phase, tuple(right), depths=_depths(model, record)),
    )


def _depths(model: LocalizedModel, record: Record) -> Axis:
    """Return the axis of the colours: the output, from the lowest level to the highest."""
    places = display_unit(record.output_unit)[1] * np.array([one.position for one in model.levels])
    axis = signal_axis(record.output_name, record.output_unit)
    return replace(axis, limits=(float(places.min()), float(places.max())))


def _kind(level: LevelFit) -> Kind:
    return "dashed" if level.level.direction < 0 else "line"
