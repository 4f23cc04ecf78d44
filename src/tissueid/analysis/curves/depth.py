"""Curves of mass, damping and stiffness against depth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    KINDS,
    MARKERS,
    Array,
    Axis,
    Bars,
    Curve,
    Plot,
    banded,
    cloud,
    signal_axis,
)
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.dpn.fit import CurveBand
from tissueid.identification.engines.dpn import DpnModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

QUANTITIES = {
    "mass": (Axis(marked("Mass"), "g"), "mass_kg", 1e3),
    "damping": (Axis(marked("Damping"), "N·s/m"), "damping_n_s_per_m", 1.0),
    "stiffness": (Axis(marked("Stiffness"), "N/m"), "stiffness_n_per_m", 1.0),
}
"""Axis, name of the parameter, and factor from SI to the unit of the axis."""

_COLOURS = ("measured", "model", "good", "check", "muted")
DENSE = 25
"""Number of rows above which a profile is drawn as a curve with a band, not as points with bars."""
_WIDEST = 1.5
"""Largest ratio of half bar to value for which a bar counts for the limits of a plot."""
_DIRECTION_OFFSET = 0.01
"""Shift of each direction, as a share of the range of depths, so that neither hides the other."""
_BINS = 50
_DPN_BINS = 60
_WAYS = {1: marked("inwards"), -1: marked("outwards")}
_Series = tuple[str, DepthProfile, NDArray[np.intp]]
"""A name, a profile, and the indices of its rows: one colour and marker."""


def profile_curve(
    profile: DepthProfile,
    quantity: str,
    rows: NDArray[np.intp] | NDArray[np.bool_],
    *,
    deviations: float = 1.0,
    origin_m: float = 0.0,
) -> Curve:
    """Return one quantity of some rows of a profile against depth (mm), with a band of some standard deviations."""
    scale = QUANTITIES[quantity][2]
    x = 1e3 * (profile.position[rows] - origin_m)
    y, std = scale * getattr(profile, quantity)[rows], scale * getattr(profile, f"{quantity}_std")[rows]
    return banded(x, y, deviations * std, colour="model")


def depth_plots(analysis: Analysis) -> tuple[Plot, Plot, Plot]:
    """Return mass, damping and stiffness against position, each with one standard deviation.

    A faint curve shows retraction if it differs from indentation. An engine without a profile gives a point at
    the mean position.

    Raises:
        UnusableInputError: the engine estimates no mass, damping and stiffness.
    """
    profile = analysis.depth_profile()
    position = Axis(marked("Position"), "mm")
    made = []
    for quantity, (axis, _name, _scale) in QUANTITIES.items():
        if profile is None:
            parts = [_point(analysis, quantity)]
        else:
            parts = [profile_curve(profile, quantity, profile.direction >= 0)]
            out = profile.direction < 0
            if out.any():
                back = profile_curve(profile, quantity, out)
                parts.append(Curve(back.x, back.y, marked("faint: on the way out"), "model", opacity=0.5, width=0.8))
        made.append(Plot(axis.label, position, axis, tuple(parts)))
    return made[0], made[1], made[2]


def _point(analysis: Analysis, quantity: str) -> Curve:
    """Return the parameter of a linear system as a point at the mean position of the test."""
    record, parameters = analysis.record[analysis.fit_part], analysis.model.report.reportable_parameters
    complete = all(name in parameters for _axis, name, _scale in QUANTITIES.values())
    if (record.output_unit, record.input_unit) != ("m", "N") or not complete:
        raise UnusableInputError(
            "research.no_second_order", "this engine estimates no mass, damping and stiffness from this record"
        )
    _axis, name, scale = QUANTITIES[quantity]
    where: Array = np.array([1e3 * float(np.nanmean(record.output))])
    return Curve(where, np.array([scale * parameters[name].value]), colour="model", kind="points", width=2.0)


def profile_plots(
    profiles: Mapping[str, DepthProfile], surface_position_m: float = float("nan"), visited: Array | None = None
) -> tuple[Plot, Plot, Plot, Plot]:
    """Return mass, damping and stiffness against depth with 95 % bars or bands, and the number of samples.

    Args:
        profiles: profiles by their name in the key.
        surface_position_m: origin of depth, m; NaN for positions on the actuator.
        visited: output (n,), m, whose samples are counted; None for the support of the profiles.

    Raises:
        UnusableInputError: no row holds a value.
    """
    estimated = {name: p for name, p in profiles.items() if np.isfinite(p.stiffness).any() or np.isfinite(p.mass).any()}
    if not estimated:
        raise UnusableInputError("report.no_profile", "mass, damping and stiffness could not be estimated at any depth")
    x, origin = depth_axis(surface_position_m)
    series = [
        (_one_direction(name, way), profile, np.flatnonzero(profile.direction == way))
        for name, profile in estimated.items()
        for way in (0, 1, -1)
        if (profile.direction == way).any()
    ]
    made = []
    for quantity, (axis, _name, _scale) in QUANTITIES.items():
        curves = [_series_curve(entry, quantity, origin) for entry in series]
        styled = (_styled(*item, index, origin) for index, item in enumerate(zip(curves, series, strict=True)))
        limits = limits_of(np.concatenate([range_of(curve) for curve in curves]))
        made.append(Plot(axis.label, x, replace(axis, limits=limits), tuple(chain.from_iterable(styled))))
    counts = [_support(entry, index, len(series), origin) for index, entry in enumerate(series)]
    if visited is not None:
        counts = [sample_counts(visited, origin, _BINS)]
    samples = Axis(marked("Samples"))
    return made[0], made[1], made[2], Plot(samples.label, x, samples, tuple(counts))


def dpn_plots(model: DpnModel, positions: Array, surface_position_m: float) -> tuple[Plot, Plot, Plot, Plot]:
    """Return mass, damping and stiffness of the dynamic-parameter nonlinearity with 95 % bands, and its samples.

    Args:
        model: a model of force and position.
        positions: where the curves are evaluated (k,), m.
        surface_position_m: origin of depth, m; NaN for positions on the actuator.
    """
    estimated = model.estimated
    x, origin = depth_axis(surface_position_m)
    mass = [(estimated.mass(positions), marked("mass"))]
    if estimated.curves.direction.size:
        inwards, outwards = marked("into the tissue"), marked("out of the tissue")
        damping = [(estimated.damping(positions, 1), inwards), (estimated.damping(positions, -1), outwards)]
    else:
        damping = [(estimated.damping(positions, 0), marked("damping"))]
    stiffness = [(estimated.stiffness(positions), marked("tangent, dF/dy"))]
    if model.surface_position_m is not None:
        stiffness.append((estimated.secant(positions, model.surface_position_m), marked("secant, F over depth")))
    made = []
    for bands, (axis, _name, scale) in zip((mass, damping, stiffness), QUANTITIES.values(), strict=True):
        parts = [
            _band_curve(band, 1e3 * (positions - origin), scale, index, name)
            for index, (band, name) in enumerate(bands)
        ]
        tops = np.concatenate([part.y if part.high is None else part.high for part in parts])
        top = float(np.max(tops[np.isfinite(tops)], initial=0.0))
        made.append(Plot(axis.label, x, replace(axis, limits=(0.0, 1.05 * top or 1.0)), tuple(parts)))
    samples = Axis(marked("Samples"))
    counts = sample_counts(estimated.position, origin, _DPN_BINS)
    return made[0], made[1], made[2], Plot(samples.label, x, samples, (counts,))


def static_force_plot(model: DpnModel, record: Record, positions: Array, surface_position_m: float) -> Plot:
    """Return the force at rest against depth with its 95 % band, over the samples of a record.

    Arguments as :func:`dpn_plots`.
    """
    x, origin = depth_axis(surface_position_m)
    samples = cloud(1e3 * (record.output - origin), record.input)
    force = _band_curve(model.estimated.force(positions), 1e3 * (positions - origin), 1.0, 1, marked("at rest, F(y)"))
    force = replace(force, kind="line", width=1.5)
    return Plot("", x, signal_axis(record.input_name, record.input_unit), (samples, force))


def _band_curve(band: CurveBand, depth_mm: Array, scale: float, index: int, name: str) -> Curve:
    """Return a parameter curve; its band closes on it where the band is unknown."""
    bounded = np.isfinite(band.low + band.high)
    low, high = np.where(bounded, band.low, band.value), np.where(bounded, band.high, band.value)
    look = name, _COLOURS[index], KINDS[index]
    return Curve(depth_mm, scale * band.value, *look, scale * low, scale * high, width=1.2)


def depth_axis(surface_position_m: float) -> tuple[Axis, float]:
    """Return the axis of depth, or of position where the surface is unknown (NaN), and its origin, m."""
    is_depth = bool(np.isfinite(surface_position_m))
    return Axis(marked("Depth") if is_depth else marked("Position"), "mm"), surface_position_m if is_depth else 0.0


def sample_counts(positions: Array, origin_m: float, bins: int) -> Bars:
    """Return how many of some positions (n,), m, lie in each of equal ranges of depth."""
    heights, edges = np.histogram(1e3 * (positions[np.isfinite(positions)] - origin_m), bins=bins)
    middles = 0.5 * (edges[:-1] + edges[1:])
    return Bars(middles, heights.astype(np.float64), np.diff(edges), colour="muted", opacity=0.5)


def _one_direction(name: str, way: int) -> str:
    """Return the name of a profile with its direction, if it has one."""
    if not way or not name:
        return _WAYS.get(way, name)
    return Message("plot.direction", "{name}, {direction}", name=name, direction=_WAYS[way])


def _series_curve(series: _Series, quantity: str, origin_m: float) -> Curve:
    _name, profile, rows = series
    curve = profile_curve(profile, quantity, rows, deviations=CONFIDENCE, origin_m=origin_m)
    shift = _DIRECTION_OFFSET * float(profile.direction[rows[0]]) * float(np.ptp(curve.x))
    return replace(curve, x=curve.x + shift)


def _styled(curve: Curve, series: _Series, index: int, origin_m: float) -> list[Curve]:
    """Return the curves that show one series: a band, or bars with the range of depths of each row."""
    name, profile, rows = series
    colour, kind = _COLOURS[index % len(_COLOURS)], KINDS[index % len(KINDS)]
    if rows.size > DENSE:
        return [replace(curve, name=name, colour=colour, kind=kind, width=1.2)]
    gap = np.full(rows.size, np.nan)
    ranges = np.stack([1e3 * (profile.low[rows] - origin_m), 1e3 * (profile.high[rows] - origin_m), gap], axis=1)
    return [
        Curve(ranges.ravel(), np.repeat(curve.y, 3), colour=colour, width=0.6, opacity=0.6),
        replace(curve, name=name, colour=colour, kind="bars", marker=MARKERS[index % len(MARKERS)]),
        Curve(curve.x, curve.y, colour=colour, kind=kind, width=0.6, opacity=0.6),
    ]


def range_of(curve: Curve) -> Array:
    """Return the values that the limits of a plot must contain: those of a curve and of its bars, unless too wide."""
    high = curve.y if curve.high is None else curve.high
    half = high - curve.y
    ends = np.where(half < _WIDEST * np.abs(curve.y), half, 0.0)
    return np.concatenate([curve.y - ends, curve.y + ends])


def limits_of(values: Array) -> tuple[float, float] | None:
    """Return limits that begin at zero where the values allow it; None where no value is finite."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return None
    return 1.1 * min(0.0, float(finite.min())), 1.1 * max(0.0, float(finite.max())) or 1.0


def _support(series: _Series, index: int, count: int, origin_m: float) -> Bars:
    """Return the support of the rows of one of ``count`` series, next to each other in each range of depths."""
    _name, profile, rows = series
    low, high = 1e3 * (profile.low[rows] - origin_m), 1e3 * (profile.high[rows] - origin_m)
    width = (high - low) / count
    heights = profile.support[rows].astype(np.float64)
    colour = _COLOURS[index % (len(_COLOURS) - 1)]
    return Bars(low + (index + 0.5) * width, heights, width, colour=colour, opacity=0.5)
