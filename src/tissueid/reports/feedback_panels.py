"""Panels of tests with a feedback stimulus (Chen 2010, Figs. 6.7, 6.8 and 6.10 to 6.12)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tissueid.analysis.curves.feedback import FeedbackRun, description_plots, profiles_of, series_plots, settling_plot
from tissueid.language import _
from tissueid.reports.depth_panels import draw_depth_panels
from tissueid.reports.page import Panel
from tissueid.reports.plot_renderer import draw_grid


def feedback_panels(runs: Sequence[FeedbackRun]) -> Iterator[Panel]:
    """Yield all panels of one run, or of several side by side."""
    yield Panel(
        "feedback-series",
        _("Force and depth over time"),
        _("Line plots over time of the force and, below, of the depth with its desired range."),
        _("The force sweeps so that the depth covers its range (dashed) with the desired distribution."),
        lambda figure: draw_grid(figure, list(zip(*map(series_plots, runs), strict=True))),
        height=3.9,
    )
    yield Panel(
        "feedback-distributions",
        _("Distributions and linear description"),
        _("Histograms of force and depth, the linear impulse response, and depth against its linear prediction."),
        _(
            "From left to right: force; depth, with the desired distribution (dashed) and Kolmogorov's distance from "
            "it; linear response of the whole test; depth against its linear prediction, which bends where the tissue "
            "stiffens."
        ),
        lambda figure: draw_grid(figure, [description_plots(run, run.label if len(runs) > 1 else "") for run in runs]),
        height=0.5 + 2.1 * len(runs),
    )
    yield Panel(
        "feedback-settling",
        _("Settling time, block and memory"),
        _("A map of the settling time of the impulse response by stiffness and damping."),
        _(
            "Time after which the impulse response stays below 5 % of its peak (Chen 2010, Fig. 6.6). The mean depth "
            "follows the offset of the force only over times longer than that: between the dashed lines, where there "
            "are any, a block is long enough, and between the dotted lines the memory is. Points: the levels of depth "
            "as identified during the test."
        ),
        lambda figure: draw_grid(figure, [[settling_plot(runs)]]),
        height=3.4,
    )
    yield Panel(
        "feedback-parameters",
        _("Mass, damping and stiffness by depth, identified during the test"),
        _("Three panels against depth: mass, damping and stiffness by level, and below the samples of each level."),
        _(
            "Estimates of the feedback loop by adaptive least squares, which steer the stimulus during the test. They "
            "are no result: neighbouring levels are averaged, and mass and damping can be wrong by a factor of two or "
            "more (Chen 2010, 6.3.2). Use an engine fitted to the whole record."
        ),
        lambda figure: draw_depth_panels(figure, profiles_of(runs), 0.0),
        height=4.3,
    )
