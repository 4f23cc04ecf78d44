"""Plots of static nonlinearities, and of cascades: blocks in signal order, passes of iterations (Chen 2010, 3.2)."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    KINDS,
    LAG,
    Array,
    Axis,
    Curve,
    Plot,
    banded,
    is_mechanical,
    kernel_unit,
    signal_axis,
    whole_ticks,
)
from tissueid.analysis.curves.validation import ROLES
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit
from tissueid.identification.cascades.blocks import curve_slopes
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.impulse_response import convolve_at_rest
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_FINE = 200
_NEAR = 0.6
"""Largest distance of the surface from the shallowest sample, as a share of their range, at which it is marked."""
_LEAST_SLOPE = 1e-3
"""Share of the steepest slope below which its inverse is not shown."""
_MOST_POINTS = 4000
_STRETCHES = 40
_FEWEST = 8


def wiener_nonlinearity(
    model: WienerModel, record: Record, part: slice | None = None, surface_position_m: float = float("nan")
) -> Plot:
    """Return the static nonlinearity of a Wiener cascade and the samples about it (Chen 2010, Fig. 3.8, Eq. 3.26).

    Args:
        model: the cascade.
        record: input and output; the points are its received samples.
        part: which of them were fitted.
        surface_position_m: position of the tissue surface, m, which is marked where it is near; NaN if unknown.

    Raises:
        UnusableInputError: no sample lies where the model can be run.
    """
    z, measured = linear_output(model, record, part)
    in_scale, out_scale = display_unit(record.input_unit)[1], display_unit(record.output_unit)[1]
    some = slice(None, None, max(1, -(-z.size // _MOST_POINTS)))
    fine = np.linspace(z.min(), z.max(), _FINE)
    surface: tuple[Curve, ...] = ()
    if record.output_name == "position" and measured.min() - surface_position_m < _NEAR * np.ptp(measured):
        at = np.array([out_scale * surface_position_m])
        surface = (Curve(np.zeros(1), at, marked("surface"), "muted", "level"),)
    return Plot(
        marked("Static nonlinearity"),
        signal_axis("predicted_linear_output", record.input_unit),
        signal_axis(f"measured_{record.output_name}", record.output_unit),
        (
            Curve(in_scale * z[some], out_scale * measured[some], marked("measured"), kind="points", opacity=0.55),
            Curve(
                in_scale * fine,
                out_scale * model.nonlinearity(fine),
                marked("fitted nonlinearity"),
                "model",
                width=1.5,
            ),
            *surface,
        ),
    )


def stiffness_plot(model: WienerModel, record: Record, part: slice | None, surface_position_m: float) -> Plot:
    """Return the inverse slope of the nonlinearity against depth, over 99 % of the samples (Chen 2010, Eq. 3.27).

    Arguments as :func:`wiener_nonlinearity`; ``surface_position_m`` is the origin of depth, NaN if unknown.
    """
    ends = np.quantile(linear_output(model, record, part)[0], (0.005, 0.995))
    low, high = model.nonlinearity.monotone_range
    z = np.linspace(max(low, float(ends[0])), min(high, float(ends[1])), _FINE)
    slope = np.abs(model.nonlinearity.slope(z))
    clear = slope > _LEAST_SLOPE * slope.max()
    is_depth = np.isfinite(surface_position_m) and record.output_name == "position"
    out_scale = display_unit(record.output_unit)[1]
    depth = out_scale * (model.nonlinearity(z[clear]) - (surface_position_m if is_depth else 0.0))
    inverse = display_unit(record.input_unit)[1] / slope[clear]
    y = Axis(marked("Inverse slope"), f"{record.input_unit}/{record.output_unit}")
    if is_mechanical(record):
        y = Axis(marked("Stiffness"), "N/m")
    return Plot(
        "",
        signal_axis("depth_below_the_surface" if is_depth else record.output_name, record.output_unit),
        replace(y, limits=(0.0, 1.05 * float(inverse.max(initial=0.0)) or 1.0)),
        (Curve(depth, inverse, colour="good", width=1.4),),
    )


def linear_output(model: WienerModel, record: Record, part: slice | None = None) -> tuple[Array, Array]:
    """Return output of the linear stage and measured output (k,) where both are known.

    Raises:
        UnusableInputError: they are known at fewer than two samples.
    """
    z, measured = model.linear_output(record.input)[part or slice(None)], record.output[part or slice(None)]
    finite = np.isfinite(z) & np.isfinite(measured)
    if finite.sum() < 2:
        raise UnusableInputError(
            "report.wiener_not_run",
            "the Wiener model cannot be simulated: no sample has an uninterrupted input over the memory",
        )
    return z[finite], measured[finite]


def nonlinearity_plot(analysis: Analysis) -> Plot:
    """Return the static nonlinearity: after the linear stage for a Wiener cascade, before it otherwise.

    The band is the standard deviation of the samples about the curve for a Wiener cascade, and 95 % confidence for a
    Hammerstein cascade.

    Raises:
        UnusableInputError: the engine has none.
    """
    model, record = analysis.model, analysis.record[analysis.fit_part]
    half: Array | None = None
    if isinstance(model, WienerModel):
        z = model.linear_output(record.input)
        x = central_span(z)
        y = model.nonlinearity(x)
        half = _scatter(x, z, record.output - model.nonlinearity(z))
    elif isinstance(model, HammersteinModel):
        x = central_span(record.input)
        y = model.nonlinearity(x) + model.offset
        std = curve_std(model.nonlinearity, x, model.nonlinearity_covariance)
        if std is not None and model.steady_gain:
            half = CONFIDENCE * std
    elif isinstance(model, CascadeModel) and model.structure == "hammerstein" and model.inner is not None:
        x = central_span(record.input)
        y = model.inner(x) + model.offset
    else:
        raise UnusableInputError(
            "research.no_nonlinearity", "only engines with a static nonlinearity have this curve: Wiener, Hammerstein"
        )
    (in_unit, into), (out_unit, out) = display_unit(record.input_unit), display_unit(record.output_unit)
    low, high = (None, None) if half is None else (out * (y - half), out * (y + half))
    title = marked("Static nonlinearity")
    curve = Curve(into * x, out * y, colour="model", low=low, high=high)
    return Plot(title, Axis(marked("Input of the curve"), in_unit), Axis(title, out_unit), (curve,))


def curve_std(curve: StaticNonlinearity, x: Array, covariance: Array) -> Array | None:
    """Return the standard deviation of a curve at x (k,), (k,); None where the covariance is not known."""
    if not np.isfinite(covariance).all():
        return None
    slopes = curve_slopes(curve, x)  # (p, k)
    return np.asarray(np.sqrt(np.maximum(np.einsum("pk,pq,qk->k", slopes, covariance, slopes), 0.0)))


def central_span(values: Array) -> Array:
    """Return even steps over the central 99 % of the received values.

    Raises:
        UnusableInputError: fewer than two values were received.
    """
    received = values[np.isfinite(values)]
    if received.size < 2:
        raise UnusableInputError("research.no_cascade_sample", "no sample lies in the range of the cascade")
    low, high = np.quantile(received, (0.005, 0.995))
    return np.linspace(float(low), float(high), _FINE)


def _scatter(x: Array, z: Array, error: Array) -> Array:
    """Return the standard deviation of the error near each of x (k,), from samples z (n,)."""
    finite = np.isfinite(z) & np.isfinite(error)
    edges = np.linspace(x[0], x[-1], _STRETCHES + 1)
    bin_index = np.clip(np.digitize(z[finite], edges) - 1, 0, _STRETCHES - 1)
    count = np.bincount(bin_index, minlength=_STRETCHES)
    squares = np.bincount(bin_index, error[finite] ** 2, _STRETCHES)
    held = count >= _FEWEST
    if not held.any():
        return np.full(x.size, float(np.std(error[finite])))
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.interp(x, middle[held], np.sqrt(squares[held] / count[held]))


_COLOURS, _MARKERS = (*ROLES, "text", "muted"), "os^DvP"
_INNER = "inner_signal"
SINGLE_PASS = Message("report.single_pass", "the iteration made only one pass")


def hammerstein_blocks(model: HammersteinModel, record: Record, fit_part: slice) -> tuple[Plot, ...]:
    """Return the static curve and the impulse response of a Hammerstein cascade, with 95 % bands."""
    scale = display_unit(record.output_unit)[1]
    u = central_span(record.input[fit_part])
    y, std = scale * model.nonlinearity(u), curve_std(model.nonlinearity, u, model.nonlinearity_covariance)
    axis, in_scale = _input(record)
    inner = signal_axis(_INNER, record.output_unit)
    return (
        _static(axis, inner, in_scale * u, y, None if std is None else scale * std),
        _dynamic(model.kernel, model.kernel_std, model.lag_s, model.sample_rate_hz),
    )


def wiener_blocks(model: WienerModel, record: Record, fit_part: slice) -> tuple[Plot, ...]:
    """Return the impulse response and the static curve of a Wiener cascade (Chen 2010, Fig. 3.6)."""
    z = central_span(model.linear_output(record.input)[fit_part])
    lag_s = np.arange(model.kernel.size) / model.sample_rate_hz
    y = display_unit(record.output_unit)[1] * model.nonlinearity(z)
    inner = signal_axis(_INNER, record.input_unit)
    return (
        _dynamic(model.kernel, None, lag_s, model.sample_rate_hz),
        _static(inner, signal_axis(record.output_name, record.output_unit), _input(record)[1] * z, y),
    )


def cascade_blocks(model: CascadeModel, record: Record, fit_part: slice) -> tuple[Plot, ...]:
    """Return the blocks of the chosen structure, with 95 % bands of the impulse responses."""
    out_scale, rate = display_unit(record.output_unit)[1], model.sample_rate_hz
    blocks: list[Plot] = []
    driven = record.input - model.input_mean
    unit, scale = kernel_unit(record) if model.structure == "linear" else ("1/s", 1.0)
    if model.inner is not None:
        u, last = central_span(record.input[fit_part]), model.outer is None
        inner = signal_axis(_INNER, record.output_unit if last else "")
        y = model.inner(u) * (out_scale if last else 1.0)
        axis, in_scale = _input(record)
        blocks.append(_static(axis, inner, in_scale * u, y))
        driven = model.inner(record.input)
    blocks.append(_dynamic(scale * model.first_kernel, scale * model.first_kernel_std, model.lag_s, rate, unit))
    if model.outer is not None:
        z = central_span(convolve_at_rest(model.first_kernel, driven)[fit_part])
        last = model.second_kernel is None
        drain = signal_axis(record.output_name if last else _INNER, record.output_unit)
        y = out_scale * (model.outer(z) + (model.offset if last else 0.0))
        blocks.append(_static(signal_axis(_INNER, ""), drain, z, y))
    if model.second_kernel is not None:
        blocks.append(_dynamic(model.second_kernel, model.second_kernel_std, model.lag_s, rate))
    return tuple(blocks)


def iteration_plots(model: WienerModel | HammersteinModel) -> tuple[Plot, Plot]:
    """Return VAF by pass, and the parameters of the linear stage relative to their last value (Chen 2010, Fig. 3.9).

    The pass that was kept is marked.

    Raises:
        UnusableInputError: there was only one pass.
    """
    history = model.history
    if len(history) < 2:
        raise UnusableInputError(SINGLE_PASS)
    passes = np.array([float(state.iteration) for state in history])
    scores = [_passes(passes, [state.nonlinear_vaf_percent for state in history], 0, "")]
    if isinstance(model, WienerModel):
        linear = [state.linear_vaf_percent for state in model.history]
        scores = [
            _passes(passes, scores[0].y, 1, marked("cascade, against the output"), kind="line"),
            _passes(passes, linear, 0, marked("linear stage, against its own target"), kind="dashed"),
        ]
    parameters: list[Curve] = []
    for name, last in history[-1].parameters.items():
        values = np.array([state.parameters.get(name, np.nan) for state in history])
        if last != 0.0 and np.all(np.isfinite(values)) and np.ptp(values) > 0.0:
            parameters.append(_passes(passes, values / last, len(parameters), label_and_unit(name)[0]))
    kept = Curve(np.array([float(model.chosen)]), np.zeros(1), "", "muted", "position", width=0.8)
    unity = Curve(np.zeros(1), np.ones(1), "", "muted", "level", width=0.8)
    x = Axis(marked("Pass"), ticks=whole_ticks(int(passes[0]), int(passes[-1])))
    return (
        Plot("", x, Axis(marked("VAF"), "%"), (*scores, kept)),
        Plot("", x, Axis(marked("Parameter over its last value")), (*parameters, unity, kept)),
    )


def _passes(
    passes: Array, values: Array | list[float], index: int, name: str, *, kind: Literal["line", "dashed", ""] = ""
) -> Curve:
    """Return values by pass as a line with points, in the look of entry ``index`` of the key."""
    colour, marker = _COLOURS[index % len(_COLOURS)], _MARKERS[index % len(_MARKERS)]
    return Curve(passes, np.asarray(values), name, colour, kind or KINDS[index % len(KINDS)], marker=marker)


def _static(x: Axis, y: Axis, across: Array, values: Array, std: Array | None = None) -> Plot:
    half = None if std is None else CONFIDENCE * std
    return Plot(marked("static"), x, y, (banded(across, values, half, "", "model", width=1.4),))


def _dynamic(kernel: Array, std: Array | None, lag_s: Array, rate: float, unit: str = "1/s") -> Plot:
    """Return a linear block with its impulse response per second, from a kernel (lags,) per sample."""
    curve = banded(1e3 * lag_s, rate * kernel, None if std is None else CONFIDENCE * (rate * std), width=1.4)
    return Plot(marked("linear"), LAG, Axis(marked("Impulse response"), unit, zero=True), (curve,))


def _input(record: Record) -> tuple[Axis, float]:
    """Return the axis of the input, and the factor to its unit."""
    return signal_axis(record.input_name, record.input_unit), display_unit(record.input_unit)[1]
