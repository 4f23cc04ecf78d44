"""A subject's sittings side by side: one row each, mass, damping and stiffness as dots with their deviation."""

from __future__ import annotations

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QPushButton, QVBoxLayout, QWidget

from tissueid.app.plotting import PlotCard
from tissueid.app.small_window import FoldingBox
from tissueid.app.theme import Theme
from tissueid.app.views.clinician.comparing import Comparison
from tissueid.app.views.clinician.sitting import QUANTITIES
from tissueid.formatting import label_and_unit
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.units import display_unit

_ROW = 17
_AROUND = 62
_LABELS, _NARROW_LABELS = 250, 220
_ONE_ROW = 600
"""Width below which the plots stand below each other, pixels."""
_LEGEND = marked(
    "Bars: one standard deviation, of the estimate where a sitting has one test, of its repeats otherwise."
)
READING = marked("Reading the subject's other sittings…")
THIS = marked("this sitting")


class ComparisonCard(QFrame):
    """Hidden until there is something to compare with; its plots are built then. ``cancel`` ends the reading."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.heading = QLabel(_("Compared with the subject's other sites and sittings"))
        self.heading.setProperty("role", "heading")
        self.heading.setMinimumWidth(1)
        self.words = QLabel()
        self.words.setProperty("role", "field")
        self.words.setWordWrap(True)
        self.words.setMinimumWidth(1)
        self.words.setTextFormat(Qt.TextFormat.PlainText)
        self.cancel = QPushButton(_("Cancel comparison"))
        top = FoldingBox(_ONE_ROW)
        top.setContentsMargins(2, 0, 0, 0)
        top.addWidget(self.heading)
        top.addWidget(self.words, 1)
        top.addWidget(self.cancel)
        self.cards: list[PlotCard] = []
        self._parts: list[tuple[list[pg.PlotDataItem], list[pg.PlotDataItem]]] = []
        self._layout = layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        layout.addLayout(top)
        self.setToolTip(_(_LEGEND))
        self._ticks: list[tuple[float, str]] = []
        self._folded = False
        self._theme: Theme | None = None
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

    def show_comparison(self, comparison: Comparison) -> None:
        """Show the sittings, the newest on top; nothing where there is but one."""
        sightings = comparison.sightings
        self.cancel.hide()
        if len(sightings) < 2:
            self.hide()
            return
        self._build_plots()
        self.words.setText(" ".join(map(translated, filter(None, [comparison.remark, comparison.left_out]))))
        rows = range(len(sightings), 0, -1)
        self._ticks = [(row, one.label) for row, one in zip(rows, sightings, strict=True)]
        for card, (bars, dots), quantity in zip(self.cards, self._parts, QUANTITIES, strict=True):
            scale = display_unit(label_and_unit(quantity)[1])[1]
            for which, (bar, dot) in enumerate(zip(bars, dots, strict=True)):
                x, y, ends, heights = [], [], [], []
                for row, one in zip(rows, sightings, strict=True):
                    found = one.values.get(quantity)
                    if found is None or one.this is not bool(which):
                        continue
                    x.append(scale * found.value)
                    y.append(float(row))
                    reach = scale * (found.std or 0.0)
                    ends += [x[-1] - reach, x[-1] + reach, np.nan]
                    heights += [float(row), float(row), np.nan]
                dot.setData(np.array(x), np.array(y))
                bar.setData(np.array(ends), np.array(heights))
            card.plot.setYRange(0.5, len(sightings) + 0.5, padding=0.0)
            card.plot.enableAutoRange(axis="x")
            card.setFixedHeight(_AROUND + _ROW * max(3, len(sightings)))
            card.show()
        self._label()
        said = "; ".join(f"{one.label}{', ' + _(THIS) if one.this else ''}" for one in sightings)
        self.setAccessibleName(_("Comparison of {count} sittings: {said}").format(count=len(sightings), said=said))
        self.show()

    def _build_plots(self) -> None:
        if self.cards:
            return
        row = FoldingBox(_ONE_ROW)
        row.setSpacing(8)
        for place, quantity in enumerate(QUANTITIES):
            name, si_unit = label_and_unit(quantity)
            key = {_(THIS): "model", _("others"): "measured"} if place == 0 else {}
            card = PlotCard(_(name), _("± one SD"), display_unit(si_unit)[0], key=key, unit_of="bottom")
            bars = [card.line(role, width=2) for role in ("measured", "model")]
            dots = [card.dots(role, size) for role, size in (("measured", 8), ("model", 11))]
            if self._theme is not None:
                card.apply_theme(self._theme)
            self._parts.append((bars, dots))
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
            self._label()

    def _label(self) -> None:
        for place, card in enumerate(self.cards):
            named = place == 0 or self._folded
            axis = card.plot.getAxis("left")
            axis.setWidth((_NARROW_LABELS if self._folded else _LABELS) if named else 8)
            axis.setTicks([self._ticks if named else [(row, "") for row, _ in self._ticks], []])

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self._theme = theme
        for card in self.cards:
            card.apply_theme(theme)
