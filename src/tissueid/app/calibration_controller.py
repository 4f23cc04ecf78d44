"""Controller of calibrations: start, progress, prompts to the person, result."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from tissueid.app.calibration_page import CalibrationPage
from tissueid.app.calibration_state import calibration_state
from tissueid.app.chooser import InstrumentChooser
from tissueid.app.context import AppContext
from tissueid.app.emergency import EmergencyStop
from tissueid.app.guidance import Guidance
from tissueid.app.live_analysis import LiveAnalysis
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.operator_prompts import CalibrationOutcome, LiveCalibration, OperatorPrompts
from tissueid.app.readouts import SafetyReadouts
from tissueid.app.services import AppServices
from tissueid.app.signals import SignalPlots
from tissueid.app.words import in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.store import create_calibration_folder, stored_calibrations
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.calibration_plans import DynamicSweepPlan, Kind, StaticCalibrationPlan
from tissueid.procedures.instrument_access import opening_after
from tissueid.procedures.test_plan import NO_INSTRUMENT


class CalibrationController(QObject):
    """Starts calibrations and shows their progress and result; they share jobs and STOP with the tests.

    ``answered`` carries the address of a calibrated instrument, and the instrument without a calibration.
    """

    answered = Signal(str, object)

    def __init__(
        self,
        context: AppContext,
        begin_energised: Callable[[Callable[[], None], str], EmergencyStop],
        end_energised: Callable[[], None],
        *,
        page: CalibrationPage,
        instruments: InstrumentChooser,
        notice: Notice,
        guidance: Guidance,
        safety: SafetyReadouts,
        signals: SignalPlots,
        analysis: LiveAnalysis,
        parent: QObject,
    ) -> None:
        super().__init__(parent)
        self._context = context
        self._begin_energised, self._end_energised = begin_energised, end_energised
        self._page, self._instruments = page, instruments
        self._notice, self._guidance, self._safety = notice, guidance, safety
        self._signals, self._analysis = signals, analysis
        self._prompts: OperatorPrompts | None = None
        self._live: LiveCalibration | None = None
        self._report: Path | None = None
        self._url = ""
        self._page.begun.connect(self.begin)
        self._page.answered.connect(self._answer)
        self._page.report_wanted.connect(self._open_report)

    def begin(self, kind: Kind) -> None:
        """Calibrate the chosen instrument."""
        if self._context.busy:
            return
        try:
            plan = self._plan(kind)
        except (TissueIDError, OSError) as error:
            self._notice.say(in_words(error), problem=True, about_form=True)
            return
        self._url = self._instruments.url
        stop = self._begin_energised(self._show, _("Calibrating. Keep hands and cables clear of the probe."))
        self._safety.expect(calibrating=True)
        self._signals.clear()
        self._analysis.hide()
        self._live = LiveCalibration(sweep=kind == "sweep")
        self._prompts = prompts = OperatorPrompts(stop, self._live)
        self._page.expect(kind)
        services = self._context.services
        services = replace(services, opener=opening_after(stop.wait_until_watched, services.opener))
        work = functools.partial(calibrate, plan, prompts, self._context.trail, services)
        why = _("A calibration is running on Measure: stop it there, or wait.")
        self._context.jobs.do(work, self._ended, self._failed, why=why)

    def _plan(self, kind: Kind) -> StaticCalibrationPlan | DynamicSweepPlan:
        """Return the plan of the form.

        Raises:
            UnusableInputError: no instrument is chosen.
        """
        if not self._instruments.url:
            raise UnusableInputError(NO_INSTRUMENT)
        folder = self._context.services.calibrations or create_calibration_folder()
        if kind == "sweep":
            return DynamicSweepPlan(device=self._instruments.url, folder=folder, all_files=True)
        return StaticCalibrationPlan(
            device=self._instruments.url,
            folder=folder,
            all_files=True,
            ambient_c=self._page.ambient_c,
            push_only=not self._page.fixed.isChecked(),
        )

    def _show(self) -> None:
        if self._live is not None:
            snapshot = self._live.snapshot()
            self._safety.show_safety(snapshot.safety)
            self._signals.show_rolling(snapshot)
            self._page.show_curve(*self._live.curve())
        if self._prompts is not None and not self._prompts.cancelled():
            state = self._prompts.snapshot()
            self._page.show_prompts(state)
            said = translated(state.instruction) or _("Calibrating. Keep hands and cables clear of the probe.")
            self._guidance.say(said)

    def _answer(self) -> None:
        if self._prompts is not None:
            self._prompts.answer()

    def _ended(self, outcome: CalibrationOutcome) -> None:
        self._close()
        self._report = outcome.report
        self._page.show_outcome(outcome)
        self._context.note(self._page.headline.text())
        # The same instrument may stand at another address too.
        self._instruments.forget_calibrations()
        self._instruments.tell_calibration(self._url, outcome.state)
        if outcome.nominal is not None:
            self.answered.emit(self._url, outcome.nominal)

    def _failed(self, words: str) -> None:
        notices = [] if self._prompts is None else [sentence(translated(line)) for line in self._prompts.notices]
        self._close()
        self._page.clear()
        self._notice.say(" ".join([words, *notices]), problem=True, page=MEASURE)

    def _close(self) -> None:
        self._end_energised()
        self._prompts = self._live = None
        self._context.show_idle()

    def _open_report(self) -> None:
        if self._report is not None:
            self._context.show_file(self._report)


def calibrate(
    plan: StaticCalibrationPlan | DynamicSweepPlan,
    prompts: OperatorPrompts,
    trail: AuditTrail,
    services: AppServices,
) -> CalibrationOutcome:
    """Run a calibration in the thread that owns the instrument."""
    if isinstance(plan, StaticCalibrationPlan):
        from tissueid.procedures.calibration_runs import run_static_calibration

        result = run_static_calibration(plan, prompts, trail, services.opener, services.now)
    else:
        from tissueid.procedures.calibration_runs import run_sweep

        result = run_sweep(plan, prompts, trail, services.opener, services.now)
    remarks = (*result.notes, *prompts.notices)
    if result.report_error is not None:
        remarks += (
            Message(
                "calibration.no_report",
                "its report could not be written ({problem}); the calibration is complete without it",
                problem=in_words(result.report_error).removesuffix("."),
            ),
        )
    stored = stored_calibrations(plan.folder)
    state = calibration_state(apply_calibrations(result.nominal, stored, datetime.now(UTC)))
    return CalibrationOutcome(result.calibration, result.path, result.report, remarks, state, result.nominal)
