"""The main window: one guided test, from the choice of an instrument to the result."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QCoreApplication, QLocale, Qt, SignalInstance
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent
from PySide6.QtWidgets import QApplication, QFileDialog, QMainWindow, QWidget

from tissueid.acquisition.playback import Phase
from tissueid.app import build
from tissueid.app.calibration_controller import CalibrationController
from tissueid.app.clinician import Clinician, Reports
from tissueid.app.command_palette import CommandPalette, PaletteEntry, declare, install_shortcuts
from tissueid.app.context import AppContext, AppServices, AppState
from tissueid.app.device_search import DeviceSearch
from tissueid.app.emergency import BY_BUTTON, BY_CLOSING, BY_DEFECT, NO_ANSWER, DeliberatePress, EmergencyStop
from tissueid.app.findings import Findings, whose
from tissueid.app.jobs import Jobs
from tissueid.app.layout import Layout
from tissueid.app.live_signals import LiveSignals
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.pages import FileDrops, Pages, dropped_paths
from tissueid.app.panels import Panels
from tissueid.app.readouts import NO_TEST, StopKeys
from tissueid.app.session_jobs import find, judge_and_analyse, open_test
from tissueid.app.study_sitting import StudySitting
from tissueid.app.theme import PaletteWatch, appearance, palette_of, style_sheet
from tissueid.app.user_files import check_save_path
from tissueid.app.widgets import show_disabled_reason
from tissueid.app.window_state import (
    chosen,
    chosen_theme,
    restore_window_state,
    save_role,
    save_window_state,
    saved_role,
    show_everywhere,
    take_kept,
    text_scale,
)
from tissueid.app.words import calibration_state, in_words, outcome_text, sentence
from tissueid.atomic_write import private_folder
from tissueid.audit import Role
from tissueid.errors import CancelledError, LinkLostError, TissueIDError
from tissueid.formatting import ANONYMOUS
from tissueid.language import ENGLISH, _, current_language, set_language
from tissueid.messages import code_of, translated
from tissueid.procedures.audit_queries import NOT_LOGGED, record_role
from tissueid.procedures.control import BY_KEY
from tissueid.procedures.instruments import opening_after
from tissueid.procedures.test_plan import TestPlan
from tissueid.sessions import Session, Test
from tissueid.sessions.file_policy import RECORDS
from tissueid.sessions.model import IMPORTED
from tissueid.sessions.quality import quality_of

if TYPE_CHECKING:
    from tissueid.app.live_test import LiveTest
    from tissueid.procedures.test_run import TestOutcome
    from tissueid.reports.verdict import Verdict

FRAME_MS = 33
_PREPARING_MS = 5
"""Time between two frames until the watchdog is armed, ms."""
KEEPS_UP_S = 0.25
"""Longest time between two frames of a window that keeps up, s: a quarter of what the watchdog permits."""
_STEADY_FRAMES = 3
"""Consecutive frames that must keep up before the watchdog is armed and an instrument is opened."""


class MainWindow(QMainWindow):
    """The main window. Slow work runs in a :class:`Job`."""

    def __init__(self, services: AppServices | None = None) -> None:
        super().__init__()
        self.services = services or AppServices()
        self.jobs = Jobs(self)
        self.emergency = self.services.stop()
        self._keys = StopKeys(self)
        self.live = LiveSignals()
        self._running: LiveTest | None = None
        self._notices_shown = 0
        self._plan: TestPlan | None = None
        self.findings: Findings | None = None
        self.restarts = False
        """Whether a new window is to be opened after this one, which closes."""
        QCoreApplication.setAttribute(Qt.ApplicationAttribute.AA_UseStyleSheetPropagationInWidgetStyles)
        self._palette_watch = PaletteWatch()
        self.setWindowTitle("TissueID")
        self.settings = self.services.settings()
        set_language(chosen(self.services.language, self.settings))
        QLocale.setDefault(QLocale(current_language()) if current_language() != ENGLISH else QLocale.c())
        self.setLocale(QLocale())  # it had the one before, and its fields take that of the window
        take_kept(self.settings)
        self._take_palette()
        appearance.changed.connect(self._dress)  # before the widgets in it, which inherit from it
        self.state = AppState(self.jobs, self.services.role or saved_role(self.settings))
        self.ui = Layout(self, self.services.folder, self.services.now, self.state)
        self.frame_timer = build.timer(self, FRAME_MS, self._frame, repeat=True)
        self._frame_at = 0.0
        self._steady = 0
        self.abort_shown: BaseException | None = None
        self._said_when_watched = ""
        self.warming: Callable[[], bool] = lambda: False
        """Whether modules are still being imported in the background, which slows the window down."""
        ui = self.ui
        self.context = self._make_context()
        self._calibrator = CalibrationController(
            self.context,
            self.begin_energised,
            self.end_energised,
            page=ui.calibration,
            instruments=ui.form.instrument,
            notice=ui.notice,
            guidance=ui.guidance,
            safety=ui.safety,
            signals=ui.signals,
            analysis=ui.analysis,
            parent=self,
        )
        self.reports = Reports(self.context, ui.notice, ui.guidance, self)
        self.clinician = Clinician(self.context, ui, self)
        self.study = StudySitting(self.context, ui, self)
        self.panels = Panels(self.context, self, ui.rail, ui.notice)
        ui.add_help(self.panels.help)
        self.device_search = DeviceSearch(self.context, ui.form, ui.notice, self)
        self.pages = Pages(self.context, ui, self)
        self.files = FileDrops(self.context, self.pages, lambda: ui.form.folder, self)
        self.setAcceptDrops(True)
        install_shortcuts(self.declare_actions(), self)
        DeliberatePress(ui.guarded, self)
        self.commands = CommandPalette(self.declare_actions, self)
        self._connect()
        self._dress()
        self.device_search.list_instruments()
        restore_window_state(self, ui.form, self.panels.help, self.settings)
        self.pages.restore()
        if self.ui.page != self.pages.start.name:  # which says so itself
            self.device_search.offer_recovery()
        self.state.changed.emit()

    def _make_context(self) -> AppContext:
        """Return what pages and the objects next to the window can use of it, looked up when it is used."""
        ui = self.ui
        return AppContext(
            self.services,
            self.state,
            self.settings,
            ui.notice.say,
            go=lambda name: self.pages.show(name),
            open_session=self.open_session,
            prepare_test=lambda values, message: self.pages.prepare_test(values, message),
            show_file=lambda path: self.reports.show(path),
            instrument=lambda: ui.form.instrument.url,
            calibrate=lambda message: self.pages.go_calibrate(message),
            begin_sitting=lambda folder, subject: self.study.begin(folder, subject),
            answered=lambda url, device: ui.form.instrument.tell_calibration(url, calibration_state(device)),
            note=lambda message: self.panels.log.note(message),
            show_idle=self.show_idle,
        )

    def declare_actions(self) -> tuple[PaletteEntry, ...]:
        """Return the actions of the command palette."""
        return declare(self.ui, self.panels, self.pages, self)

    # -- a test -------------------------------------------------------------------------------------------

    def start_test(self) -> None:
        """Start the test of the form."""
        from tissueid.app.live_test import LiveTest
        from tissueid.procedures.test_run import run_test

        if self.clinician.watcher.start_after() or self.busy or self.study.complete:
            return
        form = self.ui.form
        wrong: QWidget = form.site
        try:
            plan = form.plan()
            plan.check()
            if plan.out.parent == self.services.folder:
                private_folder(plan.out.parent)
            wrong = form.path
            check_save_path(plan.out, taken=form.another_name is not None)
        except (TissueIDError, OSError) as error:
            self.ui.notice.say(in_words(error), problem=True, about_form=True)
            if isinstance(error, TissueIDError) and code_of(error.message) == "subject.name":
                form.is_pseudonym.setFocus()
            elif wrong is form.path or not form.site.currentText().strip():
                wrong.setFocus()
            return
        self._plan, self.live = plan, LiveSignals()
        plan = self.clinician.planned(plan, self.study.wanted, self.study.before)
        stop = self.begin_energised(self.show_frame, _("Connecting to the instrument."))
        self._clear_result()
        self.panels.log.note(
            _("A test begins: {site}, with {url}, to {path}.").format(site=plan.site, url=plan.url, path=plan.out)
        )
        self.ui.signals.expect(plan)
        self.ui.analysis.expect(plan)
        self.ui.show_part(self.ui.running)
        self._running = LiveTest(self.live, stop)
        self.abort_shown = None
        self._notices_shown = 0
        work = functools.partial(
            run_test,
            plan,
            self._running,
            self.context.trail,
            opener=opening_after(stop.wait_until_watched, self.services.opener),
            calibrate=self.services.calibrate,
            pace=self.services.wait or stop.wait,
            separate_process=self.services.separate_process,
            earlier=self.clinician.earlier,
            another_name=form.another_name,
        )
        why = _("A test is running on Measure: stop it there, or wait.")
        self.jobs.do(work, self.on_test_ended, self.on_test_failed, why=why)

    def begin_energised(self, draw: Callable[[], None], said: str) -> EmergencyStop:
        """Arm the STOP button and the stop keys for an operation that can energise the coil; return its stop.

        ``draw`` shows its state 30 times a second until :meth:`end_energised`. The watchdog is armed, and ``said`` is
        shown, once the window keeps up: new plots, first drawing and imports of the first test take seconds. Open the
        instrument ``opening_after`` the stop's ``wait_until_watched``, so that no coil is energised before.
        """
        self.draw_frame, self.emergency = draw, self.services.stop()
        self._steady, self._frame_at, self._said_when_watched = 0, math.inf, said
        self.ui.guidance.show_idle()
        self.ui.guidance.say(_("Preparing. The coil is off."))
        self._keys.listen(True)
        self.state.testing = True
        self.jobs.hold_results(True)
        self.ui.make_way()
        self.ui.notice.retract()
        self.ui.safety.expect()
        self.frame_timer.start(_PREPARING_MS)
        self.ui.stop.setFocus()
        return self.emergency

    def end_energised(self) -> None:
        """Disarm the stop keys and the watchdog: the operation has ended and the coil is released."""
        self._keys.listen(False)
        self.frame_timer.stop()
        self.state.testing = False
        self.jobs.hold_results(False)
        self.clinician.freed()
        self.ui.safety.clear()

    def stop_test(self, reason: str) -> None:
        """Release the coil and end the running test; the recorded part is saved."""
        if self.testing:
            self.emergency.press(reason)
            self.ui.guidance.say(_("Stopping: the coil is being released."))
        elif not self.busy and not self.ui.notice.holds_problem:
            self.ui.notice.say(sentence(translated(NO_TEST)))

    def _stop_by_button(self) -> None:
        self.stop_test(BY_BUTTON)

    def _stop_by_key(self) -> None:
        self.stop_test(BY_KEY)

    def on_defect(self, error: BaseException) -> None:
        """Handle an unexpected exception of the window: release the coil first, then show it."""
        self.emergency.press(BY_DEFECT)
        self.ui.notice.say_everywhere(in_words(error))

    def _frame(self) -> None:
        """Draw a frame, then record a heartbeat; without heartbeats the running test is stopped."""
        self.draw_frame()
        self.ui.safety.show_key_reach(reach=QApplication.activeWindow() is not None)
        if self.emergency.watching or self._is_prepared():
            self.emergency.beat()

    def _is_prepared(self) -> bool:
        """Return whether the window keeps up, so that the watchdog can be armed."""
        now = time.monotonic()
        late = not 0.0 <= now - self._frame_at <= KEEPS_UP_S
        self._frame_at, self._steady = now, 0 if late or self.warming() else self._steady + 1
        if self._steady < _STEADY_FRAMES:
            return False
        self.frame_timer.setInterval(FRAME_MS)
        if not self.emergency.is_set():
            self.ui.guidance.say(self._said_when_watched)
        return True

    def show_frame(self) -> None:
        """Show the newest samples of the running test."""
        if self._running is not None and (new := self._running.notices[self._notices_shown :]):
            self._notices_shown += len(new)
            self.ui.notice.say(" ".join(sentence(translated(notice)) for notice in new), page=MEASURE)
        if self._running is not None and self._running.error is not None:
            self._show_abort(self._running.error)
            return
        snapshot = self.live.snapshot()
        self.ui.signals.show_live(snapshot)
        self.ui.safety.show_safety(snapshot.safety, free=snapshot.phase is Phase.RELEASE)
        if self.live.device is not None and self._plan is not None:
            self.ui.form.instrument.tell_calibration(self._plan.url, calibration_state(self.live.device))
            if self.live.greatest_force_n is not None:
                self.ui.form.tell_force(self._plan.url, self.live.greatest_force_n)
        self.clinician.follow(snapshot, self.live.device)
        if self.live.identification is not None:
            self.ui.analysis.show_live(self.live.identification)
        if self._plan is not None and not self.emergency.is_set():
            self.ui.guidance.follow(snapshot, self._plan)

    def _show_abort(self, error: BaseException) -> None:
        """Show at once that the test ended early: until its recording is saved, nothing of it is live any more."""
        if self.abort_shown is error:
            return
        self.abort_shown = error
        self.ui.signals.show_live(self.live.snapshot())
        self.clinician.freed()
        self.ui.safety.clear()
        if isinstance(error, LinkLostError):
            self.ui.safety.show_link_lost(error.watchdog_s)
        if not isinstance(error, CancelledError):
            self.ui.notice.say(in_words(error), problem=True, page=MEASURE)
        self.ui.guidance.say(_("The test has ended. What was recorded is being saved."))

    def on_test_ended(self, outcome: TestOutcome) -> None:
        """Show the outcome of a test, however it ended."""
        self._end_frames()
        self.ui.form.renew_path()
        session = outcome.session
        if self._plan is not None:
            self._plan = self._plan.model_copy(update={"out": outcome.path})
        notices = [] if self._running is None else self._running.notices
        unlogged = [notice for notice in notices if code_of(notice) == NOT_LOGGED]
        said, failed = outcome_text(outcome, unanswered=self.emergency.reason == NO_ANSWER, unlogged=unlogged)
        if said:
            self.ui.notice.say(said, problem=failed, page=MEASURE)
        if outcome.instrument_failed:
            self._doubt_instrument()
        if outcome.link_lost is not None:
            self.ui.safety.show_link_lost(outcome.link_lost.watchdog_s)
        if session is not None:
            self.study.recorded(outcome.path, session)
            self.state.session_saved.emit(outcome.path)
        if session is not None and session.tests and not self.state.closing:
            self._show_gate(session.test())
            self._analyse(functools.partial(find, outcome.path, session, None), self.context.say_failed)
        else:
            self.show_idle()

    def on_test_failed(self, message: str) -> None:
        """Show why a test could not be run or saved."""
        self._end_frames()
        self.ui.signals.clear()
        self.ui.analysis.hide()
        self.show_idle()
        self.ui.notice.say(message, problem=True, page=MEASURE)
        if self.live.device is None:  # else it had answered, and something else kept the test from beginning
            self._doubt_instrument()

    def _doubt_instrument(self) -> None:
        if self._plan is not None:
            self.ui.form.instrument.doubt(self._plan.url)

    def _end_frames(self) -> None:
        self.end_energised()
        self.show_frame()
        self.ui.safety.clear()
        self.ui.analysis.clear()
        self.clinician.freed()  # the last frame tells of a probe that is followed no more

    # -- sessions and results ------------------------------------------------------------------------------

    def open_session(self, path: Path) -> None:
        """Read a saved session and analyse it on the page of results; return to this page if it cannot be read."""
        before = self.ui.page
        self.ui.notice.retract()
        self.ui.analysis.hide()
        self.pages.show(MEASURE)
        work = functools.partial(find if self.clinician.holds(path) else open_test, path)
        self._analyse(work, functools.partial(self._not_opened, before))

    def _not_opened(self, before: str, message: str) -> None:
        if self.ui.page == MEASURE:
            self.pages.show(before)
        self.context.say_failed(message)

    def identify(self, path: Path, session: Session | None = None) -> None:
        """Analyse a session and show the page of results."""
        self.pages.show(MEASURE)
        self._analyse(functools.partial(find, path, session, None), self.context.say_failed)

    def _analyse(self, work: Callable[[], Findings], failed: Callable[[str], None]) -> None:
        self.ui.guidance.say(_("Identifying the tissue."))
        why = _("A test is being analysed on Measure: wait a few seconds.")
        self.jobs.do(work, self.show_findings, failed, why=why)

    def show_findings(self, findings: Findings) -> None:
        """Show the result of the analysis of a test."""
        self.findings = findings
        self.reports.show_findings(findings)
        self.panels.log.note(
            _("{path}, test {number}: {headline}.").format(
                path=findings.path, number=findings.test.number, headline=_(findings.verdict.headline)
            )
        )
        self.ui.signals.show_test(findings.test, findings.session.instrument)
        self._show_gate(findings.test, findings.verdict)
        self.ui.result.show_findings(findings)
        self.ui.form.show_other_test(self._plan is None or self._plan.out != findings.path)
        self.clinician.found(findings, self._plan, done=self.study.moved_on)
        self.ui.show_part(self.ui.result)
        self.ui.pages.tabBar().setFocus()
        self.show_idle()

    def _clear_result(self) -> None:
        self.findings = None
        self.reports.show_findings(None)
        self.ui.pages.setTabVisible(1, False)
        self.ui.gate.hide()
        self.ui.form.show_other_test(False)
        self.clinician.clear()
        self.show_idle()

    def _subject_begins(self, subject: str) -> None:
        """Remove a result that is shown: it is of another subject than the next test."""
        findings = self.findings
        if findings is None or self.testing or subject in ("", findings.session.subject.pseudonym):
            return
        self._clear_result()
        self.ui.signals.clear()
        self.ui.analysis.hide()
        self._settle()

    def _judge(self) -> None:
        """Judge the tests of the shown session that the quality gate has not judged; the file is not changed."""
        if self.findings is None or self.busy:
            return
        self.ui.guidance.say(_("Judging the test."))
        self.jobs.do(functools.partial(judge_and_analyse, self.findings), self.show_findings, self.context.say_failed)

    def _go_calibrate(self) -> None:
        self.pages.go_calibrate(_("Put the calibration spring under the probe, then begin a calibration."))

    def _show_gate(self, test: Test, verdict: Verdict | None = None) -> None:
        """Show the findings of the quality gate, and the verdict once the test is analysed."""
        self.ui.gate.show_quality(quality_of(test), can_repeat=self._repeats_shown, verdict=verdict)

    @property
    def _repeats_shown(self) -> bool:
        """Whether a test by the form is the shown test again: one recorded here, of the same subject and site."""
        form, findings, plan = self.ui.form, self.findings, self._plan
        if plan is None or self.state.closing or self.study.leads:
            return False
        shown = (
            (plan.subject, plan.site) if findings is None else (findings.session.subject.pseudonym, findings.test.site)
        )
        imported = findings is not None and IMPORTED in findings.test.notes
        return not imported and shown == (form.subject.text().strip() or ANONYMOUS, form.site.currentText().strip())

    def _offer_repeat(self) -> None:
        self.ui.gate.allow_repeat(self._repeats_shown)

    def _start_again(self) -> None:
        if self._repeats_shown:
            self.start_test()

    def show_idle(self) -> None:
        """Show the name of the displayed test, or how to start one."""
        findings = self.findings
        shown = "" if findings is None else f"{whose(findings)}  ·  {findings.path.name}"
        self.ui.guidance.show_idle(self.study.instruction or shown)

    def _choose_session(self) -> None:
        kinds = _("Sessions and records (*.h5 {records});;All files (*)").format(
            records=" ".join(f"*{suffix}" for suffix in RECORDS)
        )
        dialog = build.styled(
            QFileDialog(self, _("Open a session, or import records"), str(self.ui.form.folder), kinds),
            file_mode=QFileDialog.FileMode.ExistingFiles,
            attribute=Qt.WidgetAttribute.WA_DeleteOnClose,
        )
        dialog.filesSelected.connect(self._open_chosen)
        dialog.open()

    def _open_chosen(self, paths: list[str]) -> None:
        self.files.open([Path(path) for path in paths])

    def dragEnterEvent(self, event: QDragEnterEvent) -> None:  # noqa: N802
        """Files may be dropped on every page while nothing goes on."""
        if self.files.can_take(dropped_paths(event)):
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent) -> None:  # noqa: N802
        """Open what was dropped."""
        self.files.take(dropped_paths(event))
        event.acceptProposedAction()

    def _analyse_other(self, number: int) -> None:
        if self.findings is not None:
            self.ui.analysis.hide()
            work = functools.partial(find, self.findings.path, self.findings.session, number)
            self._analyse(work, self.context.say_failed)

    def _show_recovered(self, sessions: list[tuple[Path, Session]]) -> None:
        for path, _session in sessions:
            self.state.session_saved.emit(path)
        self.identify(*sessions[-1])

    def _page_changed(self) -> None:
        if self.ui.page != MEASURE:
            self.clinician.watcher.cancel()

    def _page_shown(self, name: str) -> None:
        if name == MEASURE:
            self.device_search.list_twins()
        self.panels.help.show_page(name)

    # -- roles and jobs -----------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether a job runs or the window closes: no other job may start."""
        return self.state.busy

    @property
    def testing(self) -> bool:
        """Whether a coil can be energised."""
        return self.state.testing

    def _change_role(self, before: str, now: Role) -> None:
        self.ui.show_role(now)
        if not self.ui.notice.holds_problem:
            self.ui.notice.retract()  # news that another role contradicts
        self.state.take_role(now)
        save_role(self.settings, now)
        work = functools.partial(record_role, self.context.trail, before, now)
        self.jobs.do(work, self.on_logged, self.ui.notice.say_everywhere)

    def on_logged(self, _: object) -> None:
        """It is in the audit log; there is nothing to say."""

    def _settle(self) -> None:
        """Let every control do what now makes sense, and nothing else."""
        self.ui.update_enabled(has_result=self.findings is not None)
        self.clinician.update_enabled(busy=self.busy, testing=self.testing)
        self.study.update_enabled(busy=self.busy)
        show_disabled_reason(self.ui.waiting, self.jobs.why)
        if self.state.closing and self.jobs.idle:
            self.close()

    # -- the window itself ------------------------------------------------------------------------------------

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Close; a running test first releases the coil and keeps what was recorded."""
        if not self.jobs.idle:
            self.state.closing = True
            self.emergency.press(BY_CLOSING)
            self.state.cancelling.emit()
            first = _("Closing: the coil is being released.")
            self.ui.guidance.say(first if self.testing else _("Closing: the last work is being finished."))
            self.state.changed.emit()
            event.ignore()
            return
        self.frame_timer.stop()
        ui = self.ui
        save_window_state(self, ui.form, self.panels.help, ui.page, ui.role.role, self.settings)
        self.pages.save()
        super().closeEvent(event)

    def _take_units(self) -> None:
        take_kept(self.settings)
        show_everywhere(self)

    def _offer_restart(self) -> None:
        language = self.pages.start.language.choice.currentText()
        said = _("The language is {language} when TissueID has restarted.").format(language=language)
        self.ui.notice.say(said, offer=_("Restart now"), act=self._restart)

    def _restart(self) -> None:
        self.restarts = True
        self.close()

    def _take_palette(self) -> None:
        """Apply appearance and text size; called whenever they or the system's palette change."""
        appearance.use(chosen_theme(self.settings, self._palette_watch.palette()), text_scale(self.settings))

    def _dress(self) -> None:
        palette = palette_of(appearance.theme)
        self.setFont(appearance.font())
        self.setPalette(palette)
        self.setStyleSheet(style_sheet(appearance.theme, appearance.scale))
        for view in self.pages.views:  # a page that is created late does not inherit the palette
            view.setPalette(palette)

    def _connect(self) -> None:
        ui, start, clinician = self.ui, self.pages.start, self.clinician
        wiring: tuple[tuple[SignalInstance, Callable[..., object]], ...] = (
            (self.state.changed, self._settle),
            (ui.start.clicked, self.start_test),
            (ui.role.changed, self._change_role),
            (ui.gate.again, self._start_again),
            (ui.gate.judge, self._judge),
            (ui.gate.calibration_wanted, self._go_calibrate),
            (ui.form.changed, ui.notice.form_changed),
            (ui.form.changed, self._offer_repeat),
            (ui.form.subject_chosen, self._subject_begins),
            (ui.stop.clicked, self._stop_by_button),
            (ui.halt.clicked, self._stop_by_button),
            (self._keys.pressed, self._stop_by_key),
            (ui.open.clicked, self._choose_session),
            (ui.report.clicked, self.reports.open),
            (ui.result.test_chosen, self._analyse_other),
            (ui.stack.currentChanged, self._page_changed),
            (clinician.test_wanted, self._start_again),
            (clinician.watcher.start_wanted, self.start_test),
            (clinician.findings_wanted, self.show_findings),
            (self.device_search.recovered, self._show_recovered),
            (self.pages.shown, self._page_shown),
            (start.language.chosen, self._offer_restart),
            (start.units.chosen, self._take_units),
            (start.find_asked, self.device_search.find_instruments),
            (start.recovery_asked, self.device_search.recover),
        )
        for signal, slot in wiring:
            signal.connect(slot)
        for chooser in (start.appearance, start.text_size):
            chooser.chosen.connect(self._take_palette, Qt.ConnectionType.QueuedConnection)
        # Queued: the new palette must first have reached every widget, or the rest would be overwritten by it.
        self._palette_watch.changed.connect(self._take_palette, Qt.ConnectionType.QueuedConnection)
        build.shortcut(self, "Esc", self._stop_by_key, Qt.ShortcutContext.ApplicationShortcut)
