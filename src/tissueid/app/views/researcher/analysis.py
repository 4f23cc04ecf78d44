"""Panel of analyses: engine form, results, population, recommendation and history."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import (
    QWidget,
)

from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.jobs import JobControl
from tissueid.app.small_window import FoldingSplitter
from tissueid.app.views.researcher.batch import Batch, refit, run, run_folder
from tissueid.app.views.researcher.engine_form import EngineForm
from tissueid.app.views.researcher.engine_outcome import (
    MOST_RESULTS,
    MOST_TESTS,
    NAME,
    AnalysisHistory,
    AnalysisTask,
    EngineOutcome,
    Preparation,
    StoredResults,
    read_results,
    write_results,
)
from tissueid.app.views.researcher.outcome_tabs import HistoryList, PopulationView, RecommendationView
from tissueid.app.views.researcher.pictures import CalibrationButton, Pictures
from tissueid.app.views.researcher.results_table import SERIES, ResultsTable
from tissueid.app.views.researcher.save_dialog import SaveDialog
from tissueid.app.views.researcher.selected_test import SelectedTest
from tissueid.app.widgets import ElidedLabel, show_disabled_reason
from tissueid.app.words import in_words, sentence
from tissueid.errors import TissueIDError
from tissueid.language import _, plural
from tissueid.messages import Message, Verbatim, translated
from tissueid.plan_options import validation_reason
from tissueid.procedures.control import Control, RemainingTime

_LOOK_MS = 100
_TOLD = 3
STATE = "research/analysis"
_LONGEST_STATE = 100_000
_GRACE_S = 60.0
"""How long the fit at hand may take after a cancellation before the results so far are given up, s."""
_FORM_WIDTH = 232
_FORM_HEIGHT = 170
"""Height of the form above the results in a narrow window, pixels."""
_HEIGHTS = (104, 400)
"""Initial heights of the table and of the plots below it, pixels."""


class AnalysisPanel(QWidget):
    """Runs engines on tests; shows and stores the results."""

    def __init__(
        self, context: AppContext, parent: QWidget | None = None, *, history: AnalysisHistory | None = None
    ) -> None:
        super().__init__(parent)
        self.context = context
        self._history = history or AnalysisHistory()
        self._chosen: tuple[SelectedTest, ...] = ()
        self._work: JobControl | None = None
        self._remaining = RemainingTime()
        self._doing, self._shown_parts = "", 0
        self._busy = self._working = False
        self.form = EngineForm()
        self.run = build.button(_("R&un"), self._run, tip=_("Fit the engine to every chosen test"))
        self.compare = build.button(
            _("Com&pare engines"), self._compare, tip=_("Fit every engine to every chosen test, and recommend one")
        )
        self.folder = build.button(
            _("Run on folder…"),
            self._choose_folder,
            tip=_("Fit the engine to every stochastic test of every session below a folder"),
        )
        self.progress = build.ProgressRow(ElidedLabel(), _("Progress of the analysis"), "", self.cancel)
        self.step, self.bar, self.cancelling = self.progress.parts
        self.results = ResultsTable()
        self._before_removal: tuple[EngineOutcome, ...] = ()
        self._kept_in = self._history.path.with_name(NAME)
        self._read_kept = self._to_keep = False
        self.pictures = Pictures()
        self.save_table = build.button(
            _("Table…"), self._save_table, name=_("Save the table"), tip=_("Save the table of results as CSV")
        )
        self.save_figure = build.button(
            _("Figure…"),
            self._save_figure,
            name=_("Save the figure"),
            tip=_("Save the figure as PDF, SVG or PNG with 300 dpi"),
        )
        self.calibration = CalibrationButton(context, self.pictures)
        self.pictures.add_for_depth(self.calibration)
        self._saver = SaveDialog(context, self)
        self.refit = build.button(
            _("Refit"), self._refit, tip=_("Fit the drawn results again whose curves were not kept")
        )
        self.undo = build.button(
            _("Undo"),
            self._undo_removal,
            name=_("Bring back the results that were taken out"),
            tip=_("Bring back the results that were taken out (Ctrl+Z in the table)"),
        )
        self.clear = build.button(
            _("Clear"),
            lambda: self._remove(list(self.results.outcomes)),
            tip=_("Take all results out of the table (Delete: the selected ones)"),
        )
        self.population = PopulationView()
        self.verdicts = RecommendationView()
        self.past = HistoryList()
        self.fits = build.splitter((self.results, 1), (self.pictures, 3), sizes=_HEIGHTS, upright=True)
        self.tabs = build.tabs(
            _("Results, recommendation and history"),
            (self.fits, _("Results")),
            (self.population, _("Population")),
            (self.verdicts, _("Recommendation")),
            (self.past, _("History")),
        )
        self._arrange()
        self._looking = build.timer(self, _LOOK_MS, self._look, repeat=True)
        self._connect()
        self._read_history()
        self.restore_state(self.context.settings.value(STATE))
        self._rest()

    def _arrange(self) -> None:
        """Arrange the form on the left, and buttons, progress and results on the right."""
        self.form.setMinimumWidth(_FORM_WIDTH)
        top = build.row(self.run, self.compare, self.folder, None)
        below = build.row((self.step, 2), (self.bar, 1), self.cancelling, self.refit, self.undo)
        build.fill(self.pictures.tools, self.save_figure, self.save_table, self.clear, None, spacing=4)
        right = build.holder(build.column(top, below, (self.tabs, 1), margins=(6, 0, 0, 0)))
        sizes = _FORM_WIDTH, 4 * _FORM_WIDTH
        parts = build.splitter((self.form, 0), (right, 1), sizes=sizes, made=FoldingSplitter(_FORM_HEIGHT))
        build.column(parts, margins=(0, 6, 0, 0), parent=self)

    def show_tests(self, chosen: Sequence[SelectedTest]) -> None:
        """Select the tests for the next run."""
        self._chosen = tuple(chosen)[:MOST_TESTS]
        self._rest()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls."""
        self._busy = busy
        self._working = testing or busy or self.context.jobs.working
        self._rest()

    @property
    def waiting(self) -> tuple[QWidget, ...]:
        """The buttons that are disabled while other work runs."""
        saving = self.save_table, self.save_figure, self.population.save_figure
        return self.run, self.compare, self.folder, *saving

    def cancel(self) -> None:
        """Cancel the work after the current fit."""
        if self._work is not None:
            self._work.cancel()
            self.step.setText(_("Cancelling: what is being fitted is finished first."))
            self.cancelling.setEnabled(False)

    def go_on(self) -> bool:
        """Start reading the stored results once; return whether a job was started."""
        if self._read_kept:
            return False
        self._read_kept = True
        if not self._kept_in.exists():
            return False
        self.context.jobs.do(functools.partial(read_results, self._kept_in), self._restore, self._failed)
        return True

    def _restore(self, kept: StoredResults) -> None:
        """Show the stored results before the new ones."""
        there = {outcome.key: outcome for outcome in (*kept.outcomes, *self.results.outcomes)}
        self._show_results(list(there.values())[-MOST_RESULTS:])
        self._draw()
        if kept.bad:
            self.context.say(
                _("{count} results of the last start could not be read and are passed over.").format(count=kept.bad),
                problem=True,
            )

    def save_state(self) -> None:
        """Save engine, options, results and the selected tabs."""
        if self._to_keep and self._read_kept:
            try:
                write_results(self._kept_in, self.results.outcomes)
            except OSError as error:
                self.context.say(in_words(error), problem=True)
        state = {
            "engine": self.form.name,
            "options": self.form.all_options(),
            "signals": self.form.signals,
            "together": self.form.together.isChecked(),
            "preparation": self.form.preparation.value().model_dump(),
            "compared": self.verdicts.compared,
            "picture": self.pictures.choice.currentData(),
            "tab": self.tabs.currentIndex(),
        }
        self.context.settings.setValue(STATE, json.dumps(state))

    def restore_state(self, saved: object) -> None:
        """Restore the saved state; invalid content is ignored."""
        form, picture = self.form, self.pictures.choice
        try:
            state = json.loads(saved) if isinstance(saved, str) and len(saved) <= _LONGEST_STATE else {}
            form.restore(dict(state.get("options", {})))
            form.choose(str(state.get("engine", form.name)))
            into, out = map(str, state.get("signals", form.signals))
            form.take_signals(into, out, state.get("together") is True)
            form.preparation.set_value(Preparation.model_validate(state.get("preparation", {})))
            self.verdicts.take_compared([str(name) for name in state.get("compared", ())])
            picture.setCurrentIndex(max(0, picture.findData(str(state.get("picture", "")))))
            self.tabs.setCurrentIndex(int(state.get("tab", 0)))
        except (TissueIDError, ValueError, TypeError, AttributeError, RecursionError):
            form.restore({})

    # -- running ------------------------------------------------------------------------------------------

    def start(self, task: AnalysisTask, folder: Path | None = None) -> None:
        """Start a task, on all sessions in ``folder`` if given."""
        moment = datetime.now(UTC).isoformat(timespec="milliseconds")
        wanted = task, self._history, moment
        work = functools.partial(run, *wanted) if folder is None else functools.partial(run_folder, folder, *wanted)
        self._begin(work, _("Comparing") if task.kind == "compare" else _("Fitting"), self._done)

    def _begin(self, work: Callable[[Control], Batch], doing: str, done: Callable[[Batch], None]) -> None:
        if self.context.no_work:
            return
        control = JobControl()
        self._work, self._doing, self._shown_parts = control, doing, 0
        self._remaining = RemainingTime()
        self.cancelling.setEnabled(True)
        self._look()
        self._looking.start()
        why = _("An analysis is running on Research: cancel it there, or wait.")
        self.context.do_work(work, control, done, self._failed, why=why, grace_s=_GRACE_S)

    def _task(self, **changes: Any) -> AnalysisTask | None:
        """Return the task of the form; show the error and return None if it is invalid."""
        into, out = self.form.signals
        try:
            asked = {
                "engines": (self.form.name,),
                "options": self.form.options() if "engines" not in changes else {},
                "input_name": into,
                "output_name": out,
                "together": self.form.together.isChecked(),
                "preparation": self.form.preparation.value(),
                "tests": tuple(self._chosen),
            }
            return AnalysisTask.model_validate(asked | changes)
        except ValidationError as error:
            self.context.say(sentence(translated(validation_reason(error))), problem=True)
        except TissueIDError as error:
            self.context.say(in_words(error), problem=True)
        return None

    def _run(self) -> None:
        if self._chosen and (task := self._task()) is not None:
            self.start(task)

    def _compare(self) -> None:
        engines = self.verdicts.compared
        if not engines:
            self.context.say(_("Choose at least one engine to compare."), problem=True)
        elif self._chosen and (task := self._task(kind="compare", engines=engines)) is not None:
            self.start(task)

    def _choose_folder(self) -> None:
        if self._task(tests=()) is None:
            return
        title = _("Run on the sessions below a folder")
        build.ask_path(self, title, self.context.services.folder, self._run_folder)

    def _run_folder(self, folder: Path) -> None:
        if (task := self._task(tests=())) is not None:
            self.start(task, folder)

    def _look(self) -> None:
        """Show progress, and the fits that are ready: not during a measurement, which new plots would disturb."""
        ready = [] if self._work is None or self.context.state.testing else self._work.parts[self._shown_parts :]
        if ready:
            self._shown_parts += len(ready)
            self._keep([outcome for part in ready for outcome in part])
        if self._work is not None and not self._work.cancelled():
            step, share = self._work.step, self._work.fraction or 0.0
            doing = Verbatim(f"{self._doing} {step}" if step else self._doing)
            said = self._remaining.added_to(Message("research.step", "{step}", step=doing), share)
            self.progress.show_progress(share, translated(said))

    def _done(self, batch: Batch) -> None:
        self._end()
        if batch.entry is not None:
            self.past.add(batch.entry)
        self._keep(batch.outcomes)
        self.verdicts.add(batch.verdicts)
        if batch.verdicts or self.tabs.currentWidget() is not self.population:
            self.tabs.setCurrentWidget(self.verdicts if batch.verdicts else self.fits)
        if batch.problems:
            more = len(batch.problems) - _TOLD
            shown = [*batch.problems[:_TOLD], *([_("And {count} more.").format(count=more)] if more > 0 else [])]
            self.context.say(" ".join(shown), problem=True)
        elif batch.cancelled:
            self.context.say(_("Cancelled; what was done by then is shown."))

    def _failed(self, message: str) -> None:
        self._end()
        self.context.say(message, problem=True)

    def _end(self) -> None:
        self._looking.stop()
        self._work = None
        self.progress.clear()
        self._rest()

    def _keep(self, new: Sequence[EngineOutcome]) -> None:
        """Add results; a result of the same engine, options and tests replaces the old one."""
        self._to_keep = True
        kept = {outcome.key: outcome for outcome in self.results.outcomes}
        fresh = {outcome.key: outcome for outcome in new}
        self._show_results(list((kept | fresh).values())[-MOST_RESULTS:])
        if len(self.results.outcomes) > len(SERIES):
            self.results.select(list(fresh.values())[: len(SERIES)])
        self.results.bring_up(list(fresh.values()))
        self._draw()

    def _show_results(self, outcomes: Sequence[EngineOutcome]) -> None:
        self.results.show_outcomes(outcomes)
        self.population.show_outcomes(self.results.outcomes)

    def _draw(self) -> None:
        fitted = sum(outcome.report is not None for outcome in self.results.outcomes)
        self.results.colour(self.pictures.show_outcomes(self.results.chosen, fitted))
        self._enable()

    def _remove(self, some: list[EngineOutcome]) -> None:
        self._to_keep = True
        self._before_removal = tuple(self.results.outcomes)
        gone = {id(outcome) for outcome in some}
        self._show_results([outcome for outcome in self.results.outcomes if id(outcome) not in gone])
        self._draw()

    def _undo_removal(self) -> None:
        """Restore the results that were removed last."""
        before, self._before_removal = self._before_removal, ()
        self._to_keep = True
        if before:
            there = {outcome.key: outcome for outcome in (*before, *self.results.outcomes)}
            self._show_results(list(there.values())[-MOST_RESULTS:])
            self._draw()

    @property
    def _without_curves(self) -> list[EngineOutcome]:
        return [outcome for outcome in self.pictures.outcomes if outcome.without_curves]

    def _refit(self) -> None:
        """Refit the drawn results that have no curves."""
        wanted = self._without_curves
        if wanted:
            self._begin(functools.partial(refit, wanted), _("Fitting"), self._refitted)

    def _refitted(self, batch: Batch) -> None:
        chosen = {outcome.key for outcome in self.results.chosen[: len(SERIES)]}
        self._done(batch)
        self.results.select([outcome for outcome in self.results.outcomes if outcome.key in chosen])
        self._draw()

    def _show_in_table(self, outcomes: list[EngineOutcome]) -> None:
        """Select fits in the table and draw them."""
        self.results.select(outcomes)
        self.tabs.setCurrentWidget(self.fits)
        self._draw()

    # -- history and state --------------------------------------------------------------------------------

    def _read_history(self) -> None:
        try:
            self.past.show_entries(*self._history.read())
        except OSError as error:
            self.past.remark.setText(_("The history cannot be read: {problem}").format(problem=in_words(error)))

    def _take_task(self, task: AnalysisTask) -> None:
        """Put the settings of an earlier run into the form; the selected tests stay."""
        try:
            if task.kind == "compare":
                self.verdicts.take_compared(task.engines)
                self.tabs.setCurrentWidget(self.verdicts)
            else:
                self.form.choose(task.engines[0], task.options)
        except TissueIDError as error:
            self.context.say(in_words(error), problem=True)
            return
        self.form.take_signals(task.input_name, task.output_name, task.together)
        self.form.preparation.set_value(task.preparation)
        self.context.say(_("The settings of that run are in the form; the chosen tests are as they were."))

    def _save_table(self) -> None:
        self._saver.save_table(self.results.rows())

    def _save_recommendation(self) -> None:
        self._saver.save_table(self.verdicts.rows(), _("Save the recommendation"), _("recommendation"))

    def _save_figure(self) -> None:
        if (figure := self.pictures.figure) is not None:
            self._saver.save_figure(figure)

    def _save_population(self) -> None:
        if (figure := self.population.figure) is not None:
            self._saver.save_figure(figure)

    # -- how it stands ------------------------------------------------------------------------------------

    def _rest(self) -> None:
        """Show the number of selected tests if no work runs."""
        if self._work is None:
            count = len(self._chosen)
            chosen = plural("{count} test chosen.", "{count} tests chosen.", count).format(count=count)
            idle = chosen if count else _("No test is chosen.")
            self.progress.show_reason(self.context.jobs.why_no_work if self.context.jobs.working else idle)
        self._enable()

    def _enable(self) -> None:
        free = not self._working
        there, save = bool(self.results.outcomes), bool(self.results.outcomes) and not self._busy
        if self._busy and (self.save_table.hasFocus() or self.save_figure.hasFocus()):
            self.results.setFocus()  # by itself the focus would go on to Clear, and Space would press that
        enabled = {
            self.run: free and bool(self._chosen),
            self.compare: free and bool(self._chosen),
            self.folder: free,
            self.save_table: save,
            self.save_figure: save,
            self.verdicts.save: not self._busy,
            self.population.save_figure: save,
            self.clear: there and self._work is None,
            self.undo: self._work is None,
            self.refit: free,
        }
        for button, usable in enabled.items():
            button.setEnabled(usable)
        self.undo.setVisible(bool(self._before_removal))
        self.refit.setVisible(bool(self._without_curves))
        self.past.update_enabled(busy=not free)
        show_disabled_reason(self.waiting, self.context.jobs.why_no_work)

    def _connect(self) -> None:
        self.results.chosen_changed.connect(self._draw)
        self.results.removed.connect(self._remove)
        self.population.wanted.connect(self._show_in_table)
        keys, of_table = QKeySequence.StandardKey.Undo, Qt.ShortcutContext.WidgetShortcut
        build.shortcut(self.results, keys, self._undo_removal, of_table)
        self.population.save_figure.clicked.connect(self._save_population)
        self.verdicts.save.clicked.connect(self._save_recommendation)
        self.past.again.connect(self.start)
        self.past.wanted.connect(self._take_task)
