"""Tab "Population": many fits as points, with the means of groups."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pyqtgraph as pg
from pyqtgraph.GraphicsScene.mouseEvents import MouseClickEvent
from PySide6.QtCore import QPointF, Qt, Signal
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from tissueid.app.elided_label import ElidedLabel
from tissueid.app.plotting import PlotCard
from tissueid.app.theme import Theme, faint
from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.app.views.researcher.engine_variants import variant_of
from tissueid.app.views.researcher.population import (
    ACROSS,
    DATE,
    DISTRIBUTION,
    GROUPS,
    SCORES,
    Mean,
    Population,
    day,
    estimate_of,
    parameters_of,
    population,
)
from tissueid.app.views.researcher.result_figures import PopulationFigure
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.app.views.researcher.tool_tips import plain_tip
from tissueid.formatting import axis_label, grouped, label_and_unit, plus_minus, with_unit
from tissueid.language import _, marked, plural
from tissueid.records import Estimate
from tissueid.units import display_unit, shown, shown_si

SPREADS: Mapping[str, str] = {
    "std": marked("Mean ± standard deviation"),
    "interval": marked("Mean, 95 % confidence"),
    "": marked("No mean"),
}
_NOTHING = np.zeros(0)
_POINT, _MEAN = 7, 11
_CHARACTERS = 9
_TICK_PX = 7
"""Pixels that a letter of a tick takes."""
_MOST_TICKS = 6
_MOST_NAMED = 12
_LONGEST = 16


class PopulationView(QWidget):
    """Plot of the population; ``wanted`` carries the fits to select in the table."""

    wanted = Signal(list)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._outcomes: tuple[EngineOutcome, ...] = ()
        self._stale = False
        self._theme: Theme | None = None
        self._wanted = ""
        self.shown: Population | None = None
        self.engine = _choice(_("Fits that are drawn: engine and options"))
        self.parameter = _choice(_("Parameter"))
        self.across = _choice(_("Drawn against"))
        self.group = _choice(_("Groups"))
        self.spread = _choice(_("Means of the groups"))
        for choice, entries in ((self.group, GROUPS), (self.spread, SPREADS), (self.across, ACROSS)):
            for key, words in entries.items():
                choice.addItem(_(words), key)
        self.group.setCurrentIndex(self.group.findData("engine"))
        self.save_figure = QPushButton(_("Figure…"))
        self.save_figure.setAccessibleName(_("Save the figure of the population"))
        self.save_figure.setToolTip(_("Save the figure as PDF, SVG or PNG with 300 dpi"))
        self.card = PlotCard(_("Population"), " ", "")
        self.card.plot.getAxis("left").setWidth(60)
        self.card.setToolTip(_("Click on a point: its test is named below. A double click selects it in the table"))
        self._points = [self._scatter(_POINT) for _role in SERIES]
        self._steps = [self._bar() for _role in SERIES]
        self._bars = [pg.ErrorBarItem(x=_NOTHING, y=_NOTHING, height=_NOTHING, beam=0.0) for _role in SERIES]
        for bar in self._bars:
            bar.setZValue(5)
            self.card.plot.addItem(bar)
        self._centres = self._scatter(_MEAN, hoverable=False)
        self._centres.setZValue(6)
        self.card.plot.scene().sigMouseClicked.connect(self._clicked)
        self.key = QLabel()
        self.key.setTextFormat(Qt.TextFormat.RichText)
        self.key.setWordWrap(True)
        self.key.setMinimumWidth(1)
        self.key.setAccessibleName(_("Groups and their means"))
        self.count = ElidedLabel()
        self.count.setProperty("role", "muted")
        self.named = ElidedLabel()
        top = QGridLayout()
        top.setSpacing(4)
        for place, part in enumerate((self.parameter, self.across, self.group, self.spread)):
            top.addWidget(part, place // 2, place % 2)
        top.addWidget(self.engine, 2, 0, 1, 2)
        top.addWidget(self.save_figure, 0, 2)
        top.setColumnStretch(0, 1)
        top.setColumnStretch(1, 1)
        rows = QVBoxLayout(self)
        rows.setContentsMargins(0, 6, 0, 0)
        rows.setSpacing(4)
        rows.addLayout(top)
        rows.addWidget(self.key)
        rows.addWidget(self.card, 1)
        rows.addWidget(self.count)
        rows.addWidget(self.named)
        for choice in (self.engine, self.parameter, self.across, self.group, self.spread):
            choice.activated.connect(self._choose)
        self.show_outcomes(())

    def show_outcomes(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Show fits when the tab becomes visible."""
        self._outcomes = tuple(outcomes)
        self._stale = True
        if self.isVisible():
            self._refresh()

    def showEvent(self, event: object) -> None:  # noqa: N802
        """Draw pending changes."""
        if self._stale:
            self._refresh()

    def take_units(self) -> None:
        """Show all values in the active unit system."""
        self._stale = True
        if self.isVisible():
            self._refresh()

    def apply_theme(self, theme: Theme) -> None:
        """Apply the colours of a theme."""
        self._theme = theme
        self.card.apply_theme(theme)
        for role, points, steps, bar in zip(SERIES, self._points, self._steps, self._bars, strict=True):
            colour = getattr(theme, role)
            points.setBrush(faint(colour, 150))
            steps.setPen(pg.mkPen(colour, width=1))
            steps.setBrush(faint(colour, 70))
            bar.setData(pen=pg.mkPen(colour, width=2))
        self._show()

    @property
    def figure(self) -> PopulationFigure | None:
        """The shown plot as a figure for files; None if nothing is shown."""
        found = self.shown
        if found is None or not found.outcomes:
            return None
        parameter, across = str(self.parameter.currentData()), str(self.across.currentData())
        names = [f"{name}: {mean}" if name else mean for name, mean in zip(found.groups, _overall(found), strict=True)]
        title = f"{self.parameter.currentText()} {self.across.currentText()}"
        spread = str(self.spread.currentData())
        return PopulationFigure(title, found, across, _heading(parameter), spread, names, self.count.text())

    # -- choosing --------------------------------------------------------------------------------------------

    def _choose(self) -> None:
        self._wanted = str(self.parameter.currentData() or "")
        self._show()

    def _refresh(self) -> None:
        """Offer the parameters of the fits; the selection stays if possible."""
        self._stale = False
        variants = dict.fromkeys(variant_of(outcome) for outcome in self._outcomes)
        shown_variant = self.engine.currentData()
        self.engine.clear()
        self.engine.addItem(_("Fits of all engines"), "")
        for variant in variants:
            self.engine.addItem(variant, variant)
        self.engine.setCurrentIndex(max(0, self.engine.findData(shown_variant)))
        parameters = parameters_of(self._outcomes)
        names = [(name, _heading(name)) for name in parameters]
        across = self.across.currentData()
        for choice, entries in (
            (self.parameter, names),
            (self.across, [*((key, _(words)) for key, words in ACROSS.items()), *names]),
        ):
            choice.blockSignals(True)
            choice.clear()
            for key, words in entries:
                choice.addItem(words, key)
            choice.blockSignals(False)
        self.parameter.setCurrentIndex(max(0, self.parameter.findData(self._wanted)) if names else -1)
        self.across.setCurrentIndex(max(0, self.across.findData(across)))
        self._show()

    # -- drawing ---------------------------------------------------------------------------------------------

    def _show(self) -> None:
        parameter, across = self.parameter.currentData(), str(self.across.currentData())
        self.named.setText("")
        if parameter is None:
            self.shown = None
            self.card.say_missing(_("Nothing to show yet: choose tests and run an engine."))
            self.key.setText("")
            self.count.setText("")
            return
        found = population(self._wanted_fits(), parameter, across, str(self.group.currentData()), len(SERIES))
        self.shown = found
        self.card.say_missing("" if found.outcomes else _("No fit has this parameter."))
        histogram = across == DISTRIBUTION
        if histogram:
            self.card.retitle(found.counted, "")
            self.card.relabel(_heading(parameter, clinical=True))
        else:
            self.card.retitle(found.title, found.unit)
            self.card.relabel(found.x_label)
        self._draw_points(found, histogram=histogram)
        self._draw_means(found, histogram=histogram)
        self._label_ticks(found, across)
        self.card.plot.enableAutoRange()
        self._say(found)

    def _wanted_fits(self) -> list[EngineOutcome]:
        """Return the fits of the selected engine and options."""
        wanted = self.engine.currentData()
        return [outcome for outcome in self._outcomes if not wanted or variant_of(outcome) == wanted]

    def _draw_points(self, found: Population, *, histogram: bool) -> None:
        edges = found.edges
        for place in range(len(SERIES)):
            mask = found.group == place
            there = bool(mask.any())
            if histogram:
                counts = np.histogram(found.y[mask], edges)[0].astype(np.float64)
                self._points[place].clear()
                self._steps[place].setData(*((edges, counts) if there else (np.zeros(1), _NOTHING)), stepMode="center")
                self._steps[place].setVisible(there)
            else:
                self._steps[place].setVisible(False)
                self._steps[place].setData(np.zeros(1), _NOTHING, stepMode="center")
                self._points[place].setData(found.x[mask], found.y[mask], data=np.flatnonzero(mask))

    def _draw_means(self, found: Population, *, histogram: bool) -> None:
        spread = self.spread.currentData()
        means = [mean for mean in found.means if spread and not histogram]
        for place, bar in enumerate(self._bars):
            own = [mean for mean in means if mean.group == place and mean.count > 1]
            half = np.array([_half(mean, spread) for mean in own])
            x, y = np.array([mean.x for mean in own]), np.array([mean.y for mean in own])
            bar.setData(x=x, y=y, height=2.0 * half)
            bar.setVisible(bool(own))  # an empty one would stretch the axes to zero
        brushes = [QColor(getattr(self._theme, SERIES[mean.group])) for mean in means] if self._theme else None
        self._centres.setData([mean.x for mean in means], [mean.y for mean in means], brush=brushes)

    def _label_ticks(self, found: Population, across: str) -> None:
        axis = self.card.plot.getAxis("bottom")
        if across == DATE and found.x.size:
            low, high = float(found.x.min()), float(found.x.max())
            times = np.linspace(low, high, _MOST_TICKS) if high > low else np.array([low])
            named = {day(float(time)): float(time) for time in times}
            axis.setTicks([[(time, name) for name, time in named.items()]])
        elif found.places:
            width = max(len(name[:_LONGEST]) for name in found.places) * _TICK_PX
            step = max(1, math.ceil(width * len(found.places) / max(200, self.card.plot.width() - 80)))
            ticks = [(float(place), name[:_LONGEST]) for place, name in enumerate(found.places) if place % step == 0]
            axis.setTicks([ticks])
        else:
            axis.setTicks(None)

    def _say(self, found: Population) -> None:
        total = len(self._wanted_fits())
        words = plural("{drawn} of {count} fit drawn", "{drawn} of {count} fits drawn", total).format(
            drawn=grouped(len(found.outcomes)), count=grouped(total)
        )
        of_tests = plural("of {count} test", "of {count} tests", found.tests).format(count=grouped(found.tests))
        reasons = [f"{grouped(count)} {why}" for why, count in found.left_out.items()]
        variants = list(dict.fromkeys(variant_of(outcome) for outcome in found.outcomes))
        self.count.setText("; ".join([f"{words} {of_tests}", *reasons, *variants]))
        theme = self._theme
        if theme is None:
            return
        overall = _overall(found)
        entries = []
        for place, name in enumerate(found.groups[:_MOST_NAMED]):
            words = f"{name}: {overall[place]}" if name else overall[place]
            square = f'<span style="color:{getattr(theme, SERIES[place])}">■</span>&nbsp;'
            entries.append(f"<nobr>{square}{html.escape(words)}</nobr>")
        self.key.setText(" &nbsp; ".join(entries))

    # -- pointing --------------------------------------------------------------------------------------------

    def _clicked(self, click: MouseClickEvent) -> None:
        found = self._at(click.scenePos())
        if not found:
            return
        self.name(found)
        if click.double():
            self.wanted.emit(found)

    def _at(self, scene: QPointF) -> list[EngineOutcome]:
        """Return the fit at a position in the plot, or all fits of a bar of the histogram."""
        found = self.shown
        if found is None:
            return []
        where = self.card.plot.getViewBox().mapSceneToView(scene)
        if self.across.currentData() == DISTRIBUTION:
            edges = found.edges
            if not edges[0] <= where.x() <= edges[-1] or where.y() < 0.0:
                return []
            bins = np.clip(np.searchsorted(edges, found.y, "right") - 1, 0, edges.size - 2)
            bin_there = min(int(np.searchsorted(edges, where.x(), "right")) - 1, edges.size - 2)
            return [found.outcomes[place] for place in np.flatnonzero(bins == bin_there)]
        for points in reversed(self._points):
            for spot in points.pointsAt(points.mapFromScene(scene)):
                return [found.outcomes[int(spot.data())]]
        return []

    def name(self, outcomes: Sequence[EngineOutcome]) -> None:
        """Show the label and value of a fit, or the number of fits."""
        if len(outcomes) == 1:
            self.named.setText(self._words(outcomes[0]))
        else:
            self.named.setText(_("{count} fits; a double click selects them in the table").format(count=len(outcomes)))

    def _words(self, outcome: EngineOutcome) -> str:
        parameter = str(self.parameter.currentData())
        estimate = estimate_of(outcome, parameter)
        return f"{outcome.label}: {_figure(parameter, estimate)}" if estimate is not None else outcome.label

    def _tip(self, x: float, y: float, data: object) -> str:
        found = self.shown
        place = int(data)  # type: ignore[call-overload]
        return plain_tip(self._words(found.outcomes[place])) if found is not None else ""

    # -- building --------------------------------------------------------------------------------------------

    def _scatter(self, size: int, *, hoverable: bool = True) -> pg.ScatterPlotItem:
        item = pg.ScatterPlotItem(size=size, pen=None, pxMode=True, hoverable=hoverable, tip=self._tip, hoverSize=9)
        self.card.plot.addItem(item)
        return item

    def _bar(self) -> pg.PlotCurveItem:
        item = pg.PlotCurveItem(np.zeros(1), _NOTHING, stepMode="center", fillLevel=0.0)
        item.hide()
        self.card.plot.addItem(item)
        return item


