"""The tabs "Recommendation", "History" and "Population" of the results of an analysis."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QHeaderView,
    QLabel,
    QMenu,
    QPlainTextEdit,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import button, choice, column, label, offer, row, splitter, styled, table, tiles
from tissueid.app.plot_canvas import PlotCanvas, Point
from tissueid.app.theme import LIGHT, appearance
from tissueid.app.views.researcher.batch import COLUMNS, ComparisonSummary
from tissueid.app.views.researcher.engine_outcome import (
    MOST_ENTRIES,
    AnalysisTask,
    EngineOutcome,
    HistoryEntry,
    changed_options,
    variant_of,
)
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
from tissueid.app.views.researcher.results_table import SERIES, in_two_lines
from tissueid.app.widgets import ElidedLabel, fill_table
from tissueid.formatting import axis_label, clean, fixed, grouped, label_and_unit, plain_text, plus_minus, with_unit
from tissueid.identification import engine_label, engine_names
from tissueid.language import _, marked, plural
from tissueid.messages import Verbatim, translated
from tissueid.records import Estimate
from tissueid.units import display_unit, shown, shown_si

if TYPE_CHECKING:
    from tissueid.analysis.curves import Plot

_NOTHING = marked("No comparison yet. “Compare engines” fits every engine to the chosen tests and recommends one.")
_STATE = 1
_NUMBERS = (2, 3, 4, 5)
"""Columns of the table."""


class RecommendationView(QWidget):
    """Shows one comparison at a time."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._verdicts: dict[str, ComparisonSummary] = {}
        self.choice = choice({}, self._show, 0, name=_("Test whose comparison is shown"))
        self.engines = button(_("En&gines compared"))
        menu = QMenu(self.engines)
        self.engines.setMenu(menu)
        self._actions = {name: build.add_check(menu, engine_label(name), True, self._count) for name in engine_names()}
        self.save = button(_("Table…"), name=_("Save the recommendation"), tip=_("Save table and reasons as CSV"))
        self.headline = label("headline")
        self.reasons = styled(
            QPlainTextEdit(), name=_("Reasons of the recommendation"), read_only=True, tab_changes_focus=True
        )
        self.standings = table([in_two_lines(_(name)) for name in COLUMNS], _("Engines by how well they do"))
        self.standings.setWordWrap(True)  # the last column has the reason of a refusal
        header = self.standings.horizontalHeader()
        header.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)
        header.sectionResized.connect(self.standings.resizeRowsToContents)
        parts = splitter((self.reasons, 2), (self.standings, 3), upright=True)
        top = row(self.engines, (self.choice, 1), self.save)
        build.column(top, self.headline, (parts, 1), margins=(0, 6, 0, 0), parent=self)
        self._count()
        self._show()

    @property
    def compared(self) -> tuple[str, ...]:
        """The engines that are compared."""
        return tuple(name for name, action in self._actions.items() if action.isChecked())

    def take_compared(self, engines: Sequence[str]) -> None:
        """Select the engines to compare; unknown names are ignored, an empty selection means all."""
        selected = [name for name in engines if name in self._actions] or list(self._actions)
        for name, action in self._actions.items():
            action.setChecked(name in selected)

    def add(self, verdicts: Sequence[ComparisonSummary]) -> None:
        """Add summaries and show the first; a later summary of a test replaces the earlier one."""
        if not verdicts:
            return
        self._verdicts |= {verdict.label: verdict for verdict in verdicts}
        offer(self.choice, {label: label for label in self._verdicts}, verdicts[0].label)
        self._show()

    def rows(self) -> list[Sequence[str]]:
        """Return the shown comparison as rows of a table: its engines, then each sentence in a row of its own."""
        verdict = self._verdicts.get(self.choice.currentText())
        if verdict is None:
            return []
        said = (verdict.label, verdict.headline, verdict.judged_on, *verdict.reasons, *verdict.doubts)
        return [list(map(_, COLUMNS)), *verdict.rows, *([line] for line in (*said, *verdict.experiments))]

    def _count(self) -> None:
        count = _("all") if len(self.compared) == len(self._actions) else len(self.compared)
        self.engines.setText(_("En&gines compared: {count}").format(count=count))

    def _show(self) -> None:
        verdict = self._verdicts.get(self.choice.currentText())
        for part in (self.choice, self.standings, self.headline, self.save):
            part.setVisible(verdict is not None)
        if verdict is None:
            self.headline.setText("")
            self.reasons.setPlainText(_(_NOTHING))
            return
        self.headline.setText(verdict.headline)
        parts = [verdict.judged_on, *verdict.reasons]
        for title, lines in ((_("Caveats"), verdict.doubts), (_("Suggested tests"), verdict.experiments)):
            parts += ["", title, *lines] if lines else []
        self.reasons.setPlainText("\n".join(parts))
        best = [index for index, texts in enumerate(verdict.rows) if texts[_STATE] == _("recommended")]
        fill_table(self.standings, verdict.rows, bold=best, right=_NUMBERS)
        self.standings.resizeRowsToContents()


