"""Plots of fits of several tests: responses, nonlinearities, scores, by depth; correlations of their signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from tissueid.analysis.curves.depth import DENSE, QUANTITIES, limits_of, profile_curve, range_of
from tissueid.analysis.curves.linear import excited, impulse_curve, response_axes, response_curves, spectra_of
from tissueid.analysis.curves.nonlinearity import linear_output
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    DEPTHS,
    FREQUENCY,
    KINDS,
    LAG,
    MARKERS,
    Array,
    Axis,
    Curve,
    Kind,
    Plot,
    banded,
    cloud,
    depth_roles,
    kernel_unit,
    signal_axis,
)
from tissueid.analysis.overlay import Overlay, OverlayEntry, series_profiles
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.second_order import SecondOrder
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.records import Record
from tissueid.units import display_unit

COLOURS = ("measured", "model", "good", "check", "poor", "text")
"""Colours of sources, in their order."""
_POINTS = 300
_LOOPS_S = 0.5
"""Seconds whose samples are joined by a line."""
_MOST_LINE = 1500
"""Largest number of samples of that line: longer lines are drawn as ranges, which hides loops."""


def colour_of(overlay: Overlay, source: str, fit: str) -> str:
    """Return the colour of a series: that of its source, or of its fit where there is one source.

    Series with a number, such as "forearm (2)", have the colour of their source.
    """
    names = overlay.sources
    index = names.index(source) if source in names else names.index(source.rpartition(" (")[0])
    if len(names) == 1:
        index = overlay.fits.index(fit)
    return COLOURS[index % len(COLOURS)]


def style_of(overlay: Overlay, entry: OverlayEntry) -> tuple[str, Kind]:
    """Return colour and line style of an entry."""
    return colour_of(overlay, entry.source, entry.fit.label), kind_of(overlay, entry.fit.label)


def kind_of(overlay: Overlay, fit: str) -> Kind:
    """Return the line style of a fit."""
    return KINDS[overlay.fits.index(fit) % len(KINDS)]


def named(text: str) -> str:
    """Return the label of a source or fit, which is data of a user and is not translated.

    A thin space stands before an underscore: keys leave out what begins with one.
    """
    return Verbatim(f"\u200a{text}" if text.startswith("_") else text)


def series_name(overlay: Overlay, source: str, fit: str) -> str:
    """Return the name of a series in a key: what distinguishes it."""
    if len(overlay.fits) == 1:
        return named(source)
    return named(fit if len(overlay.sources) == 1 else f"{source}, {fit}")


def response_overlay(overlay: Overlay) -> tuple[Plot, Plot, Plot]:
    """Return impulse response, magnitude and phase of every fit, laid over each other.

    Raises:
        UnusableInputError: no fit has an impulse response.
    """
    impulses, upper, lower, said = list[Curve](), list[Curve](), list[Curve](), set[str]()
    for entry in overlay.entries:
        label = overlay.label(entry)
        name, (colour, kind) = "" if label in said else named(label), style_of(overlay, entry)
        try:
            impulse = impulse_curve(entry.analysis.model, entry.analysis.record, entry.analysis)
            spectra = spectra_of(entry.analysis)
            excited(spectra)
            answers = response_curves(entry.analysis, spectra)
        except UnusableInputError:
            continue
        for into, curve in zip((impulses, upper, lower), (impulse, *answers), strict=True):
            into.append(replace(curve, name=name, colour=colour, kind=kind, low=None, high=None))
        said.add(label)
    if not impulses:
        raise UnusableInputError("overlay.no_response", "no fit has an impulse response")
    record = overlay.entries[0].analysis.record
    magnitude, phase = response_axes(record)
    return (
        Plot("", LAG, Axis(marked("Impulse response"), kernel_unit(record)[0], zero=True), tuple(impulses)),
        Plot("", FREQUENCY, magnitude, tuple(upper)),
        Plot("", FREQUENCY, phase, tuple(lower)),
    )


# -- static nonlinearity ----------------------------------------------------------------------------------------------


def nonlinearity_overlay(overlay: Overlay) -> tuple[Plot, ...]:
    """Return measured output against the output of the linear stage, a panel for each source (Chen 2010, 3.11, 3.12).

    All samples are a pale cloud. A line follows a stretch of them in time, so that a system whose dynamics depend on
    its output shows loops. Dashed, the fitted nonlinearities. Panels have the same axes where their samples overlap.

    Raises:
        UnusableInputError: no fit is a Wiener cascade.
    """
    panels: dict[str, list[OverlayEntry]] = {}
    for entry in overlay.entries:
        if isinstance(entry.analysis.model, WienerModel):
            panels.setdefault(entry.source, []).append(entry)
    if not panels:
        raise UnusableInputError(
            "overlay.no_nonlinearity", "no fit is a Wiener cascade, which has a static nonlinearity"
        )
    record = overlay.entries[0].analysis.record
    (in_unit, into), out = display_unit(record.input_unit), display_unit(record.output_unit)[1]
    made: list[tuple[str, list[Curve]]] = []
    for source, entries in panels.items():
        clouds, lines, curves = list[Curve](), list[Curve](), list[Curve]()
        colours = depth_roles(len(entries)) if len(entries) > 1 else [colour_of(overlay, source, entries[0].fit.label)]
        for entry, colour in zip(entries, colours, strict=True):
            z, y, model = _static_points(entry)
            clouds.append(cloud(into * z, out * y, colour))
            stretch = slice(0, min(_MOST_LINE, round(_LOOPS_S * entry.analysis.record.sample_rate_hz)))
            lines.append(Curve(into * z[stretch], out * y[stretch], "", colour, width=0.5))
            fine = np.linspace(*_span(z), 100)
            curves.append(Curve(into * fine, out * model.nonlinearity(fine), "", "text", "dashed", width=1.2))
        made.append((named(source), [*clouds, *lines, *curves]))
    x = Axis(signal_axis("predicted_linear_output", record.input_unit).label, in_unit)
    y_axis = signal_axis(f"measured_{record.output_name}", record.output_unit)
    ends = [(_ends(parts, "x"), _ends(parts, "y")) for _name, parts in made]
    middles = [0.5 * (low + high) for _across, (low, high) in ends]
    if all(low < middle < high for _across, (low, high) in ends for middle in middles):
        every = [curve for _name, parts in made for curve in parts]
        ends = [(_ends(every, "x"), _ends(every, "y"))] * len(made)
    return tuple(
        Plot(name, replace(x, limits=across), replace(y_axis, limits=along), tuple(parts))
        for (name, parts), (across, along) in zip(made, ends, strict=True)
    )


def loop_width(entry: OverlayEntry, bins: int = 20) -> float:
    """Return the difference of the output on the way in and on the way out at the same linear output, m.

    The root mean square over bins of the linear output of the difference of the two means: zero for a linear system and
    for a Wiener cascade, positive where the dynamics depend on the output (Chen 2010, 3.4).
    """
    z, y, _model = _static_points(entry)
    edges = np.quantile(z, np.linspace(0.05, 0.95, bins + 1))
    bin_index, inwards = np.digitize(z, edges), np.gradient(z) > 0.0
    differences = []
    for number in range(1, bins + 1):
        ways = [y[(bin_index == number) & way] for way in (inwards, ~inwards)]
        if min(outputs.size for outputs in ways) >= 5:
            differences.append(float(ways[0].mean() - ways[1].mean()))
    return float(np.sqrt(np.mean(np.square(differences)))) if differences else float("nan")


def _static_points(entry: OverlayEntry) -> tuple[Array, Array, WienerModel]:
    """Return output of the linear stage and measured output (k,) of the fitted samples, and the cascade."""
    model = cast(WienerModel, entry.analysis.model)
    return *linear_output(model, entry.analysis.record, entry.analysis.fit_part), model


def _span(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _ends(curves: Sequence[Curve], name: str) -> tuple[float, float]:
    values = np.concatenate([getattr(curve, name) for curve in curves])
    low, high = _span(values[np.isfinite(values)])
    return low - 0.04 * (high - low), high + 0.04 * (high - low)


# -- scores -----------------------------------------------------------------------------------------------------------


def score_overlay(overlay: Overlay) -> Plot:
    """Return VAF of every entry: of the fitted samples, held out, and scheduled by the measured output.

    Entries with the same label share a row.

    Raises:
        UnusableInputError: every fit is swept.
    """
    entries = [entry for entry in overlay.entries if entry.swept is None]
    if not entries:
        raise UnusableInputError("overlay.all_swept", "every fit is swept")
    labels = list(dict.fromkeys(overlay.label(entry) for entry in entries))
    places = np.array([float(len(labels) - labels.index(overlay.label(entry))) for entry in entries])
    reports = [entry.analysis.model.report for entry in entries]
    columns = (
        (marked("fitted samples"), "muted", [r.vaf_percent for r in reports], "o"),
        (marked("held out, free run"), "measured", [r.vaf_validation_percent for r in reports], "o"),
        (marked("fitted, scheduled by measured output"), "model", [e.scheduled_percent for e in entries], "D"),
    )
    parts = []
    for name, colour, values, marker in columns:
        percent = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        if np.isfinite(percent).any():
            kind: Kind = "circles" if colour == "muted" else "points"
            parts.append(Curve(np.clip(percent, 0.0, 100.0), places, name, colour, kind, width=1.5, marker=marker))
    ticks = tuple((float(len(labels) - index), named(label)) for index, label in enumerate(labels))
    y = Axis(limits=(0.4, len(labels) + 0.6), ticks=ticks)
    low = min(float(np.nanmin(curve.x)) for curve in parts)
    return Plot("", Axis(marked("Variance accounted for"), "%", limits=(max(0.0, low - 4.0), 101.0)), y, tuple(parts))


def sweep_overlay(overlay: Overlay) -> tuple[Plot, Plot]:
    """Return VAF and AICc on the fitted samples against the swept option (Chen 2010, Fig. 8.1).

    A line for each source and fit. Models with a schedule show the run that is scheduled by the measured output.

    Raises:
        UnusableInputError: nothing was swept.
    """
    rows: dict[tuple[str, str], list[OverlayEntry]] = {}
    for entry in overlay.entries:
        if entry.swept is not None:
            rows.setdefault((entry.source, entry.fit.label), []).append(entry)
    if not rows:
        raise UnusableInputError("overlay.no_sweep", "no option was swept")
    scale = 1e3 if overlay.swept == "memory" else 1.0
    upper, lower = list[Curve](), list[Curve]()
    for index, ((source, fit), entries) in enumerate(rows.items()):
        x = scale * np.array([float(entry.swept or 0.0) for entry in entries])
        fitted = np.array([entry.shown_percent for entry in entries])
        criterion = [e.analysis.model.report.aicc if e.scheduled_aicc is None else e.scheduled_aicc for e in entries]
        aicc = 1e-3 * np.array([np.nan if value is None else value for value in criterion])
        style = COLOURS[index % len(COLOURS)], KINDS[index % len(KINDS)]
        name = series_name(overlay, source, fit)
        for into, values in ((upper, fitted), (lower, aicc)):
            line = Curve(x, values, name, *style, width=0.9)
            into.append(replace(line, marker=MARKERS[index % len(MARKERS)]))
    axis = Axis(marked("Memory"), "ms") if overlay.swept == "memory" else Axis(_option_label(overlay))
    values = np.concatenate([curve.y for curve in lower])
    values = values[np.isfinite(values)]
    lowest = float(values.min()) if values.size else 0.0
    ordinary = np.quantile(values, 0.9) if values.size else 0.0
    limits = (lowest - 0.5, min(float(values.max(initial=0.0)), float(ordinary) + 6.0) + 0.5) if values.size else None
    return (
        Plot("", axis, Axis(marked("VAF, fitted"), "%"), tuple(upper)),
        Plot("", axis, Axis(marked("AICc (thousands)"), limits=limits), tuple(lower)),
    )


def _option_label(overlay: Overlay) -> str:
    for entry in overlay.entries:
        field = type(entry.fit.engine).model_fields.get(overlay.swept)
        if field is not None and field.title:
            return field.title
    return named(overlay.swept)


_BAND = (0.2, 5.0)
"""Ends of a Bode diagram by depth, as multiples of the lowest and the highest natural frequency."""
Columns = Mapping[str, Array]


def depth_overlay(overlay: Overlay, calibration: Columns | None = None) -> tuple[Plot, Plot, Plot]:
    """Return mass, damping and stiffness against depth of every series (Chen 2010, Figs. 3.13, 5.9 to 5.11).

    Each source has a colour and each fit a marker, solid for the first one and hollow for the others. Rows of a
    direction are joined by a line; the way out is dotted.

    Args:
        overlay: the fits.
        calibration: columns of a dynamic sweep, SI, drawn below: ``position_m`` and the three parameters. The abscissa
            is then the position on the actuator; otherwise the depth, where every surface is known.

    Raises:
        UnusableInputError: no fit gives the parameters.
    """
    from_surface = calibration is None and all(np.isfinite(entry.surface_position_m) for entry in overlay.entries)
    series = series_profiles(overlay, from_surface=from_surface)
    if not series:
        raise UnusableInputError("overlay.no_profile", "no fit gives mass, damping and stiffness of force and position")
    x = Axis(marked("Depth") if from_surface else marked("Position"), "mm")
    if calibration is not None:
        # The stretch of the stroke about the positions, three times as long as they are.
        low, high = _span(1e3 * np.concatenate([profile.position for profile in series.values()]))
        x = replace(x, limits=(max(0.0, low - (high - low) - 1.0), high + (high - low) + 1.0))
    made = []
    for quantity, (axis, _column, _scale) in QUANTITIES.items():
        parts: list[Curve] = []
        ends: list[Array] = []
        if below := {} if calibration is None else calibration_curves(calibration):
            parts += [below[quantity]] if quantity in below else []
            ends += [curve.y for curve in parts]
        for (source, fit), profile in series.items():
            name = series_name(overlay, source, fit)
            for way in (0, 1, -1):
                rows = np.flatnonzero(profile.direction == way)
                if rows.size:
                    curve = profile_curve(profile, quantity, rows, deviations=CONFIDENCE)
                    parts += _styled(overlay, curve, source, fit, name, way)
                    ends.append(range_of(curve))
                    name = ""
        made.append(Plot(axis.label, x, replace(axis, limits=limits_of(np.concatenate(ends))), tuple(parts)))
    return made[0], made[1], made[2]


def calibration_curves(calibration: Columns) -> dict[str, Curve]:
    """Return mass, damping and stiffness of a dynamic sweep along the stroke, by the names of ``QUANTITIES``."""
    curves = {}
    for quantity, (_axis, column, scale) in QUANTITIES.items():
        if column in calibration:
            std = calibration.get(column.replace("_kg", "_std_kg").replace("_n_", "_std_n_"))
            half = None if std is None else CONFIDENCE * scale * std
            x, y = 1e3 * calibration["position_m"], scale * calibration[column]
            curves[quantity] = banded(x, y, half, marked("calibration spring"), "muted", width=1.5)
    return curves


def _styled(overlay: Overlay, curve: Curve, source: str, fit: str, name: str, way: int) -> list[Curve]:
    index = overlay.fits.index(fit)
    colour, kind = colour_of(overlay, source, fit), kind_of(overlay, fit)
    if curve.x.size > DENSE:
        return [replace(curve, name=name, colour=colour, kind=kind, width=1.2)]
    marker = MARKERS[index % len(MARKERS)]
    line = Curve(curve.x, curve.y, "", colour, "dotted" if way < 0 else kind, width=0.6, opacity=0.7)
    points = Curve(curve.x, curve.y, name, colour, "points" if index == 0 else "circles", width=1.4, marker=marker)
    bars = replace(curve, colour=colour, kind="bars", marker=",", width=0.1)
    return [line, bars, points]


def bode_by_depth(overlay: Overlay) -> list[tuple[Plot, Plot]]:
    """Return magnitude and phase of the second-order system at each row of each series (Chen 2010, Fig. 3.13).

    A column for each series with two rows or more and not more than a curve's; colours run from shallow to deep.

    Raises:
        UnusableInputError: no series has two rows.
    """
    series = _by_depth(overlay)
    systems = {key: _systems(profile) for key, profile in series.items()}
    natural = [s.natural_frequency_rad_per_s / (2.0 * np.pi) for some in systems.values() for s in some]
    frequency_hz = np.geomspace(_BAND[0] * min(natural), _BAND[1] * max(natural), _POINTS)
    frequency = replace(FREQUENCY, limits=(float(frequency_hz[0]), float(frequency_hz[-1])))
    magnitude, phase = response_axes(overlay.entries[0].analysis.record)
    made = []
    depths = _depths(series)
    for (source, fit), profile in series.items():
        upper, lower = [], []
        for system, role in zip(systems[source, fit], _roles(profile, depths), strict=True):
            answer = system.frequency_response(frequency_hz)
            upper.append(Curve(frequency_hz, 1e3 * np.abs(answer), "", role))
            lower.append(Curve(frequency_hz, np.degrees(np.unwrap(np.angle(answer))), "", role))
        name = series_name(overlay, source, fit)
        made.append((Plot(name, frequency, magnitude, tuple(upper)), Plot("", frequency, phase, tuple(lower))))
    return _with_depths(made, depths)


def impulse_by_depth(overlay: Overlay) -> list[tuple[Plot, Plot]]:
    """Return the impulse response at each row of each series, and each divided by its area (Chen 2010, Fig. 3.12a).

    Raises:
        UnusableInputError: no series has two rows.
    """
    series = _by_depth(overlay)
    systems = {key: _systems(profile) for key, profile in series.items()}
    slowest = min(s.natural_frequency_rad_per_s for some in systems.values() for s in some)
    time_s = np.linspace(0.0, 3.0 * np.pi / slowest, _POINTS)
    unit, scale = kernel_unit(overlay.entries[0].analysis.record)
    lag = replace(LAG, limits=(0.0, 1e3 * float(time_s[-1])))
    made = []
    depths = _depths(series)
    for (source, fit), profile in series.items():
        upper, lower = [], []
        for system, role in zip(systems[source, fit], _roles(profile, depths), strict=True):
            response = system.impulse_response(time_s)
            upper.append(Curve(1e3 * time_s, scale * response, "", role))
            lower.append(Curve(1e3 * time_s, response * system.stiffness, "", role))
        name = series_name(overlay, source, fit)
        made.append(
            (
                Plot(name, lag, Axis(marked("Impulse response"), unit, zero=True), tuple(upper)),
                Plot("", lag, Axis(marked("Divided by its area"), "1/s", zero=True), tuple(lower)),
            )
        )
    return _with_depths(made, depths)


def _by_depth(overlay: Overlay) -> dict[tuple[str, str], DepthProfile]:
    """Return the series with several rows, without rows that lack a parameter or a positive one.

    Raises:
        UnusableInputError: there is none.
    """
    made = {}
    for key, profile in series_profiles(overlay).items():
        values = np.stack([profile.mass, profile.damping, profile.stiffness])
        valid = np.isfinite(values).all(axis=0) & (values[[0, 2]] > 0.0).all(axis=0)
        if int(valid.sum()) >= 2 and len(profile) <= DENSE:
            made[key] = replace(
                profile, **{name: getattr(profile, name)[valid] for name in DepthProfile.__dataclass_fields__}
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
    limits = _span(1e3 * np.concatenate([profile.position for profile in series.values()]))
    return Axis(marked("Position"), "mm", limits=limits)


def _roles(profile: DepthProfile, depths: Axis) -> list[str]:
    """Return the role of the colour of each row."""
    low, high = depths.limits or (0.0, 1.0)
    every = depth_roles(DEPTHS)
    places = np.round((DEPTHS - 1) * (1e3 * profile.position - low) / max(high - low, 1e-9)).astype(np.intp)
    return [every[index] for index in places]


def _with_depths(columns: list[tuple[Plot, Plot]], depths: Axis) -> list[tuple[Plot, Plot]]:
    """Return the columns with the colour bar at the last one."""
    upper, lower = columns[-1]
    return [*columns[:-1], (replace(upper, depths=depths), replace(lower, depths=depths))]


_CORRELATION_S = 0.1
"""Largest lag of the correlations of a test, s."""


def signal_correlations(records: Mapping[str, Record], seconds: float = _CORRELATION_S) -> tuple[Plot, Plot, Plot]:
    """Return normalised correlations of tests over both signs of the lag (Chen 2010, Fig. 3.4).

    Autocorrelations of input and output, and cross-correlation of the output with the input: for a white input the
    last one is the impulse response. Lost samples are left out of the sums.

    Args:
        records: tests by their names in the key.
        seconds: largest lag, s.

    Raises:
        UnusableInputError: a test is constant or shorter than the lags.
    """
    made: tuple[list[Curve], ...] = ([], [], [])
    for index, (name, record) in enumerate(records.items()):
        lags = round(seconds * record.sample_rate_hz)
        colour, kind = COLOURS[index % len(COLOURS)], KINDS[index // len(COLOURS) % len(KINDS)]
        u, y = (_centred(values, lags) for values in (record.input, record.output))
        lag_ms = 1e3 * np.arange(-lags, lags + 1, dtype=np.float64) / record.sample_rate_hz
        for into, (earlier, later) in zip(made, ((u, u), (y, y), (u, y)), strict=True):
            values = _correlation(earlier, later, lags)
            into.append(Curve(lag_ms, values, name if len(records) > 1 else "", colour, kind))
    first = next(iter(records.values()))
    lag = replace(LAG, limits=(-1e3 * seconds, 1e3 * seconds))
    correlation = Axis(marked("Correlation"), limits=(-1.05, 1.05), zero=True)
    titles = [
        *(
            Message("plot.autocorrelation", "autocorrelation of the {signal}", signal=name)
            for name in (first.input_name, first.output_name)
        ),
        Message("plot.cross_correlation", "{input} to {output}", input=first.input_name, output=first.output_name),
    ]
    of_input, of_output, between = (
        Plot(title, lag, correlation, tuple(curves)) for title, curves in zip(titles, made, strict=True)
    )
    return of_input, of_output, between


def _centred(values: Array, lags: int) -> Array:
    """Return values without their mean, zero where nothing was received.

    Raises:
        UnusableInputError: they are constant or too few.
    """
    received = np.isfinite(values)
    if values.size < 2 * lags or not received.any() or not float(np.ptp(values[received])) > 0.0:
        raise UnusableInputError("plot.no_correlation", "the test is too short or constant for correlations")
    return np.where(received, values - values[received].mean(), 0.0)


def _correlation(earlier: Array, later: Array, lags: int) -> Array:
    """Return the normalised correlation (2 lags + 1,) of ``later`` with ``earlier``, biased as Eqs. 3.3, 3.4."""
    from scipy.signal import correlate  # whose import takes half a second

    whole = correlate(later, earlier, method="fft")
    middle = earlier.size - 1
    scale = float(np.sqrt(np.sum(earlier**2) * np.sum(later**2)))
    return np.asarray(whole[middle - lags : middle + lags + 1] / scale, dtype=np.float64)
