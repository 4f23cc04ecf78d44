"""Figures of localized linear tests: levels of a stepped record, and the dynamics at each (Chen 2010, 3.4)."""

from __future__ import annotations

import numpy as np

from tissueid.analysis.curves.linear import by_depth, level_impulse_plots, level_plots, level_response_plots
from tissueid.formatting import fixed
from tissueid.identification.localized import LocalizedModel
from tissueid.language import _, marked
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, row_figure


@figure(
    LocalizedModel,
    "levels",
    marked("Levels found in the record"),
    marked("Input and output over time, with each level as a line coloured by its depth."),
    group="record",
    place=50,
)
def levels(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw the levels found in the record (Chen 2010, Fig. 3.12)."""
    found = subject.model.levels
    drawn = column_figure(level_plots(subject.model, subject.record), 3.9, wide=True)
    least = min(one.samples for one in found)
    return drawn, _(
        "{count} levels; each has its own linear fit, which begins one memory length after the step. Lines: mean of "
        "each level, coloured from shallow to deep. The shortest level has {least} usable samples."
    ).format(count=len(found), least=least)


@figure(
    LocalizedModel,
    "impulse-responses",
    marked("Impulse response at each level"),
    marked("Left: impulse responses against lag, coloured by depth. Right: each divided by its area."),
    group="linear",
    place=50,
)
def impulse_responses(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw impulse responses by level, unscaled and divided by their area (Chen 2010, Fig. 3.12a)."""
    drawn = row_figure(level_impulse_plots(subject.model, subject.record), 3.7)
    return drawn, _(
        "Deeper tissue should respond less and faster. Divided by its area (right), a response shows the dynamics "
        "alone: in a Wiener system all curves would coincide. Dashed: levels reached by moving out of the tissue."
    )


@figure(
    LocalizedModel,
    "bode",
    marked("Bode diagram at each level"),
    marked("Magnitude and phase against frequency of the linear system at each level, coloured by depth."),
    group="linear",
    place=52,
)
def bode(subject: Subject[LocalizedModel]) -> Drawn:
    """Draw the compliance by level (Chen 2010, Fig. 3.13)."""
    drawn = row_figure(level_response_plots(subject.model, subject.record), 3.7)
    natural = [one.fit.system.natural_frequency_rad_per_s / (2.0 * np.pi) for one in by_depth(subject.model)]
    low, high = (fixed(float(one), 1) for one in (natural[0], natural[-1]))
    return drawn, _(
        "The magnitude at low frequencies is one over the stiffness: it falls with depth, while the natural frequency "
        "rises, here from {low} Hz at the shallowest level to {high} Hz at the deepest."
    ).format(low=low, high=high)
