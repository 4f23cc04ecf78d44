"""Plots that compare engines on one test, and a parameter of many fits: points by group, histograms, named rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis import EngineComparison, Scored, SweepRow
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    KINDS,
    LAG,
    Array,
    Axis,
    Bars,
    Curve,
    Plot,
    Surface,
    kernel_unit,
    signal_axis,
)
from tissueid.analysis.curves.validation import ROLES, cloud_plot, held_out_prediction, running_mean
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.registry import label_of
from tissueid.identification.validation.distortion import Distortion
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_MARKERS = "os^DvPX*<>"
_LOWEST_VAF = -20.0
"""Lowest score, percent, that is shown; an unstable simulation has any."""
_AICC = Axis(marked("AICc above the lowest (thousands)"))
NO_MEMORY_SWEEP = Message(
    "report.no_memory_sweep", "scores against memory were not computed: request them by --memory-sweep"
)
FEW_IMPULSE_RESPONSES = Message(
    "report.few_impulse_responses", "fewer than two engines with an impulse response were run"
)


@runtime_checkable
class HasImpulseResponse(Protocol):
    """A model with an impulse response (lags,) at ``lag_s`` (lags,), in output units per input unit and second."""

    impulse_response: Array
    lag_s: Array


def score_plots(comparison: EngineComparison) -> tuple[Plot, Plot]:
    """Return VAF, fitted and held out, with the limit set by repeats, and AICc; a row for each engine, best on top."""
    rows = sorted((entry.scored for entry in comparison.entries if entry.scored is not None), key=_held_out)
    reports = [row.analysis.model.report for row in rows]
    places = np.arange(len(rows), dtype=np.float64)
    fitted, unseen = np.array([r.vaf_percent for r in reports]), np.array([_held_out(row) for row in rows])
    scheduled = np.array([_known(r.vaf_scheduled_percent) for r in reports])
    gap = np.full(places.size, np.nan)
    between = np.stack([fitted, np.where(np.isfinite(unseen), unseen, np.nan), gap], axis=1)
    parts = [
        Curve(between.ravel(), np.repeat(places, 3), "", "muted", width=0.8),
        Curve(fitted, places, marked("fitted samples"), "muted", "circles", width=1.4),
        Curve(unseen, places, marked("held out, free run"), "measured", "points", width=1.7, marker="o"),
    ]
    if np.isfinite(scheduled).any():
        name = marked("held out, scheduled")
        parts.append(Curve(scheduled, places + 0.22, name, "model", "circles", width=1.4, marker="D"))
    everything = np.concatenate([fitted, unseen, scheduled])
    if comparison.ceiling is not None:
        best, name = comparison.ceiling.vaf_percent, Message("compare.ceiling", "limit set by repeats")
        at = np.array([best.value])
        parts.append(Curve(at, np.zeros(1), name, "good", "position"))
        if best.std is not None:
            reach = np.array([-1.0, 1.0]) * CONFIDENCE * best.std
            ends = np.minimum(best.value + reach, 100.0)
            parts.append(Curve(ends, np.zeros(0), "", "good", "spans", opacity=0.15))
        everything = np.append(everything, best.value)
    low = max(float(everything[np.isfinite(everything)].min()), _LOWEST_VAF)
    limits = low - 0.06 * (100.0 - low), 100.0 + 0.03 * (100.0 - low)
    names = tuple((float(height), label_of(r.engine)) for height, r in zip(places, reports, strict=True))
    engines = Axis(limits=(-0.6, len(rows) - 0.3), ticks=names)
    aicc = np.array([_known(row.aicc) for row in rows])
    bars: list[Curve | Surface | Bars] = []
    top = 1.0
    if np.isfinite(aicc).any():
        above = 1e-3 * (aicc - np.nanmin(aicc))
        top = float(np.nanmax(above)) or 1.0
        bars = [
            Bars(places, above, 0.55, "", "check", across=True, opacity=0.75),
            Curve(np.zeros(1), places[[np.nanargmin(aicc)]], "", "check", "points", width=2.0, marker="*"),
        ]
    return (
        Plot("", Axis(marked("Variance accounted for"), "%", limits=limits), engines, tuple(parts)),
        Plot("", replace(_AICC, limits=(-0.06 * top, 1.04 * top)), engines, tuple(bars)),
    )


def memory_plots(sweep: Sequence[SweepRow]) -> tuple[Plot, Plot, Plot]:
    """Return VAF, fitted and held out, and AICc against memory, a line for each engine.

    Raises:
        UnusableInputError: the memory sweep was not run, or every engine refused it.
    """
    by_engine: dict[str, list[tuple[float, float, float, float]]] = {}
    for row in sweep:
        if row.analysis is not None:
            report = row.analysis.model.report
            values = _known(report.vaf_validation_percent), 1e-3 * _known(report.aicc)
            by_engine.setdefault(row.engine, []).append((1e3 * row.memory, report.vaf_percent, *values))
    if not by_engine:
        raise UnusableInputError(NO_MEMORY_SWEEP)
    curves: list[list[Curve]] = [[], [], []]
    for index, (name, rows) in enumerate(by_engine.items()):
        memory_ms, *columns = np.array(rows).T
        colour, kind = ROLES[index % len(ROLES)], KINDS[(index // len(ROLES)) % len(KINDS)]
        for panel, values in zip(curves, columns, strict=True):
            line = Curve(memory_ms, values, label_of(name), colour, kind, width=0.85)
            panel.append(replace(line, marker=_MARKERS[index % len(_MARKERS)]))
    memory = Axis(marked("Memory"), "ms")
    fitted, unseen, aicc = (tuple(panel) for panel in curves)
    return (
        Plot("", memory, Axis(marked("VAF, fitted"), "%", limits=_percent(fitted)), fitted),
        Plot("", memory, Axis(marked("VAF, held out"), "%", limits=_percent(unseen)), unseen),
        Plot("", memory, Axis(marked("AICc (thousands)")), aicc),
    )


def response_plots(comparison: EngineComparison) -> tuple[Plot, Plot]:
    """Return impulse responses of linear engines, and the mean of measured against predicted output (Fig. 6.3).

    Raises:
        UnusableInputError: fewer than two engines have an impulse response.
    """
    chosen = list(_with_impulse_response(comparison))
    if len(chosen) < 2:
        raise UnusableInputError(FEW_IMPULSE_RESPONSES)
    record = comparison.split.record
    (unit, scale), out_scale = kernel_unit(record), display_unit(record.output_unit)[1]
    responses, means = [], []
    for index, (name, model) in enumerate(chosen):
        colour, kind = ROLES[index % len(ROLES)], KINDS[index % len(KINDS)]
        responses.append(Curve(1e3 * model.lag_s, scale * model.impulse_response, label_of(name), colour, kind))
        run = held_out_prediction(name, comparison.analyses[name])
        means.append(Curve(*running_mean(out_scale * run.predicted, out_scale * run.measured), "", colour, kind))
    measured = np.concatenate([curve.y for curve in means]) / out_scale
    right = cloud_plot(measured, measured, record.output_unit, x="predicted", mean=False)
    return (
        Plot("", LAG, Axis(marked("Impulse response"), unit, zero=True), tuple(responses)),
        replace(right, parts=(*means, *right.parts[1:])),
    )


def _with_impulse_response(comparison: EngineComparison) -> Iterator[tuple[str, HasImpulseResponse]]:
    """Yield name and model of the engines with an impulse response."""
    for name, analysis in comparison.analyses.items():
        model: Model | HasImpulseResponse = analysis.model
        if isinstance(model, HasImpulseResponse) and isinstance(model.impulse_response, np.ndarray):
            yield name, model


def distortion_plot(levels: Distortion, record: Record) -> Plot:
    """Return the output at the driven lines, even and odd distortion between them, and noise, against frequency."""
    scale = display_unit(record.output_unit)[1]
    parts = [
        Curve(lines.frequency_hz, scale * lines.level, name, colour, "points", width=0.8, marker=marker)
        for lines, name, colour, marker in (
            (levels.driven, marked("driven lines"), "measured", "o"),
            (levels.detection, marked("odd, not driven: odd distortion"), "model", "^"),
            (levels.even, marked("even: even distortion"), "good", "s"),
        )
        if lines.line.size
    ]
    noise = scale * levels.driven.noise
    if np.isfinite(noise).any():
        parts.append(Curve(levels.driven.frequency_hz, noise, marked("noise"), "muted", "dashed", width=0.8))
    level = replace(signal_axis(f"{record.output_name}_level", record.output_unit), log=True)
    return Plot("", Axis(marked("Frequency"), "Hz"), level, tuple(parts))


def _held_out(row: Scored) -> float:
    """Return the score on held-out samples, -inf for none: it is the lowest."""
    value = _known(row.analysis.model.report.vaf_validation_percent)
    return value if np.isfinite(value) else -np.inf


def _known(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _percent(curves: Sequence[Curve]) -> tuple[float, float] | None:
    """Return limits of scores that leave out what is below zero; None where there is no score."""
    values = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in curves])
    if not values.size:
        return None
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * (high - low) or 1.0
    return max(low - margin, 0.0), max(min(high + margin, 101.0), 1.0)


Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Centre:
    """Mean of a group at one place, with half its error bar; NaN for none."""

    group: int
    x: float
    y: float
    half: float


def points_plot(
    axes: tuple[Axis, Axis],
    groups: Sequence[tuple[Array, Array]],
    colours: Sequence[str],
    names: Sequence[str],
    centres: Sequence[Centre] = (),
) -> Plot:
    """Return abscissa and ordinate (n,) of each group as points in its colour, and means with error bars over them."""
    parts = [
        Curve(x, y, name, colour, "points", width=1.8, opacity=0.6)
        for (x, y), colour, name in zip(groups, colours, names, strict=False)
        if x.size
    ]
    for index, colour in enumerate(colours):
        own = [centre for centre in centres if centre.group == index]
        if own:
            x, y = np.array([point.x for point in own]), np.array([point.y for point in own])
            half = np.nan_to_num(np.array([point.half for point in own]))
            parts.append(Curve(x, y, "", colour, "bars", y - half, y + half, width=1.1, opacity=0.9))
    return Plot("", *axes, tuple(parts))


def histogram_plot(
    axes: tuple[Axis, Axis], groups: Sequence[Array], edges: Array, colours: Sequence[str], names: Sequence[str]
) -> Plot:
    """Return how many values (n,) of each group lie in the bins between ``edges`` (bins + 1,)."""
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    parts = [
        Bars(middle, np.histogram(values, edges)[0].astype(np.float64), width, name, colour, opacity=0.4)
        for values, colour, name in zip(groups, colours, names, strict=False)
        if values.size
    ]
    return Plot("", *axes, tuple(parts))


def rows_plot(
    title: str, x: Axis, names: Sequence[str], values: Array, std: Array, groups: Sequence[tuple[str, str, Rows]]
) -> Plot:
    """Return values in named rows, the first on top, with error bars of one standard deviation along the abscissa.

    Args:
        title: what stands above.
        x: axis of the values.
        names: name of each row (n,); data of a user are wrapped in ``Verbatim``.
        values: value of each row (n,); NaN for none.
        std: its standard deviation (n,); NaN for none.
        groups: name, role of the colour, and rows (k,) of each group; later groups are drawn larger.
    """
    places = np.arange(len(names), 0.0, -1.0)
    half = np.nan_to_num(std)
    parts = []
    for index, (name, colour, rows) in enumerate(groups):
        own = rows[np.isfinite(values[rows])]
        x_own, reach = values[own], half[own]
        bars = Curve(x_own, places[own], name, colour, "bars", x_own - reach, x_own + reach, across=True)
        parts.append(replace(bars, width=1.2 + 0.5 * index))
    y = Axis(limits=(0.5, len(names) + 0.5), ticks=tuple(zip(places.tolist(), names, strict=True)))
    return Plot(title, x, y, tuple(parts))
