"""Plots of the impulse response during a test, by recursive and adaptive least squares (Chen 2010, 6.2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.analysis.curves.plot import Array, Axis, Curve, Plot, Surface, depth_roles
from tissueid.analysis.curves.units import LAG, TIME, kernel_unit, signal_axis
from tissueid.analysis.curves.validation import KINDS, ROLES
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.online.identifier import OnlineModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_FULLEST = 0.999
"""Share of the responses after the first quarter below the value of the fullest colour."""


def convergence_plots(model: OnlineModel, record: Record) -> tuple[Plot, Plot]:
    """Return the distance of the response from the last one, and its value at three lags, against time.

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    course, time_s = _course(model)
    last = course[-1]
    size = float(np.sqrt(np.sum(last**2))) or 1.0
    distance = 100.0 * np.sqrt(np.sum((course - last) ** 2, axis=1)) / size
    unit, scale = kernel_unit(record)
    peak = int(np.argmax(np.abs(last)))
    shown = sorted({peak // 2, peak, min(2 * peak + 1, last.size - 1)})
    curves = []
    for lag, colour, kind in zip(shown, ROLES, KINDS, strict=False):
        name = Message("plot.at_lag", "at {lag:.1f} ms", lag=1e3 * float(model.lag_s[lag]))
        curves.append(Curve(time_s, scale * course[:, lag], name, colour, kind, width=0.8))
    away = Axis(marked("Distance"), "%", limits=(0.0, min(1.05 * float(distance.max()), 200.0) or 1.0))
    return (
        Plot("", TIME, away, (Curve(time_s, distance),)),
        Plot("", TIME, Axis(marked("Response"), unit), tuple(curves)),
    )


def response_over_time(model: OnlineModel, record: Record) -> tuple[Plot, Plot]:
    """Return the output, and the impulse response over time and lag (Chen 2010, Fig. 6.4a).

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    course, time_s = _course(model)
    unit, scale = kernel_unit(record)
    even = np.linspace(time_s[0], time_s[-1], course.shape[0])
    nearest = np.clip(np.searchsorted(time_s, even), 0, time_s.size - 1)
    top = scale * float(np.quantile(np.abs(course[course.shape[0] // 4 :]), _FULLEST)) or None
    time = replace(TIME, limits=(0.0, float(time_s[-1])))
    out_scale = display_unit(record.output_unit)[1]
    output = Curve(record.time, out_scale * record.output, colour="good", width=0.5)
    surface = Surface(even, 1e3 * model.lag_s, scale * course[nearest].T, unit=unit, limit=top)
    return (
        Plot("", time, signal_axis(record.output_name, record.output_unit), (output,)),
        Plot("", time, LAG, (surface,)),
    )


def response_by_depth(model: AlsModel, record: Record, fitted_output: Array) -> tuple[Plot, Plot]:
    """Return the responses averaged by the output (n,) at which they were estimated (Chen 2010, Fig. 6.4b).

    The first plot shows them over lag and depth, the second as curves.

    Raises:
        UnusableInputError: the model has fewer than two levels of depth.
    """
    if model.depth_position.size < 2:
        raise UnusableInputError(
            "report.no_depth_levels", "responses by depth need a fit with two depth levels or more"
        )
    unit, scale = kernel_unit(record)
    out_scale = display_unit(record.output_unit)[1]
    output = fitted_output[np.isfinite(fitted_output)]
    edges = out_scale * np.concatenate([[output.min()], model.depth_edges, [output.max()]])
    lag_ms, responses = 1e3 * model.lag_s, scale * model.depth_response
    surface = Surface(lag_ms, 0.5 * (edges[1:] + edges[:-1]), responses, unit=unit, edges=edges)
    depth = signal_axis(record.output_name, record.output_unit)
    places = out_scale * model.depth_position
    curves = zip(responses, depth_roles(len(responses)), strict=True)
    return (
        Plot("", LAG, replace(depth, reverse=True), (surface,)),
        Plot(
            "",
            replace(LAG, limits=(0.0, float(lag_ms[-1]))),
            Axis(marked("Impulse response"), unit, zero=True),
            tuple(Curve(lag_ms, response, "", role) for response, role in curves),
            depths=replace(depth, limits=(float(places.min()), float(places.max()))),
        ),
    )


def _course(model: OnlineModel) -> tuple[Array, Array]:
    """Return responses (t, lags) and their times (t,), s.

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    if model.trajectory.shape[0] < 3:
        raise UnusableInputError("report.record_too_short", "the record is too short for a response over time")
    return model.trajectory, model.trajectory_s


__all__ = ["convergence_plots", "response_by_depth", "response_over_time"]
