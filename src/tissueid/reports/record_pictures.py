"""Figures of what was recorded, with their headings, captions and alternative texts."""

from __future__ import annotations

from matplotlib.figure import Figure

from tissueid.analysis.curves.overlay_plots import signal_correlations
from tissueid.analysis.curves.signals import distribution_plots, recording_plots, recording_spectra
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.language import _
from tissueid.records import Record
from tissueid.reports import captions
from tissueid.reports.page import Picture, picture
from tissueid.reports.plot_renderer import column_figure, row_figure
from tissueid.sessions import Test


def signals_figure(test: Test, held_out_s: tuple[float, float] | None = None) -> Figure:
    """Voltage, force and position over time; arguments as :func:`recording_plots`.

    Raises:
        UnusableInputError: none of the signals to be drawn was received.
    """
    plots = recording_plots(test, held_out_s)
    return column_figure(plots, 0.7 + 1.45 * len(plots), wide=True, over=True)


def signals_picture(test: Test, held_out_s: tuple[float, float] | None, key: str) -> Picture:
    """The signals over time."""
    return picture(
        f"{key}-signals",
        _("Signals"),
        _("Line plots over time of coil voltage, coil force and probe position, with the preload shaded."),
        lambda: (signals_figure(test, held_out_s), captions.signals(test)),
    )


def power_picture(test: Test, spectra: SpectralModel | None, key: str) -> Picture:
    """The power spectra."""
    return picture(
        f"{key}-power",
        _("Power spectra"),
        _("Power spectral densities of voltage, force and position against frequency, both axes logarithmic."),
        lambda: (column_figure([recording_spectra(test)], 3.3), captions.power(spectra)),
        wide=False,
    )


def correlations_picture(record: Record, key: str) -> Picture:
    """The correlations of input and output."""
    return picture(
        f"{key}-correlations",
        _("Correlations of input and output"),
        _("Autocorrelations of input and output and their cross-correlation over both signs of the lag."),
        lambda: (row_figure(signal_correlations({"": record}), 2.7), _(captions.CORRELATIONS)),
    )


def distributions_picture(record: Record, key: str) -> Picture:
    """The distributions of input and output."""
    return picture(
        f"{key}-distributions",
        _("Distributions of input and output"),
        _("Histograms of {input} and {output}, each with a Gaussian curve.").format(
            input=_(record.input_name), output=_(record.output_name)
        ),
        lambda: (row_figure(distribution_plots(record), 2.5), captions.distributions(record)),
    )
