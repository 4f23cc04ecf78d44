"""The page ``studies``: the table of a study, its analysis, figures and report, and the way to a subject's sitting."""

from __future__ import annotations

import functools
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QAbstractButton, QComboBox, QWidget

from tissueid.app.build import (
    button,
    choice,
    column,
    label,
    offer,
    restore_tab,
    row,
    show_text,
    single_tab_stop,
    tabs,
    timer,
)
from tissueid.app.context import AppContext, View
from tissueid.app.jobs import JobControl
from tissueid.app.plot_canvas import PlotCanvas
from tissueid.app.views.studies.request_row import ProtocolDialog, RequestRow
from tissueid.app.views.studies.study_data import (
    StudyData,
    StudyFigures,
    analyse_study,
    compute_figures,
    load_study,
    report_and_load,
)
from tissueid.app.views.studies.tests_tab import TestsTab
from tissueid.app.words import in_words
from tissueid.atomic_write import private_folder
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import StudyReportPlan
from tissueid.procedures.study_protocol import Protocol, template
from tissueid.procedures.study_sitting import save_protocol

_MOST_REMARKS = 6


class FiguresTab(QWidget):
    """One figure at a time, chosen by kind and parameter. ``wanted`` asks for the figures."""

    wanted = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.figures = StudyFigures()
        self.canvas = PlotCanvas(_("Figure of the study"))
        self.compute = button(_("Compute figures"), self.wanted, tip=_("Statistics and figures of the table as it is"))
        saving = _("Save the figure as PNG, SVG or PDF, or its numbers as CSV")
        self.save = button(_("Save figure…"), self.canvas.ask_where_to_save, tip=saving)
        self.kind = choice({}, self._choose_kind, 10, name=_("Kind of the figure"))
        self.parameter = choice({}, self._draw, 10, name=_("Parameter of the figure"))
        self.remarks = label("muted")
        top = row((self.kind, 1), (self.parameter, 1), self.save, self.compute)
        column(top, (self.canvas, 1), self.remarks, margins=(0, 8, 0, 0), parent=self)
        self.show_figures(None, analysed=False)

    @property
    def fields(self) -> list[QWidget]:
        """Widgets in tab order."""
        return [self.kind, self.parameter, self.save, self.compute]

    def show_figures(self, figures: StudyFigures | None, *, analysed: bool) -> None:
        """Offer the figures of a study; the chosen kind and parameter stay if they are there."""
        self.figures = figures or StudyFigures()
        _fill(self.kind, [heading for heading, _figures in self.figures.groups])
        shown, more = list(self.figures.remarks[:_MOST_REMARKS]), len(self.figures.remarks) - _MOST_REMARKS
        shown += [_("and {count} more: see the report").format(count=more)] * (more > 0)
        show_text(self.remarks, "\n".join(shown))
        self._choose_kind()
        if figures is None:
            self.canvas.say_missing(
                _("Press “Compute figures” to draw the figures of this table.")
                if analysed
                else _("Press “Analyse” first: the figures are drawn from its table.")
            )

    def update_enabled(self, *, busy: bool, has_table: bool) -> None:
        """Enable what makes sense now."""
        self.compute.setEnabled(has_table and not busy)

    def _choose_kind(self) -> None:
        index = self.kind.currentIndex()
        figures = self.figures.groups[index][1] if index >= 0 else ()
        _fill(self.parameter, [label for label, _plot in figures])
        self.save.setEnabled(bool(figures))
        self._draw()

    def _draw(self) -> None:
        index = self.kind.currentIndex()
        if index < 0:
            self.canvas.say_missing(_("The table has no parameter that can be drawn."))
        else:
            self.canvas.show_plots([self.figures.groups[index][1][self.parameter.currentIndex()][1]])


def _fill(box: QComboBox, texts: list[str]) -> None:
    """Offer texts; the chosen one stays if it is there."""
    offer(box, {text: text for text in texts})
    box.setEnabled(len(texts) > 1)


_WELCOME = marked(
    "A study is a folder with the sessions of several subjects.\n\n"
    "1. “New study…”: name its folder. “Open study…”: choose one with sessions.\n"
    "2. “New protocol…”: which sites, how many tests at each, with which products, and what a subject is asked for.\n"
    "3. “Measure subject”: type a pseudonym such as P01; the page Measure leads through the visit.\n"
    "4. “Analyse” and “Write report”: a table of all tests, statistics and figures."
)
_TAB = "study/tab"
_LOOK_MS = 100
"""Interval at which the progress is shown, ms."""
_CANCELLED = Message("study.cancelled", "Cancelled. What is analysed is kept, and Analyse continues.")


