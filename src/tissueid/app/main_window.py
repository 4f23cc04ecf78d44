"""The main window: one guided test, from the choice of an instrument to the result."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from PySide6.QtCore import QCoreApplication, Qt, QTimer, QUrl
from PySide6.QtGui import QCloseEvent, QDesktopServices, QKeySequence, QShortcut
from PySide6.QtWidgets import QFileDialog, QMainWindow

from tissueid.app.errands import Recovery, recover_all, unfinished, write_report_beside
from tissueid.app.findings import Findings, find
from tissueid.app.jobs import Job
from tissueid.app.layout import Layout
from tissueid.app.live import LiveSignals
from tissueid.app.measuring import Outcome, Wait, measure
from tissueid.app.plan import Plan, default_folder
from tissueid.app.theme import PaletteWatch, Theme, palette_of, style_sheet, theme_of
from tissueid.app.words import in_words
from tissueid.errors import TissueIDError
from tissueid.instrument import Found, Instrument, find_instruments, open_instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.sessions import Session
from tissueid.wording import clean

FRAME_MS = 33
LONGEST_SITE = 80


def _show_file(path: Path) -> bool:
    return QDesktopServices.openUrl(QUrl.fromLocalFile(str(path)))


@dataclass(frozen=True)
class Surroundings:
    """What the window reaches out to; tests hand in their own.

    ``wait`` None paces simulations by the clock. ``apart`` is whether a running test is looked at by another process.
    """

    opener: Callable[[str], Instrument] = open_instrument
    finder: Callable[..., list[Found]] = find_instruments
    folder: Path = field(default_factory=default_folder)
    wait: Wait | None = None
    apart: bool = True
    now: Callable[[], datetime] = datetime.now
    show_file: Callable[[Path], bool] = _show_file


class MainWindow(QMainWindow):
    """Everything that a person does goes through here; everything slow goes through a :class:`Job`."""

    def __init__(self, surroundings: Surroundings | None = None) -> None:
        super().__init__()
        self._around = surroundings or Surroundings()
        self._jobs: set[Job] = set()
        self._stop = threading.Event()
        self._live = LiveSignals()
        self._plan: Plan | None = None
        self.findings: Findings | None = None
        self._report: Path | None = None
        self._unfinished: list[Path] = []
        self._closing = False
        self._theme: Theme | None = None
        QCoreApplication.setAttribute(Qt.ApplicationAttribute.AA_UseStyleSheetPropagationInWidgetStyles)
        self._palette_watch = PaletteWatch()
        self.testing = False
        self.setWindowTitle("TissueID")
        self.ui = Layout(self, self._around.folder, self._around.now)
        self._frames = QTimer(self)
        self._frames.setInterval(FRAME_MS)
        self._frames.timeout.connect(self._show_frame)
        self._connect()
        self._take_palette()
        self._list_instruments()
        self._offer_recovery()
        self._settle()

    # -- a test -------------------------------------------------------------------------------------------

    def start_test(self) -> None:
        """Begin the test that the form describes."""
        if self._busy:
            return
        try:
            plan = self.ui.form.plan()
            plan.check()
            if plan.path.parent == self._around.folder:
                plan.path.parent.mkdir(parents=True, exist_ok=True)
        except (TissueIDError, OSError) as error:
            self.ui.notice.say(in_words(error), problem=True)
            if not self.ui.form.site.currentText().strip():
                self.ui.form.site.setFocus()
            return
        self._plan, self._live, self._stop = plan, LiveSignals(), threading.Event()
        self.testing = True
        self.findings = None
        self.ui.pages.setTabVisible(1, False)
        self.ui.notice.hide()
        self.ui.guidance.rest()
        self.ui.guidance.say("Connecting to the instrument.")
        self.ui.signals.expect(plan)
        self.ui.analysis.expect(plan)
        self.ui.pages.setCurrentWidget(self.ui.running)
        work = functools.partial(
            measure,
            plan,
            self._live,
            self._stop,
            opener=self._around.opener,
            wait=self._around.wait,
            apart=self._around.apart,
        )
        self._do(work, self._test_ended, self._test_failed)
        self._frames.start()
        self.ui.stop.setFocus()

    def stop_test(self) -> None:
        """Release the coil and end the running test; what was recorded is kept."""
        if self.testing:
            self._stop.set()
            self.ui.guidance.say("Stopping: the coil is being released.")
        else:
            self.ui.notice.say("No test is running.")

    def _show_frame(self) -> None:
        glance = self._live.look()
        self.ui.signals.show_live(glance)
        if self._live.identification is not None:
            self.ui.analysis.show_live(self._live.identification)
        if self._plan is not None and not self._stop.is_set():
            self.ui.guidance.follow(glance, self._plan)

    def _test_ended(self, outcome: Outcome) -> None:
        self._end_frames()
        self.ui.form.renew_path()
        session = outcome.session
        saved = f"The recorded part is saved in {outcome.path}." if session else "Nothing was recorded yet."
        if outcome.stopped:
            self.ui.notice.say(f"Stopped, and the coil is released. {saved}")
        elif outcome.problem:
            self.ui.notice.say(f"{outcome.problem} {saved if session else ''}".strip(), problem=True)
            self._doubt_instrument()
        if session is not None and session.tests and not self._closing:
            self._identify(outcome.path, session, None)
        else:
            self.ui.guidance.rest()

    def _test_failed(self, words: str) -> None:
        self._end_frames()
        self.ui.signals.clear()
        self.ui.analysis.hide()
        self.ui.guidance.rest()
        self.ui.notice.say(words, problem=True)
        self._doubt_instrument()

    def _doubt_instrument(self) -> None:
        if self._plan is not None:
            self.ui.form.instrument.doubt(self._plan.url)

    def _end_frames(self) -> None:
        self._show_frame()
        self._frames.stop()
        self.testing = False

    # -- sessions and results ------------------------------------------------------------------------------

    def open_session(self, path: Path) -> None:
        """Read a saved session and analyse it."""
        self.ui.notice.hide()
        self.ui.analysis.hide()
        self._identify(path, None, None)

    def _identify(self, path: Path, session: Session | None, number: int | None) -> None:
        self.ui.guidance.say("Identifying the tissue.")
        self._do(functools.partial(find, path, session, number), self._show_findings, self._say_failed)

    def _show_findings(self, findings: Findings) -> None:
        self.findings, self._report = findings, None
        self.ui.signals.show_test(findings.test)
        self.ui.result.show_findings(findings)
        self.ui.pages.setTabVisible(1, True)
        self.ui.pages.setCurrentWidget(self.ui.result)
        self.ui.pages.tabBar().setFocus()
        self._rest()

    def _rest(self) -> None:
        """Nothing goes on: name what is shown, or say how to begin."""
        self.ui.guidance.rest()
        if self.findings is not None:
            site = clean(self.findings.test.site)[:LONGEST_SITE] or "Site not recorded"
            self.ui.guidance.say(f"{site}  ·  {self.findings.path.name}")

    def _say_failed(self, words: str) -> None:
        self._rest()
        self.ui.notice.say(words, problem=True)

    def _choose_session(self) -> None:
        dialog = QFileDialog(self, "Open a session", str(self.ui.form.folder), "Sessions (*.h5);;All files (*)")
        dialog.setFileMode(QFileDialog.FileMode.ExistingFile)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.fileSelected.connect(self._open_chosen)
        dialog.open()

    def _open_chosen(self, path: str) -> None:
        self.open_session(Path(path))

    def _analyse_other(self, number: int) -> None:
        if self.findings is not None:
            self.ui.analysis.hide()
            self._identify(self.findings.path, self.findings.session, number)

    # -- report -------------------------------------------------------------------------------------------

    def open_report(self) -> None:
        """Write the report of the shown result beside its session, and open it."""
        if self.findings is None or self._busy:
            return
        if self._report is not None and self._report.exists():
            self._show_report(self._report)
            return
        self.ui.guidance.say("Writing the report.")
        self._do(functools.partial(write_report_beside, self.findings), self._show_report, self._say_failed)

    def _show_report(self, path: Path) -> None:
        self._report = path
        self._rest()
        if self._around.show_file(path):
            self.ui.notice.say(f"The report is saved in {path}.")
        else:
            self.ui.notice.say(f"The report is saved in {path}; open it in a browser.")

    # -- instruments and journals ---------------------------------------------------------------------------

    def find_instruments(self) -> None:
        """Ask every port whether an instrument answers."""
        if self._busy:
            return
        self.ui.form.instrument.about.setText("Asking every port…")
        work = functools.partial(self._around.finder, probe=True)
        self._do(work, self._found, self._finding_failed)

    def _found(self, found: Sequence[Found]) -> None:
        self.ui.form.instrument.offer(found)
        answering = sum(item.answers is True and not item.url.startswith(IN_PROCESS) for item in found)
        what = {0: "No instrument answers", 1: "One instrument answers"}.get(
            answering, f"{answering} instruments answer"
        )
        self.ui.notice.say(f"{what}; simulations in this program can always be chosen.")

    def _finding_failed(self, words: str) -> None:
        self.ui.form.instrument.offer([])
        self.ui.notice.say(words, problem=True)

    def _list_instruments(self) -> None:
        """Offer what can be seen without asking; a system that cannot list its ports still has typed addresses."""
        try:
            self.ui.form.instrument.offer(self._around.finder(probe=False))
        except (TissueIDError, OSError) as error:
            self._finding_failed(in_words(error))

    def _offer_recovery(self) -> None:
        self._unfinished = unfinished(self._around.folder)
        if self._unfinished:
            count = len(self._unfinished)
            what = "An unfinished test was" if count == 1 else f"{count} unfinished tests were"
            names = ", ".join(path.name.removesuffix(".journal") for path in self._unfinished[:3])
            self.ui.notice.say(f"{what} found in {self._around.folder}: {names}.", offer="Re&cover")

    def _recover(self) -> None:
        if not self._busy:
            self.ui.notice.hide()
            self._do(functools.partial(recover_all, self._unfinished), self._recovered, self._say_failed)

    def _recovered(self, recovery: Recovery) -> None:
        saved = [f"Recovered {path}." for path, _ in recovery.sessions]
        self.ui.notice.say(" ".join(saved + recovery.problems), problem=bool(recovery.problems))
        if recovery.sessions:
            self._identify(*recovery.sessions[-1], None)

    # -- jobs -----------------------------------------------------------------------------------------------

    @property
    def _busy(self) -> bool:
        return bool(self._jobs) or self._closing

    def _do(self, work: Callable[[], Any], succeeded: Callable[[Any], None], failed: Callable[[str], None]) -> None:
        job = Job(work, self)
        job.succeeded.connect(succeeded)
        job.failed.connect(failed)
        job.finished.connect(self._job_finished)
        self._jobs.add(job)
        self._settle()
        job.start()

    def _job_finished(self) -> None:
        job = self.sender()
        if isinstance(job, Job):
            job.wait()
            self._jobs.discard(job)
            job.deleteLater()
        self._settle()
        if self._closing and not self._jobs:
            self.close()

    def _settle(self) -> None:
        """Let every control do what now makes sense, and nothing else."""
        self.ui.settle(busy=self._busy, testing=self.testing, has_result=self.findings is not None)

    # -- the window itself ------------------------------------------------------------------------------------

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        """Close; a running test first releases the coil and keeps what was recorded."""
        if self._jobs:
            self._closing = True
            self._stop.set()
            first = "the coil is being released" if self.testing else "the last work is being finished"
            self.ui.guidance.say(f"Closing: {first}.")
            self._settle()
            event.ignore()
            return
        self._frames.stop()
        super().closeEvent(event)

    def _take_palette(self) -> None:
        """Take colours that go with the system's palette; called anew whenever that changes."""
        theme = theme_of(self._palette_watch.palette())
        if theme is not self._theme:
            self._theme = theme
            self.setPalette(palette_of(theme))
            self.setStyleSheet(style_sheet(theme))
            self.ui.paint_with(theme)

    def _connect(self) -> None:
        ui = self.ui
        ui.start.clicked.connect(self.start_test)
        ui.form.filled.connect(ui.start.setFocus)
        ui.stop.clicked.connect(self.stop_test)
        ui.open.clicked.connect(self._choose_session)
        ui.report.clicked.connect(self.open_report)
        ui.form.instrument.refresh.clicked.connect(self.find_instruments)
        ui.notice.accepted.connect(self._recover)
        ui.result.test_chosen.connect(self._analyse_other)
        # Queued: the new palette must first have reached every widget, or the rest would be overwritten by it.
        self._palette_watch.changed.connect(self._take_palette, Qt.ConnectionType.QueuedConnection)
        escape = QShortcut(QKeySequence(Qt.Key.Key_Escape), self)
        escape.setContext(Qt.ShortcutContext.ApplicationShortcut)
        escape.activated.connect(self.stop_test)
