"""Figure of the shown signals, drawn by matplotlib on white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.labels_of_tests import distinguishing_labels
from tissueid.app.views.researcher.signal_loading import Channel, LoadedTest
from tissueid.language import _
from tissueid.units import shown_si

if TYPE_CHECKING:  # matplotlib is imported when the first figure is drawn
    from matplotlib.figure import Figure

_WIDTH, _PANEL, _REST = 7.2, 1.7, 1.1
"""Inches."""
_COLUMNS = 1200


@dataclass(frozen=True)
class SignalFigure:
    """Signals of tests between two times (s), and the spectrum of one signal below."""

    loaded: Sequence[LoadedTest]
    channels: Sequence[Channel]
    low_s: float
    high_s: float
    spectrum: Channel | None

    @property
    def title(self) -> str:
        """Title of the figure, from which the file name is made."""
        common, labels = distinguishing_labels([[test.chosen] for test in self.loaded])
        return f"{_('Signals')} {common or ' '.join(labels[:1])}"

    def draw(self) -> Figure:
        """Draw a panel per signal, and the spectrum below."""
        from tissueid.reports.style import frequency_axis, log_axis, new_figure

        count = len(self.channels) + (self.spectrum is not None)
        figure = new_figure(_WIDTH, _PANEL * count + _REST)
        every = figure.subplots(count, 1, squeeze=False)[:, 0]
        colours = series(LIGHT)
        common, labels = distinguishing_labels([[test.chosen] for test in self.loaded])
        for axes, channel in zip(every, self.channels, strict=False):
            unit, scale = shown_si(channel.unit)
            axes.set_title(f"{channel.title} ({unit})" if unit else channel.title)
            for test, colour, label in zip(self.loaded, colours, labels, strict=False):
                if (track := test.tracks.get(channel)) is not None:
                    times, values = track.outline(self.low_s, self.high_s, _COLUMNS)
                    axes.plot(times, scale * values, color=colour, linewidth=0.8, label=label)
            axes.set_xlim(self.low_s, self.high_s)
        every[len(self.channels) - 1].set_xlabel(_("Time from the start of the test (s)"))
        if self.spectrum is not None:
            unit, scale = shown_si(self.spectrum.unit)
            axes = every[-1]
            axes.set_title(
                _("Power spectrum of {title} ({unit}²/Hz)").format(title=self.spectrum.title, unit=unit)
                if unit
                else _("Power spectrum (1/Hz)")
            )
            for test, colour in zip(self.loaded, colours, strict=False):
                if (track := test.tracks.get(self.spectrum)) is not None:
                    frequency, density = track.spectrum(self.low_s, self.high_s)
                    if np.any(density > 0.0):
                        axes.plot(frequency, scale**2 * density, color=colour, linewidth=0.8)
            drawn = np.concatenate([line.get_xdata() for line in axes.get_lines()] or [np.array([1.0, 1e3])])
            frequency_axis(axes, float(drawn.min()), float(drawn.max()))
            log_axis(axes)
        handles, labels = every[0].get_legend_handles_labels()
        figure.legend(handles, labels, title=common, loc="outside lower center", ncols=1 + (len(labels) > 3))
        return figure


__all__ = ["SignalFigure"]
