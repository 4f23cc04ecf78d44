"""Figures of recursive and adaptive least squares: the impulse response during the test (Chen 2010, 6.2)."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.diagnostics import Array
from tissueid.analysis.curves.plot import CONFIDENCE, Plot, Surface, thin
from tissueid.analysis.curves.units import LAG, TIME, kernel_unit, signal_axis
from tissueid.errors import UnusableInputError
from tissueid.formatting import axis_label, fixed
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.engines.rls import RlsModel
from tissueid.identification.online.identifier import OnlineModel
from tissueid.language import _, marked
from tissueid.messages import Message
from tissueid.reports.captions import joined, second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.panels import depth_bar, depth_colours
from tissueid.reports.plot_renderer import draw_plot
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
from tissueid.units import display_unit


@figure(
    OnlineModel,
    "impulse",
    marked("Impulse response"),
    marked("Impulse response against lag, with a band where one is known, and the second-order curve."),
    group="linear",
    wide=False,
    place=44,
)
def impulse_response(subject: Subject[OnlineModel]) -> Drawn:
    """Draw the response used in simulation: the last one of ``rls``, the mean of ``als`` (Chen 2010, Fig. 6.3a)."""
    model = subject.model
    unit, scale = kernel_unit(subject.record)
    drawn = new_figure(HALF_WIDTH, 3.9)
    axes = drawn.subplots()
    lag_ms, response = 1e3 * model.lag_s, scale * model.impulse_response
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    if isinstance(model, RlsModel):
        half = CONFIDENCE * scale * model.impulse_response_std
        low, high = response - half, response + half
        axes.fill_between(lag_ms, low, high, color=BLUE, alpha=0.22, linewidth=0.0, label=_("95 % band"))
    axes.plot(lag_ms, response, color=BLUE, linestyle="none", marker=".", markersize=4.0, label=_("each lag by itself"))
    fine = np.linspace(0.0, float(model.lag_s[-1]), 400)
    fitted = scale * model.second_order.sign * model.second_order.system.impulse_response(fine)
    axes.plot(1e3 * fine, fitted, color=ORANGE, linestyle=DASHES[1], linewidth=1.6, label=_("second order"))
    axes.set_xlim(0.0, float(lag_ms[-1]) or 1.0)
    axes.set_xlabel(_("Lag (ms)"))
    axes.set_ylabel(_("Impulse response ({unit})").format(unit=unit))
    axes.legend(loc="upper right")
    which = _("The response after the last sample. It is used in simulations.")
    if isinstance(model, AlsModel):
        which = _("The response averaged over time. It is used in simulations.")
    return drawn, joined(which, second_order(model.second_order))


@figure(
    OnlineModel,
    "convergence",
    marked("Convergence of the response"),
    marked("Curves over time: distance of the response from the last one, and its value at a few lags."),
    group="linear",
    wide=False,
    place=46,
)
def convergence(subject: Subject[OnlineModel]) -> Drawn:
    """Draw the distance of the response from the last one, and its value at a few lags."""
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
    upper.set_ylabel(_("Distance (%)"))
    peak = int(np.argmax(np.abs(last)))
    shown = sorted({peak // 2, peak, min(2 * peak + 1, last.size - 1)})
    for lag, colour, dash in zip(shown, SERIES, DASHES, strict=False):
        label = _("at {lag} ms").format(lag=fixed(1e3 * float(model.lag_s[lag]), 1))
        lower.plot(time_s, scale * course[:, lag], color=colour, linestyle=dash, linewidth=1.0, label=label)
    lower.set_ylabel(_("Response ({unit})").format(unit=unit))
    lower.set_xlabel(_("Time (s)"))
    lower.legend(loc="upper left", bbox_to_anchor=(0.0, 1.16), ncols=3, borderaxespad=0.0, handlelength=1.6)
    drawn.align_ylabels()
    settled = np.flatnonzero(distance > 10.0)
    after = float(time_s[min(settled[-1] + 1, time_s.size - 1)]) if settled.size else float(time_s[0])
    text = _("Above: distance from the last response, relative to it; below 10 % after {seconds} s.").format(
        seconds=fixed(after, 1)
    )
    expected = _("It should fall and stay low: late changes are drift. Below: the response at three lags.")
    if isinstance(model, AlsModel):
        expected = _("An adaptive response does not settle: it follows the tissue, and the noise. Below: three lags.")
    return drawn, joined(text, expected)


@figure(
    OnlineModel,
    "over-time",
    marked("Impulse response over time"),
    marked("Output over time, and below it an image of the impulse response over time and lag."),
    group="nonlinear",
    place=62,
)
def over_time(subject: Subject[OnlineModel]) -> Drawn:
    """Draw the response over time, with the output above it (Chen 2010, Fig. 6.4a)."""
    model, record = subject.model, subject.record
    course, time_s = _course(model)
    unit, scale = kernel_unit(record)
    out_unit, out_scale = display_unit(record.output_unit)
    drawn = new_figure(FULL_WIDTH, 4.6)
    upper, lower = drawn.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.7))
    upper.plot(*thin(record.time, out_scale * record.output), color=SERIES[2], linewidth=0.7)
    upper.set_ylabel(axis_label(record.output_name, out_unit))
    even = np.linspace(time_s[0], time_s[-1], course.shape[0])
    nearest = np.clip(np.searchsorted(time_s, even), 0, time_s.size - 1)
    settled = course[course.shape[0] // 4 :]
    top = scale * float(np.quantile(np.abs(settled), 0.999)) or None
    surface = Surface(even, 1e3 * model.lag_s, scale * course[nearest].T, unit=unit, limit=top)
    draw_plot(lower, Plot("", TIME, LAG, (surface,)))
    upper.set_xlim(0.0, float(time_s[-1]))
    drawn.align_ylabels()
    text = _(
        "Orange is positive. The response uses all samples so far; it should become steady within the first second."
    )
    if isinstance(model, AlsModel):
        text = _(
            "Orange is positive. Where the output is shallow the response should be larger and longer, where it is "
            "deep smaller and faster. It lags the depth by the time that it takes to adapt."
        )
    return drawn, text


@figure(
    AlsModel,
    "by-depth",
    marked("Impulse response by depth"),
    marked("Left: image of the impulse response over lag and depth. Right: the responses as curves coloured by depth."),
    group="nonlinear",
    place=63,
)
def by_depth(subject: Subject[AlsModel]) -> Drawn:
    """Draw the responses averaged by the output at which they were estimated (Chen 2010, Fig. 6.4b)."""
    model, record = subject.model, subject.record
    if model.depth_position.size < 2:
        raise UnusableInputError(
            Message("report.no_depth_levels", "responses by depth need a fit with two depth levels or more")
        )
    unit, scale = kernel_unit(record)
    out_unit, out_scale = display_unit(record.output_unit)
    output = subject.fitted_output[np.isfinite(subject.fitted_output)]
    edges = out_scale * np.concatenate([[output.min()], model.depth_edges, [output.max()]])
    lag_ms, responses = 1e3 * model.lag_s, scale * model.depth_response
    drawn = new_figure(FULL_WIDTH, 3.7)
    left, right = drawn.subplots(1, 2)
    surface = Surface(lag_ms, 0.5 * (edges[1:] + edges[:-1]), responses, unit=unit, edges=edges)
    depth = signal_axis(record.output_name, record.output_unit, reverse=True)
    draw_plot(left, Plot("", LAG, depth, (surface,)))
    right.axhline(0.0, color=MUTED, linewidth=0.8)
    for response, colour in zip(responses, depth_colours(len(responses)), strict=True):
        right.plot(lag_ms, response, color=colour, linewidth=1.2)
    right.set_xlim(0.0, float(lag_ms[-1]))
    right.set_xlabel(_("Lag (ms)"))
    right.set_ylabel(_("Impulse response ({unit})").format(unit=unit))
    depths = out_scale * model.depth_position
    depth_bar(right, float(depths.min()), float(depths.max()), axis_label(record.output_name, out_unit))
    return drawn, _(
        "Responses averaged by the depth at which they were estimated, deep at the bottom. Deeper tissue should "
        "respond less and faster. Adaptation takes time, so that a response is partly shown at the next depth: "
        "differences between depths appear too small."
    )


def _course(model: OnlineModel) -> tuple[Array, Array]:
    """Return responses (t, lags) and their times (t,), s.

    Raises:
        UnusableInputError: the model stored fewer than three responses.
    """
    if model.trajectory.shape[0] < 3:
        raise UnusableInputError(Message("report.record_too_short", "the record is too short for a response over time"))
    return model.trajectory, model.trajectory_s
