"""Plot of a sealed check: risk against coverage."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.plot import Axis, Curve, Plot, steps
from tissueid.gap.blind_scoring import Score
from tissueid.language import marked

_MOST_POINTS = 40
"""Number of answers from which they are drawn without points."""


def risk_plot(score: Score) -> Plot:
    """Return the share of wrong names among the answers against the share of answered scenarios; the score has some."""
    coverage, risk = 100.0 * np.array(score.risk_coverage).T
    parts = [
        Curve(np.array([0.0, 100.0]), np.full(2, risk[-1]), "", "muted", "dotted", width=0.8),
        Curve(*steps(coverage, risk)),
    ]
    if risk.size < _MOST_POINTS:
        parts.append(Curve(coverage, risk, kind="points", marker="o", width=0.9))
    return Plot(
        "",
        Axis(marked("Answered (% of scenarios, most probable first)"), limits=(0.0, 101.0)),
        Axis(marked("Wrong among them"), "%", limits=(-1.0, max(1.15 * float(risk.max()), 10.0))),
        tuple(parts),
    )


__all__ = ["risk_plot"]
