"""Figures of spectra: coherence and Bode diagram."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tissueid.analysis.curves.linear import coherence_plot, frequency_response, power_band
from tissueid.formatting import fixed
from tissueid.identification.engines.spectral import Spectral, SpectralModel
from tissueid.language import _, marked
from tissueid.reports.captions import second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import column_figure, draw_plot
from tissueid.reports.style import (
    HALF_WIDTH,
    MUTED,
    drawing,
    new_figure,
)


@figure(
    SpectralModel,
    "coherence",
    marked("Mean squared coherence"),
    marked("Coherence between 0 and 1 against frequency, with its significance level as a dashed line."),
    group="record",
    wide=False,
    place=30,
    standard=Spectral.name,
    short=True,
)
def _coherence(subject: Subject[SpectralModel]) -> Drawn:
    return coherence_figure(subject.model), _coherence_caption(subject.model)


@figure(
    SpectralModel,
    "bode",
    marked("Bode diagram"),
    marked("Magnitude and phase of output over input against frequency, measured and as a second-order system."),
    group="linear",
    wide=False,
    place=30,
    standard=Spectral.name,
    short=True,
)
def _bode(subject: Subject[SpectralModel]) -> Drawn:
    return column_figure(frequency_response(subject.model, subject.record), 4.6), _bode_caption(subject.model)


@drawing
def coherence_figure(model: SpectralModel) -> Figure:
    """Mean squared coherence with the level that unrelated signals seldom exceed (Chen 2010, Fig. 3.2b, Eq. 3.1)."""
    figure = new_figure(HALF_WIDTH, 3.3)
    axes, plot = figure.subplots(), coherence_plot(model.spectra)
    draw_plot(axes, plot)
    if any(curve.kind == "spans" for curve in plot.curves):
        words, end = _("hardly\nany input"), float(model.spectra.frequency_hz[-1])
        look: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "top", "fontsize": 8.5}
        axes.annotate(words, (end, 1.0), (-3, 0), color=MUTED, **look)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, min(0.7, model.spectra.coherence_floor + 0.01)))
    return figure


def _coherence_caption(model: SpectralModel) -> str:
    """Under the coherence."""
    band = power_band(model.spectra)
    mean = float(np.mean(model.spectra.coherence[band])) if band.any() else None
    return _(
        "Near one where a linear system explains the motion; lower where nonlinearity, drift or noise takes part. "
        "The mean over the excited band is {mean}. Unrelated signals exceed the dashed level of {level} at one "
        "frequency in twenty."
    ).format(mean=fixed(mean, 2), level=fixed(model.spectra.coherence_floor, 2))


def _bode_caption(model: SpectralModel) -> str:
    """Under the Bode diagram."""
    text = _(
        "Over the band where the input has power. The magnitude should be level up to the natural frequency and then "
        "fall with the square of the frequency, while the phase goes from 0° towards −180°."
    )
    return f"{text} {second_order(model.second_order)}"
