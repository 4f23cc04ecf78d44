"""Plots of calibrations: residuals of a line, a figure over the dates, and figures along the stroke."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from tissueid.analysis.curves.plot import Axis, Bars, Curve, Plot, Surface
from tissueid.calibration.comparison import Residuals, Trend, linear_region, profile_of
from tissueid.calibration.file import Calibration, Quantity
from tissueid.calibration.labels import label_of, unit_of_quantity
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


def residual_plot(found: Residuals) -> Plot:
    """Return the residuals of a line of a static calibration."""
    x_unit, x_scale = display_unit(found.x_unit)
    y_unit, y_scale = fine_unit(found.y_unit)
    x, y = x_scale * found.x, y_scale * found.y
    reach = 1.15 * max(float(np.abs(y).max(initial=0.0)), 1e-6)
    across = Axis(marked("Position") if found.x_unit == "m" else marked("Reading"), x_unit)
    up = Axis("", y_unit, limits=(-reach, reach), zero=True)
    return Plot(found.label, across, up, (Curve(x, y, kind="points", width=2.0),))


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
    drawn = False
    for sweep, colour in zip(sweeps, colours, strict=False):
        region = linear_region(sweep)
        if region is not None:
            ends = 1e3 * np.array(region)
            parts.insert(0, Curve(ends, np.zeros(0), colour=colour, kind="spans", opacity=0.09))
        profile = profile_of(sweep, name)
        if profile is None:
            continue
        drawn = True
        x, y = 1e3 * profile.position_m, scale * profile.value
        half = None if profile.std is None else scale * profile.std
        low, high = (None, None) if half is None else (y - half, y + half)
        parts.append(Curve(x, y, colour=colour, low=low, high=high, width=1.2))
        if name != "force_constant":
            parts.append(Curve(x, y, colour=colour, kind="points", width=1.5))
    position = Axis(marked("Position"), "mm")
    if not drawn:
        missing = Message("plot.no_profile", "{quantity}: not contained in any of these sweeps.", quantity=axis.label)
        return Plot(axis.label, position, axis, missing=missing)
    return Plot(axis.label, position, axis, tuple(parts))


__all__ = ["ALONG_STROKE", "residual_plot", "stroke_plot", "trend_plot"]
