"""The panels of a designed stimulus, each with what was asked for beside what came out."""

from __future__ import annotations

from collections.abc import Iterator

from tissueid.analysis.design import Design
from tissueid.reports.panel_sheet import Panel
from tissueid.reports.stimulus_figures import (
    draw_amplitudes,
    draw_autocorrelation,
    draw_lines,
    draw_power,
    draw_swaps,
    draw_time_series,
)
from tissueid.stimuli.kinds.multisine import Multisine
from tissueid.wording import number

_AMPLITUDES = "Left: how often each amplitude is played; right: the share of samples below it."
_INTENDED = " Dashed: what was asked for, counted in the same bins."


def stimulus_panels(design: Design) -> Iterator[Panel]:
    """All panels that have a meaning for a stimulus."""
    yield _time_series(design)
    yield _amplitudes(design)
    if isinstance(design.specification, Multisine):
        yield _lines(design, design.specification)
    yield _power(design)
    yield _autocorrelation(design)
    if design.search is not None:
        yield _swaps(design)


def _time_series(design: Design) -> Panel:
    return Panel(
        "time-series",
        "Over time",
        "Line plots of the stimulus: the whole of it, and a fifth of a second sample by sample.",
        "Above the whole stimulus, below its beginning sample by sample. Volts are those of a coil at rest.",
        lambda figure: draw_time_series(figure, design.stimulus, design.device),
        height=3.9,
    )


def _amplitudes(design: Design) -> Panel:
    wanted = design.intended_amplitudes
    return Panel(
        "amplitudes",
        "Distribution of amplitudes",
        "Histogram and cumulative distribution of the values, with the intended ones as dashed lines.",
        _AMPLITUDES if wanted is None else _AMPLITUDES + _INTENDED,
        lambda figure: draw_amplitudes(figure, design.played, design.stimulus.unit, wanted),
        height=2.7,
    )


def _lines(design: Design, multisine: Multisine) -> Panel:
    return Panel(
        "lines",
        "Lines of one period",
        "Amplitude of the lines of one period against frequency: driven, detection and other lines.",
        f"One period has a line every {number(multisine.resolution_hz)} Hz. Lines that are not driven are empty but "
        "for rounding, so what the answer holds there is noise or distortion.",
        lambda figure: draw_lines(figure, multisine, design.stimulus),
    )


def _power(design: Design) -> Panel:
    found = design.appraisal
    edges = [(hz, label) for hz, label in ((found.power_95_hz, "95 %"), (found.power_99_hz, "99 %")) if hz is not None]
    target = design.target_power
    return Panel(
        "power",
        "Power spectral density",
        "Power spectral density against frequency, both axes logarithmic, with its target where there is one.",
        "Welch's estimate. Dotted: where 95 and 99 % of the power about the mean end."
        + ("" if target is None else " Dashed: the target."),
        lambda figure: draw_power(
            figure, design.played, design.stimulus.sample_rate_hz, design.stimulus.unit, target, edges
        ),
        wide=False,
    )


def _autocorrelation(design: Design) -> Panel:
    rate, error = design.stimulus.sample_rate_hz, design.autocorrelation_error
    told = "About the mean, divided by its value at lag 0, of the record as it is played."
    if error is not None:
        lags = design.autocorrelation.size - 1
        told += f" Below: played less target; its squares over {lags} lags sum to {number(error, 2)}."
    return Panel(
        "autocorrelation",
        "Autocorrelation",
        "Normalised autocorrelation against lag, with its target where there is one and the difference below.",
        told,
        lambda figure: draw_autocorrelation(figure, design.autocorrelation, rate, design.target_autocorrelation),
        wide=False,
    )


def _swaps(design: Design) -> Panel:
    return Panel(
        "swaps",
        "Convergence of the interchange",
        "Sum of squared differences of the autocorrelation from its target against accepted swaps.",
        "Every accepted swap lowers it. It begins at what the spectral surrogate left (Chen 2010, Fig. 6.2b).",
        lambda figure: draw_swaps(figure, design.search),
        wide=False,
    )