_COLUMNS = (
    marked("When"),
    marked("Engine"),
    marked("Tests"),
    marked("Result"),
    marked("Options that differ from the defaults"),
)
_LONGEST = 200


class HistoryList(QWidget):
    """Earlier analyses. ``again`` carries a task to repeat, ``wanted`` one to put into the form."""

    again = Signal(object)
    wanted = Signal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._entries: list[HistoryEntry] = []
        self._busy = False
        self.run = build.button(_("Run again"), self._again)
        self.fill = build.button(_("Put into the form"), self._fill)
        self.remark = build.label("muted")
        self.table = build.table([_(name) for name in _COLUMNS], _("History of analyses"))
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        interactive = QHeaderView.ResizeMode.Interactive
        build.styled(self.table.horizontalHeader(), section_resize_mode=interactive, stretch_last_section=True)
        build.column(
            build.row(self.fill, self.run, (self.remark, 1)), (self.table, 1), margins=(0, 6, 0, 0), parent=self
        )
        self.table.itemSelectionChanged.connect(self._settle)
        self.table.activated.connect(self._fill)
        self._settle()

    def show_entries(self, entries: Sequence[HistoryEntry], bad: int = 0) -> None:
        """Show entries, newest first; ``bad`` is the number of unreadable lines."""
        self._entries = list(entries)[:MOST_ENTRIES]
        self.remark.setText(
            _("{count} lines of the history could not be read and are passed over.").format(count=bad) if bad else ""
        )
        fill_table(self.table, [[text[:_LONGEST] for text in _texts(entry)] for entry in self._entries])
        for index in range(len(_COLUMNS) - 1):
            self.table.resizeColumnToContents(index)
            self.table.setColumnWidth(index, min(240, self.table.columnWidth(index) + 6))
        self._settle()

    def add(self, entry: HistoryEntry) -> None:
        """Add the newest run."""
        self.show_entries([entry, *self._entries])

    def update_enabled(self, *, busy: bool) -> None:
        """Disable "Run again" while other work runs."""
        self._busy = busy
        self._settle()

    def _chosen(self) -> AnalysisTask | None:
        rows = self.table.selectionModel().selectedRows()
        return self._entries[rows[0].row()].task if rows else None

    def _settle(self) -> None:
        chosen = self._chosen() is not None
        self.fill.setEnabled(chosen)
        self.run.setEnabled(chosen and not self._busy)

    def _again(self) -> None:
        if (task := self._chosen()) is not None and not self._busy:
            self.again.emit(task)

    def _fill(self) -> None:
        if (task := self._chosen()) is not None:
            self.wanted.emit(task)


def _texts(entry: HistoryEntry) -> tuple[str, str, str, str, str]:
    task = entry.task
    when = entry.time.astimezone().strftime("%Y-%m-%d %H:%M:%S")
    names = ", ".join(engine_label(clean(name)) for name in task.engines)
    what = _("{count} compared").format(count=len(task.engines)) if task.kind == "compare" else names
    first = clean(task.tests[0].label or str(task.tests[0].path)) if task.tests else _("none")
    tests = first if len(task.tests) < 2 else f"{len(task.tests)}: {first} …"
    return when, what, tests, clean(translated(entry.headline)), names if task.kind == "compare" else _changed(task)


