"""Figures of recursive and adaptive least squares: the response under way (Chen 2010, 6.2)."""

from __future__ import annotations

import numpy as np

from tissueid.errors import UnusableInputError
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.engines.rls import RlsModel
from tissueid.identification.online.identifier import OnlineModel
from tissueid.reports.captions import second_order
from tissueid.reports.diagnostics import CONFIDENCE, Array, thin
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import depth_bar, depth_colours, image, uneven_image
from tissueid.reports.style import (
    BLUE,
    DASHES,
    FULL_WIDTH,
    HALF_WIDTH,
    MUTED,
    ORANGE,
    SERIES,
    new_figure,
)
from tissueid.reports.units import kernel_unit
from tissueid.wording import axis_label, fixed, people_unit


@figure(
    OnlineModel,
    "impulse",
    "Impulse response",
    "Impulse response against lag, with a band where one is known, and the second-order curve.",
    group="linear",
    wide=False,
    place=44,
)
def impulse_response(subject: Subject[OnlineModel]) -> Drawn:
    """The response that is simulated: the last one of ``rls``, the average of ``als`` (Chen 2010, Fig. 6.3a)."""
    model = subject.model
    unit, scale = kernel_unit(subject.record)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    lag_ms, response = 1e3 * model.lag_s, scale * model.impulse_response
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    if isinstance(model, RlsModel):
        half = CONFIDENCE * scale * model.impulse_response_std
        low, high = response - half, response + half
        axes.fill_between(lag_ms, low, high, color=BLUE, alpha=0.22, linewidth=0.0, label="95 % band")
    axes.plot(lag_ms, response, color=BLUE, linestyle="none", marker=".", markersize=4.0, label="each lag by itself")
    fine = np.linspace(0.0, float(model.lag_s[-1]), 400)
    fitted = scale * model.second_order.sign * model.second_order.system.impulse_response(fine)
    axes.plot(1e3 * fine, fitted, color=ORANGE, linestyle=DASHES[1], linewidth=1.6, label="second order")
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel("Lag (ms)")
    axes.set_ylabel(f"Impulse response ({unit})")
    axes.legend(loc="upper right")
    which = "averaged over time" if isinstance(model, AlsModel) else "after the last sample"
    return drawn, f"The response {which}, which is what is simulated. {second_order(model.second_order)}"


