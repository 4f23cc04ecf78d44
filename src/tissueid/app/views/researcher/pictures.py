"""Overlaid plots of several results: one picture at a time, of one to three panels."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import pyqtgraph as pg
from pyqtgraph.GraphicsScene.mouseEvents import MouseClickEvent
from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QStackedWidget, QVBoxLayout, QWidget

from tissueid.app.plotting import PlotCard
from tissueid.app.theme import Theme, faint
from tissueid.app.views.researcher.engine_outcome import EngineOutcome, keys_of
from tissueid.app.views.researcher.kernel_plot import KernelPlot
from tissueid.app.views.researcher.plot_data import Line, Panel
from tissueid.app.views.researcher.plot_panels import KERNELS, OUTPUT, PANELS, PICTURES
from tissueid.app.views.researcher.result_figures import KernelFigure, PictureFigure
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.formatting import fixed
from tissueid.language import _

_NOTHING = np.zeros(0)
_CHOICE = 80
"""Minimum width of the choice of a picture, pixels."""
_LEAST, _AROUND = 48, 8
"""Characters of a name in the legend that are shown at least, and those that the square and the margins take."""
_PLAIN, _LABELLED = 90, 104
"""Minimum heights of a panel without and with a label below its axis, pixels."""


class Pictures(QWidget):
    """Plots of results. ``show_outcomes`` returns the drawn ones in the order of their colours."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.choice = QComboBox()
        self.choice.setAccessibleName(_("Picture"))
        self.choice.setMinimumWidth(_CHOICE)
        self._pages = QStackedWidget()
        self._cards: dict[Panel, PlotCard] = {}
        self._measured: pg.PlotDataItem | None = None
        self._slots: dict[Panel, list[_Slot]] = {}
        self._theme: Theme | None = None
        self._drawn: list[EngineOutcome] = []
        self._total = 0
        self.kernel = KernelPlot()
        for name, panels in PICTURES.items():
            self.choice.addItem(_(name), name)
            self._pages.addWidget(QWidget() if panels else self.kernel)
        self.legend = QLabel()
        self.legend.setTextFormat(Qt.TextFormat.RichText)
        self.legend.setWordWrap(True)
        self.legend.setMinimumWidth(1)
        self.legend.setAccessibleName(_("Key of the plots"))
        self.choice.currentIndexChanged.connect(self._turn)
        self.canvas = QWidget()
        inside = QVBoxLayout(self.canvas)
        inside.setContentsMargins(0, 0, 0, 0)
        inside.setSpacing(4)
        inside.addWidget(self.legend)
        inside.addWidget(self._pages, 1)
        self.tools = QHBoxLayout()
        self.tools.setSpacing(4)
        self.tools.addWidget(self.choice)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(self.tools)
        layout.addWidget(self.canvas, 1)
        self._make(0)
        self.show_outcomes(())

    def show_outcomes(self, outcomes: Sequence[EngineOutcome], total: int = 0) -> list[EngineOutcome]:
        """Draw the first seven results with the same signals that were not refused.

        ``total`` counts all fits of the table, which the legend says where only some are drawn.
        """
        there = [outcome for outcome in outcomes if outcome.report is not None]
        self._drawn = [outcome for outcome in there if outcome.plots.units == there[0].plots.units][: len(SERIES)]
        self._total = max(total, len(there))
        for panel in self._cards:
            self._fill(panel)
        self.kernel.offer([o for o in there if o.plots.kernels])
        self._show_legend()
        return self._drawn

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        self._theme = theme
        for panel in self._cards:
            self._paint(panel)
        self.kernel.apply_theme(theme)
        self._show_legend()

    @property
    def outcomes(self) -> tuple[EngineOutcome, ...]:
        """The drawn results in the order of their colours."""
        return tuple(self._drawn)

    @property
    def keys(self) -> tuple[str, list[str]]:
        """The common part of the labels of the drawn results, and the label of each in the legend."""
        return self._keys()

    def _keys(self, room: int | None = None) -> tuple[str, list[str]]:
        """Return ``keys``; with ``room`` names are elided to that number of characters, but not the scores."""
        common, labels = keys_of(self._drawn)
        scores = [""] * len(labels)
        if self._pages.currentIndex() == list(PICTURES).index(OUTPUT):
            scores = [f": {_scores(outcome)}" for outcome in self._drawn]
        if room is not None:
            labels = [
                in_the_middle(label, max(_LEAST // 2, room - len(score)))
                for label, score in zip(labels, scores, strict=True)
            ]
        return common, [label + score for label, score in zip(labels, scores, strict=True)]

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        """Elide the names in the legend to the available width."""
        super().resizeEvent(event)
        self._show_legend()

    @property
    def figure(self) -> PictureFigure | KernelFigure | None:
        """The shown plot as a figure for files; None if nothing is shown."""
        name = list(PICTURES)[self._pages.currentIndex()]
        plot = self.kernel.plot
        if name == KERNELS:
            return None if plot is None else KernelFigure(self.kernel.choice.currentText(), plot, self.kernel.turned)
        return PictureFigure(name, tuple(self._drawn), *self.keys) if self._drawn else None

    # -- inside -------------------------------------------------------------------------------------------

    def _make(self, place: int) -> None:
        """Create a page on first use, so that the window starts faster."""
        panels = list(PICTURES.values())[place]
        page = self._pages.widget(place)
        if not panels or page is None or panels[0] in self._cards:
            return
        column = QVBoxLayout(page)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(4)
        for panel in panels:
            look = PANELS[panel]
            card = PlotCard(_(look.title), _(look.x_label), "", log_axes=look.logs)
            card.setToolTip(_(look.band) if look.band else "")
            card.plot.getAxis("left").setWidth(52)
            card.plot.getAxis("left").enableAutoSIPrefix(False)
            self._cards[panel] = card
            self._slots[panel] = []
            if panel != panels[0] and (look.logs or panel == "residual"):
                card.plot.setXLink(self._cards[panels[0]].plot)
            if panel in PICTURES[OUTPUT]:
                card.plot.setMouseEnabled(x=True, y=False)
                card.plot.getViewBox().setAutoVisible(y=True)
                card.plot.scene().sigMouseClicked.connect(self._show_whole)
                card.setToolTip(_("Turn the wheel or drag to look closer; a double click shows everything"))
            if panel == "output":
                self._measured = card.line("muted", width=3, alpha=150)
            if panel == "coherence":
                card.plot.setYRange(0.0, 1.05, padding=0.0)
            card.setMinimumHeight(_LABELLED if look.x_label else _PLAIN)
            column.addWidget(card, 4 if look.x_label else 3)
            self._fill(panel)
            self._paint(panel)

    def _fill(self, panel: Panel) -> None:
        card = self._cards[panel]
        lines = [outcome.plots.lines.get(panel) for outcome in self._drawn]
        slots = self._slots[panel]
        for role in SERIES[len(slots) : len(lines)]:  # made when they are needed: a plot's items take their time
            slots.append(_Slot(card, role, 1 if panel in PICTURES[OUTPUT] else 2))
            self._paint(panel)
        for place, slot in enumerate(slots):
            slot.show(lines[place] if place < len(lines) else None)
        self._lay_under(panel)
        unit = self._drawn[0].plots.units.get(panel, "") if self._drawn else ""
        card.retitle(_(PANELS[panel].title), unit)
        if any(line is not None for line in lines):
            card.say_missing("")
            if panel in PICTURES["Against depth"]:
                _hold_bands(card, [line for line in lines if line is not None])
            without = sum(line is None for line in lines)
            card.remark(
                _("{without} of {count} have none").format(without=without, count=len(lines)) if without else ""
            )
            return
        reasons = dict.fromkeys(o.plots.missing.get(panel, "") for o in self._drawn)
        card.say_missing(" ".join(filter(None, reasons)) or _("Nothing to show yet: choose tests and run an engine."))

    def _lay_under(self, panel: Panel) -> None:
        """Draw the measurement below the curves: once if all results share it, otherwise once each."""
        measured = [outcome.plots.measured.get(panel) for outcome in self._drawn]
        if panel == "output" and self._measured is not None:
            one = next((line for line in measured if line is not None), None) if self._same_data else None
            self._measured.setData(*((one.x, one.y) if one is not None else (_NOTHING, _NOTHING)))
            for place, slot in enumerate(self._slots[panel]):
                slot.lay_under(measured[place] if place < len(measured) and not self._same_data else None)
        if panel in PICTURES[OUTPUT]:
            self._cards[panel].plot.enableAutoRange()

    @property
    def _same_data(self) -> bool:
        return len({(outcome.signals, *outcome.tests) for outcome in self._drawn}) == 1

    def _show_whole(self, click: MouseClickEvent) -> None:
        if click.double():
            for panel in PICTURES[OUTPUT]:
                self._cards[panel].plot.enableAutoRange()

    def _paint(self, panel: Panel) -> None:
        if self._theme is not None:
            self._cards[panel].apply_theme(self._theme)
            for slot in self._slots[panel]:
                slot.apply_theme(self._theme)

    def _turn(self, place: int) -> None:
        self._make(place)
        self._pages.setCurrentIndex(place)
        self._show_legend()

    def _show_legend(self) -> None:
        theme = self._theme
        if theme is None:
            return
        room = max(_LEAST, self.width() // max(1, self.fontMetrics().averageCharWidth()) - _AROUND)
        common, labels = self._keys(room)
        entries = [html.escape(f"{common}:")] if common else []
        for role, label in zip(SERIES, labels, strict=False):
            name = html.escape(label).replace(" ", "&nbsp;")
            entries.append(f'<span style="color:{getattr(theme, role)}">■</span>&nbsp;{name}')
        words = []
        if self._pages.currentIndex() == list(PICTURES).index(OUTPUT) and self._drawn:
            words.append(_("broad and pale: measured"))
            if any(o.plots.lines[p].out_x is not None for o in self._drawn for p in ("output",) if p in o.plots.lines):
                words.append(_("faint: scheduled by the measured output"))
        if self._pages.currentIndex() == list(PICTURES).index("Against depth") and any(
            line.out_x is not None for o in self._drawn for line in o.plots.lines.values()
        ):
            words.append(_("faint: on the way out"))
        if len(self._drawn) < self._total:
            words.append(
                _("{drawn} of {count} drawn: select which in the table").format(
                    drawn=len(self._drawn), count=self._total
                )
            )
        entries += [f'<span style="color:{theme.muted}">{word}</span>' for word in words]
        self.legend.setText(" &nbsp;&nbsp; ".join(entries))
        self.legend.setMinimumHeight(0)  # what the text needs must be asked without the former minimum
        needed = max(0, self.legend.heightForWidth(self.width()))  # -1 without a text
        self.legend.setMinimumHeight(needed)  # a splitter does not know heights of wrapped texts
        self.legend.setVisible(bool(entries) and self.choice.currentText() != _(KERNELS))


def in_the_middle(text: str, longest: int) -> str:
    """Return a text that is elided in the middle."""
    half = (longest - 1) // 2
    return text if len(text) <= longest else f"{text[:half]}…{text[-half:]}"


def _scores(outcome: EngineOutcome) -> str:
    """Return the VAF on held-out data, and that of the simulation scheduled by measured depth if there is one."""
    report = outcome.report
    assert report is not None
    words = _("VAF {vaf} %").format(vaf=fixed(report.vaf_validation_percent, 1))
    scheduled = report.vaf_scheduled_percent
    return (
        words
        if scheduled is None
        else _("{vaf} (scheduled {scheduled} %)").format(vaf=words, scheduled=fixed(scheduled, 1))
    )


def _hold_bands(card: PlotCard, lines: Sequence[Line]) -> None:
    """Extend the range to the bands, unless they are much wider than the curves."""
    values = np.concatenate([part for line in lines for part in (line.y, line.out_y) if part is not None])
    edges = [part for line in lines for part in (line.low, line.high) if part is not None]
    values = values[np.isfinite(values)]
    if values.size == 0:
        return
    every = np.concatenate([values, *edges])
    reach = float(np.median(np.abs(values)))
    low = max(float(np.nanmin(every)), float(values.min()) - reach)
    high = min(float(np.nanmax(every)), float(values.max()) + reach)
    if high > low:
        card.plot.setYRange(low, high, padding=0.08)
    else:
        card.plot.enableAutoRange(y=True)


class _Slot:
    """The items of one colour in one card."""

    def __init__(self, card: PlotCard, role: str, width: int) -> None:
        self._low, self._high = card.band(role, alpha=45)
        self._line = card.line(role, width=1)
        self._out = card.line(role, width=1, alpha=130)
        self._dots = card.dots(role, 9)
        self._under: pg.PlotDataItem | None = None
        self._card = card
        self._theme: Theme | None = None
        self._role, self._width = role, width

    def show(self, line: Line | None) -> None:
        """Draw a line; clear the plot for None."""
        nothing = Line(_NOTHING, _NOTHING)
        line = line or nothing
        joined, separate = (nothing, line) if line.dots else (line, nothing)
        self._line.setData(joined.x, joined.y)
        self._dots.setData(separate.x, separate.y)
        banded = line.low is not None and line.high is not None
        for edge, values in ((self._low, line.low), (self._high, line.high)):
            edge.setData(line.x if banded else _NOTHING, values if banded else _NOTHING)
        there = line.out_x is not None and line.out_y is not None
        self._out.setData(line.out_x if there else _NOTHING, line.out_y if there else _NOTHING)

    def lay_under(self, line: Line | None) -> None:
        """Draw a measurement below the curves; None clears it."""
        if self._under is None and line is not None:
            self._under = self._card.line(self._role, width=4, alpha=70)
            self._under.setZValue(-1)
            if self._theme is not None:
                self._under.setPen(pg.mkPen(faint(getattr(self._theme, self._role), 70), width=4))
        if self._under is not None:
            self._under.setData(*((line.x, line.y) if line is not None else (_NOTHING, _NOTHING)))

    def apply_theme(self, theme: Theme) -> None:
        """Take on the colours of a theme; lines as wide as can be followed among others."""
        self._theme = theme
        self._line.setPen(pg.mkPen(getattr(theme, self._role), width=self._width))
