"""Panels of a designed stimulus: what is played, with its targets."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from matplotlib.figure import FigureBase

from tissueid.analysis.curves.signals import (
    amplitude_plots,
    autocorrelation_plots,
    line_plot,
    power_plot,
    stimulus_plots,
    swaps_plot,
)
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.formatting import number
from tissueid.language import _, marked
from tissueid.reports import captions
from tissueid.reports.page import Panel
from tissueid.reports.plot_renderer import draw_plots, draw_row
from tissueid.stimuli.kinds.multisine import Multisine

_AMPLITUDES = marked("Left: histogram of the amplitudes. Right: share of samples below each amplitude.")
_INTENDED = marked("Dashed: intended amplitudes, counted in the same bins.")


def stimulus_panels(design: StimulusDesign) -> Iterator[Panel]:
    """Yield the panels that apply to a stimulus."""
    yield _time_series(design)
    yield _amplitudes(design)
    if isinstance(design.specification, Multisine):
        yield _lines(design, design.specification)
    yield _power(design)
    yield _autocorrelation(design)
    if design.search is not None:
        yield _swaps(design)


def _time_series(design: StimulusDesign) -> Panel:
    return Panel(
        "time-series",
        _("Over time"),
        _("Line plots of the stimulus: the whole of it, and a fifth of a second sample by sample."),
        _("Above: the whole stimulus. Below: its beginning sample by sample. Volts are those of a coil at rest."),
        lambda figure: _draw_time_series(figure, design),
        height=3.9,
    )


def _draw_time_series(figure: FigureBase, design: StimulusDesign) -> None:
    """Draw the stimulus; the right axis converts newtons to volts, or volts to newtons."""
    in_newtons = design.stimulus.unit == "N"
    per_newton = design.device.voltage_for_force(1.0)
    factor = per_newton if in_newtons else 1.0 / per_newton
    for axes in draw_plots(figure, stimulus_plots(design.stimulus))[0]:
        other = axes.secondary_yaxis(
            "right", functions=(partial(np.multiply, factor), partial(np.multiply, 1.0 / factor))
        )
        other.set_ylabel(_("Command (V)") if in_newtons else _("Force at rest (N)"))
        other.spines["right"].set_visible(True)


def _amplitudes(design: StimulusDesign) -> Panel:
    wanted = design.intended_amplitudes
    return Panel(
        "amplitudes",
        _("Distribution of amplitudes"),
        _("Histogram and cumulative distribution of the values, with the intended ones as dashed lines."),
        captions.joined(_(_AMPLITUDES), "" if wanted is None else _(_INTENDED)),
        lambda figure: draw_row(figure, amplitude_plots(design.played, design.stimulus.unit, wanted)),
        height=2.7,
    )


def _lines(design: StimulusDesign, multisine: Multisine) -> Panel:
    return Panel(
        "lines",
        _("Lines of one period"),
        _("Amplitude of the lines of one period against frequency: driven, detection and other lines."),
        _(
            "One period has a line every {spacing} Hz. Lines that are not driven contain only rounding, so that power "
            "of the response at these lines is noise or distortion."
        ).format(spacing=number(multisine.resolution_hz)),
        lambda figure: draw_row(figure, [line_plot(multisine, design.stimulus)]),
    )


def _power(design: StimulusDesign) -> Panel:
    found = design.appraisal
    edges = [(hz, label) for hz, label in ((found.power_95_hz, "95 %"), (found.power_99_hz, "99 %")) if hz is not None]
    target = design.target_power
    return Panel(
        "power",
        _("Power spectral density"),
        _("Power spectral density against frequency, both axes logarithmic, with its target where there is one."),
        captions.joined(
            _("Welch's estimate. Dotted: frequencies below which 95 % and 99 % of the power about the mean lie."),
            "" if target is None else _("Dashed: target."),
        ),
        lambda figure: draw_row(
            figure, [power_plot(design.played, design.stimulus.sample_rate_hz, design.stimulus.unit, target, edges)]
        ),
        wide=False,
    )


def _autocorrelation(design: StimulusDesign) -> Panel:
    rate, error = design.stimulus.sample_rate_hz, design.autocorrelation_error
    caption = _("Autocorrelation of the played values about their mean, divided by its value at lag 0.")
    if error is not None:
        squares = _("Below: played minus target; the sum of squares over {lags} lags is {sum}.")
        caption = captions.joined(caption, squares.format(lags=design.autocorrelation.size - 1, sum=number(error, 2)))

    def draw(figure: FigureBase) -> None:
        plots = autocorrelation_plots(design.autocorrelation, rate, design.target_autocorrelation)
        draw_plots(figure, plots, heights=(1.5, 1.0)[: len(plots)])

    return Panel(
        "autocorrelation",
        _("Autocorrelation"),
        _("Normalised autocorrelation against lag, with its target where there is one and the difference below."),
        caption,
        draw,
        wide=False,
    )


def _swaps(design: StimulusDesign) -> Panel:
    return Panel(
        "swaps",
        _("Convergence of the interchange"),
        _("Sum of squared differences of the autocorrelation from its target against accepted swaps."),
        _(
            "Every accepted swap reduces the error. It begins at the error of the spectral surrogate (Chen 2010, "
            "Fig. 6.2b)."
        ),
        lambda figure: draw_row(figure, [swaps_plot(design.search)]),
        wide=False,
    )