class StudiesView(View):
    """The page ``studies``. Analysis, statistics and report run in separate processes and can be cancelled."""

    name = "studies"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self.data: StudyData | None = None
        self._control = JobControl()
        self._running = self._changed = False
        self.asking = RequestRow()
        self.tests = TestsTab()
        self.figures = FiguresTab()
        self.tabs = tabs(_("Tests and figures"), (self.tests, _("Tests")), (self.figures, _("Figures")))
        single_tab_stop(self.tabs)
        self.welcome = label("muted", text=_(_WELCOME), alignment=Qt.AlignmentFlag.AlignTop)
        column(self.asking, (self.welcome, 1), (self.tabs, 1), spacing=8, margins=(12, 10, 12, 6), parent=self)
        self.tabs.hide()
        order = [*self.asking.fields, self.tabs.tabBar(), *self.tests.fields, *self.figures.fields]
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)
        self._looking = timer(self, _LOOK_MS, self._show_progress, repeat=True)
        # Not from within a job's end: the other pages must have settled first.
        self.refresh_timer = timer(self, 0, self._read_again)
        self.asking.chosen.connect(self.open_study)
        self.asking.made.connect(self.make_study)
        self.asking.wanted.connect(self.analyse)
        self.asking.report_wanted.connect(self.write_report)
        self.asking.protocol_wanted.connect(self.edit_protocol)
        self.asking.sitting_wanted.connect(self.begin_sitting)
        self.asking.unwanted.connect(self.cancel)
        self.figures.wanted.connect(self.compute_figures)
        self._last = self.asking.restore(context.settings)
        restore_tab(self.tabs, context.settings.value(_TAB))

    # -- what the window tells ------------------------------------------------------------------------------------

    def enter(self) -> None:
        """Open the study of the last start, or read a table again after tests were recorded."""
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls."""
        self.asking.update_enabled(busy=busy or testing, working=self.context.no_work)
        self.asking.progress.show_reason(self.context.jobs.why_no_work if self.context.jobs.working else "")
        has_table = self.data is not None and self.data.tests > 0
        self.figures.update_enabled(busy=self.context.no_work, has_table=has_table)
        if not busy:
            self.refresh_timer.start()

    def waiting(self) -> tuple[QWidget, ...]:
        """The buttons that are disabled while other work runs."""
        return *self.asking.waiting, self.figures.compute

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return *self.asking.waiting, self.asking.stop, self.figures.compute

    def on_session_saved(self, path: Path) -> None:
        """Read the study again when it is shown the next time, if the session belongs to it."""
        self._changed = self._changed or (self.data is not None and self.data.folder in path.parents)

    def offer_files(self, paths: list[Path]) -> bool:
        """Open a folder that was dropped on this page."""
        if len(paths) == 1 and paths[0].is_dir():
            self.open_study(paths[0])
            return True
        return False

    def cancel(self) -> None:
        """Cancel the running work; what is analysed is kept."""
        self._control.cancel()

    def save_state(self) -> None:
        """Save folder, engine and options."""
        self.asking.save(self.context.settings)
        self.context.settings.setValue(_TAB, self.tabs.currentIndex())

    # -- what a person asks for -------------------------------------------------------------------------------------

    def open_study(self, folder: Path) -> None:
        """Read the table of a study and show it."""
        if not self.context.busy:
            self.context.jobs.do(functools.partial(load_study, folder), self._opened, self._failed)

    def make_study(self, folder: Path) -> None:
        """Make the folder of a study, unless it is there, and show it."""
        if not self.context.busy:
            self.context.jobs.do(functools.partial(_made, folder), self._opened, self._failed)

    def analyse(self) -> None:
        """Analyse the sessions that are new or changed."""
        if self.data is not None and (plan := self._plan(self.data.folder)) is not None:
            self._start(functools.partial(analyse_study, plan), self._analysed)

    def write_report(self) -> None:
        """Write the report and open it."""
        if self.data is not None and (plan := self._plan(self.data.folder)) is not None:
            report = StudyReportPlan(**plan.model_dump())
            self._start(functools.partial(report_and_load, report), self._reported)

    def compute_figures(self) -> None:
        """Compute the statistics of the table and offer their figures."""
        if self.data is not None:
            self._start(functools.partial(compute_figures, self.data.folder), self._computed)

    def edit_protocol(self) -> None:
        """Show the protocol, or a proposal for a study without one, to be changed and saved."""
        if self.data is not None:
            dialog = ProtocolDialog(self.data.protocol or template(), self)
            dialog.saved.connect(self.save_protocol)
            dialog.open()

    def save_protocol(self, protocol: Protocol) -> None:
        """Write the protocol of the study."""
        if self.data is not None and not self.context.busy:
            work = functools.partial(_with_protocol, self.data.folder, protocol)
            self.context.jobs.do(work, self._opened, self._failed)

    def begin_sitting(self, subject: str) -> None:
        """Lead through the sitting of a subject on the page Measure."""
        if self.data is not None:
            self.asking.subject.selectAll()  # the next one is typed over it
            self.context.begin_sitting(self.data.folder, subject)

    # -- jobs -----------------------------------------------------------------------------------------------------

    def _plan(self, folder: Path) -> Any:
        try:
            return self.asking.plan(folder, workers=None if self.context.services.separate_process else 1)
        except UnusableInputError as error:
            self.context.say(in_words(error), problem=True)
            return None

    def _start(self, work: Callable[[Control], Any], done: Callable[[Any], None]) -> None:
        if self.context.no_work:
            return
        self._control = JobControl()
        self._running, self._done = True, done
        self._looking.start()
        self._show_progress()
        why = _("A study is being analysed on Studies: cancel it there, or wait.")
        self.context.do_work(functools.partial(_outcome, work), self._control, self._ended, self._broke, why=why)

    def _show_progress(self) -> None:
        if self._running:
            step = translated(self._control.step or _("Starting"))
            self.asking.progress.show_progress(self._control.fraction, step)

    def _over(self) -> None:
        self._running = False
        self._looking.stop()
        self.asking.progress.clear()

    def _ended(self, result: Any) -> None:
        self._over()
        if result is None:
            self.context.say(translated(_CANCELLED))
            self._changed = True
        else:
            self._done(result)

    def _broke(self, message: str) -> None:
        self._over()
        self._failed(message)
        self._changed = True  # a run without a usable session leaves the reason of each

    def _failed(self, message: str) -> None:
        self.context.say_failed(message)

    def _opened(self, data: StudyData) -> None:
        other = self.data is None or self.data.folder != data.folder
        self.data, self._changed = data, False
        self.welcome.hide()
        self.tabs.show()
        self.asking.show_study(data)
        self.tests.show_study(data)
        self.figures.show_figures(data.figures, analysed=data.tests > 0)
        if other and data.protocol_problem:
            self.context.say(translated(data.protocol_problem), problem=True)

    def _analysed(self, data: StudyData) -> None:
        self._opened(data)
        if not data.without_row:
            self.context.say(_("The study is analysed."))
            return
        said = Message(
            "study.analysed",
            "The study is analysed. Sessions without a test in the table: {count}; the first rows say why.",
            count=data.without_row,
        )
        self.context.say(translated(said), problem=True)

    def _reported(self, report: tuple[Path, StudyData]) -> None:
        page, data = report
        self._analysed(data)
        self.context.show_file(page)

    def _computed(self, figures: StudyFigures) -> None:
        self.figures.show_figures(figures, analysed=True)
        self.tabs.setCurrentWidget(self.figures)

    def _read_again(self) -> None:
        if not self.isVisible():
            return
        wanted = self._last if self.data is None else self.data.folder if self._changed else None
        if wanted is not None and self.context.busy:
            self.asking.doing.setText(self.context.unread)
        elif wanted is not None:
            self._last, self._changed = None, False
            self.open_study(wanted)


def _outcome(work: Callable[[Control], Any], control: Control) -> Any:
    """Return the result of work, None where it was cancelled."""
    try:
        return work(control)
    except CancelledError:
        return None


def _made(folder: Path) -> StudyData:
    private_folder(folder)
    return load_study(folder)


def _with_protocol(folder: Path, protocol: Protocol) -> StudyData:
    save_protocol(folder, protocol)
    return load_study(folder)
