"""Figures of what was recorded, with their headings, captions and alternative texts."""

from __future__ import annotations

from tissueid.identification.engines.spectral import SpectralModel
from tissueid.records import Record
from tissueid.reports import captions
from tissueid.reports.blocks import Picture, picture
from tissueid.reports.signal_figures import distributions_figure, power_figure, signals_figure
from tissueid.sessions import Test


def signals_picture(test: Test, held_out_s: tuple[float, float] | None, key: str) -> Picture:
    """The signals over time."""
    return picture(
        f"{key}-signals",
        "Signals",
        "Line plots over time of coil voltage, coil force and probe position, with the preload shaded.",
        lambda: (signals_figure(test, held_out_s), captions.signals(test)),
    )


def power_picture(test: Test, spectra: SpectralModel | None, key: str) -> Picture:
    """The power spectra."""
    return picture(
        f"{key}-power",
        "Power spectra",
        "Power spectral densities of voltage, force and position against frequency, both axes logarithmic.",
        lambda: (power_figure(test), captions.power(spectra)),
        wide=False,
    )


def distributions_picture(record: Record, key: str) -> Picture:
    """The distributions of input and output."""
    return picture(
        f"{key}-distributions",
        "Distributions of input and output",
        f"Histograms of {record.input_name} and {record.output_name}, each with a Gaussian curve.",
        lambda: (distributions_figure(record), captions.distributions(record)),
    )
