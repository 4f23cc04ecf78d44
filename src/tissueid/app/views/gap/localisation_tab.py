"""Tab "Where": the gap against frequency, depth, velocity and time, with the noise floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from PySide6.QtWidgets import QVBoxLayout, QWidget

from tissueid.app.plotting import PlotCard
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import Theme
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent, ProfileContent, SpectrumContent

_LINES = {
    "recorded": (marked("recorded"), "muted", 1),
    "residual": (marked("left by the twin"), "text", 2),
    "linear": (marked("linear"), "measured", 1),
    "even": (marked("even"), "model", 1),
    "odd": (marked("odd"), "good", 1),
    "noise": (marked("noise"), "check", 1),
}
"""Line: what it is called, the role of its colour, and its width."""
_ABOVE = {marked("above noise"): "poor"}
_NOTHING = np.zeros(0)
_NOT_THERE = marked("There is no data to show.")
_FAR = 20.0
_ONE_ROW = 820
"""Width below which the three profiles stand below each other, pixels."""


class LocalisationTab(QWidget):
    """Four plots: spectrum, and error against depth, velocity and time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        key = {_(label): role for label, role, _width in _LINES.values()}
        self.frequency = PlotCard(_("By frequency"), _("Frequency (Hz)"), "", key=key, log_axes=("bottom", "left"))
        self._bands = self.frequency.band("poor", alpha=28)
        self._lines = {name: self.frequency.line(role, width=width) for name, (_label, role, width) in _LINES.items()}
        self.frequency.setToolTip(_("Shaded: bands that stand above the noise with significance"))
        self.profiles = {
            "depth_m": _profile_card(_("By depth"), _("Depth (mm)")),
            "velocity_m_s": _profile_card(_("By velocity"), _("Velocity (mm/s), positive goes in")),
            "time_s": _profile_card(_("By time"), _("Time (s)")),
        }
        self._items = {
            name: (card.line("muted"), card.dots("poor", 7), card.dots("muted", 6))
            for name, card in self.profiles.items()
        }
        for card in self.profiles.values():
            noise = card.mark(upright=False, text=_("noise"))
            noise.setValue(0.0)
            noise.show()
            card.setToolTip(
                _(
                    "Root-mean-square error as a multiple of the noise; 1 is what the sensors' noise alone leaves. "
                    "Red: above it with significance"
                )
            )
        self.cards: tuple[PlotCard, ...] = (self.frequency, *self.profiles.values())
        rows = QVBoxLayout(self)
        rows.setContentsMargins(0, 6, 0, 0)
        rows.setSpacing(8)
        across = FoldingBox(_ONE_ROW)
        across.setSpacing(8)
        for card in self.cards:
            card.setMinimumHeight(165)
        for card in self.profiles.values():
            across.addWidget(card, 1)
        rows.addWidget(self.frequency, 1)
        rows.addLayout(across, 1)

    def show_story(self, story: PageContent) -> None:
        """Draw the result of a diagnosis."""
        self._show_spectrum(story.spectrum)
        channel = story.spectrum.channel if story.spectrum is not None else ""
        for name, card in self.profiles.items():
            self._show_profile(card, name, story.profiles.get(name), channel)

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        for card in self.cards:
            card.apply_theme(theme)

    def _show_spectrum(self, spectrum: SpectrumContent | None) -> None:
        card = self.frequency
        card.say_missing("" if spectrum is not None else _(_NOT_THERE))
        if spectrum is None:
            return
        card.retitle(_("By frequency, {channel}").format(channel=_(spectrum.channel)), f"{spectrum.unit}/√Hz")
        for name, line in self._lines.items():
            line.setData(spectrum.frequency, spectrum.lines[name])
        self._shade(spectrum.bands)
        drawn = np.concatenate([values[np.isfinite(values)] for values in spectrum.lines.values()])
        if drawn.size:
            card.plot.setYRange(float(drawn.min()), float(drawn.max()), padding=0.05)
        card.plot.setXRange(float(spectrum.frequency[0]), float(spectrum.frequency[-1]), padding=0.02)

    def _shade(self, bands: tuple[tuple[float, float], ...]) -> None:
        # From far below to far above inside of a band, of no height outside.
        x = [value for low, high in bands for value in (low, low, high, high)]
        top = [value for _ in bands for value in (-_FAR, _FAR, _FAR, -_FAR)]
        lower, upper = self._bands
        lower.setData(np.array(x), np.full(len(x), -_FAR))
        upper.setData(np.array(x), np.array(top))

    def _show_profile(self, card: PlotCard, name: str, profile: ProfileContent | None, channel: str) -> None:
        there = profile is not None and profile.middle.size > 0
        card.say_missing("" if there else _(_NOT_THERE))
        if profile is None or not there:
            return
        card.setAccessibleDescription(_described(profile, channel))
        line, above, at = self._items[name]
        line.setData(profile.middle, profile.error)
        _dot(above, profile, profile.above)
        _dot(at, profile, ~profile.above)
        low = min(float(profile.error.min()), np.log10(0.7))
        card.plot.setYRange(float(low), max(float(profile.error.max()), np.log10(3.0)), padding=0.06)
        card.plot.setXRange(float(profile.middle[0]), float(profile.middle[-1]), padding=0.04)


def _dot(item: pg.PlotDataItem, profile: ProfileContent, chosen: np.ndarray) -> None:
    item.setData(profile.middle[chosen], profile.error[chosen]) if chosen.any() else item.setData(_NOTHING, _NOTHING)


def _described(profile: ProfileContent, channel: str) -> str:
    most = int(np.argmax(profile.error))
    many = int(profile.above.sum())
    return _(
        "Error of the {channel}: {many} of {count} bins stand above the noise; most at {place:.3g}, "
        "{most:.3g} times it."
    ).format(
        channel=_(channel),
        many=many,
        count=profile.above.size,
        place=profile.middle[most],
        most=10.0 ** profile.error[most],
    )


def _profile_card(title: str, x_label: str) -> PlotCard:
    return PlotCard(
        title, x_label, _("× noise"), key={_(name): role for name, role in _ABOVE.items()}, log_axes=("left",)
    )
