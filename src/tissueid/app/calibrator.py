"""What the window does about calibrations: begins one, shows it, asks the person, tells what came of it."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject

from tissueid.app.conversation import CalibrationOutcome, CalibrationPlan, Conversation, Kind
from tissueid.app.layout import MEASURE
from tissueid.app.live_calibration import LiveCalibration
from tissueid.app.words import in_words
from tissueid.audit import Trail
from tissueid.calibration.store import made_folder
from tissueid.errors import TissueIDError
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.main_window import MainWindow


class Calibrator(QObject):
    """Stands beside the tests of the window: the same jobs, the same STOP, one at a time."""

    def __init__(self, window: MainWindow) -> None:
        super().__init__(window)
        self._window = window
        self._page = window.ui.calibration
        self._talk: Conversation | None = None
        self._live: LiveCalibration | None = None
        self._report: Path | None = None
        self._url = ""
        self._page.begun.connect(self.begin)
        self._page.answered.connect(self._answer)
        self._page.report_wanted.connect(self._open_report)

    def begin(self, kind: Kind) -> None:
        """Calibrate the chosen instrument."""
        from tissueid.app.calibrating import calibrate

        window, around = self._window, self._window.around
        if window.busy:
            return
        try:
            folder = around.calibrations or made_folder()
            plan = CalibrationPlan(
                window.ui.form.instrument.url, kind, folder, self._page.ambient_c, not self._page.fixed.isChecked()
            )
            plan.check()
        except (TissueIDError, OSError) as error:
            window.ui.notice.say(in_words(error), problem=True, about_form=True)
            return
        self._url = plan.url
        stop = window.energise(self._show)
        window.ui.safety.expect(calibrating=True)
        window.ui.signals.clear()
        window.ui.analysis.hide()
        self._talk = talk = Conversation(stop)
        self._live = live = LiveCalibration(sweep=kind == "sweep")
        trail = Trail(around.audit, window.ui.role.role)
        self._page.expect(kind)
        window.ui.guidance.say(_("Calibrating. Keep hands and cables clear of the probe."))
        work = functools.partial(calibrate, plan, talk, stop, around.opener, trail, around.now, live)
        why = _("A calibration is running on Measure: stop it there, or wait.")
        window.jobs.do(work, self._ended, self._failed, why=why)
        window.ui.stop.setFocus()

    def _show(self) -> None:
        if self._live is not None:
            glance = self._live.glance()
            self._window.ui.safety.show_safety(glance.safety)
            self._window.ui.signals.show_rolling(glance)
            self._page.show_curve(*self._live.curve())
        if self._talk is not None and not self._talk.stopped:
            talk = self._talk.look()
            self._page.show_talk(talk)
            self._window.ui.guidance.say(talk.wanted or _("Calibrating. Keep hands and cables clear of the probe."))

    def _answer(self) -> None:
        if self._talk is not None:
            self._talk.answer()

    def _ended(self, outcome: CalibrationOutcome) -> None:
        self._close()
        self._report = outcome.report
        self._page.show_outcome(outcome)
        self._window.panels.log.note(self._page.headline.text())
        # The same instrument may stand at another address too.
        chooser = self._window.ui.form.instrument
        chooser.forget_calibrations()
        chooser.tell_calibration(self._url, outcome.state)

    def _failed(self, words: str) -> None:
        self._close()
        self._page.rest()
        self._window.ui.notice.say(words, problem=True, page=MEASURE)

    def _close(self) -> None:
        self._window.free()
        self._talk = self._live = None
        self._window.ui.guidance.rest()

    def _open_report(self) -> None:
        if self._report is not None:
            self._window.reports.show(self._report)
