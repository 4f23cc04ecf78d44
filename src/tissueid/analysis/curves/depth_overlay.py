"""Plots of fits of several tests by depth: profiles, Bode diagrams, impulse responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.depth import QUANTITIES, limits_of, profile_curve, range_of
from tissueid.analysis.curves.linear import response_axes
from tissueid.analysis.curves.overlay import MARKERS, colour_of, kind_of, series_name
from tissueid.analysis.curves.plot import CONFIDENCE, DEPTHS, Array, Axis, Curve, Plot, depth_roles
from tissueid.analysis.curves.units import FREQUENCY, LAG, kernel_unit
from tissueid.analysis.overlay import Overlay, series_profiles
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message

_DENSE = 25
"""Number of rows above which a profile is drawn as a curve with a band."""
_BAND = (0.2, 5.0)
"""Ends of a Bode diagram by depth, as multiples of the lowest and the highest natural frequency."""
_FEW_PROFILES = Message("overlay.no_profile", "no fit gives mass, damping and stiffness of force and position")
Columns = Mapping[str, Array]
_POINTS = 300


def depth_overlay(found: Overlay, calibration: Columns | None = None) -> tuple[Plot, Plot, Plot]:
    """Return mass, damping and stiffness against depth of every series (Chen 2010, Figs. 3.13, 5.9 to 5.11).

    Each source has a colour and each fit a marker, solid for the first one and hollow for the others. Rows of a
    direction are joined by a line; the way out is dotted.

    Args:
        found: the fits.
        calibration: columns of a dynamic sweep, SI, drawn below: ``position_m`` and the three parameters. The abscissa
            is then the position on the actuator; otherwise the depth, where every surface is known.

    Raises:
        UnusableInputError: no fit gives the parameters.
    """
    from_surface = calibration is None and all(np.isfinite(entry.surface_position_m) for entry in found.entries)
    series = series_profiles(found, from_surface=from_surface)
    if not series:
        raise UnusableInputError(_FEW_PROFILES)
    x = Axis(marked("Depth") if from_surface else marked("Position"), "mm")
    if calibration is not None:
        x = replace(x, limits=_near([profile.position for profile in series.values()]))
    made = []
    for quantity, (axis, _column, _scale) in QUANTITIES.items():
        parts: list[Curve] = []
        ends: list[Array] = []
        if below := {} if calibration is None else calibration_curves(calibration):
            parts += [below[quantity]] if quantity in below else []
            ends += [curve.y for curve in parts]
        for (source, fit), profile in series.items():
            name = series_name(found, source, fit)
            for way in (0, 1, -1):
                rows = np.flatnonzero(profile.direction == way)
                if rows.size:
                    curve = profile_curve(profile, quantity, rows, deviations=CONFIDENCE)
                    parts += _styled(found, curve, source, fit, name, way)
                    ends.append(range_of(curve))
                    name = ""
        made.append(Plot(axis.label, x, replace(axis, limits=limits_of(np.concatenate(ends))), tuple(parts)))
    return made[0], made[1], made[2]


def _near(positions: Sequence[Array]) -> tuple[float, float]:
    """Return limits, mm, of the stretch of the stroke about positions (k,), m: three times as long as they are."""
    every = 1e3 * np.concatenate(positions)
    low, high = float(every.min()), float(every.max())
    return max(0.0, low - (high - low) - 1.0), high + (high - low) + 1.0


def calibration_curves(calibration: Columns) -> dict[str, Curve]:
    """Return mass, damping and stiffness of a dynamic sweep along the stroke, by the names of ``QUANTITIES``."""
    return {
        quantity: _calibration_curve(calibration, column, scale)
        for quantity, (_axis, column, scale) in QUANTITIES.items()
        if column in calibration
    }


def _calibration_curve(calibration: Columns, column: str, scale: float) -> Curve:
    """Return a parameter of the dynamic sweep along the stroke, with its 95 % band where it is known."""
    x, y = 1e3 * calibration["position_m"], scale * calibration[column]
    std = calibration.get(column.replace("_kg", "_std_kg").replace("_n_", "_std_n_"))
    low, high = (None, None) if std is None else (y - CONFIDENCE * scale * std, y + CONFIDENCE * scale * std)
    return Curve(x, y, marked("calibration spring"), "muted", "line", low, high, width=1.5)


def _styled(found: Overlay, curve: Curve, source: str, fit: str, name: str, way: int) -> list[Curve]:
    place = found.fits.index(fit)
    colour, kind = colour_of(found, source, fit), kind_of(found, fit)
    if curve.x.size > _DENSE:
        return [replace(curve, name=name, colour=colour, kind=kind, width=1.2)]
    marker = MARKERS[place % len(MARKERS)]
    line = Curve(curve.x, curve.y, "", colour, "dotted" if way < 0 else kind, width=0.6, opacity=0.7)
    points = Curve(curve.x, curve.y, name, colour, "points" if place == 0 else "circles", width=1.4, marker=marker)
    bars = replace(curve, colour=colour, kind="bars", marker=",", width=0.1)
    return [line, bars, points]


def bode_by_depth(found: Overlay) -> list[tuple[Plot, Plot]]:
    """Return magnitude and phase of the second-order system at each row of each series (Chen 2010, Fig. 3.13).

    A column for each series with two rows or more and not more than a curve's; colours run from shallow to deep.

    Raises:
        UnusableInputError: no series has two rows.
    """
    series = _by_depth(found)
    systems = {key: _systems(profile) for key, profile in series.items()}
    natural = [s.natural_frequency_rad_per_s / (2.0 * np.pi) for some in systems.values() for s in some]
    frequency_hz = np.geomspace(_BAND[0] * min(natural), _BAND[1] * max(natural), _POINTS)
    frequency = replace(FREQUENCY, limits=(float(frequency_hz[0]), float(frequency_hz[-1])))
    magnitude, phase = response_axes(found.entries[0].analysis.record)
    made = []
    depths = _depths(series)
    for (source, fit), profile in series.items():
        upper, lower = [], []
        for system, role in zip(systems[source, fit], _roles(profile, depths), strict=True):
            answer = system.frequency_response(frequency_hz)
            upper.append(Curve(frequency_hz, 1e3 * np.abs(answer), "", role))
            lower.append(Curve(frequency_hz, np.degrees(np.unwrap(np.angle(answer))), "", role))
        name = series_name(found, source, fit)
        made.append((Plot(name, frequency, magnitude, tuple(upper)), Plot("", frequency, phase, tuple(lower))))
    return _with_depths(made, depths)


def impulse_by_depth(found: Overlay) -> list[tuple[Plot, Plot]]:
    """Return the impulse response at each row of each series, and each divided by its area (Chen 2010, Fig. 3.12a).

    Raises:
        UnusableInputError: no series has two rows.
    """
    series = _by_depth(found)
    systems = {key: _systems(profile) for key, profile in series.items()}
    slowest = min(s.natural_frequency_rad_per_s for some in systems.values() for s in some)
    time_s = np.linspace(0.0, 3.0 * np.pi / slowest, _POINTS)
    unit, scale = kernel_unit(found.entries[0].analysis.record)
    lag = replace(LAG, limits=(0.0, 1e3 * float(time_s[-1])))
    made = []
    depths = _depths(series)
    for (source, fit), profile in series.items():
        upper, lower = [], []
        for system, role in zip(systems[source, fit], _roles(profile, depths), strict=True):
            response = system.impulse_response(time_s)
            upper.append(Curve(1e3 * time_s, scale * response, "", role))
            lower.append(Curve(1e3 * time_s, response * system.stiffness, "", role))
        name = series_name(found, source, fit)
        made.append(
            (
                Plot(name, lag, Axis(marked("Impulse response"), unit, zero=True), tuple(upper)),
                Plot("", lag, Axis(marked("Divided by its area"), "1/s", zero=True), tuple(lower)),
            )
        )
    return _with_depths(made, depths)


def _by_depth(found: Overlay) -> dict[tuple[str, str], DepthProfile]:
    """Return the series with several rows, without rows that lack a parameter or a positive one.

    Raises:
        UnusableInputError: there is none.
    """
    made = {}
    for key, profile in series_profiles(found).items():
        values = np.stack([profile.mass, profile.damping, profile.stiffness])
        known = np.isfinite(values).all(axis=0) & (values[[0, 2]] > 0.0).all(axis=0)
        if int(known.sum()) >= 2 and len(profile) <= _DENSE:
            made[key] = replace(
                profile, **{name: getattr(profile, name)[known] for name in DepthProfile.__dataclass_fields__}
            )
    if not made:
        raise UnusableInputError(
            "overlay.one_depth", "no series has parameters at several depths: give several tests one label"
        )
    return made


def _systems(profile: DepthProfile) -> list[SecondOrder]:
    columns = zip(profile.mass, profile.damping, profile.stiffness, strict=True)
    return [SecondOrder(float(mass), float(damping), float(stiffness)) for mass, damping, stiffness in columns]


def _depths(series: Mapping[tuple[str, str], DepthProfile]) -> Axis:
    """Return the axis of the colours that all series share."""
    positions = 1e3 * np.concatenate([profile.position for profile in series.values()])
    return Axis(marked("Position"), "mm", limits=(float(positions.min()), float(positions.max())))


def _roles(profile: DepthProfile, depths: Axis) -> list[str]:
    """Return the role of the colour of each row."""
    low, high = depths.limits or (0.0, 1.0)
    every = depth_roles(DEPTHS)
    places = np.round((DEPTHS - 1) * (1e3 * profile.position - low) / max(high - low, 1e-9)).astype(np.intp)
    return [every[place] for place in places]


def _with_depths(columns: list[tuple[Plot, Plot]], depths: Axis) -> list[tuple[Plot, Plot]]:
    """Return the columns with the colour bar at the last one."""
    upper, lower = columns[-1]
    return [*columns[:-1], (replace(upper, depths=depths), replace(lower, depths=depths))]
