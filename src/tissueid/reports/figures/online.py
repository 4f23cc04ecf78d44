"""Figures of recursive and adaptive least squares: the impulse response during the test (Chen 2010, 6.2)."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.feedback import convergence_plots, response_by_depth, response_over_time
from tissueid.analysis.curves.linear import online_response
from tissueid.formatting import fixed
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.online.identifier import OnlineModel
from tissueid.language import _, marked
from tissueid.reports.captions import joined, second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, row_figure


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
    drawn = column_figure([online_response(model, subject.record)], 3.9)
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
    above, below = convergence_plots(subject.model, subject.record)
    drawn = column_figure((above, below), 3.9)
    time_s, distance = above.curves[0].x, above.curves[0].y
    settled = np.flatnonzero(distance > 10.0)
    after = float(time_s[min(settled[-1] + 1, time_s.size - 1)]) if settled.size else float(time_s[0])
    text = _("Above: distance from the last response, relative to it; below 10 % after {seconds} s.").format(
        seconds=fixed(after, 1)
    )
    expected = _("It should fall and stay low: late changes are drift. Below: the response at three lags.")
    if isinstance(subject.model, AlsModel):
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
    plots = response_over_time(subject.model, subject.record)
    drawn = column_figure(plots, 4.6, wide=True, heights=(1.0, 1.7))
    text = _(
        "Orange is positive. The response uses all samples so far; it should become steady within the first second."
    )
    if isinstance(subject.model, AlsModel):
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
    plots = response_by_depth(subject.model, subject.record, subject.fitted_output)
    return row_figure(plots, 3.7), _(
        "Responses averaged by the depth at which they were estimated, deep at the bottom. Deeper tissue should "
        "respond less and faster. Adaptation takes time, so that a response is partly shown at the next depth: "
        "differences between depths appear too small."
    )
