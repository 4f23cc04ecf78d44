"""Figures of what was identified: coherence, Bode diagram, impulse response, static nonlinearity, iteration."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.records import Record
from tissueid.reports.diagnostics import CONFIDENCE, Array, power_edge
from tissueid.reports.style import (
    BLUE,
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    INK,
    MUTED,
    ORANGE,
    POINTS,
    SERIES,
    SHADE,
    drawing,
    frequency_axis,
    log_axis,
    new_figure,
)
from tissueid.wording import axis_label, named_unit, people_unit

_MOST_POINTS = 4000


def excited_band(model: SpectralModel) -> NDArray[np.bool_]:
    """Mask (bins,) of the frequencies that hold 99 % of the input's power, zero apart."""
    spectra = model.spectra
    edge = power_edge(spectra.frequency_hz, spectra.input_psd)
    return (spectra.frequency_hz > 0.0) & (spectra.frequency_hz <= edge)


@drawing
def coherence_figure(model: SpectralModel) -> Figure:
    """Mean squared coherence with the level that unrelated signals seldom exceed (Chen 2010, Fig. 3.2b, Eq. 3.1)."""
    spectra = model.spectra
    figure = new_figure(HALF_WIDTH, 3.3)
    axes = figure.subplots()
    frequency_hz = spectra.frequency_hz[1:]
    edge = float(spectra.frequency_hz[excited_band(model)].max(initial=frequency_hz[0]))
    if edge < frequency_hz[-1]:
        axes.axvspan(edge, frequency_hz[-1], color=SHADE, zorder=0)
        axes.annotate(
            "hardly\nany input",
            (frequency_hz[-1], 1.0),
            (-3, 0),
            textcoords="offset points",
            ha="right",
            va="top",
            color=MUTED,
            fontsize=8.5,
        )
    axes.plot(frequency_hz, spectra.coherence[1:], color=BLUE)
    floor = spectra.coherence_floor
    axes.axhline(floor, color=ORANGE, linewidth=1.0, linestyle=DASHES[1], label="5 % significance level")
    frequency_axis(axes, float(frequency_hz[0]), float(frequency_hz[-1]))
    axes.set_ylim(0.0, 1.06)
    axes.set_ylabel("Mean squared coherence")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, min(0.7, floor + 0.01)))
    return figure


