"""Figures of linear dynamics: impulse response, coherence, Bode diagram, in the whole record, online and by level."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis.curves.feedback import convergence_plots, response_by_depth, response_over_time
from tissueid.analysis.curves.linear import (
    by_depth,
    coherence_plot,
    frequency_response,
    impulse_response,
    level_impulse_plots,
    level_plots,
    level_response_plots,
    online_response,
    power_band,
)
from tissueid.formatting import fixed, number
from tissueid.identification.engines.als import AlsModel
from tissueid.identification.engines.lms import Lms, LmsModel
from tissueid.identification.engines.localized import LocalizedModel
from tissueid.identification.engines.spectral import Spectral, SpectralModel
from tissueid.identification.online_identifier import OnlineModel
from tissueid.language import _, marked
from tissueid.reports.captions import joined, second_order
from tissueid.reports.figures.registry import Drawn, FigureSubject, figure
from tissueid.reports.plot_renderer import column_figure, draw_plot, row_figure
from tissueid.reports.style import HALF_WIDTH, MUTED, drawing, new_figure


@figure(
    LmsModel,
    "impulse",
    marked("Impulse response"),
    marked("Impulse response against lag: points with a band of one deviation, and the second-order curve."),
    group="linear",
    wide=False,
    order=40,
    standard=Lms.name,
)
def _impulse_response(subject: FigureSubject[LmsModel]) -> Drawn:
    model = subject.model
    memory_ms = 1e3 * model.memory_samples / model.sample_rate_hz
    text = _(
        "The response rises, and should be over well before the end of the memory of {memory} ms; the "
        "points should scatter about the curve within the band. The last lags also carry what comes after the memory. "
        "A curve that dips below zero is that of a damping ratio below one."
    ).format(memory=number(memory_ms, 3))
    drawn = column_figure([impulse_response(model, subject.record)], 4.6)
    return drawn, f"{text} {second_order(model.second_order)}"


@figure(
    SpectralModel,
    "coherence",
    marked("Mean squared coherence"),
    marked("Coherence between 0 and 1 against frequency, with its significance level as a dashed line."),
    group="record",
    wide=False,
    order=30,
    standard=Spectral.name,
    short=True,
)
def _coherence(subject: FigureSubject[SpectralModel]) -> Drawn:
    model = subject.model
    band = power_band(model.spectra)
    mean = float(np.mean(model.spectra.coherence[band])) if band.any() else None
    return coherence_figure(model), _(
        "Near one where a linear system explains the motion; lower where nonlinearity, drift or noise takes part. "
        "The mean over the excited band is {mean}. Unrelated signals exceed the dashed level of {level} at one "
        "frequency in twenty."
    ).format(mean=fixed(mean, 2), level=fixed(model.spectra.coherence_floor, 2))


@figure(
    SpectralModel,
    "bode",
    marked("Bode diagram"),
    marked("Magnitude and phase of output over input against frequency, measured and as a second-order system."),
    group="linear",
    wide=False,
    order=30,
    standard=Spectral.name,
    short=True,
)
def _bode(subject: FigureSubject[SpectralModel]) -> Drawn:
    text = _(
        "Over the band where the input has power. The magnitude should be level up to the natural frequency and then "
        "fall with the square of the frequency, while the phase goes from 0° towards −180°."
    )
    drawn = column_figure(frequency_response(subject.model, subject.record), 4.6)
    return drawn, f"{text} {second_order(subject.model.second_order)}"


@drawing
def coherence_figure(model: SpectralModel) -> Figure:
    """Mean squared coherence with the level that unrelated signals seldom exceed (Chen 2010, Fig. 3.2b, Eq. 3.1)."""
    figure = new_figure(HALF_WIDTH, 3.3)
    axes, plot = figure.subplots(), coherence_plot(model.spectra)
    draw_plot(axes, plot)
    if any(curve.kind == "spans" for curve in plot.curves):
        label, end = _("hardly\nany input"), float(model.spectra.frequency_hz[-1])
        look: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "top", "fontsize": 8.5}
        axes.annotate(label, (end, 1.0), (-3, 0), color=MUTED, **look)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, min(0.7, model.spectra.coherence_floor + 0.01)))
    return figure


@figure(
    OnlineModel,
    "impulse",
    marked("Impulse response"),
    marked("Impulse response against lag, with a band where one is known, and the second-order curve."),
    group="linear",
    wide=False,
    order=44,
)
def impulse_figure(subject: FigureSubject[OnlineModel]) -> Drawn:
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
    order=46,
)
def convergence(subject: FigureSubject[OnlineModel]) -> Drawn:
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
    order=62,
)
def over_time(subject: FigureSubject[OnlineModel]) -> Drawn:
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
    order=63,
)
def online_by_depth(subject: FigureSubject[AlsModel]) -> Drawn:
    """Draw the responses averaged by the output at which they were estimated (Chen 2010, Fig. 6.4b)."""
    plots = response_by_depth(subject.model, subject.record, subject.fitted_output)
    return row_figure(plots, 3.7), _(
        "Responses averaged by the depth at which they were estimated, deep at the bottom. Deeper tissue should "
        "respond less and faster. Adaptation takes time, so that a response is partly shown at the next depth: "
        "differences between depths appear too small."
    )


@figure(
    LocalizedModel,
    "levels",
    marked("Levels found in the record"),
    marked("Input and output over time, with each level as a line coloured by its depth."),
    group="record",
    order=50,
)
def levels(subject: FigureSubject[LocalizedModel]) -> Drawn:
    """Draw the levels found in the record (Chen 2010, Fig. 3.12)."""
    level_fits = subject.model.levels
    drawn = column_figure(level_plots(subject.model, subject.record), 3.9, wide=True)
    least = min(level.samples for level in level_fits)
    return drawn, _(
        "{count} levels; each has its own linear fit, which begins one memory length after the step. Lines: mean of "
        "each level, coloured from shallow to deep. The shortest level has {least} usable samples."
    ).format(count=len(level_fits), least=least)


@figure(
    LocalizedModel,
    "impulse-responses",
    marked("Impulse response at each level"),
    marked("Left: impulse responses against lag, coloured by depth. Right: each divided by its area."),
    group="linear",
    order=50,
)
def impulse_responses(subject: FigureSubject[LocalizedModel]) -> Drawn:
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
    order=52,
)
def bode(subject: FigureSubject[LocalizedModel]) -> Drawn:
    """Draw the compliance by level (Chen 2010, Fig. 3.13)."""
    drawn = row_figure(level_response_plots(subject.model, subject.record), 3.7)
    natural = [level.fit.system.natural_frequency_rad_per_s / (2.0 * np.pi) for level in by_depth(subject.model)]
    low, high = (fixed(float(frequency), 1) for frequency in (natural[0], natural[-1]))
    return drawn, _(
        "The magnitude at low frequencies is one over the stiffness: it falls with depth, while the natural frequency "
        "rises, here from {low} Hz at the shallowest level to {high} Hz at the deepest."
    ).format(low=low, high=high)
