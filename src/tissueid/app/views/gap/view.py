"""The page ``gap``: where simulation and recording differ, which effect causes it, and how far it closes the gap."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QAbstractButton,
    QCheckBox,
    QDialog,
    QDialogButtonBox,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from tissueid.app import build
from tissueid.app.build import ask_path, column, label, restore_tab, row, shortcut, stack, timer
from tissueid.app.context import AppContext, View
from tissueid.app.jobs import JobControl
from tissueid.app.views.gap.diagnosis_list import DiagnosisList
from tissueid.app.views.gap.diagnosis_result import (
    DiagnosisResult,
    KeptDiagnoses,
    accept_into_twin,
    default_folder,
    export_json,
    keep,
    proposed_twin,
    remove,
    run_diagnosis,
    why_not_accepted,
    write_report,
)
from tissueid.app.views.gap.page_content import as_title, prepared_words, session_url
from tissueid.app.views.gap.request_panel import DiagnosisLoader, RequestPanel
from tissueid.app.views.gap.result_page import DiagnosisPage
from tissueid.app.window_state import RESEARCH_FOLDERS, load_texts
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.language import _, marked
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.control import Control
from tissueid.procedures.gap_plans import DiagnosisPlan


class EffectDialog(QDialog):
    """A check box for each effect; ``chosen`` carries the names of the checked effects."""

    chosen = Signal(list)

    def __init__(self, offered: Sequence[tuple[str, str, bool]], parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(_("Accept into twin"))
        about = build.label(
            text=_(
                "Which effects is the twin to have? Those that the diagnosis names are checked; another choice is "
                "fitted to the session first."
            )
        )
        self.boxes: dict[str, QCheckBox] = {}
        self.buttons = QDialogButtonBox()
        self.accept_button = self.buttons.addButton(_("Accept"), QDialogButtonBox.ButtonRole.AcceptRole)
        self.buttons.addButton(_("Cancel"), QDialogButtonBox.ButtonRole.RejectRole)
        column = QVBoxLayout(self)
        column.addWidget(about)
        for name, title, named in offered:
            if name in self.boxes:
                continue
            box = build.styled(QCheckBox(as_title(title).replace("&", "&&")), checked=named)
            box.toggled.connect(self._settle)
            self.boxes[name] = box
            column.addWidget(box)
        column.addWidget(self.buttons)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        self.accepted.connect(lambda: self.chosen.emit(self.names))

    @property
    def names(self) -> list[str]:
        """The names of the checked effects."""
        return [name for name, box in self.boxes.items() if box.isChecked()]

    def _settle(self) -> None:
        self.accept_button.setEnabled(bool(self.names))


_WELCOME = marked(
    "A simulation of the same test never equals the recording. Choose a session and run: this page says whether the "
    "difference is more than noise, in which stage of the signal chain it arises, which effect that the simulation "
    "leaves out causes it, and how much of it goes away once that effect is added."
)
_CANCELLED = Message("gap.cancelled", "The diagnosis was cancelled.")
_TAB = "gap/tab"
_LOOK_MS = 100
"""Interval at which the progress is shown, ms."""


class GapView(View):
    """The page ``gap``. A diagnosis runs in separate processes and can be cancelled at any time."""

    name = "gap"

    def __init__(self, context: AppContext, parent: QWidget | None = None) -> None:
        super().__init__(context, parent)
        self._written: tuple[DiagnosisResult, Path] | None = None
        self._control = JobControl()
        self._running = self._over = False
        self._kept_in = default_folder()
        self.background = DiagnosisLoader(context.jobs, self._kept_in, self)
        self._testing = False
        self._looking = timer(self, _LOOK_MS, self._look, repeat=True)
        # Not from within a job's end: the other pages must have settled first.
        self.refresh_timer = timer(self, 0, self._go_on)
        self.asking = RequestPanel(
            context.services.folder, lambda: [Path(text) for text in load_texts(context.settings, RESEARCH_FOLDERS)]
        )
        self.history = DiagnosisList()
        self.result = DiagnosisPage()
        self.welcome = label("muted", text=_(_WELCOME), alignment=Qt.AlignmentFlag.AlignTop)
        self._stack = stack(self.welcome, self.result)
        self._stack.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._arrange()
        self._connect()
        self.asking.restore(context.settings)
        restore_tab(self.result.tabs, context.settings.value(_TAB))
        self._show_chosen()

    # -- what the window tells ------------------------------------------------------------------------------------

    def enter(self) -> None:
        """List the files again when the page is shown."""
        self.asking.look()
        self.history.look()
        self.refresh_timer.start()

    def on_session_saved(self, path: Path) -> None:
        """List a new session."""
        self.asking.on_session_saved(path)
        self.refresh_timer.start()

    def update_enabled(self, *, busy: bool, testing: bool) -> None:
        """Enable or disable the controls."""
        self._testing = testing
        # While the page only reads, a diagnosis can be asked for all the same.
        working = self.context.jobs.working
        waits = working or testing or (busy and not self.background.running)
        self.asking.update_enabled(busy=waits, testing=testing)
        self.asking.progress.show_reason(self.context.jobs.why_no_work if working and not self._running else "")
        self.result.update_enabled(busy=busy, testing=testing, working=working)
        if not busy:
            self.refresh_timer.start()

    def waiting(self) -> tuple[QWidget, ...]:
        """The buttons that are disabled while other work runs."""
        return self.asking.run, *self.result.buttons

    def buttons(self) -> tuple[QAbstractButton, ...]:
        """Return the buttons that the command palette offers."""
        return self.asking.run, self.asking.stop, *self.result.buttons

    def cancel(self) -> None:
        """Cancel the running diagnosis and start no further work; the window closes."""
        self._over = True
        self._control.cancel()
        self.background.cancel()

    def save_state(self) -> None:
        """Save the selection; diagnoses are stored when they are made."""
        self.asking.save(self.context.settings)
        self.context.settings.setValue(_TAB, self.result.tabs.currentIndex())

    # -- a diagnosis ----------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Diagnose the selected session."""
        if not self.asking.run.isEnabled():
            return
        try:
            asked = self.asking.asked()
        except UnusableInputError as error:
            self.context.say(in_words(error), problem=True)
            return
        self._control, self._running = JobControl(), True
        self.asking.stop.setEnabled(True)
        self.asking.show_progress(None, _("Starting"))
        self._looking.start()
        self.asking.stop.setFocus()
        separate_process = self.context.services.separate_process
        work = functools.partial(self._diagnose, asked, self._control, separate_process=separate_process)
        why = _("A diagnosis is running on Gap: cancel it there, or wait.")
        self.context.jobs.do(work, self._ended, self._failed, why=why, long=True)

    def begin_again(self) -> None:
        """Repeat the shown diagnosis."""
        if (result := self.history.result) is not None and not (self._running or self._testing):
            self.asking.put(result.asked)
            self.begin()

    def stop(self) -> None:
        """Cancel the running diagnosis."""
        if self._running:
            self._control.cancel()
            self.asking.stop.setEnabled(False)
            self.asking.show_progress(None, _("Cancelling"))

    def _go_on(self) -> None:
        """Read what is missing."""
        if not (self._over or self._testing or self.context.busy) and self.isVisible():
            self.background.load_next(self.asking.session.untitled)

    def _diagnose(
        self, asked: DiagnosisPlan, control: Control, *, separate_process: bool
    ) -> tuple[DiagnosisResult | None, str]:
        """Diagnose and store the result; return the result and why it was not stored. Runs in a thread."""
        try:
            result = run_diagnosis(asked, control, separate_process=separate_process)
        except CancelledError:
            return None, ""
        return result, self._kept(result)

    def _kept(self, result: DiagnosisResult) -> str:
        """Store a diagnosis; return why it was not stored, or ""."""
        try:
            keep(result, self._kept_in)
        except (OSError, UnusableInputError) as error:
            return in_words(error)
        return ""

    def _look(self) -> None:
        if not self._control.cancelled():
            self.asking.show_progress(self._control.fraction, self._control.step or _("Starting"))

    def _ended(self, ended: tuple[DiagnosisResult | None, str]) -> None:
        waited = self._rest()
        result, unkept = ended
        if result is None:
            self.context.say(translated(_CANCELLED))
            return
        self.history.add(result)
        if waited:
            self.result.chain.chosen_box.setFocus()
        self._say_unkept(unkept)

    def _say_unkept(self, why: str) -> None:
        if why:
            self.context.say(
                translated(
                    Message("gap.not_kept", "The diagnosis is not there at the next start. {why}", why=Verbatim(why))
                ),
                problem=True,
            )

    def _failed(self, message: str) -> None:
        self._rest()
        self.context.say(message, problem=True)

    def _rest(self) -> bool:
        # The focus would be lost with the button that disappears.
        waited = self.asking.stop.hasFocus() or self.asking.stop.isHidden()
        self._running = False
        self._looking.stop()
        self.asking.session.choice.setFocus() if waited else None
        self.asking.progress.clear()
        return waited

    def _show_chosen(self) -> None:
        result = self.history.result
        self._stack.setCurrentWidget(self.welcome if result is None else self.result)
        if result is not None:
            self.result.show_story(result.story, self.history.state)
        self.changed.emit()

    # -- what the page reads by itself -------------------------------------------------------------------------------

    def _restore(self, kept: KeptDiagnoses) -> None:
        self.history.restore(kept.results)
        if kept.bad:
            single = Message("gap.one_unreadable", "1 kept diagnosis could not be read and is passed over.")
            several = Message(
                "gap.several_unreadable",
                "{count} kept diagnoses could not be read and are passed over.",
                count=kept.bad,
            )
            self.context.say(translated(single if kept.bad == 1 else several), problem=True)

    def _forget(self, result: DiagnosisResult) -> None:
        remove(result.key, self._kept_in)

    def _keep_again(self, result: DiagnosisResult) -> None:
        self.context.jobs.do(functools.partial(self._kept, result), self._say_unkept, self._not_kept)

    # -- what is kept of it ---------------------------------------------------------------------------------------

    def _ask_for_twin(self) -> None:
        result = self.history.result
        if result is None:
            return
        if why := why_not_accepted(result):
            self.context.say(translated(why), problem=True)
            return
        offered = result.story.offered
        if len(offered) < 2:
            self._ask_for_file([name for name, _title, _named in offered])
            return
        dialog = EffectDialog(offered, self)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.chosen.connect(self._ask_for_file)
        dialog.open()

    def _ask_for_file(self, effects: list[str]) -> None:
        result = self.history.result
        if result is not None:
            path = proposed_twin(result, effects)
            accept = functools.partial(self._accept, effects)
            self._ask(_("Save the twin"), path, _("Twins (*.toml)"), accept)

    def _ask_for_json(self) -> None:
        result = self.history.result
        if result is not None:
            session = result.asked.session
            path = session.with_name(f"{session.stem}-gap.json")
            self._ask(_("Save the answer"), path, "JSON (*.json)", self._export)

    def _ask(self, title: str, path: Path, kinds: str, then: Callable[[Path], None]) -> None:
        ask_path(self, title, path.parent, then, kinds, save=path.name, default_suffix=path.suffix[1:])

    def _accept(self, effects: list[str], path: Path) -> None:
        trail, separate_process = self.context.trail, self.context.services.separate_process

        def accept(result: DiagnosisResult) -> tuple[Path, str]:
            return path, accept_into_twin(result, path, trail, effects, separate_process=separate_process)

        self._keep(accept, self._accepted, long=True)

    def _export(self, path: Path) -> None:
        self._keep(lambda result: export_json(result, path), self._exported)

    def _report(self) -> None:
        written = self._written
        if written is not None and written[0] is self.history.result and written[1].exists():
            self.context.show_file(written[1])  # of what is shown it is there already
        else:
            self._keep(lambda result: (result, write_report(result)), self._reported)

    def _reported(self, written: tuple[DiagnosisResult, Path]) -> None:
        self._written = written
        self.context.show_file(written[1])

    def _keep(
        self, work: Callable[[DiagnosisResult], object], then: Callable[..., None], *, long: bool = False
    ) -> None:
        result = self.history.result
        if result is not None and not (self.context.no_work if long else self.context.busy):
            why = _("A twin is being saved on Gap: wait a moment.") if long else ""
            self.context.jobs.do(functools.partial(work, result), then, self._not_kept, why=why, long=long)

    def _accepted(self, accepted: tuple[Path, str]) -> None:
        path, notice = accepted
        self.asking.on_session_saved(path)
        self.context.say(notice)

    def _exported(self, path: Path) -> None:
        self.context.say(_("The answer is saved in {path}.").format(path=path))

    def _not_kept(self, message: str) -> None:
        self.context.say(message, problem=True)

    # -- what to measure next -------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        result = self.history.result
        step = None if result is None else result.story.proposal
        if result is None or step is None or step.fields is None or self._testing:
            return
        fields = dict(step.fields)
        device = result.instrument
        folders = [self.context.services.folder, result.asked.session.parent]
        url = session_url(device, result.asked.twin, folders)
        if url:
            fields["url"] = url
        self.context.prepare_test(fields, prepared_words(step, device, url))

    # -- files that are dropped -----------------------------------------------------------------------------------

    def offer_files(self, paths: list[Path]) -> bool:
        """Select a dropped session or twin."""
        if len(paths) != 1 or not paths[0].is_file() or paths[0].suffix.lower() not in (".h5", ".toml"):
            return False
        self.asking.take(paths[0])
        return True

    # -- building -------------------------------------------------------------------------------------------------

    def _arrange(self) -> None:
        row(
            self.history,
            (column(self.asking, (self._stack, 1), spacing=8), 1),
            spacing=10,
            margins=(12, 10, 12, 10),
            parent=self,
        )
        order = [self.history.list, self.history.remove, *self.asking.fields, *self.result.fields]
        for before, after in pairwise(order):
            QWidget.setTabOrder(before, after)

    def _connect(self) -> None:
        self.asking.wanted.connect(self.begin)
        self.asking.unwanted.connect(self.stop)
        self.asking.changed.connect(self.apply_state)
        self.history.chosen.connect(self._show_chosen)
        self.history.removed.connect(self._forget)
        self.history.returned.connect(self._keep_again)
        self.background.kept_read.connect(self._restore)
        self.background.titles_read.connect(self.asking.session.entitle)
        self.background.failed.connect(self._not_kept)
        self.result.again.clicked.connect(self.begin_again)
        self.result.accept.clicked.connect(self._ask_for_twin)
        self.result.report.clicked.connect(self._report)
        self.result.export.clicked.connect(self._ask_for_json)
        self.result.next.wanted.connect(self._prepare)
        shortcut(self, "Ctrl+Return", self.begin)
