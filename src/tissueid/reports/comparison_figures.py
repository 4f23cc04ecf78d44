"""Figures of several engines: scores, memory, impulse responses, and distortion (Chen 2010, Fig. 8.1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis import EngineComparison, Scored, SweepRow
from tissueid.analysis.curves.diagnostics import Array, held_out_prediction
from tissueid.analysis.curves.plot import CONFIDENCE
from tissueid.analysis.curves.units import kernel_unit
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label
from tissueid.identification import engine_label
from tissueid.identification.base import Model
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.validation.distortion import Distortion
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.records import Record
from tissueid.reports.panels import diagonal, markers, running_mean
from tissueid.reports.style import (
    BLUE,
    DASHES,
    FULL_WIDTH,
    GREEN,
    MUTED,
    ORANGE,
    SERIES,
    drawing,
    log_axis,
    new_figure,
)
from tissueid.units import display_unit

_MARKERS = "os^DvPX*<>"
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


def line_style(place: int) -> dict[str, object]:
    """Return colour, dash and marker of the engine at a place; no two of the first twelve share all three."""
    return {
        "color": SERIES[place % len(SERIES)],
        "linestyle": DASHES[(place // len(SERIES)) % len(DASHES)],
        "marker": _MARKERS[place % len(_MARKERS)],
        "markersize": 4.5,
    }


@drawing
def scores_figure(found: EngineComparison) -> Figure:
    """Draw VAF, fitted and held out, with the limit set by repeats, and AICc (Chen 2010, Fig. 8.1)."""
    rows = _scored(found)
    rows.sort(key=lambda row: _held_out(row), reverse=True)
    labels = [engine_label(row.analysis.model.report.engine) for row in rows]
    places = np.arange(len(rows), dtype=np.float64)[::-1]
    figure = new_figure(FULL_WIDTH, 1.4 + 0.3 * len(rows))
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.2, 1.0))
    reports = [row.analysis.model.report for row in rows]
    fitted = np.array([r.vaf_percent for r in reports])
    unseen = np.array([_held_out(row) for row in rows])
    scheduled = np.array([np.nan if r.vaf_scheduled_percent is None else r.vaf_scheduled_percent for r in reports])
    left.hlines(places, np.minimum(fitted, unseen), np.maximum(fitted, unseen), color=MUTED, linewidth=1.0)
    hollow = {"linestyle": "none", "markerfacecolor": "none", "markersize": 6.5, "markeredgewidth": 1.3}
    left.plot(fitted, places, marker="o", markeredgecolor=MUTED, label=_("fitted samples"), **hollow)
    left.plot(unseen, places, marker="o", color=BLUE, linestyle="none", markersize=7.0, label=_("held out, free run"))
    if np.isfinite(scheduled).any():
        shifted = places + 0.22
        left.plot(scheduled, shifted, marker="D", markeredgecolor=ORANGE, label=_("held out, scheduled"), **hollow)
    everything = np.concatenate([fitted, unseen, scheduled])
    if found.ceiling is not None:
        best = found.ceiling.vaf_percent
        left.axvline(
            best.value,
            color=GREEN,
            linestyle=DASHES[1],
            label=translated(Message("compare.ceiling", "limit set by repeats")),
        )
        if best.std is not None:
            half = CONFIDENCE * best.std
            left.axvspan(best.value - half, min(best.value + half, 100.0), color=GREEN, alpha=0.15)
        everything = np.append(everything, best.value)
    finite = everything[np.isfinite(everything)]
    low = max(float(finite.min()), -20.0)
    left.set_xlim(low - 0.06 * (100.0 - low), 100.0 + 0.03 * (100.0 - low))
    left.set_yticks(places, labels)
    left.set_ylim(-0.6, len(rows) - 0.3)
    left.set_xlabel(_("Variance accounted for (%)"))
    left.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    aicc = np.array(
        [np.nan if r.aicc is None or row.own_samples else r.aicc for r, row in zip(reports, rows, strict=True)]
    )
    if np.isfinite(aicc).any():
        right.barh(places, 1e-3 * (aicc - np.nanmin(aicc)), 0.55, color=SERIES[3], alpha=0.75)
        right.plot(np.zeros(1), places[np.nanargmin(aicc)], marker="*", color=SERIES[3], markersize=9.0, clip_on=False)
    right.set_xlabel(_("AICc above the lowest (thousands)"))
    return figure


def _scored(found: EngineComparison) -> list[Scored]:
    return [entry.scored for entry in found.entries if entry.scored is not None]


def _held_out(row: Scored) -> float:
    value = row.analysis.model.report.vaf_validation_percent
    return -np.inf if value is None or not np.isfinite(value) else float(value)


@drawing
def sweep_figure(sweep: Sequence[SweepRow]) -> Figure:
    """Draw VAF, held out and fitted, and AICc against memory for every engine (Chen 2010, Fig. 8.1).

    Raises:
        UnusableInputError: the memory sweep was not run, or every engine refused it.
    """
    names = list(dict.fromkeys(row.engine for row in sweep if row.analysis is not None))
    if not names:
        raise UnusableInputError(NO_MEMORY_SWEEP)
    figure = new_figure(FULL_WIDTH, 3.9)
    every = figure.subplots(1, 3, sharex=True)
    for place, name in enumerate(names):
        rows = [row for row in sweep if row.engine == name and row.analysis is not None]
        memory_ms = [1e3 * row.memory for row in rows]
        reports = [row.analysis.model.report for row in rows if row.analysis is not None]
        for axes, values in zip(
            every,
            (
                [r.vaf_percent for r in reports],
                [_or_nan(r.vaf_validation_percent) for r in reports],
                [1e-3 * _or_nan(r.aicc) for r in reports],
            ),
            strict=True,
        ):
            axes.plot(memory_ms, values, label=engine_label(name), linewidth=1.1, **line_style(place))
    for axes, label in zip(every, (_("VAF, fitted (%)"), _("VAF, held out (%)"), _("AICc (thousands)")), strict=True):
        axes.set_ylabel(label)
        axes.set_xlabel(_("Memory (ms)"))
    for axes in every[:2]:
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, 0.0), min(high, 101.0))
    handles, labels = every[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=min(6, len(labels)))
    return figure


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


@drawing
def impulse_responses_figure(found: EngineComparison) -> Figure:
    """Draw impulse responses of linear engines, and measured against predicted output (Fig. 6.3).

    Raises:
        UnusableInputError: fewer than two engines have an impulse response.
    """
    chosen = list(with_impulse_response(found))
    if len(chosen) < 2:
        raise UnusableInputError(FEW_IMPULSE_RESPONSES)
    record = found.split.record
    unit, scale = kernel_unit(record)
    out_unit, out_scale = display_unit(record.output_unit)
    figure = new_figure(FULL_WIDTH, 3.9)
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    left.axhline(0.0, color=MUTED, linewidth=0.8)
    ends: list[float] = []
    for place, (name, model) in enumerate(chosen):
        style = line_style(place) | {"marker": None, "linestyle": DASHES[place % len(DASHES)]}
        left.plot(1e3 * model.lag_s, scale * model.impulse_response, label=engine_label(name), **style)
        run = held_out_prediction(name, found.analyses[name])
        across, along = running_mean(out_scale * run.predicted, out_scale * run.measured)
        right.plot(across, along, linewidth=1.4, **style)
        ends += [float(along.min()), float(along.max())]
    left.set_xlabel(_("Lag (ms)"))
    left.set_ylabel(_("Impulse response ({unit})").format(unit=unit))
    left.legend(loc="upper right")
    diagonal(right, min(ends), max(ends))
    right.set_xlabel(axis_label("predicted", out_unit))
    right.set_ylabel(axis_label("measured", out_unit))
    return figure


def with_impulse_response(found: EngineComparison) -> Iterator[tuple[str, HasImpulseResponse]]:
    """Yield name and model of the engines with an impulse response."""
    for name, analysis in found.analyses.items():
        model: Model | HasImpulseResponse = analysis.model
        if isinstance(model, HasImpulseResponse) and isinstance(model.impulse_response, np.ndarray):
            yield name, model


def depth_profiles(found: EngineComparison) -> dict[str, DepthProfile]:
    """Return the depth profiles of the engines that have one, by engine label."""
    profiles = {engine_label(name): a.depth_profile() for name, a in found.analyses.items()}
    return {name: profile for name, profile in profiles.items() if profile is not None}


@drawing
def distortion_figure(levels: Distortion, record: Record) -> Figure:
    """Draw the output at the driven lines, even and odd distortion between them, and noise."""
    unit, scale = display_unit(record.output_unit)
    figure = new_figure(FULL_WIDTH, 3.9)
    axes = figure.subplots()
    for lines, label, colour, marker in (
        (levels.driven, _("driven lines"), BLUE, "o"),
        (levels.detection, _("odd, not driven: odd distortion"), ORANGE, "^"),
        (levels.even, _("even: even distortion"), GREEN, "s"),
    ):
        if lines.line.size:
            markers(axes, lines.frequency_hz, scale * lines.level, label=label, colour=colour, marker=marker)
    noise = levels.driven.noise * scale
    if np.isfinite(noise).any():
        axes.plot(levels.driven.frequency_hz, noise, color=MUTED, linestyle=DASHES[1], linewidth=1.0, label=_("noise"))
    axes.set_xlabel(_("Frequency (Hz)"))
    axes.set_ylabel(axis_label(f"{record.output_name}_level", unit))
    log_axis(axes)

    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2)
    return figure
