"""Figure of the shown signals for a file, on white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from tissueid.app.theme import LIGHT
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.selected_test import distinguishing_labels
from tissueid.app.views.researcher.signal_loading import Channel, LoadedTest
from tissueid.app.views.researcher.spectrum_card import spectrum_of
from tissueid.language import _
from tissueid.units import shown

if TYPE_CHECKING:  # matplotlib is imported when the first figure is drawn
    from matplotlib.figure import Figure

    from tissueid.analysis.curves import Plot

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

    @property
    def plots(self) -> list[Plot]:
        """The signals from the top, and the spectrum."""
        from tissueid.analysis.curves.signals import time_plot

        ends_s, colours = (self.low_s, self.high_s), series(LIGHT)
        labels = distinguishing_labels([[test.chosen] for test in self.loaded])[1]
        made = []
        for channel in self.channels:
            tracks = [test.tracks.get(channel) for test in self.loaded]
            lines = [track.outline(*ends_s, _COLUMNS) if track else None for track in tracks]
            made.append(time_plot(channel.title, channel.unit, lines, colours, labels, ends_s))
        if self.spectrum is not None:
            plot = spectrum_of(self.spectrum, self.loaded, ends_s, colours)
            made.append(replace(plot, title=_("Power spectrum of {title}").format(title=self.spectrum.title)))
        return made

    def draw(self) -> Figure:
        """Draw a panel per signal, and the spectrum below."""
        from tissueid.reports.plot_renderer import draw_plots
        from tissueid.reports.style import new_figure

        plots = self.plots
        figure = new_figure(_WIDTH, _PANEL * len(plots) + _REST)
        every, _long = draw_plots(figure, plots, units=shown, key=False)
        for axes in every[: len(self.channels) - 1]:
            axes.set_xlabel("")
        common = distinguishing_labels([[test.chosen] for test in self.loaded])[0]
        handles, labels = every[0].get_legend_handles_labels()
        figure.legend(handles, labels, title=common, loc="outside lower center", ncols=1 + (len(labels) > 3))
        return figure