@drawing
def bode_figure(model: SpectralModel, record: Record) -> Figure:
    """Compliance and phase over the band with input power, 95 % bands, and the second-order fit (Chen 2010, Fig. 3.3).

    Args:
        model: the spectra and the second-order fit.
        record: what was fitted, for the units.

    Raises:
        UnusableInputError: the input has no power but at a single frequency.
    """
    band = excited_band(model)
    if band.sum() < 3:
        raise UnusableInputError("the input has power at fewer than three frequencies")
    spectra = model.spectra
    frequency_hz = spectra.frequency_hz[band]
    per_unit, scale = _ratio_unit(record)
    response = scale * spectra.response[band]
    relative = _finite_or(spectra.phase_std_rad[band], 1e3) * CONFIDENCE
    fit_hz = np.geomspace(frequency_hz[0], frequency_hz[-1], 300)
    fitted = scale * model.second_order.sign * model.second_order.system.frequency_response(fit_hz)

    figure = new_figure(HALF_WIDTH, 4.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    magnitude = np.abs(response)
    upper.fill_between(
        frequency_hz,
        magnitude / (1.0 + relative),
        magnitude * (1.0 + relative),
        color=BLUE,
        alpha=0.22,
        linewidth=0.0,
        label="95 % band",
    )
    upper.plot(frequency_hz, magnitude, color=BLUE, marker=".", markersize=3.5, linewidth=0.8, label="measured")
    upper.plot(fit_hz, np.abs(fitted), color=ORANGE, linestyle=DASHES[1], label="second order")
    trusted = np.concatenate([magnitude, np.abs(fitted)])
    upper.set_ylim(0.5 * trusted[trusted > 0.0].min(), 2.0 * trusted.max())
    log_axis(upper)
    upper.set_ylabel(f"Magnitude ({per_unit})")
    upper.legend(loc="lower left")

    phase, fitted_phase = _phase_degrees(response), _phase_degrees(fitted)
    phase += 360.0 * np.round((np.median(fitted_phase) - np.median(phase)) / 360.0)
    half_width = np.minimum(np.degrees(relative), 180.0)
    lower.fill_between(frequency_hz, phase - half_width, phase + half_width, color=BLUE, alpha=0.22, linewidth=0.0)
    lower.plot(frequency_hz, phase, color=BLUE, marker=".", markersize=3.5, linewidth=0.8)
    lower.plot(fit_hz, fitted_phase, color=ORANGE, linestyle=DASHES[1])
    both = np.concatenate([phase, fitted_phase])
    lower.set_ylim(45.0 * np.floor(both.min() / 45.0 - 0.2), 45.0 * np.ceil(both.max() / 45.0 + 0.2))
    lower.yaxis.set_major_locator(MultipleLocator(45.0) if np.ptp(both) < 400.0 else MaxNLocator(6))
    lower.set_ylabel("Phase (°)")
    frequency_axis(lower, float(frequency_hz[0]), float(frequency_hz[-1]))
    figure.align_ylabels()
    return figure


@drawing
def impulse_response_figure(model: LmsModel, record: Record) -> Figure:
    """Impulse response, its deviation at every lag, and the second-order fit (Chen 2010, Fig. 3.5)."""
    per_unit, scale = _ratio_unit(record)
    figure = new_figure(HALF_WIDTH, 4.6)
    axes = figure.subplots()
    lag_ms = 1e3 * model.lag_s
    response, std = scale * model.impulse_response, scale * model.impulse_response_std
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.fill_between(
        lag_ms, response - std, response + std, color=BLUE, alpha=0.22, linewidth=0.0, label="± 1 standard deviation"
    )
    axes.plot(lag_ms, response, color=BLUE, linestyle="none", marker=".", markersize=4.0, label="each lag by itself")
    fit_s = np.linspace(0.0, float(model.lag_s[-1]), 400)
    fitted = scale * model.second_order.sign * model.second_order.system.impulse_response(fit_s)
    axes.plot(1e3 * fit_s, fitted, color=ORANGE, linestyle=DASHES[1], linewidth=1.6, label="second order")
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel("Lag (ms)")
    axes.set_ylabel(f"Impulse response ({per_unit} per s)")
    axes.legend(loc="upper right")
    return figure


@drawing
def nonlinearity_figure(
    model: WienerModel, record: Record, part: slice | None = None, surface_position_m: float = float("nan")
) -> Figure:
    """Static nonlinearity (Chen 2010, Fig. 3.8, Eq. 3.26), and beside it the stiffness along it (Eq. 3.27).

    Args:
        model: the cascade.
        record: input and output; the points are its received samples.
        part: which of them were fitted.
        surface_position_m: where the tissue begins; NaN when nobody knows.

    Raises:
        UnusableInputError: no sample lies where the model can be run.
    """
    z = model.linear_output(record.input)[part or slice(None)]
    measured = record.output[part or slice(None)]
    known = np.isfinite(z) & np.isfinite(measured)
    z, measured = z[known], measured[known]
    if z.size < 2:
        raise UnusableInputError("no sample lies where the Wiener model can be run")
    in_unit, in_scale = people_unit(record.input_unit)
    out_unit, out_scale = people_unit(record.output_unit)
    figure = new_figure(FULL_WIDTH, 3.7)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    some = slice(None, None, max(1, -(-z.size // _MOST_POINTS)))
    left.plot(
        in_scale * z[some],
        out_scale * measured[some],
        color=POINTS[0],
        linestyle="none",
        marker=".",
        markersize=2.5,
        markeredgewidth=0.0,
        alpha=0.55,
        rasterized=True,
    )
    grid = np.linspace(z.min(), z.max(), 200)
    curve = model.nonlinearity(grid)
    left.plot(in_scale * grid, out_scale * curve, color=ORANGE, linewidth=2.0, label="fitted nonlinearity")
    near = measured.min() - surface_position_m < 0.6 * np.ptp(measured)
    if near and record.output_name == "position":
        left.axhline(out_scale * surface_position_m, color=MUTED, linestyle=DASHES[2], linewidth=1.2, label="surface")
    left.set_xlabel(axis_label("predicted_linear_output", in_unit))
    left.set_ylabel(axis_label(f"measured_{record.output_name}", out_unit))
    left.legend(loc="lower right")
    _stiffness_panel(right, model, record, np.quantile(z, (0.005, 0.995)), surface_position_m)
    return figure


def _stiffness_panel(axes: Axes, model: WienerModel, record: Record, ends: Array, surface_position_m: float) -> None:
    """Inverse slope of the nonlinearity against depth, over the range that holds 99 % of the samples."""
    low, high = model.nonlinearity.monotone_range
    z = np.linspace(max(low, float(ends[0])), min(high, float(ends[1])), 200)
    slope = np.abs(model.nonlinearity.slope(z))
    clear = slope > 1e-3 * slope.max()
    _, in_scale = people_unit(record.input_unit)
    out_unit, out_scale = people_unit(record.output_unit)
    origin = surface_position_m if np.isfinite(surface_position_m) and record.output_name == "position" else 0.0
    depth = out_scale * (model.nonlinearity(z) - origin)
    axes.plot(depth[clear], in_scale / slope[clear], color=SERIES[2], linewidth=1.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(axis_label("depth_below_the_surface" if origin else record.output_name, out_unit))
    mechanical = (record.input_unit, record.output_unit) == ("N", "m")
    axes.set_ylabel("Stiffness (N/m)" if mechanical else f"Inverse slope ({record.input_unit}/{record.output_unit})")


@drawing
def iterations_figure(model: WienerModel) -> Figure:
    """How the Wiener iteration settled: VAF, and parameters relative to the last pass (Chen 2010, Fig. 3.9).

    Raises:
        UnusableInputError: there was one pass only.
    """
    history = model.history
    if len(history) < 2:
        raise UnusableInputError("the iteration made a single pass")
    passes = [item.iteration for item in history]
    figure = new_figure(FULL_WIDTH, 2.9)
    left, right = figure.subplots(1, 2)
    for scores, label, colour, dash in (
        ([item.nonlinear_vaf_percent for item in history], "cascade, against the output", SERIES[1], DASHES[0]),
        ([item.linear_vaf_percent for item in history], "linear stage, against its own target", SERIES[0], DASHES[1]),
    ):
        left.plot(passes, scores, color=colour, linestyle=dash, marker="o", markersize=3.5, label=label)
    left.set_ylabel("VAF (%)")
    left.margins(y=0.25)
    left.legend(loc="best")
    drawn = 0
    for name, last in history[-1].parameters.items():
        values = np.array([item.parameters.get(name, np.nan) for item in history])
        if not np.all(np.isfinite(values)) or last == 0.0 or np.ptp(values) == 0.0:
            continue
        right.plot(
            passes,
            values / last,
            color=(*SERIES, INK, MUTED)[drawn % 6],
            linestyle=DASHES[drawn % len(DASHES)],
            marker="os^DvP"[drawn % 6],
            markersize=3.5,
            label=named_unit(name)[0],
        )
        drawn += 1
    right.axhline(1.0, color=MUTED, linewidth=0.8)
    right.set_ylabel("Parameter over its last value")
    if drawn:
        right.legend(loc="best", ncols=2)
    for axes in (left, right):
        axes.axvline(model.chosen, color=MUTED, linewidth=1.0, linestyle=DASHES[2])
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
        axes.set_xlabel("Pass")
    return figure


def _ratio_unit(record: Record) -> tuple[str, float]:
    """Unit of output over input as people read it, and its size in SI."""
    out_unit, out_scale = people_unit(record.output_unit)
    in_unit, in_scale = people_unit(record.input_unit)
    return f"{out_unit or '1'}/{in_unit or '1'}", out_scale / in_scale


def _phase_degrees(response: NDArray[np.complex128]) -> Array:
    return np.asarray(np.degrees(np.unwrap(np.angle(response))), dtype=np.float64)


def _finite_or(values: Array, other: float) -> Array:
    return np.where(np.isfinite(values), values, other)
