"""The panels of tests whose stimulus was generated while they ran (Chen 2010, Figs. 6.7, 6.8 and 6.10 to 6.12)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tissueid.reports.feedback_figures import (
    FeedbackRun,
    draw_feedback_distributions,
    draw_feedback_parameters,
    draw_feedback_series,
)
from tissueid.reports.panel_sheet import Panel


def feedback_panels(runs: Sequence[FeedbackRun]) -> Iterator[Panel]:
    """All panels of one run, or of several side by side."""
    yield Panel(
        "feedback-series",
        "Force and depth over time",
        "Line plots over time of the force and, below, of the depth with the range that was to be visited.",
        "The force goes to and fro so that the depth visits its range (dashed) as often as it was asked to.",
        lambda figure: draw_feedback_series(figure, runs),
        height=3.9,
    )
    yield Panel(
        "feedback-distributions",
        "Distributions and linear description",
        "Histograms of force and depth, the linear impulse response, and depth against its linear prediction.",
        "From the left: force; depth, with the desired distribution (dashed) and Kolmogorov's distance from it; the "
        "linear response of the whole test; depth against what that response predicts, which bends where the tissue "
        "stiffens.",
        lambda figure: draw_feedback_distributions(figure, runs),
        height=0.5 + 2.1 * len(runs),
    )
    yield Panel(
        "feedback-parameters",
        "Mass, damping and stiffness by depth, as identified on the way",
        "Three panels against depth: mass, damping and stiffness by level, and below them the samples of each level.",
        "What the loop identified by adaptive least squares while the test ran. Levels share samples and the "
        "stochastic part is wide, so neighbours are averaged (Chen 2010, 6.3.2); an engine on the whole record does "
        "better.",
        lambda figure: draw_feedback_parameters(figure, runs),
        height=4.3,
    )
