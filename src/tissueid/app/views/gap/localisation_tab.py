"""Tab "Where": the gap against frequency, depth, velocity and time, with the noise floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtWidgets import QWidget

from tissueid.app import build
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.language import _, marked

if TYPE_CHECKING:
    from tissueid.app.views.gap.page_content import PageContent
    from tissueid.gap.diagnosis_curves import GapProfile

_NOT_THERE = marked("There is no data to show.")
_ONE_ROW = 820
"""Width below which the three profiles stand below each other, pixels."""


class LocalisationTab(QWidget):
    """Four plots: spectrum, and error against depth, velocity and time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.frequency = PlotCanvas(_("By frequency"))
        self.profiles = {
            "depth_m": PlotCanvas(_("By depth")),
            "velocity_m_s": PlotCanvas(_("By velocity")),
            "time_s": PlotCanvas(_("By time")),
        }
        self.cards: tuple[PlotCanvas, ...] = (self.frequency, *self.profiles.values())
        for card in self.cards:
            card.setMinimumHeight(165)
        build.column(
            (self.frequency, 1),
            (build.fill(FoldingBox(_ONE_ROW), *[(card, 1) for card in self.profiles.values()], spacing=8), 1),
            spacing=8,
            margins=(0, 6, 0, 0),
            parent=self,
        )

    def show_story(self, story: PageContent) -> None:
        """Draw the result of a diagnosis."""
        from tissueid.gap.diagnosis_plots import profile_plot, spectrum_plot

        if story.spectrum is None:
            self.frequency.say_missing(_(_NOT_THERE))
        else:
            self.frequency.show_plots([spectrum_plot(story.spectrum)])
        channel = story.spectrum.channel if story.spectrum is not None else ""
        for name, card in self.profiles.items():
            profile = story.profiles.get(name)
            if profile is None or not profile.middle.size:
                card.say_missing(_(_NOT_THERE))
                continue
            card.show_plots([profile_plot(name, profile)], description=_described(profile, channel))


def _described(profile: GapProfile, channel: str) -> str:
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
        most=profile.error[most],
    )
