"""Plots of fits of several tests: responses, nonlinearities, scores; colours and line styles of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.linear import excited, impulse_curve, response_axes, response_curves, spectra_of
from tissueid.analysis.curves.nonlinearity import linear_output
from tissueid.analysis.curves.plot import Array, Axis, Curve, Kind, Plot, cloud, depth_roles
from tissueid.analysis.curves.units import FREQUENCY, LAG, kernel_unit, signal_axis
from tissueid.analysis.overlay import Overlay, OverlayEntry
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.units import display_unit

COLOURS = ("measured", "model", "good", "check", "poor", "text")
"""Colours of sources, in their order."""
MARKERS = "osD^vP"
"""Markers of fits, in their order."""
KINDS: tuple[Kind, ...] = ("line", "dashed", "dotted", "dashdot")
"""Line styles of fits, in their order."""
_POINTS = 300
_LOOPS_S = 0.5
"""Seconds whose samples are joined by a line."""
_MOST_LINE = 1500
"""Largest number of samples of that line: longer lines are drawn as ranges, which hides loops."""
_NO_NONLINEARITY = Message("overlay.no_nonlinearity", "no fit is a Wiener cascade, which has a static nonlinearity")


def colour_of(found: Overlay, source: str, fit: str) -> str:
    """Return the colour of a series: that of its source, or of its fit where there is one source.

    Series with a number, such as "forearm (2)", have the colour of their source.
    """
    names = found.sources
    place = names.index(source) if source in names else names.index(source.rpartition(" (")[0])
    if len(names) == 1:
        place = found.fits.index(fit)
    return COLOURS[place % len(COLOURS)]


def style_of(found: Overlay, entry: OverlayEntry) -> tuple[str, Kind]:
    """Return colour and line style of an entry."""
    return colour_of(found, entry.source, entry.fit.label), kind_of(found, entry.fit.label)


def kind_of(found: Overlay, fit: str) -> Kind:
    """Return the line style of a fit."""
    return KINDS[found.fits.index(fit) % len(KINDS)]


def named(text: str) -> str:
    """Return the label of a source or fit, which is data of a user and is not translated.

    A thin space stands before an underscore: keys leave out what begins with one.
    """
    return Verbatim(f"\u200a{text}" if text.startswith("_") else text)


def series_name(found: Overlay, source: str, fit: str) -> str:
    """Return the name of a series in a key: what distinguishes it."""
    if len(found.fits) == 1:
        return named(source)
    return named(fit if len(found.sources) == 1 else f"{source}, {fit}")


def response_overlay(found: Overlay) -> tuple[Plot, Plot, Plot]:
    """Return impulse response, magnitude and phase of every fit, laid over each other.

    Raises:
        UnusableInputError: no fit has an impulse response.
    """
    impulses, upper, lower, said = list[Curve](), list[Curve](), list[Curve](), set[str]()
    for entry in found.entries:
        label = found.label(entry)
        name, (colour, kind) = "" if label in said else named(label), style_of(found, entry)
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
    record = found.entries[0].analysis.record
    magnitude, phase = response_axes(record)
    return (
        Plot("", LAG, Axis(marked("Impulse response"), kernel_unit(record)[0], zero=True), tuple(impulses)),
        Plot("", FREQUENCY, magnitude, tuple(upper)),
        Plot("", FREQUENCY, phase, tuple(lower)),
    )


# -- static nonlinearity ----------------------------------------------------------------------------------------------


def nonlinearity_overlay(found: Overlay) -> tuple[Plot, ...]:
    """Return measured output against the output of the linear stage, a panel for each source (Chen 2010, 3.11, 3.12).

    All samples are a pale cloud. A line follows a stretch of them in time, so that a system whose dynamics depend on
    its output shows loops. Dashed, the fitted nonlinearities. Panels have the same axes where their samples overlap.

    Raises:
        UnusableInputError: no fit is a Wiener cascade.
    """
    panels: dict[str, list[OverlayEntry]] = {}
    for entry in found.entries:
        if isinstance(entry.analysis.model, WienerModel):
            panels.setdefault(entry.source, []).append(entry)
    if not panels:
        raise UnusableInputError(_NO_NONLINEARITY)
    record = found.entries[0].analysis.record
    (in_unit, into), out = display_unit(record.input_unit), display_unit(record.output_unit)[1]
    made: list[tuple[str, list[Curve]]] = []
    for source, entries in panels.items():
        clouds, lines, curves = list[Curve](), list[Curve](), list[Curve]()
        colours = depth_roles(len(entries)) if len(entries) > 1 else [colour_of(found, source, entries[0].fit.label)]
        for entry, colour in zip(entries, colours, strict=True):
            z, y = _static_points(entry)
            clouds.append(cloud(into * z, out * y, colour))
            stretch = slice(0, min(_MOST_LINE, round(_LOOPS_S * entry.analysis.record.sample_rate_hz)))
            lines.append(Curve(into * z[stretch], out * y[stretch], "", colour, width=0.5))
            fine = np.linspace(*_span(z), 100)
            model = entry.analysis.model
            assert isinstance(model, WienerModel)
            curves.append(Curve(into * fine, out * model.nonlinearity(fine), "", "text", "dashed", width=1.2))
        made.append((named(source), [*clouds, *lines, *curves]))
    x = Axis(signal_axis("predicted_linear_output", record.input_unit).label, in_unit)
    y_axis = signal_axis(f"measured_{record.output_name}", record.output_unit)
    ends = [(_ends(parts, "x"), _ends(parts, "y")) for _name, parts in made]
    if _overlapping([one[1] for one in ends]):
        ends = [(_ends([c for _n, parts in made for c in parts], "x"), _ends([c for _n, p in made for c in p], "y"))]
        ends *= len(made)
    return tuple(
        Plot(name, replace(x, limits=across), replace(y_axis, limits=along), tuple(parts))
        for (name, parts), (across, along) in zip(made, ends, strict=True)
    )


def _overlapping(ranges: Sequence[tuple[float, float]]) -> bool:
    """Return whether the middle of every range lies in every other."""
    middles = [0.5 * (low + high) for low, high in ranges]
    return all(low < middle < high for low, high in ranges for middle in middles)


def loop_width(entry: OverlayEntry, bins: int = 20) -> float:
    """Return the difference of the output on the way in and on the way out at the same linear output, m.

    The root mean square over bins of the linear output of the difference of the two means: zero for a linear system and
    for a Wiener cascade, positive where the dynamics depend on the output (Chen 2010, 3.4).
    """
    z, y = _static_points(entry)
    edges = np.quantile(z, np.linspace(0.05, 0.95, bins + 1))
    place, inwards = np.digitize(z, edges), np.gradient(z) > 0.0
    differences = []
    for number in range(1, bins + 1):
        ways = [y[(place == number) & way] for way in (inwards, ~inwards)]
        if min(one.size for one in ways) >= 5:
            differences.append(float(ways[0].mean() - ways[1].mean()))
    return float(np.sqrt(np.mean(np.square(differences)))) if differences else float("nan")


def _static_points(entry: OverlayEntry) -> tuple[Array, Array]:
    """Return output of the linear stage and measured output (k,) of the fitted samples."""
    model = entry.analysis.model
    assert isinstance(model, WienerModel)
    return linear_output(model, entry.analysis.record, entry.analysis.fit_part)


def _span(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _ends(curves: Sequence[Curve], name: str) -> tuple[float, float]:
    values = np.concatenate([getattr(curve, name) for curve in curves])
    low, high = _span(values[np.isfinite(values)])
    return low - 0.04 * (high - low), high + 0.04 * (high - low)


# -- scores -----------------------------------------------------------------------------------------------------------


def score_overlay(found: Overlay) -> Plot:
    """Return VAF of every entry: of the fitted samples, held out, and scheduled by the measured output.

    Entries with the same label share a row.

    Raises:
        UnusableInputError: every fit is swept.
    """
    entries = [entry for entry in found.entries if entry.swept is None]
    if not entries:
        raise UnusableInputError("overlay.all_swept", "every fit is swept")
    labels = list(dict.fromkeys(found.label(entry) for entry in entries))
    places = np.array([float(len(labels) - labels.index(found.label(entry))) for entry in entries])
    reports = [entry.analysis.model.report for entry in entries]
    columns = (
        (marked("fitted samples"), "muted", [r.vaf_percent for r in reports], "o"),
        (marked("held out, free run"), "measured", [r.vaf_validation_percent for r in reports], "o"),
        (marked("fitted, scheduled by measured output"), "model", [e.scheduled_percent for e in entries], "D"),
    )
    parts = []
    for name, colour, values, marker in columns:
        known = np.array([np.nan if value is None else value for value in values], dtype=np.float64)
        if np.isfinite(known).any():
            kind: Kind = "circles" if colour == "muted" else "points"
            parts.append(Curve(np.clip(known, 0.0, 100.0), places, name, colour, kind, width=1.5, marker=marker))
    ticks = tuple((float(len(labels) - place), named(label)) for place, label in enumerate(labels))
    y = Axis(limits=(0.4, len(labels) + 0.6), ticks=ticks)
    low = min(float(np.nanmin(curve.x)) for curve in parts)
    return Plot("", Axis(marked("Variance accounted for"), "%", limits=(max(0.0, low - 4.0), 101.0)), y, tuple(parts))


def sweep_overlay(found: Overlay) -> tuple[Plot, Plot]:
    """Return VAF and AICc on the fitted samples against the swept option (Chen 2010, Fig. 8.1).

    A line for each source and fit. Models with a schedule show the run that is scheduled by the measured output.

    Raises:
        UnusableInputError: nothing was swept.
    """
    rows: dict[tuple[str, str], list[OverlayEntry]] = {}
    for entry in found.entries:
        if entry.swept is not None:
            rows.setdefault((entry.source, entry.fit.label), []).append(entry)
    if not rows:
        raise UnusableInputError("overlay.no_sweep", "no option was swept")
    upper, lower = list[Curve](), list[Curve]()
    for place, ((source, fit), entries) in enumerate(rows.items()):
        x = np.array([_swept_value(found, entry) for entry in entries])
        fitted = np.array([entry.shown_percent for entry in entries])
        criterion = [e.analysis.model.report.aicc if e.scheduled_aicc is None else e.scheduled_aicc for e in entries]
        aicc = 1e-3 * np.array([np.nan if value is None else value for value in criterion])
        style = COLOURS[place % len(COLOURS)], KINDS[place % len(KINDS)]
        name = series_name(found, source, fit)
        for into, values in ((upper, fitted), (lower, aicc)):
            line = Curve(x, values, name, *style, width=0.9)
            into.append(replace(line, marker=MARKERS[place % len(MARKERS)]))
    axis = Axis(marked("Memory"), "ms") if found.swept == "memory" else Axis(_option_label(found))
    values = np.concatenate([curve.y for curve in lower])
    values = values[np.isfinite(values)]
    lowest = float(values.min()) if values.size else 0.0
    ordinary = np.quantile(values, 0.9) if values.size else 0.0
    limits = (lowest - 0.5, min(float(values.max(initial=0.0)), float(ordinary) + 6.0) + 0.5) if values.size else None
    return (
        Plot("", axis, Axis(marked("VAF, fitted"), "%"), tuple(upper)),
        Plot("", axis, Axis(marked("AICc (thousands)"), limits=limits), tuple(lower)),
    )


def _swept_value(found: Overlay, entry: OverlayEntry) -> float:
    value = float(entry.swept or 0.0)
    return 1e3 * value if found.swept == "memory" else value


def _option_label(found: Overlay) -> str:
    for entry in found.entries:
        field = type(entry.fit.engine).model_fields.get(found.swept)
        if field is not None and field.title:
            return field.title
    return named(found.swept)


__all__ = [
    "loop_width",
    "nonlinearity_overlay",
    "response_overlay",
    "score_overlay",
    "sweep_overlay",
]