def _choice(name: str) -> QComboBox:
    choice = QComboBox()
    choice.setAccessibleName(name)
    choice.setToolTip(name)
    choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    choice.setMinimumContentsLength(_CHARACTERS)
    return choice


def _heading(parameter: str, *, clinical: bool = False) -> str:
    """Return a parameter with its unit: the active one, or the one in which it is drawn."""
    if parameter in SCORES:
        return _(SCORES[parameter])
    unit = display_unit(label_and_unit(parameter)[1])[0]
    return axis_label(parameter, unit if clinical else shown(unit)[0])


def _half(mean: Mean, spread: object) -> float:
    return mean.std if spread == "std" else mean.half_interval


def _overall(found: Population) -> list[str]:
    """Mean ± standard deviation and number of fits of every group, over all places."""
    factor = shown(found.unit)[1]
    words = []
    for place in range(len(found.groups)):
        some = factor * found.y[found.group == place]
        std = float(np.std(some, ddof=1)) if some.size > 1 else None
        text = with_unit(plus_minus(Estimate(float(some.mean()), std)), shown(found.unit)[0])
        words.append(_("{mean} (n = {count})").format(mean=text, count=grouped(some.size)))
    return words


def _figure(parameter: str, estimate: Estimate) -> str:
    if parameter in SCORES:
        return f"{estimate.value:.2f} %"
    unit, scale = shown_si(label_and_unit(parameter)[1])
    return with_unit(plus_minus(estimate, scale), unit)


__all__ = ["SPREADS", "PopulationView"]
