"""Power spectrum of the brushed interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from PySide6.QtWidgets import QComboBox, QWidget

from tissueid.app import build
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.theme import appearance
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.signal_loading import Channel, LoadedTest
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot


class SpectrumCard(QWidget):
    """Power spectral density of one signal of every test."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = build.styled(
            QComboBox(),
            name=_("Signal of the spectrum"),
            size_adjust_policy=QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon,
            minimum_contents_length=10,
        )
        self.card = PlotCanvas(_("Power spectrum"))
        self._shown: tuple[Sequence[LoadedTest], tuple[float, float]] = ((), (0.0, 1.0))
        self._wanted = "position"
        build.column(self.choice, (self.card, 1), spacing=4, parent=self)
        self.choice.activated.connect(self._choose)
        appearance.changed.connect(self._show_again)

    @property
    def channel(self) -> Channel | None:
        """Signal of the spectrum."""
        channel = self.choice.currentData()
        return channel if isinstance(channel, Channel) else None

    def offer(self, channels: Sequence[Channel]) -> None:
        """Offer signals; the selection stays if possible."""
        self.choice.clear()
        for channel in channels:
            self.choice.addItem(_("Spectrum of {title}").format(title=channel.title), channel)
        names = [channel.name for channel in channels]
        self.choice.setCurrentIndex(names.index(self._wanted) if self._wanted in names else len(names) - 1)

    def show_stretch(self, loaded: Sequence[LoadedTest], low_s: float, high_s: float) -> None:
        """Show the spectrum between two times, s."""
        self._shown = loaded, (low_s, high_s)
        channel = self.channel
        if channel is None or not loaded:
            self.card.say_missing("")
            return
        self.card.show_plots([spectrum_of(channel, loaded, (low_s, high_s), series(appearance.theme))])

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        self.card.take_units()

    def _choose(self) -> None:
        channel = self.channel
        if channel is not None:
            self._wanted = channel.name
        self._show_again()

    def _show_again(self) -> None:
        loaded, (low_s, high_s) = self._shown
        self.show_stretch(loaded, low_s, high_s)


def spectrum_of(
    channel: Channel, loaded: Sequence[LoadedTest], ends_s: tuple[float, float], colours: Sequence[str]
) -> Plot:
    """Return the power spectra of one signal of tests between two times."""
    from tissueid.analysis.curves.signals import spectrum_plot

    tracks = [test.tracks.get(channel) for test in loaded]
    signals = [
        (track.values[slice(*track.places(*ends_s))], track.sample_rate_hz) if track else None for track in tracks
    ]
    return spectrum_plot(_("Power spectrum"), channel.unit, signals, colours)
