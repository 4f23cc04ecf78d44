"""Plots of calibrations: residuals, values by date, along the stroke, and of a dynamic sweep (Chen 2010, 2.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    FREQUENCY,
    KINDS,
    Array,
    Axis,
    Bars,
    Curve,
    Kind,
    Plot,
    Surface,
    depth_roles,
    whole_ticks,
)
from tissueid.analysis.curves.validation import ROLES
from tissueid.calibration.comparison import Residuals, Trend, linear_region, profile_of
from tissueid.calibration.file import CalibratedQuantity, Calibration
from tissueid.calibration.status import label_of, unit_of_quantity
from tissueid.errors import UnusableInputError
from tissueid.formatting import clean
from tissueid.identification.second_order import SecondOrder
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


def residual_plot(residuals: Residuals) -> Plot:
    """Return the residuals of a line of a static calibration; crosses are outliers."""
    y_unit, y_scale = fine_unit(residuals.y_unit)
    y = y_scale * residuals.y
    reach = 1.15 * max(float(np.abs(y).max(initial=0.0)), 1e-6)
    up = Axis(marked("Residual"), y_unit, limits=(-reach, reach), zero=True)
    return Plot(residuals.label, _across(residuals), up, tuple(_kept_and_outliers(residuals, y)))


def line_plots(residuals: Residuals) -> tuple[Plot, Plot]:
    """Return a line of a static calibration with the readings that it was fitted to, and their residuals.

    Raises:
        UnusableInputError: the calibration does not contain the readings.
    """
    if residuals.reading is None:
        raise UnusableInputError("report.no_readings", "the calibration holds no readings of this line")
    x_scale, (y_unit, y_scale) = display_unit(residuals.x_unit)[1], display_unit(residuals.y_unit)
    ends = [int(np.argmin(residuals.x)), int(np.argmax(residuals.x))]
    line = Curve(x_scale * residuals.x[ends], y_scale * (residuals.reading - residuals.y)[ends], "", "muted", width=0.8)
    points = _kept_and_outliers(residuals, y_scale * residuals.reading)
    readings = Plot("", _across(residuals), Axis(residuals.quantities[1], y_unit), (line, *points))
    return readings, replace(residual_plot(residuals), title="")


def _across(residuals: Residuals) -> Axis:
    return Axis(residuals.quantities[0], display_unit(residuals.x_unit)[0])


def _kept_and_outliers(residuals: Residuals, y: Array) -> list[Curve]:
    """Return values (n,) of a line as points, and as crosses where they are outliers."""
    x = display_unit(residuals.x_unit)[1] * residuals.x
    out = np.zeros(x.size, dtype=np.bool_) if residuals.outlier is None else residuals.outlier
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


def trend_plot(trend: Trend, now: datetime) -> Plot:
    """Return a figure of calibrations over the days before ``now``, with one standard deviation."""
    unit, scale = unit_of_quantity(trend.name, CalibratedQuantity(value=float(trend.value[-1]), unit=trend.unit))
    days = np.array([(made - now).total_seconds() / 86400.0 for made in trend.dates])
    value, std = scale * trend.value, np.nan_to_num(scale * trend.std)
    low, high = float((value - std).min()), float((value + std).max())
    margin = max(0.15 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    first, last = min(-1.0, float(days.min())), max(0.0, float(days.max()))
    room = 0.04 * (last - first)
    return Plot(
        Message("plot.trend", "{name} by date", name=label_of(trend.name)),
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


Columns = Mapping[str, Array]
"""Columns (n,) of a table of a calibration, SI, by their name."""
LINEAR_SHARE = 0.05
"""Deviation from the plateau within which the force constant counts as constant."""
_FIT_POINTS = 200
_STROKE = Axis(marked("Position"), "mm", limits=(0.0, 32.0))
_PARAMETERS = (
    ("vaf_percent", "", 1.0, Axis(marked("VAF"), "%"), (95.0, 98.0)),
    ("mass_kg", "mass_std_kg", 1e3, Axis(marked("Mass"), "g"), (60.0, 80.0)),
    ("damping_n_s_per_m", "damping_std_n_s_per_m", 1.0, Axis(marked("Damping"), "N·s/m"), (3.0, 4.0)),
    ("stiffness_n_per_m", "stiffness_std_n_per_m", 1.0, Axis(marked("Stiffness"), "N/m"), (1000.0, 1200.0)),
)
"""Columns, factor to the unit of the axis, and range of the instrument of the thesis (Chen 2010, Table 2.1)."""


@dataclass(frozen=True)
class Region:
    """Linear region (m), and its mean force constant (N/A)."""

    min_m: float
    max_m: float
    plateau_n_per_a: float

    @property
    def shade(self) -> Curve:
        """The region as a span of positions."""
        return Curve(1e3 * np.array([self.min_m, self.max_m]), np.zeros(0), "", "muted", "spans", opacity=0.12)


def parameter_plots(sweep: Columns, region: Region) -> tuple[Plot, ...]:
    """Return VAF, mass, damping and stiffness against position, with 95 % bars (Chen 2010, Fig. 2.12a).

    Dotted lines are the ends of the range of the thesis.
    """
    position, ends = 1e3 * sweep["position_m"], np.array(_STROKE.limits)
    made = []
    for name, std, scale, axis, thesis in _PARAMETERS:
        values = scale * sweep[name]
        points = Curve(position, values, kind="bars", width=0.8)
        if std in sweep:
            half = CONFIDENCE * scale * sweep[std]
            points = replace(points, low=values - half, high=values + half)
        lines = [Curve(ends, np.full(2, end), "", "muted", "dotted", width=0.7) for end in thesis]
        between = Curve(position, values, width=0.7, opacity=0.6)
        low, high = min(values.min(), thesis[0]), max(values.max(), thesis[1])
        limits = float(low - 0.08 * (high - low)), float(high + 0.08 * (high - low))
        made.append(Plot("", _STROKE, replace(axis, limits=limits), (region.shade, *lines, between, points)))
    return tuple(made)


def force_constant_plots(profile: Columns, sweep: Columns, region: Region) -> tuple[Plot, Plot]:
    """Return the force constant by each method, and each relative to the combined estimate, percent.

    Dashed lines limit the deviation from the mean within which the force constant counts as constant.
    """
    position, value = 1e3 * profile["position_m"], profile["value_n_per_a"]
    edges = [(1.0 + sign * LINEAR_SHARE) * region.plateau_n_per_a for sign in (-1.0, 1.0)]
    above = [region.shade, *(Curve(np.zeros(1), np.array([at]), "", "muted", "level", width=0.8) for at in edges)]
    below = [region.shade]
    methods: tuple[tuple[str, str, str, Kind], ...] = (
        ("by_flux", marked("by flux linkage"), "model", "dashed"),
        ("by_spring", marked("by the spring"), "measured", "line"),
    )
    for method, name, colour, kind in methods:
        if f"{method}_n_per_a" in profile:
            constant, reach = profile[f"{method}_n_per_a"], CONFIDENCE * profile[f"{method}_std_n_per_a"]
            curve = Curve(position, constant, name, colour, kind, constant - reach, constant + reach)
            above.append(curve)
            below.append(_relative(curve, value))
    if "force_constant_n_per_a" in sweep:
        at, points = 1e3 * sweep["position_m"], sweep["force_constant_n_per_a"]
        reach = CONFIDENCE * sweep["force_constant_std_n_per_a"]
        name = marked("by the stiffness at each position")
        bars = Curve(at, points, name, "good", "bars", points - reach, points + reach, width=0.8, marker="s")
        above.append(bars)
        below.append(_relative(bars, np.interp(at, position, value)))
    above.append(Curve(position, value, marked("combined"), "text", "dashdot", width=0.7))
    below.append(Curve(np.array(_STROKE.limits), np.zeros(2), "", "text", "dashdot", width=0.7))
    return (
        Plot("", _STROKE, ALONG_STROKE["force_constant"][0], tuple(above)),
        Plot("", _STROKE, Axis(marked("From combined"), "%"), tuple(below)),
    )


def _relative(curve: Curve, value: Array) -> Curve:
    """Return a curve with its band relative to values (n,), as a deviation in percent."""
    assert curve.low is not None
    assert curve.high is not None
    y, *ends = (100.0 * (ordinate / value - 1.0) for ordinate in (curve.y, curve.low, curve.high))
    return replace(curve, y=y, low=np.minimum(*ends), high=np.maximum(*ends), name="")


def bode_plots(response: Columns, sweep: Columns) -> tuple[Plot, Plot, Plot]:
    """Return compliance, compliance relative to mid-stroke, and phase by position (Chen 2010, Fig. 2.12b).

    Points are measured, lines are those of second-order systems; the middle plot shows measured values.
    """
    places = np.unique(response["position_m"])
    centre = response["position_m"] == places[int(np.argmin(np.abs(places - np.mean(places))))]
    ends = float(response["frequency_hz"].min()), float(response["frequency_hz"].max())
    fit_hz = np.geomspace(*ends, _FIT_POINTS)
    above, middle, below = list[Curve](), list[Curve](), list[Curve]()
    for position_m, role in zip(places, depth_roles(places.size), strict=True):
        rows = response["position_m"] == position_m
        hz, compliance = response["frequency_hz"][rows], response["compliance_m_per_n"][rows]
        row = int(np.argmin(np.abs(sweep["position_m"] - position_m)))
        system = SecondOrder(*(float(sweep[n][row]) for n in ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")))
        fitted = system.frequency_response(fit_hz)
        phase, measured = np.degrees(np.unwrap(np.angle(fitted))), np.degrees(response["phase_rad"][rows])
        above += _fitted_and_measured(fit_hz, 1e3 * np.abs(fitted), hz, 1e3 * compliance, role)
        below += _fitted_and_measured(fit_hz, phase, hz, measured, role)
        relative = 100.0 * compliance / response["compliance_m_per_n"][centre]
        middle.append(Curve(hz, relative, "", role, width=0.7))
    frequency = replace(FREQUENCY, limits=ends)
    depths = Axis(marked("Position"), "mm", limits=(1e3 * float(places.min()), 1e3 * float(places.max())))
    return (
        Plot("", frequency, Axis(marked("Compliance"), "mm/N", log=True), tuple(above), depths=depths),
        Plot("", frequency, Axis(marked("Of mid-stroke"), "%"), tuple(middle), depths=depths),
        Plot("", frequency, Axis(marked("Phase"), "°", limits=(-200.0, 20.0)), tuple(below), depths=depths),
    )


def _fitted_and_measured(fit_hz: Array, line: Array, hz: Array, points: Array, role: str) -> list[Curve]:
    return [Curve(fit_hz, line, "", role, width=0.7), Curve(hz, points, "", role, "points", width=0.7)]


def sweep_repeat_plots(columns: Columns) -> tuple[Plot, Plot]:
    """Return force constant and ends of the linear region of each repeat of a sweep, relative to their means."""
    run, constant = columns["run"], columns["force_constant_n_per_a"]
    share = Curve(run, 100.0 * (constant / constant.mean() - 1.0), kind="points", marker="o")
    ends = [
        Curve(run, 1e3 * (columns[column] - columns[column].mean()), name, colour, "points", marker=marker)
        for column, name, colour, marker in (
            ("linear_region_min_m", marked("beginning"), "model", "s"),
            ("linear_region_max_m", marked("end"), "good", "^"),
        )
    ]
    sweeps = Axis(marked("Sweep"), ticks=whole_ticks(int(run.min()), int(run.max())))
    return (
        Plot("", sweeps, Axis(marked("Force constant, from the mean"), "%", zero=True), (share,)),
        Plot("", sweeps, Axis(marked("Linear region, from the mean"), "mm", zero=True), tuple(ends)),
    )
