"""Power spectrum of the brushed interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pyqtgraph as pg
from PySide6.QtWidgets import QComboBox, QVBoxLayout, QWidget

from tissueid.app.plotting import PlotCard
from tissueid.app.theme import Theme
from tissueid.app.views.researcher.colours import series
from tissueid.app.views.researcher.signal_loading import Channel, LoadedTest
from tissueid.formatting import superscript
from tissueid.language import _, marked
from tissueid.units import display_unit, shown

_NOTHING = np.zeros(0)
_TICKS = 4
_DECADES = 9.0
"""Decades below the maximum that are shown; lower values are rounding errors."""
TOO_SHORT = marked("Too few samples for a spectrum.")


class SpectrumCard(QWidget):
    """Power spectral density of one signal of every test."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = QComboBox()
        self.choice.setAccessibleName(_("Signal of the spectrum"))
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setMinimumContentsLength(10)
        self.card = PlotCard(_("Power spectrum"), _("Frequency (Hz)"), "", log_axes=("bottom", "left"))
        self._curves: list[pg.PlotDataItem] = []
        self._theme: Theme | None = None
        self._shown: tuple[Sequence[LoadedTest], tuple[float, float]] = ((), (0.0, 1.0))
        self._wanted = "position"
        rows = QVBoxLayout(self)
        rows.setContentsMargins(0, 0, 0, 0)
        rows.setSpacing(4)
        rows.addWidget(self.choice)
        rows.addWidget(self.card, 1)
        self.choice.activated.connect(self._choose)

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
        while len(self._curves) < len(loaded):
            self._curves.append(self.card.plot.plot(_NOTHING, _NOTHING, connect="finite"))
            self._colour()
        unit, scale = display_unit(channel.unit) if channel else ("", 1.0)
        self.card.retitle(_("Power spectrum"), f"{unit}²/Hz" if unit else "1/Hz")
        low, last, bottom, top = np.inf, -np.inf, np.inf, -np.inf
        for place, curve in enumerate(self._curves):
            track = loaded[place].tracks.get(channel) if channel and place < len(loaded) else None
            frequency, density = track.spectrum(low_s, high_s) if track else (_NOTHING, _NOTHING)
            if not density.size or not density.max() > 0.0:
                curve.setData(_NOTHING, _NOTHING)
                continue
            floor = density.max() * 10.0**-_DECADES
            x, y = np.log10(frequency), np.log10(np.maximum(density, floor)) + 2.0 * np.log10(scale)
            curve.setData(x, y)
            low, last = min(low, float(x[0])), max(last, float(x[-1]))
            bottom, top = min(bottom, float(y.min())), max(top, float(y.max()))
        self.card.say_missing("" if low < last else _(TOO_SHORT) if loaded else "")
        if low < last:
            self.card.plot.setXRange(low, last, padding=0.02)
            self.card.plot.setYRange(bottom, top, padding=0.05)
            shift = round(math.log10(shown(f"{unit}²/Hz")[1]))
            step = max(1, math.ceil((top - bottom) / _TICKS))
            powers = range(math.floor(top), math.floor(bottom) - 1, -step)
            self.card.plot.getAxis("left").setTicks([[(power, f"10{superscript(power + shift)}") for power in powers]])

    def take_units(self) -> None:
        """Show the values in the active unit system."""
        loaded, (low, high) = self._shown
        self.show_stretch(loaded, low, high)

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        self._theme = theme
        self.card.apply_theme(theme)
        self._colour()

    def _choose(self) -> None:
        channel = self.channel
        if channel is not None:
            self._wanted = channel.name
        self.take_units()

    def _colour(self) -> None:
        if self._theme is not None:
            for curve, colour in zip(self._curves, series(self._theme), strict=False):
                curve.setPen(pg.mkPen(colour, width=1))


__all__ = ["TOO_SHORT", "SpectrumCard"]
