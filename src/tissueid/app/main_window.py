"""The main window: one guided test, from the choice of an instrument to the result."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QCoreApplication, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QDragEnterEvent, QDropEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import QApplication, QFileDialog, QMainWindow, QWidget

from tissueid.acquisition.playing import Phase
from tissueid.app import ending
from tissueid.app.actions import install_shortcuts
from tissueid.app.calibration_state import calibration_state
from tissueid.app.calibrator import Calibrator
from tissueid.app.command_palette import CommandPalette
from tissueid.app.emergency import BY_BUTTON, BY_CLOSING, BY_DEFECT, BY_KEY, EmergencyStop
from tissueid.app.errands import judge_and_find
from tissueid.app.file_drops import RECORDS, FileDrops, dropped_paths
from tissueid.app.findings import Findings, find, whose
from tissueid.app.jobs import Jobs
from tissueid.app.language_choice import chosen
from tissueid.app.layout import MEASURE, Layout
from tissueid.app.live import LiveSignals
from tissueid.app.pages import Pages
from tissueid.app.panels import Panels
from tissueid.app.place_to_save import check_place
from tissueid.app.plan import Plan
from tissueid.app.remembered import remember_role, remembered_role
from tissueid.app.reporting import Reports
from tissueid.app.searching import Searching
from tissueid.app.stop_keys import StopKeys
from tissueid.app.surroundings import Surroundings
from tissueid.app.theme import PaletteWatch, Theme, palette_of, style_sheet, theme_of
from tissueid.app.unit_choice import take_kept
from tissueid.app.views.clinician.clinician import Clinician
from tissueid.app.waiting import tell_why
from tissueid.app.words import in_words
from tissueid.audit import Role, Trail
from tissueid.errors import TissueIDError
from tissueid.language import _, speak
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import quality_of
from tissueid.whole_file import private_folder

if TYPE_CHECKING:
    from tissueid.app.measuring import Outcome
    from tissueid.reports.verdict import Verdict

FRAME_MS = 33


class MainWindow(QMainWindow):
    """Everything that a person does goes through here; everything slow goes through a :class:`Job`."""

    def __init__(self, surroundings: Surroundings | None = None) -> None:
        super().__init__()
        self.around = surroundings or Surroundings()
        self.jobs = Jobs(self)
        self._stop = self.around.stop()
        self._keys = StopKeys(self)
        self._live = LiveSignals()
        self._plan: Plan | None = None
        self.findings: Findings | None = None
        self._closing = False
        self._theme: Theme | None = None
        QCoreApplication.setAttribute(Qt.ApplicationAttribute.AA_UseStyleSheetPropagationInWidgetStyles)
        self._palette_watch = PaletteWatch()
        self.testing = False
        self.setWindowTitle("TissueID")
        self.settings = self.around.settings()
        speak(chosen(self.around.language, self.settings))
        take_kept(self.settings)
        role = self.around.role or remembered_role(self.settings)
        self.ui = Layout(self, self.around.folder, self.around.now, role)
        self._frames = QTimer(self)
        self._frames.setInterval(FRAME_MS)
        self._frames.timeout.connect(self._frame)
        self._calibrator = Calibrator(self)
        self.reports = Reports(self)
        self.clinician = Clinician(self)
        self.panels = Panels(self)
        self.searching = Searching(self)
        self.pages = Pages(self)
        self.files = FileDrops(self)
        self.setAcceptDrops(True)
        install_shortcuts(self)
        self.commands = CommandPalette(self)
        self._connect()
        self._take_palette()
        self.searching.list_instruments()
        self.pages.restore()
        if self.ui.page != self.pages.start.name:  # which says so itself
            self.searching.offer_recovery()
        self._settle()

    # -- a test -------------------------------------------------------------------------------------------

    def start_test(self) -> None:
        """Begin the test that the form describes."""
        from tissueid.app.measuring import measure

        if self.clinician.watcher.start_after() or self.busy:
            return
        form = self.ui.form
        wrong: QWidget = form.site
        try:
            plan = form.plan()
            plan.check()
            if plan.path.parent == self.around.folder:
                private_folder(plan.path.parent)
            wrong = form.path
            check_place(plan.path)
        except (TissueIDError, OSError) as error:
            self.ui.notice.say(in_words(error), problem=True, about_form=True)
            if wrong is form.path or not form.site.currentText().strip():
                wrong.setFocus()
            return
        self._plan, self._live = plan, LiveSignals()
        plan = self.clinician.planned(plan)
        stop = self.energise(self._show_frame)
        self.findings = None
        self.ui.pages.setTabVisible(1, False)
        self.ui.gate.hide()
        self.ui.guidance.rest()
        self.ui.guidance.say(_("Connecting to the instrument."))
        self.panels.log.note(
            _("A test begins: {site}, with {url}, to {path}.").format(site=plan.site, url=plan.url, path=plan.path)
        )
        self.ui.signals.expect(plan)
        self.ui.analysis.expect(plan)
        self.ui.show_part(self.ui.running)
        work = functools.partial(
            measure,
            plan,
            self._live,
            stop,
            opener=self.around.opener,
            wait=self.around.wait,
            apart=self.around.apart,
            trail=Trail(self.around.audit, self.ui.role.role),
            calibrate=self.around.calibrate,
            earlier=self.clinician.earlier,
        )
        why = _("A test is running on Measure: stop it there, or wait.")
        self.jobs.do(work, self._test_ended, self._test_failed, why=why)
        self.ui.stop.setFocus()

    def energise(self, draw: Callable[[], None]) -> EmergencyStop:
        """From now on a coil may be energised: STOP, its keys and the dead man's switch are about what begins here.

        ``draw`` shows where it stands, 30 times a second, until :meth:`free`.
        """
        self._draw, self._stop = draw, self.around.stop()
        self._stop.beat()
        self._keys.listen(True)
        self.testing = True
        self.ui.notice.retract()
        self.ui.safety.expect()
        self._frames.start()
        return self._stop

    def free(self) -> None:
        """What was begun is over, and the coil is free."""
        self._keys.listen(False)
        self._frames.stop()
        self.testing = False
        self.clinician.freed()
        self.ui.safety.rest()

    def stop_test(self, reason: str) -> None:
        """Release the coil and end the running test; what was recorded is kept."""
        if self.testing:
            self._stop.press(reason)
            self.ui.guidance.say(_("Stopping: the coil is being released."))
        elif not self.busy:
            self.ui.notice.say(_("No test is running."))

    def _stop_by_button(self) -> None:
        self.stop_test(BY_BUTTON)

    def _stop_by_key(self) -> None:
        self.stop_test(BY_KEY)

    def meet_defect(self, error: BaseException) -> None:
        """Something in the window went wrong where nobody expected it: release the coil first, then say so."""
        self._stop.press(BY_DEFECT)
        self.ui.notice.say_everywhere(in_words(error))

    def _frame(self) -> None:
        """Only a frame that was drawn is a beat of the window's heart."""
        self._draw()
        self.ui.safety.tell_keys(reach=QApplication.activeWindow() is not None)
        self._stop.beat()

    def _show_frame(self) -> None:
        glance = self._live.look()
        self.ui.signals.show_live(glance)
        self.ui.safety.show_safety(glance.safety, free=glance.phase is Phase.RELEASE)
        if self._live.device is not None and self._plan is not None:
            self.ui.form.instrument.tell_calibration(self._plan.url, calibration_state(self._live.device))
            if self._live.greatest_force_n is not None:
                self.ui.form.tell_force(self._plan.url, self._live.greatest_force_n)
        self.clinician.follow(glance, self._live.device)
        if self._live.identification is not None:
            self.ui.analysis.show_live(self._live.identification)
        if self._plan is not None and not self._stop.is_set():
            self.ui.guidance.follow(glance, self._plan)

    def _test_ended(self, outcome: Outcome) -> None:
        self._end_frames()
        self.ui.form.renew_path()
        session = outcome.session
        said, failed = ending.in_words(outcome)
        if said:
            self.ui.notice.say(said, problem=failed, page=MEASURE)
        if outcome.instrument_failed:
            self._doubt_instrument()
        if outcome.link_lost is not None:
            self.ui.safety.tell_lost(outcome.link_lost.watchdog_s)
        if session is not None:
            self.pages.heard_of(outcome.path)
        if session is not None and session.tests and not self._closing:
            self._show_gate(session.test())
            self._identify(outcome.path, session, None)
        else:
            self.ui.guidance.rest()

    def _test_failed(self, words: str) -> None:
        self._end_frames()
        self.ui.signals.clear()
        self.ui.analysis.hide()
        self.ui.guidance.rest()
        self.ui.notice.say(words, problem=True, page=MEASURE)
        if self._live.device is None:  # else it had answered, and something else kept the test from beginning
            self._doubt_instrument()

    def _doubt_instrument(self) -> None:
        if self._plan is not None:
            self.ui.form.instrument.doubt(self._plan.url)

    def _end_frames(self) -> None:
        self.free()
        self._show_frame()
        self.ui.safety.rest()
        self.ui.analysis.rest()
        self.clinician.freed()  # the last frame tells of a probe that is followed no more

    # -- sessions and results ------------------------------------------------------------------------------

    def open_session(self, path: Path) -> None:
        """Read a saved session and analyse it."""
        self.ui.notice.retract()
        self.ui.analysis.hide()
        self.identify(path)

    def identify(self, path: Path, session: Session | None = None) -> None:
        """Show the page of results, and there what a session says."""
        self.pages.show(MEASURE)
        self._identify(path, session, None)

    def _identify(self, path: Path, session: Session | None, number: int | None) -> None:
        self.ui.guidance.say(_("Identifying the tissue."))
        why = _("A test is being analysed on Measure: wait a few seconds.")
        self.jobs.do(functools.partial(find, path, session, number), self.show_findings, self.say_failed, why=why)

    def show_findings(self, findings: Findings) -> None:
        """Show the page of an analysed test."""
        self.findings = findings
        self.reports.forget()
        self.panels.log.note(
            _("{path}, test {number}: {headline}.").format(
                path=findings.path, number=findings.test.number, headline=_(findings.verdict.headline)
            )
        )
        self.ui.signals.show_test(findings.test, findings.session.instrument)
        self._show_gate(findings.test, findings.verdict)
        self.ui.result.show_findings(findings)
        self.ui.form.tell_apart(self._plan is None or self._plan.path != findings.path)
        self.clinician.found(findings, self._plan)
        self.ui.show_part(self.ui.result)
        self.ui.pages.tabBar().setFocus()
        self.rest()

    def _judge(self) -> None:
        """Let the quality gate judge the tests of the shown session that it never saw; the file stays as it is."""
        if self.findings is None or self.busy:
            return
        self.ui.guidance.say(_("Judging the test."))
        self.jobs.do(functools.partial(judge_and_find, self.findings), self.show_findings, self.say_failed)

    def _show_gate(self, test: Test, verdict: Verdict | None = None) -> None:
        """Show what the quality gate said as soon as it is known, and the verdict on the test once it is analysed."""
        can_repeat = self._plan is not None and not self._closing
        self.ui.gate.show_quality(quality_of(test), can_repeat=can_repeat, verdict=verdict)

    def rest(self) -> None:
        """Nothing goes on: name what is shown, or say how to begin."""
        found = self.findings
        self.ui.guidance.rest("" if found is None else f"{whose(found)}  ·  {found.path.name}")

    def say_failed(self, words: str) -> None:
        """Some work ended badly: say so, and show again what was shown."""
        self.rest()
        self.ui.notice.say(words, problem=True)

    def _choose_session(self) -> None:
        kinds = _("Sessions and records (*.h5 {records});;All files (*)").format(records=RECORDS)
        dialog = QFileDialog(self, _("Open a session, or import records"), str(self.ui.form.folder), kinds)
        dialog.setFileMode(QFileDialog.FileMode.ExistingFiles)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
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
            self._identify(self.findings.path, self.findings.session, number)

    # -- roles and jobs -----------------------------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether something goes on that nothing else may begin beside."""
        return bool(self.jobs) or self._closing

    def _change_role(self, before: str, now: Role) -> None:
        self.ui.show_role(now)
        self.pages.take_role(now)
        remember_role(self.settings, now)
        trail = Trail(self.around.audit, now)
        work = functools.partial(trail.record, "role.changed", old=before, new=now)
        self.jobs.do(work, self._logged, self.ui.notice.say_everywhere)

    def _logged(self, _: object) -> None:
        """It is in the audit log; there is nothing to say."""

    def _settle(self) -> None:
        """Let every control do what now makes sense, and nothing else."""
        self.ui.settle(busy=self.busy, testing=self.testing, has_result=self.findings is not None)
        self.clinician.settle(busy=self.busy, testing=self.testing)
        self.pages.settle(busy=self.busy, testing=self.testing)
        tell_why(self.ui.waiting, self.jobs.why)
        if self._closing and not self.jobs:
            self.close()

    # -- the window itself ------------------------------------------------------------------------------------

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Close; a running test first releases the coil and keeps what was recorded."""
        if self.jobs:
            self._closing = True
            self._stop.press(BY_CLOSING)
            self.pages.cancel()
            self.clinician.cancel()
            first = _("Closing: the coil is being released.")
            self.ui.guidance.say(first if self.testing else _("Closing: the last work is being finished."))
            self._settle()
            event.ignore()
            return
        self._frames.stop()
        self.pages.save()
        super().closeEvent(event)

    def _take_palette(self) -> None:
        """Take colours that go with the system's palette; called anew whenever that changes."""
        theme = theme_of(self._palette_watch.palette())
        if theme is not self._theme:
            self._theme = theme
            self.setPalette(palette_of(theme))
            self.setStyleSheet(style_sheet(theme))
            self.ui.paint_with(theme)
            self.clinician.paint_with(theme)
            self.panels.paint_with(theme)
            self.pages.paint_with(theme)

    def _connect(self) -> None:
        ui = self.ui
        self.jobs.changed.connect(self._settle)
        ui.start.clicked.connect(self.start_test)
        ui.role.changed.connect(self._change_role)
        ui.gate.again.connect(self.start_test)
        ui.gate.judge.connect(self._judge)
        ui.form.filled.connect(ui.start.setFocus)
        ui.form.changed.connect(ui.notice.form_changed)
        ui.stop.clicked.connect(self._stop_by_button)
        ui.halt.clicked.connect(self._stop_by_button)
        self._keys.pressed.connect(self._stop_by_key)
        ui.open.clicked.connect(self._choose_session)
        ui.result.test_chosen.connect(self._analyse_other)
        # Queued: the new palette must first have reached every widget, or the rest would be overwritten by it.
        self._palette_watch.changed.connect(self._take_palette, Qt.ConnectionType.QueuedConnection)
        stop = QShortcut(QKeySequence(Qt.Key.Key_Escape), self)
        stop.setContext(Qt.ShortcutContext.ApplicationShortcut)
        stop.activated.connect(self._stop_by_key)