@figure(
    OnlineModel,
    "convergence",
    "How the response settled",
    "Curves over time: distance of the response from its last, and the value of a few lags.",
    group="linear",
    wide=False,
    place=46,
)
def convergence(subject: Subject[OnlineModel]) -> Drawn:
    """How far the response was from where it ended, and a few of its lags."""
    model = subject.model
    course, time_s = _course(model)
    last = course[-1]
    size = float(np.sqrt(np.sum(last**2))) or 1.0
    distance = 100.0 * np.sqrt(np.sum((course - last) ** 2, axis=1)) / size
    unit, scale = kernel_unit(subject.record)
    drawn = new_figure(HALF_WIDTH, 3.9)
    upper, lower = drawn.subplots(2, 1, sharex=True)
    upper.plot(time_s, distance, color=BLUE)
    upper.set_ylim(0.0, min(1.05 * float(distance.max()), 200.0) or 1.0)
    upper.set_ylabel("Distance (%)")
    peak = int(np.argmax(np.abs(last)))
    shown = sorted({peak // 2, peak, min(2 * peak + 1, last.size - 1)})
    for lag, colour, dash in zip(shown, SERIES, DASHES, strict=False):
        label = f"at {fixed(1e3 * float(model.lag_s[lag]), 1)} ms"
        lower.plot(time_s, scale * course[:, lag], color=colour, linestyle=dash, linewidth=1.0, label=label)
    lower.set_ylabel(f"Response ({unit})")
    lower.set_xlabel("Time (s)")
    lower.legend(loc="upper left", bbox_to_anchor=(0.0, 1.16), ncols=3, borderaxespad=0.0, handlelength=1.6)
    drawn.align_ylabels()
    settled = np.flatnonzero(distance > 10.0)
    after = float(time_s[min(settled[-1] + 1, time_s.size - 1)]) if settled.size else float(time_s[0])
    text = f"Above: distance from the last response, as a share of it; within 10 % from {fixed(after, 1)} s on. "
    if isinstance(model, AlsModel):
        return (
            drawn,
            text + "An adaptive response does not settle: it follows the tissue, and the noise. Below: three lags.",
        )
    return (
        drawn,
        text + "It should fall and stay low: what goes on moving late is drift. Below: the response at three lags.",
    )


@figure(
    OnlineModel,
    "over-time",
    "Impulse response over time",
    "Output over time, and below it an image of the impulse response over time and lag.",
    group="nonlinear",
    place=62,
)
def over_time(subject: Subject[OnlineModel]) -> Drawn:
    """The course of the response, with the output above it (Chen 2010, Fig. 6.4a)."""
    model, record = subject.model, subject.record
    course, time_s = _course(model)
    unit, scale = kernel_unit(record)
    out_unit, out_scale = people_unit(record.output_unit)
    drawn = new_figure(FULL_WIDTH, 4.6)
    upper, lower = drawn.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.7))
    upper.plot(*thin(record.time, out_scale * record.output), color=SERIES[2], linewidth=0.7)
    upper.set_ylabel(axis_label(record.output_name, out_unit))
    even = np.linspace(time_s[0], time_s[-1], course.shape[0])
    nearest = np.clip(np.searchsorted(time_s, even), 0, time_s.size - 1)
    settled = course[course.shape[0] // 4 :]
    top = scale * float(np.quantile(np.abs(settled), 0.999)) or None
    image(lower, even, 1e3 * model.lag_s, scale * course[nearest].T, f"({unit})", limit=top)
    lower.set_ylabel("Lag (ms)")
    lower.set_xlabel("Time (s)")
    upper.set_xlim(0.0, float(time_s[-1]))
    drawn.align_ylabels()
    text = "Orange is positive. "
    if isinstance(model, AlsModel):
        text += (
            "Where the output goes shallow the response should grow and last longer; where it goes deep it should "
            "become small and quick. It trails the depth by the time that it takes to adapt."
        )
    else:
        text += "The response gathers all samples so far; it should become steady after the first part of a second."
    return drawn, text


@figure(
    AlsModel,
    "by-depth",
    "Impulse response by depth",
    "Left: image of the impulse response over lag and depth. Right: the responses as curves coloured by depth.",
    group="nonlinear",
    place=63,
)
def by_depth(subject: Subject[AlsModel]) -> Drawn:
    """Responses sorted by the output at which they held (Chen 2010, Fig. 6.4b)."""
    model, record = subject.model, subject.record
    if model.depth_position.size < 2:
        raise UnusableInputError("the responses were not sorted by depth: fit a record, with two levels or more")
    unit, scale = kernel_unit(record)
    out_unit, out_scale = people_unit(record.output_unit)
    output = subject.fitted_output[np.isfinite(subject.fitted_output)]
    edges = out_scale * np.concatenate([[output.min()], model.depth_edges, [output.max()]])
    lag_ms, responses = 1e3 * model.lag_s, scale * model.depth_response
    drawn = new_figure(FULL_WIDTH, 3.7)
    left, right = drawn.subplots(1, 2)
    uneven_image(left, lag_ms, edges, responses, f"({unit})")
    left.invert_yaxis()
    left.set_xlabel("Lag (ms)")
    left.set_ylabel(axis_label(record.output_name, out_unit))
    right.axhline(0.0, color=MUTED, linewidth=0.8)
    for response, colour in zip(responses, depth_colours(len(responses)), strict=True):
        right.plot(lag_ms, response, color=colour, linewidth=1.2)
    right.set_xlim(0.0, float(lag_ms[-1]))
    right.set_xlabel("Lag (ms)")
    right.set_ylabel(f"Impulse response ({unit})")
    depths = out_scale * model.depth_position
    depth_bar(right, float(depths.min()), float(depths.max()), axis_label(record.output_name, out_unit))
    return drawn, (
        "The responses of the course averaged by the depth at which they held, deep at the bottom. Deeper tissue "
        "should answer less and sooner. What was learnt at one depth is partly shown at the next, because adapting "
        "takes time: differences between depths come out too small."
    )


def _course(model: OnlineModel) -> tuple[Array, Array]:
    """Responses (t, lags) and times (t,).

    Raises:
        UnusableInputError: fewer than three moments were kept.
    """
    if model.trajectory.shape[0] < 3:
        raise UnusableInputError("the record is too short for a course over time")
    return model.trajectory, model.trajectory_s
