"""A subject's sittings side by side: one row each, mass, damping and stiffness as dots with their deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QVBoxLayout, QWidget

from tissueid.app.build import button, fill, label, styled
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.small_window import FoldingBox
from tissueid.app.views.clinician.comparing import Sighting, SittingComparison
from tissueid.app.views.clinician.sitting import QUANTITIES
from tissueid.formatting import label_and_unit
from tissueid.language import _, marked
from tissueid.messages import Verbatim, translated
from tissueid.units import display_unit

if TYPE_CHECKING:
    from tissueid.analysis.curves.plot import Plot

_ROW = 17
_AROUND = 75
"""Height of a row, and of what is around the rows, pixels."""
_ONE_ROW = 600
"""Width below which the plots stand below each other, pixels."""
_LEGEND = marked(
    "Bars: one standard deviation, of the estimate where a sitting has one test, of its repeats otherwise."
)
READING = marked("Reading the subject's other sittings…")
THIS, _OTHERS = marked("this sitting"), marked("others")


class ComparisonCard(QFrame):
    """Hidden until there is something to compare with; its plots are built then. ``cancel`` ends the reading."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.heading = styled(
            QLabel(_("Compared with the subject's other sites and sittings")), role="heading", minimum_width=1
        )
        self.words, self.cancel = label("field"), button(_("Cancel comparison"))
        top = fill(FoldingBox(_ONE_ROW), self.heading, (self.words, 1), self.cancel, margins=(2, 0, 0, 0))
        self.cards: list[PlotCanvas] = []
        self._plots: list[Plot] = []
        self._layout = fill(QVBoxLayout(self), top, spacing=3)
        self._folded = False
        self.hide()

    def expect(self) -> None:
        """The folder is being read."""
        self.words.setText(_(READING))
        self.cancel.show()
        for card in self.cards:
            card.hide()
        self.show()

    def clear(self) -> None:
        """There is nothing to compare with."""
        self.hide()

    def show_comparison(self, comparison: SittingComparison) -> None:
        """Show the sittings, the newest on top; nothing where there is but one."""
        sightings = comparison.sightings
        self.cancel.hide()
        if len(sightings) < 2:
            self.hide()
            return
        self._build_plots()
        self.words.setText(" ".join(map(translated, filter(None, [comparison.remark, comparison.left_out]))))
        self._plots = [_plot_of(quantity, sightings) for quantity in QUANTITIES]
        for card in self.cards:
            card.setFixedHeight(_AROUND + _ROW * max(3, len(sightings)))
            card.show()
        self._show_plots()
        said = "; ".join(f"{one.label}{', ' + _(THIS) if one.this else ''}" for one in sightings)
        self.setAccessibleName(_("Comparison of {count} sittings: {said}").format(count=len(sightings), said=said))
        self.show()

    def _build_plots(self) -> None:
        if self.cards:
            return
        row = FoldingBox(_ONE_ROW)
        row.setSpacing(8)
        for place, quantity in enumerate(QUANTITIES):
            card = PlotCanvas(_(label_and_unit(quantity)[0]))
            card.focus = Qt.FocusPolicy.ClickFocus  # the page is scrolled by keys, not stop by stop
            self.cards.append(card)
            row.addWidget(card, 0 if place else 1)
            row.setStretch(place, 30 if place else 47)
        self._layout.addLayout(row)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Name the sittings at every plot where the plots stand below each other."""
        super().resizeEvent(event)
        folded = event.size().width() < _ONE_ROW
        if folded != self._folded:
            self._folded = folded
            self.heading.setWordWrap(folded)
            self._show_plots()

    def _show_plots(self) -> None:
        """Draw the plots; those right of another one have neither names of the rows nor a key."""
        for place, (card, plot) in enumerate(zip(self.cards, self._plots, strict=False)):
            named = place == 0 or self._folded
            ticks = plot.y.ticks if named else tuple((row, "") for row, _name in plot.y.ticks)
            card.show_plots([replace(plot, y=replace(plot.y, ticks=ticks))], key=place == 0)


def _plot_of(quantity: str, sightings: Sequence[Sighting]) -> Plot:
    """Return the plot of a quantity: a row for each sitting."""
    # Late: these bring the identification with numba, and the window opens before there is anything to compare.
    from tissueid.analysis.curves.comparison_plots import rows_plot
    from tissueid.analysis.curves.plot import Axis

    label, si_unit = label_and_unit(quantity)
    unit, scale = display_unit(si_unit)
    found = [one.values.get(quantity) for one in sightings]
    values = np.array([np.nan if one is None else scale * one.value for one in found])
    std = np.array([np.nan if one is None or one.std is None else scale * one.std for one in found])
    this = np.array([one.this for one in sightings])
    groups = ((_OTHERS, "measured", np.flatnonzero(~this)), (THIS, "model", np.flatnonzero(this)))
    names = [Verbatim(one.label) for one in sightings]
    plot = rows_plot(label, Axis(marked("± one SD"), unit), names, values, std, groups)
    return replace(plot, note=_LEGEND)
