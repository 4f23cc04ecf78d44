"""Plots of calibrations: residuals of a line, a figure over the dates, and figures along the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime

import numpy as np

from tissueid.analysis.curves.plot import Array, Axis, Bars, Curve, Plot, Surface, whole_ticks
from tissueid.analysis.curves.validation import KINDS, ROLES
from tissueid.calibration.comparison import Residuals, Trend, linear_region, profile_of
from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.labels import label_of, unit_of_quantity
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.units import display_unit, fine_unit

ALONG_STROKE = {
    "force_constant": (Axis(marked("Force constant"), marked("N per A")), 1.0),
    "mass": (Axis(marked("Mass M"), "g"), 1e3),
    "damping": (Axis(marked("Damping B"), "N·s/m"), 1.0),
    "stiffness": (Axis(marked("Stiffness K"), "N/m"), 1.0),
    "vaf": (Axis(marked("Variance accounted for"), "%"), 1.0),
}
"""Axis of each figure along the stroke, and factor from SI to its unit."""
REPEATED = ("coil_resistance_ohm", "force_constant_n_per_a", "voltage_gain", "position_gain")
"""Quantities of a static calibration whose repeatability is shown."""


def residual_plot(found: Residuals) -> Plot:
    """Return the residuals of a line of a static calibration; crosses are outliers."""
    y_unit, y_scale = fine_unit(found.y_unit)
    y = y_scale * found.y
    reach = 1.15 * max(float(np.abs(y).max(initial=0.0)), 1e-6)
    up = Axis(marked("Residual"), y_unit, limits=(-reach, reach), zero=True)
    return Plot(found.label, _across(found), up, tuple(_kept_and_outliers(found, y)))


def line_plots(found: Residuals) -> tuple[Plot, Plot]:
    """Return a line of a static calibration with the readings that it was fitted to, and their residuals.

    Raises:
        UnusableInputError: the calibration does not contain the readings.
    """
    if found.reading is None:
        raise UnusableInputError("report.no_readings", "the calibration holds no readings of this line")
    x_scale, (y_unit, y_scale) = display_unit(found.x_unit)[1], display_unit(found.y_unit)
    ends = [int(np.argmin(found.x)), int(np.argmax(found.x))]
    line = Curve(x_scale * found.x[ends], y_scale * (found.reading - found.y)[ends], "", "muted", width=0.8)
    points = _kept_and_outliers(found, y_scale * found.reading)
    left = Plot("", _across(found), Axis(found.quantities[1], y_unit), (line, *points))
    return left, replace(residual_plot(found), title="")


def _across(found: Residuals) -> Axis:
    return Axis(found.quantities[0], display_unit(found.x_unit)[0])


def _kept_and_outliers(found: Residuals, y: Array) -> list[Curve]:
    """Return values (n,) of a line as points, and as crosses where they are outliers."""
    x = display_unit(found.x_unit)[1] * found.x
    out = np.zeros(x.size, dtype=np.bool_) if found.outlier is None else found.outlier
    points = [Curve(x[~out], y[~out], kind="points", width=2.0)]
    return [*points, Curve(x[out], y[out], "", "poor", "points", width=1.5, marker="X")] if out.any() else points


def static_repeat_plot(columns: Mapping[str, Array]) -> Plot:
    """Return the quantities of repeated static calibrations relative to their means, by run (n,)."""
    curves = []
    every = zip(REPEATED, (*ROLES[:3], "text"), KINDS, "os^D", strict=True)
    for name, colour, kind, marker in every:
        if name in columns:
            share = 100.0 * (columns[name] / columns[name].mean() - 1.0)
            curves.append(Curve(columns["run"], share, label_of(name), colour, kind, width=0.6, marker=marker))
    run = Axis(marked("Run"), ticks=whole_ticks(int(columns["run"].min()), int(columns["run"].max())))
    return Plot("", run, Axis(marked("From the mean"), "%", zero=True), tuple(curves))


def trend_plot(found: Trend, now: datetime) -> Plot:
    """Return a figure of calibrations over the days before ``now``, with one standard deviation."""
    unit, scale = unit_of_quantity(found.name, Quantity(value=float(found.value[-1]), unit=found.unit))
    days = np.array([(made - now).total_seconds() / 86400.0 for made in found.dates])
    value, std = scale * found.value, np.nan_to_num(scale * found.std)
    low, high = float((value - std).min()), float((value + std).max())
    margin = max(0.15 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    first, last = min(-1.0, float(days.min())), max(0.0, float(days.max()))
    room = 0.04 * (last - first)
    return Plot(
        Message("plot.trend", "{name} by date", name=label_of(found.name)),
        Axis(marked("Days from today"), limits=(first - room, last + room)),
        Axis("", clean(unit), limits=(low - margin, high + margin)),
        (
            Curve(days, value, low=value - std, high=value + std, opacity=0.6, width=0.8),
            Curve(days, value, kind="points", width=2.0),
        ),
    )


def stroke_plot(name: str, sweeps: Sequence[Calibration], colours: Sequence[str]) -> Plot:
    """Return one of ``ALONG_STROKE`` of sweeps, each in a colour, with its deviation and its linear region."""
    axis, scale = ALONG_STROKE[name]
    parts: list[Curve | Surface | Bars] = []
    drawn: list[Array] = []
    for sweep, colour in zip(sweeps, colours, strict=False):
        region = linear_region(sweep)
        if region is not None:
            ends = 1e3 * np.array(region)
            parts.insert(0, Curve(ends, np.zeros(0), colour=colour, kind="spans", opacity=0.09))
        profile = profile_of(sweep, name)
        if profile is None:
            continue
        x, y = 1e3 * profile.position_m, scale * profile.value
        drawn.append(y)
        half = None if profile.std is None else scale * profile.std
        low, high = (None, None) if half is None else (y - half, y + half)
        parts.append(Curve(x, y, colour=colour, low=low, high=high, width=1.2))
        if name != "force_constant":
            parts.append(Curve(x, y, colour=colour, kind="points", width=1.5))
    position = Axis(marked("Position"), "mm")
    if not drawn:
        missing = Message("plot.no_profile", "{quantity}: not contained in any of these sweeps.", quantity=axis.label)
        return Plot(axis.label, position, axis, missing=missing)
    return Plot(axis.label, position, replace(axis, limits=_stroke_limits(name, np.concatenate(drawn))), tuple(parts))


def _stroke_limits(name: str, values: Array) -> tuple[float, float]:
    """Return limits about values (n,) with a margin that keeps deviations of less than 2 % small."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = max(0.12 * (high - low), 0.02 * abs(high), 1e-9)
    low, high = low - margin, high + margin
    if name == "vaf":  # nothing is above 100 %
        high = min(high, 100.0 + 0.05 * (100.0 - low))
    return low, high


__all__ = [
    "ALONG_STROKE",
    "REPEATED",
    "line_plots",
    "residual_plot",
    "static_repeat_plot",
    "stroke_plot",
    "trend_plot",
]
