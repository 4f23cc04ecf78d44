"""Figures of spectra: coherence and Bode diagram."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tissueid.analysis.curves.diagnostics import power_edge
from tissueid.analysis.curves.linear import frequency_response
from tissueid.formatting import fixed
from tissueid.identification.engines.spectral import Spectral, SpectralModel
from tissueid.language import _, marked
from tissueid.records import Record
from tissueid.reports.captions import second_order
from tissueid.reports.figures.registry import Drawn, Subject, figure
from tissueid.reports.plot_renderer import draw_plots
from tissueid.reports.style import (
    BLUE,
    DASHES,
    HALF_WIDTH,
    MUTED,
    ORANGE,
    SHADE,
    drawing,
    frequency_axis,
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
    return bode_figure(subject.model, subject.record), _bode_caption(subject.model)


def excited_band(model: SpectralModel) -> NDArray[np.bool_]:
    """Return a mask (bins,) of the frequencies that contain 99 % of the input power, without zero."""
    spectra = model.spectra
    edge = power_edge(spectra.frequency_hz, spectra.input_psd)
    return (spectra.frequency_hz > 0.0) & (spectra.frequency_hz <= edge)


@drawing
def coherence_figure(model: SpectralModel) -> Figure:
    """Mean squared coherence with the level that unrelated signals seldom exceed (Chen 2010, Fig. 3.2b, Eq. 3.1)."""
    spectra = model.spectra
    figure = new_figure(HALF_WIDTH, 3.3)
    axes = figure.subplots()
    frequency_hz = spectra.frequency_hz[1:]
    edge = float(spectra.frequency_hz[excited_band(model)].max(initial=frequency_hz[0]))
    if edge < frequency_hz[-1]:
        axes.axvspan(edge, frequency_hz[-1], color=SHADE, zorder=0)
        axes.annotate(
            _("hardly\nany input"),
            (frequency_hz[-1], 1.0),
            (-3, 0),
            textcoords="offset points",
            ha="right",
            va="top",
            color=MUTED,
            fontsize=8.5,
        )
    axes.plot(frequency_hz, spectra.coherence[1:], color=BLUE)
    floor = spectra.coherence_floor
    axes.axhline(floor, color=ORANGE, linewidth=1.0, linestyle=DASHES[1], label=_("5 % significance level"))
    frequency_axis(axes, float(frequency_hz[0]), float(frequency_hz[-1]))
    axes.set_ylim(0.0, 1.06)
    axes.set_ylabel(_("Mean squared coherence"))
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, min(0.7, floor + 0.01)))
    return figure


@drawing
def bode_figure(model: SpectralModel, record: Record) -> Figure:
    """Compliance and phase over the band with input power, 95 % bands, and the second-order fit (Chen 2010, Fig. 3.3).

    Args:
        model: the spectra and the second-order fit.
        record: what was fitted, for the units.

    Raises:
        UnusableInputError: the input has power at fewer than three frequencies.
    """
    figure = new_figure(HALF_WIDTH, 4.6)
    draw_plots(figure, frequency_response(model, record))
    return figure


def _coherence_caption(model: SpectralModel) -> str:
    """Under the coherence."""
    band = excited_band(model)
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
