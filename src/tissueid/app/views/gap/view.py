"""The page ``gap``: where simulated and recorded differ, which effect causes it, and how far that closes it."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QAbstractButton,
    QFileDialog,
    QHBoxLayout,
    QSizePolicy,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from tissueid.app.theme import Theme
from tissueid.app.views.gap.asking import Asking
from tissueid.app.views.gap.choosing import EffectChoice
from tissueid.app.views.gap.diagnosing import Result, run
from tissueid.app.views.gap.history import History
from tissueid.app.views.gap.keeping import (
    accept_into_twin,
    export_json,
    proposed_twin,
    report_beside,
    why_not_accepted,
)
from tissueid.app.views.gap.labels import plain_label
from tissueid.app.views.gap.proposal import prepared_words, session_url
from tissueid.app.views.gap.result_page import ResultPage
from tissueid.app.views.view import Desk, View
from tissueid.app.waiting import tell_why
from tissueid.app.words import in_words
from tissueid.errors import UnusableInputError
from tissueid.language import _, marked

_WELCOME = marked(
    "A simulation of the same test never equals the recording. Choose a session and run: this page says whether the "
    "difference is more than noise, in which stage of the signal chain it arises, which effect that the simulation "
    "leaves out causes it, and how much of it goes away once that effect is added."
)
_CANCELLED = marked("The diagnosis was cancelled.")
_TAB = "gap/tab"


class GapView(View):
    """The page ``gap``. A diagnosis runs in processes of its own and can be cancelled at any moment."""

    name = "gap"
    stepped = Signal(str, int, int)
    """Where the diagnosis stands; sent from its thread."""

    def __init__(self, desk: Desk, parent: QWidget | None = None) -> None:
        super().__init__(desk, parent)
        self._written: tuple[Result, Path] | None = None
        self._cancelled = threading.Event()
        self._running = False
        self._busy = self._testing = False
        self.asking = Asking(desk.around.folder)
        self.history = History()
        self.result = ResultPage()
        self.welcome = plain_label("muted")
        self.welcome.setText(_(_WELCOME))
        self.welcome.setAlignment(Qt.AlignmentFlag.AlignTop)
        self._stack = QStackedWidget()
        self._stack.addWidget(self.welcome)
        self._stack.addWidget(self.result)
        self._stack.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._arrange()
        self._connect()
        self.asking.restore(desk.settings)
        self.result.tabs.setCurrentIndex(_whole_number(desk.settings.value(_TAB, 0)))
        self._show_chosen()

    # -- what the window tells ------------------------------------------------------------------------------------

    def enter(self) -> None:
        """The page is about to be shown: look which files there are now."""
        self.asking.look()

    def heard_of(self, path: Path) -> None:
        """A session was recorded: it can be chosen."""
        self.asking.look()

    def settle(self, *, busy: bool, testing: bool) -> None:
        """Enable what makes sense now."""
        self._busy, self._testing = busy, testing
        self.asking.settle(busy=busy, testing=testing)
        self.result.settle(busy=busy, testing=testing)

    def waiting(self) -> tuple[QWidget, ...]:
        """Run, and what keeps a result."""
        return self.asking.run, self.result.accept, self.result.report, self.result.export

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.asking.run, self.asking.stop, self.result.accept, self.result.report, self.result.export

    def paint_with(self, theme: Theme) -> None:
        """Take on the colours of a theme."""
        self.result.paint_with(theme)

    def cancel(self) -> None:
        """End a diagnosis that runs: the window closes."""
        self._cancelled.set()

    def save_state(self) -> None:
        """Keep what is chosen; diagnoses are not kept."""
        self.asking.save(self.desk.settings)
        self.desk.settings.setValue(_TAB, self.result.tabs.currentIndex())

    # -- a diagnosis ----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Diagnose what is chosen."""
        if self.desk.busy or self._testing or self.asking.session.path is None:
            return
        try:
            asked = self.asking.asked()
        except UnusableInputError as error:
            self.desk.say(in_words(error), problem=True)
            return
        self._cancelled, self._running = threading.Event(), True
        self.asking.begin()
        work = functools.partial(run, asked, self.stepped.emit, self._cancelled.is_set, apart=self.desk.around.apart)
        why = _("A diagnosis is running on Gap: cancel it there, or wait.")
        self.desk.jobs.do(work, self._ended, self._failed, why=why)
        self.asking.stop.setFocus()

    def stop(self) -> None:
        """Cancel the diagnosis that runs."""
        if self._running:
            self._cancelled.set()
            self.asking.stop.setEnabled(False)
            self.asking.tell(_("Cancelling"), 0, 0)

    def _step(self, what: str, done: int, total: int) -> None:
        if self._running and not self._cancelled.is_set():
            self.asking.tell(what, done, total)

    def _ended(self, result: Result | None) -> None:
        waited = self._rest()
        if result is None:
            self.desk.say(_(_CANCELLED))
            return
        self.history.add(result)
        if waited:
            self.result.chain.chosen_box.setFocus()

    def _failed(self, words: str) -> None:
        self._rest()
        self.desk.say(words, problem=True)

    def _rest(self) -> bool:
        # Whether somebody waited here for the end, and the focus would be lost with the button that goes.
        waited = self.asking.stop.hasFocus() or self.asking.stop.isHidden()
        self._running = False
        self.asking.session.choice.setFocus() if waited else None
        self.asking.rest()
        return waited

    def _show_chosen(self) -> None:
        result = self.history.result
        self._stack.setCurrentWidget(self.welcome if result is None else self.result)
        if result is not None:
            self.result.show_story(result.story)
        self.changed.emit()

    # -- what is kept of it ---------------------------------------------------------------------------------------

    def _ask_for_twin(self) -> None:
        result = self.history.result
        if result is None:
            return
        if why := why_not_accepted(result):
            self.desk.say(why, problem=True)
            return
        offered = result.story.offered
        if len(offered) < 2:
            self._ask_for_file([name for name, _title, _named in offered])
            return
        dialog = EffectChoice(offered, self)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.chosen.connect(self._ask_for_file)
        dialog.open()

    def _ask_for_file(self, effects: list[str]) -> None:
        result = self.history.result
        if result is not None:
            path = proposed_twin(result, effects)
            accept = functools.partial(self._accept, effects)
            self._ask(_("Save the twin"), path, _("Twins (*.toml)"), "toml", accept)

    def _ask_for_json(self) -> None:
        result = self.history.result
        if result is not None:
            session = result.asked.session
            path = session.with_name(f"{session.stem}-gap.json")
            self._ask(_("Save the answer"), path, "JSON (*.json)", "json", self._export)

    def _ask(self, title: str, path: Path, kinds: str, suffix: str, then: Callable[[str], None]) -> None:
        dialog = QFileDialog(self, title, str(path.parent), kinds)
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setDefaultSuffix(suffix)
        dialog.selectFile(path.name)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(then)
        dialog.open()

    def _accept(self, effects: list[str], path: str) -> None:
        trail, apart = self.desk.trail, self.desk.around.apart
        self._keep(
            lambda result: accept_into_twin(result, Path(path), trail, effects, apart=apart),
            self._accepted,
        )

    def _export(self, path: str) -> None:
        self._keep(lambda result: export_json(result, Path(path)), self._exported)

    def _report(self) -> None:
        result, written = self.history.result, self._written
        if written is not None and written[0] is result and written[1].exists():
            self.desk.show_file(written[1])  # of what is shown it is there already
        else:
            self._keep(lambda result: (result, report_beside(result)), self._reported)

    def _reported(self, written: tuple[Result, Path]) -> None:
        self._written = written
        self.desk.show_file(written[1])

    def _keep(self, work: Callable[[Result], object], then: Callable[..., None]) -> None:
        result = self.history.result
        if result is not None and not self.desk.busy:
            self.desk.jobs.do(functools.partial(work, result), then, self._not_kept)

    def _accepted(self, words: str) -> None:
        self.asking.look()
        self.desk.say(words)

    def _exported(self, path: Path) -> None:
        self.desk.say(_("The answer is saved in {path}.").format(path=path))

    def _not_kept(self, words: str) -> None:
        self.desk.say(words, problem=True)

    # -- what to measure next -------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        result = self.history.result
        step = None if result is None else result.story.proposal
        if result is None or step is None or step.fields is None or self._testing:
            return
        fields = dict(step.fields)
        device = result.diagnosis.observed.instrument
        folders = [self.desk.around.folder, result.asked.session.parent]
        url = session_url(device, result.asked.twin, folders)
        if url:
            fields["url"] = url
        self.desk.prepare_test(fields, prepared_words(step, device, url))

    # -- files that are dropped -----------------------------------------------------------------------------------

    def offer_files(self, paths: list[Path]) -> bool:
        """Choose a session or a twin that was dropped here."""
        if len(paths) != 1 or not paths[0].is_file() or paths[0].suffix.lower() not in (".h5", ".toml"):
            return False
        self.asking.take(paths[0])
        return True

    # -- building -------------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        right = QVBoxLayout()
        right.setSpacing(8)
        right.addWidget(self.asking)
        right.addWidget(self._stack, 1)
        columns = QHBoxLayout(self)
        columns.setContentsMargins(12, 10, 12, 10)
        columns.setSpacing(10)
        columns.addWidget(self.history)
        columns.addLayout(right, 1)
        order = [self.history.list, self.history.remove, *self.asking.fields, *self.result.fields]
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)

    def _connect(self) -> None:
        self.stepped.connect(self._step, Qt.ConnectionType.QueuedConnection)
        self.asking.wanted.connect(self.begin)
        self.asking.unwanted.connect(self.stop)
        self.asking.changed.connect(self._resettle)
        self.history.chosen.connect(self._show_chosen)
        self.result.accept.clicked.connect(self._ask_for_twin)
        self.result.report.clicked.connect(self._report)
        self.result.export.clicked.connect(self._ask_for_json)
        self.result.next.wanted.connect(self._prepare)
        start = QShortcut(QKeySequence("Ctrl+Return"), self)
        start.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
        start.activated.connect(self.begin)

    def _resettle(self) -> None:
        self.settle(busy=self._busy, testing=self._testing)
        tell_why(self.waiting(), self.desk.jobs.why)


def _whole_number(kept: object) -> int:
    text = str(kept)
    return int(text) if text.isdecimal() and len(text) < 3 else 0
