"""Tab "Population": many fits as points, with the means of groups."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QComboBox, QLabel, QWidget

from tissueid.app.build import button, choice, column, offer, styled, tiles
from tissueid.app.plot_canvas import PlotCanvas, Point
from tissueid.app.theme import LIGHT, appearance
from tissueid.app.views.researcher.engine_outcome import EngineOutcome, variant_of
from tissueid.app.views.researcher.pictures import PopulationFigure
from tissueid.app.views.researcher.population import (
    ACROSS,
    DISTRIBUTION,
    GROUPS,
    SCORES,
    Population,
    estimate_of,
    parameters_of,
    population,
    population_plot,
)
from tissueid.app.views.researcher.results_table import SERIES
from tissueid.app.widgets import ElidedLabel
from tissueid.formatting import axis_label, fixed, grouped, label_and_unit, plus_minus, with_unit
from tissueid.language import _, marked, plural
from tissueid.messages import Verbatim
from tissueid.records import Estimate
from tissueid.units import display_unit, shown, shown_si

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot

SPREADS: Mapping[str, str] = {
    "std": marked("Mean ± standard deviation"),
    "interval": marked("Mean, 95 % confidence"),
    "": marked("No mean"),
}
_REACH_PX = 7.0
"""Distance from a point within which it is picked."""
_CHARACTERS = 9
_TICK_PX = 7
"""Pixels that a letter of a tick takes."""
_MOST_NAMED = 12
_LONGEST = 16


class PopulationView(QWidget):
    """Plot of the population; ``wanted`` carries the fits to select in the table."""

    wanted = Signal(list)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._outcomes: tuple[EngineOutcome, ...] = ()
        self._stale = False
        self._wanted = ""
        self.shown: Population | None = None
        self.engine = _choice(_("Fits that are drawn: engine and options"))
        self.parameter = _choice(_("Parameter"))
        self.across = _choice(_("Drawn against"), ACROSS)
        self.group = _choice(_("Groups"), GROUPS)
        self.spread = _choice(_("Means of the groups"), SPREADS)
        self.group.setCurrentIndex(self.group.findData("engine"))
        self.save_figure = button(
            _("Figure…"),
            name=_("Save the figure of the population"),
            tip=_("Save the figure as PDF, SVG or PNG with 300 dpi"),
        )
        self.card = PlotCanvas(_("Population"))
        self.card.pick, self.card.tip = self._clicked, self._tip
        self.key = styled(
            QLabel(),
            text_format=Qt.TextFormat.RichText,
            word_wrap=True,
            minimum_width=1,
            name=_("Groups and their means"),
        )
        self.count = styled(ElidedLabel(), role="muted")
        self.named = ElidedLabel()
        top = tiles(2, self.parameter, self.across, self.group, self.spread, spacing=4)
        top.addWidget(self.engine, 2, 0, 1, 2)
        top.addWidget(self.save_figure, 0, 2)
        column(top, self.key, (self.card, 1), self.count, self.named, spacing=4, margins=(0, 6, 0, 0), parent=self)
        for box in (self.engine, self.parameter, self.across, self.group, self.spread):
            box.activated.connect(self._choose)
        appearance.changed.connect(self._show)
        self._show()
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

    @property
    def figure(self) -> PopulationFigure | None:
        """The shown plot as a figure for files; None if nothing is shown."""
        found = self.shown
        if found is None or not found.outcomes:
            return None
        names = [f"{name}: {mean}" if name else mean for name, mean in zip(found.groups, _overall(found), strict=True)]
        title = f"{self.parameter.currentText()} {self.across.currentText()}"
        across, spread = str(self.across.currentData()), str(self.spread.currentData())
        plot = population_plot(found, across, spread, [getattr(LIGHT, role) for role in SERIES], names)
        return PopulationFigure(title, plot, self.count.text())

    # -- choosing --------------------------------------------------------------------------------------------

    def _choose(self) -> None:
        self._wanted = str(self.parameter.currentData() or "")
        self._show()

    def _refresh(self) -> None:
        """Offer the parameters of the fits; the selection stays if possible."""
        self._stale = False
        variants = dict.fromkeys(variant_of(outcome) for outcome in self._outcomes)
        offer(self.engine, {"": _("Fits of all engines")} | {variant: variant for variant in variants})
        names = {name: _heading(name) for name in parameters_of(self._outcomes)}
        offer(self.parameter, names, self._wanted)
        offer(self.across, {key: _(words) for key, words in ACROSS.items()} | names)
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
        if found.outcomes:
            spread = str(self.spread.currentData())
            plot = population_plot(found, across, spread, SERIES, [""] * len(SERIES))
            note = _("Click on a point: its test is named below. A double click selects it in the table")
            self.card.show_plots([replace(self._with_room(plot, found), note=note)], key=False)
        else:
            self.card.say_missing(_("No fit has this parameter."))
        self._say(found)

    def _wanted_fits(self) -> list[EngineOutcome]:
        """Return the fits of the selected engine and options."""
        wanted = self.engine.currentData()
        return [outcome for outcome in self._outcomes if not wanted or variant_of(outcome) == wanted]

    def _with_room(self, plot: Plot, found: Population) -> Plot:
        """Return the plot with as many names of categories as stand side by side."""
        if not found.places:
            return plot
        width = max(len(name[:_LONGEST]) for name in found.places) * _TICK_PX
        step = max(1, math.ceil(width * len(found.places) / max(200, self.card.width() - 80)))
        ticks = tuple((place, Verbatim(name[:_LONGEST])) for place, name in plot.x.ticks[::step])
        return replace(plot, x=replace(plot.x, ticks=ticks))

    def _say(self, found: Population) -> None:
        total = len(self._wanted_fits())
        words = plural("{drawn} of {count} fit drawn", "{drawn} of {count} fits drawn", total).format(
            drawn=grouped(len(found.outcomes)), count=grouped(total)
        )
        of_tests = plural("of {count} test", "of {count} tests", found.tests).format(count=grouped(found.tests))
        reasons = [f"{grouped(count)} {why}" for why, count in found.left_out.items()]
        variants = list(dict.fromkeys(variant_of(outcome) for outcome in found.outcomes))
        self.count.setText("; ".join([f"{words} {of_tests}", *reasons, *variants]))
        theme = appearance.theme
        overall = _overall(found)
        entries = []
        for place, name in enumerate(found.groups[:_MOST_NAMED]):
            words = f"{name}: {overall[place]}" if name else overall[place]
            square = f'<span style="color:{getattr(theme, SERIES[place])}">■</span>&nbsp;'
            entries.append(f"<nobr>{square}{html.escape(words)}</nobr>")
        self.key.setText(" &nbsp; ".join(entries))

    # -- pointing --------------------------------------------------------------------------------------------

    def _clicked(self, at: Point, double: bool) -> bool:
        found = self._at(at)
        if found:
            self.name(found)
            if double:
                self.wanted.emit(found)
        return bool(found)

    def _at(self, at: Point) -> list[EngineOutcome]:
        """Return the fit at a place on the canvas, or all fits of a bar of the histogram."""
        found = self.shown
        if found is None or not found.outcomes:
            return []
        if self.across.currentData() == DISTRIBUTION:
            edges, (x, y) = found.edges, self.card.values(at)
            if not edges[0] <= x <= edges[-1] or y < 0.0:
                return []
            bins = np.clip(np.searchsorted(edges, found.y, "right") - 1, 0, edges.size - 2)
            bin_there = min(int(np.searchsorted(edges, x, "right")) - 1, edges.size - 2)
            return [found.outcomes[place] for place in np.flatnonzero(bins == bin_there)]
        away = np.hypot(*(self.card.pixels(found.x, found.y) - at).T)
        nearest = int(np.argmin(away))
        return [found.outcomes[nearest]] if away[nearest] <= _REACH_PX else []

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

    def _tip(self, at: Point) -> str:
        found = self._at(at) if self.across.currentData() != DISTRIBUTION else []
        return self._words(found[0]) if found else ""


def _choice(name: str, entries: Mapping[str, str] = MappingProxyType({})) -> QComboBox:
    return choice({key: _(words) for key, words in entries.items()}, characters=_CHARACTERS, name=name, tip=name)


def _heading(parameter: str) -> str:
    """Return a parameter with its unit."""
    if parameter in SCORES:
        return _(SCORES[parameter])
    return axis_label(parameter, shown(display_unit(label_and_unit(parameter)[1])[0])[0])


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
        return f"{fixed(estimate.value, 2)} %"
    unit, scale = shown_si(label_and_unit(parameter)[1])
    return with_unit(plus_minus(estimate, scale), unit)
