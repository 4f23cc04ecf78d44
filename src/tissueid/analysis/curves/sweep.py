"""Plots of a dynamic sweep: parameters and Bode diagrams by position, force constant by method (Chen 2010, 2.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tissueid.analysis.curves.calibration import ALONG_STROKE
from tissueid.analysis.curves.plot import CONFIDENCE, Array, Axis, Curve, Kind, Plot, depth_roles, whole_ticks
from tissueid.analysis.curves.units import FREQUENCY
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked

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
    """Linear region (m), its mean force constant, and the one that the instrument used before the sweep (N/A)."""

    min_m: float
    max_m: float
    plateau_n_per_a: float
    believed_n_per_a: float | None

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
            found, reach = profile[f"{method}_n_per_a"], CONFIDENCE * profile[f"{method}_std_n_per_a"]
            curve = Curve(position, found, name, colour, kind, found - reach, found + reach)
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
    y, *ends = (100.0 * (one / value - 1.0) for one in (curve.y, curve.low, curve.high))
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
    for place, role in zip(places, depth_roles(places.size), strict=True):
        rows = response["position_m"] == place
        hz, compliance = response["frequency_hz"][rows], response["compliance_m_per_n"][rows]
        row = int(np.argmin(np.abs(sweep["position_m"] - place)))
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


__all__ = [
    "Columns",
    "Region",
    "bode_plots",
    "force_constant_plots",
    "parameter_plots",
    "sweep_repeat_plots",
]
