"""Plots of cascades: their blocks in signal order, and the passes of their iterations (Chen 2010, 3.2)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from tissueid.analysis.curves.nonlinearity import central_span, curve_std
from tissueid.analysis.curves.plot import CONFIDENCE, Array, Axis, Curve, Plot, whole_ticks
from tissueid.analysis.curves.units import LAG, kernel_unit, signal_axis
from tissueid.analysis.curves.validation import KINDS, ROLES
from tissueid.errors import UnusableInputError
from tissueid.formatting import label_and_unit
from tissueid.identification.correlation import convolve_at_rest
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_COLOURS, _MARKERS = (*ROLES, "text", "muted"), "os^DvP"
_INNER = "inner_signal"
SINGLE_PASS = Message("report.single_pass", "the iteration made only one pass")


def hammerstein_blocks(model: HammersteinModel, record: Record, fit_part: slice) -> tuple[Plot, ...]:
    """Return the static curve and the impulse response of a Hammerstein cascade, with 95 % bands."""
    scale = display_unit(record.output_unit)[1]
    u = central_span(record.input[fit_part])
    y, std = scale * model.nonlinearity(u), curve_std(model.nonlinearity, u, model.nonlinearity_covariance)
    inner = signal_axis(_INNER, record.output_unit)
    return (
        _static(_input_axis(record), inner, _input_scale(record) * u, y, None if std is None else scale * std),
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
        _static(inner, _output_axis(record), _input_scale(record) * z, y),
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
        blocks.append(_static(_input_axis(record), inner, _input_scale(record) * u, y))
        driven = model.inner(record.input)
    blocks.append(_dynamic(scale * model.first_kernel, scale * model.first_kernel_std, model.lag_s, rate, unit))
    if model.outer is not None:
        z = central_span(convolve_at_rest(model.first_kernel, driven)[fit_part])
        last = model.second_kernel is None
        drain = _output_axis(record) if last else signal_axis(_INNER, record.output_unit)
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
    passes = np.array([float(one.iteration) for one in history])
    scores = [_passes(passes, [one.nonlinear_vaf_percent for one in history], 0, "")]
    if isinstance(model, WienerModel):
        linear = [one.linear_vaf_percent for one in model.history]
        scores = [
            _passes(passes, scores[0].y, 1, marked("cascade, against the output"), kind="line"),
            _passes(passes, linear, 0, marked("linear stage, against its own target"), kind="dashed"),
        ]
    parameters: list[Curve] = []
    for name, last in history[-1].parameters.items():
        values = np.array([one.parameters.get(name, np.nan) for one in history])
        if last != 0.0 and np.all(np.isfinite(values)) and np.ptp(values) > 0.0:
            parameters.append(_passes(passes, values / last, len(parameters), label_and_unit(name)[0]))
    kept = Curve(np.array([float(model.chosen)]), np.zeros(1), "", "muted", "position", width=0.8)
    one = Curve(np.zeros(1), np.ones(1), "", "muted", "level", width=0.8)
    x = Axis(marked("Pass"), ticks=whole_ticks(int(passes[0]), int(passes[-1])))
    return (
        Plot("", x, Axis(marked("VAF"), "%"), (*scores, kept)),
        Plot("", x, Axis(marked("Parameter over its last value")), (*parameters, one, kept)),
    )


def _passes(
    passes: Array, values: Array | list[float], place: int, name: str, *, kind: Literal["line", "dashed", ""] = ""
) -> Curve:
    """Return values by pass as a line with points, in the look of a place in the key."""
    colour, marker = _COLOURS[place % len(_COLOURS)], _MARKERS[place % len(_MARKERS)]
    return Curve(passes, np.asarray(values), name, colour, kind or KINDS[place % len(KINDS)], marker=marker)


def _static(x: Axis, y: Axis, across: Array, values: Array, std: Array | None = None) -> Plot:
    low, high = (None, None) if std is None else _band(values, std)
    return Plot(marked("static"), x, y, (Curve(across, values, "", "model", low=low, high=high, width=1.4),))


def _dynamic(kernel: Array, std: Array | None, lag_s: Array, rate: float, unit: str = "1/s") -> Plot:
    """Return a linear block with its impulse response per second, from a kernel (lags,) per sample."""
    low, high = (None, None) if std is None else _band(rate * kernel, rate * std)
    curve = Curve(1e3 * lag_s, rate * kernel, "", "measured", low=low, high=high, width=1.4)
    return Plot(marked("linear"), LAG, Axis(marked("Impulse response"), unit, zero=True), (curve,))


def _band(values: Array, std: Array) -> tuple[Array, Array]:
    half = CONFIDENCE * np.where(np.isfinite(std), std, 0.0)
    return values - half, values + half


def _input_axis(record: Record) -> Axis:
    return signal_axis(record.input_name, record.input_unit)


def _output_axis(record: Record) -> Axis:
    return signal_axis(record.output_name, record.output_unit)


def _input_scale(record: Record) -> float:
    return display_unit(record.input_unit)[1]


__all__ = ["SINGLE_PASS", "cascade_blocks", "hammerstein_blocks", "iteration_plots", "wiener_blocks"]