def _changed(task: AnalysisTask) -> str:
    """Return the settings that differ from the defaults; all of them if the engine is not installed."""
    name = task.engines[0]
    options = changed_options(name, task.options) | task.preparation.changed
    parts = [plain_text(options)] if options else []
    if (task.input_name, task.output_name) != ("force", "position"):
        parts.append(_("{input} to {output}").format(input=clean(task.input_name), output=clean(task.output_name)))
    if task.together:
        parts.append(_("tests of a file together"))
    return "; ".join(parts) or _("default options")


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
_LONGEST_TICK = 16


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
        fits = self.shown
        if fits is None or not fits.outcomes:
            return None
        names = [f"{name}: {mean}" if name else mean for name, mean in zip(fits.groups, _overall(fits), strict=True)]
        title = f"{self.parameter.currentText()} {self.across.currentText()}"
        across, spread = str(self.across.currentData()), str(self.spread.currentData())
        plot = population_plot(fits, across, spread, [getattr(LIGHT, role) for role in SERIES], names)
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
        offer(self.across, {key: _(title) for key, title in ACROSS.items()} | names)
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
        fits = population(self._wanted_fits(), parameter, across, str(self.group.currentData()), len(SERIES))
        self.shown = fits
        if fits.outcomes:
            spread = str(self.spread.currentData())
            plot = population_plot(fits, across, spread, SERIES, [""] * len(SERIES))
            note = _("Click on a point: its test is named below. A double click selects it in the table")
            self.card.show_plots([replace(self._with_room(plot, fits), note=note)], key=False)
        else:
            self.card.say_missing(_("No fit has this parameter."))
        self._say(fits)

    def _wanted_fits(self) -> list[EngineOutcome]:
        """Return the fits of the selected engine and options."""
        wanted = self.engine.currentData()
        return [outcome for outcome in self._outcomes if not wanted or variant_of(outcome) == wanted]

    def _with_room(self, plot: Plot, fits: Population) -> Plot:
        """Return the plot with as many names of categories as stand side by side."""
        if not fits.places:
            return plot
        width = max(len(name[:_LONGEST_TICK]) for name in fits.places) * _TICK_PX
        step = max(1, math.ceil(width * len(fits.places) / max(200, self.card.width() - 80)))
        ticks = tuple((position, Verbatim(name[:_LONGEST_TICK])) for position, name in plot.x.ticks[::step])
        return replace(plot, x=replace(plot.x, ticks=ticks))

    def _say(self, fits: Population) -> None:
        total = len(self._wanted_fits())
        text = plural("{drawn} of {count} fit drawn", "{drawn} of {count} fits drawn", total).format(
            drawn=grouped(len(fits.outcomes)), count=grouped(total)
        )
        of_tests = plural("of {count} test", "of {count} tests", fits.tests).format(count=grouped(fits.tests))
        reasons = [f"{grouped(count)} {why}" for why, count in fits.left_out.items()]
        variants = list(dict.fromkeys(variant_of(outcome) for outcome in fits.outcomes))
        self.count.setText("; ".join([f"{text} {of_tests}", *reasons, *variants]))
        theme = appearance.theme
        overall = _overall(fits)
        entries = []
        for index, name in enumerate(fits.groups[:_MOST_NAMED]):
            text = f"{name}: {overall[index]}" if name else overall[index]
            square = f'<span style="color:{getattr(theme, SERIES[index])}">■</span>&nbsp;'
            entries.append(f"<nobr>{square}{html.escape(text)}</nobr>")
        self.key.setText(" &nbsp; ".join(entries))

    # -- pointing --------------------------------------------------------------------------------------------

    def _clicked(self, at: Point, double: bool) -> bool:
        outcomes = self._at(at)
        if outcomes:
            self.name(outcomes)
            if double:
                self.wanted.emit(outcomes)
        return bool(outcomes)

    def _at(self, at: Point) -> list[EngineOutcome]:
        """Return the fit at a place on the canvas, or all fits of a bar of the histogram."""
        fits = self.shown
        if fits is None or not fits.outcomes:
            return []
        if self.across.currentData() == DISTRIBUTION:
            edges, (x, y) = fits.edges, self.card.values(at)
            if not edges[0] <= x <= edges[-1] or y < 0.0:
                return []
            bins = np.clip(np.searchsorted(edges, fits.y, "right") - 1, 0, edges.size - 2)
            bin_there = min(int(np.searchsorted(edges, x, "right")) - 1, edges.size - 2)
            return [fits.outcomes[index] for index in np.flatnonzero(bins == bin_there)]
        away = np.hypot(*(self.card.pixels(fits.x, fits.y) - at).T)
        nearest = int(np.argmin(away))
        return [fits.outcomes[nearest]] if away[nearest] <= _REACH_PX else []

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
        outcomes = self._at(at) if self.across.currentData() != DISTRIBUTION else []
        return self._words(outcomes[0]) if outcomes else ""


def _choice(name: str, entries: Mapping[str, str] = MappingProxyType({})) -> QComboBox:
    return choice({key: _(title) for key, title in entries.items()}, characters=_CHARACTERS, name=name, tip=name)


def _heading(parameter: str) -> str:
    """Return a parameter with its unit."""
    if parameter in SCORES:
        return _(SCORES[parameter])
    return axis_label(parameter, shown(display_unit(label_and_unit(parameter)[1])[0])[0])


def _overall(fits: Population) -> list[str]:
    """Mean ± standard deviation and number of fits of every group, over all places."""
    factor = shown(fits.unit)[1]
    means = []
    for index in range(len(fits.groups)):
        some = factor * fits.y[fits.group == index]
        std = float(np.std(some, ddof=1)) if some.size > 1 else None
        text = with_unit(plus_minus(Estimate(float(some.mean()), std)), shown(fits.unit)[0])
        means.append(_("{mean} (n = {count})").format(mean=text, count=grouped(some.size)))
    return means


def _figure(parameter: str, estimate: Estimate) -> str:
    if parameter in SCORES:
        return f"{fixed(estimate.value, 2)} %"
    unit, scale = shown_si(label_and_unit(parameter)[1])
    return with_unit(plus_minus(estimate, scale), unit)
