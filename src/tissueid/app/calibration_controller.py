"""Controller of calibrations: start, progress, prompts to the person, samples, result."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject

from tissueid.acquisition.playback import Phase, Progress
from tissueid.app.calibration_page import CalibrationOutcome, CalibrationPage, PromptState
from tissueid.app.chooser import InstrumentChooser
from tissueid.app.context import AppContext, AppServices
from tissueid.app.emergency import EmergencyStop
from tissueid.app.guidance import Guidance
from tissueid.app.live_analysis import LiveAnalysis
from tissueid.app.live_signals import Array, LiveSignals, SafetyWatch, Snapshot
from tissueid.app.navigation_bar import MEASURE
from tissueid.app.notice import Notice
from tissueid.app.readouts import SafetyReadouts
from tissueid.app.signals import SignalPlots
from tissueid.app.words import calibration_state, in_words, sentence
from tissueid.audit import AuditTrail
from tissueid.calibration.active import apply_calibrations
from tissueid.calibration.status import create_calibration_folder, stored_calibrations
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.instrument import CLINICAL, Instrument
from tissueid.language import _
from tissueid.messages import Message, translated
from tissueid.procedures.calibration_plans import DynamicSweepPlan, Kind, StaticCalibrationPlan
from tissueid.procedures.control import Control
from tissueid.procedures.instruments import opening_after
from tissueid.procedures.test_plan import NO_INSTRUMENT
from tissueid.wire import Flag

_WAIT_S = 0.1
_AT_STOP_M = 0.5e-3
"""Distance from the ends of the stroke within which the probe stands on a stop, m."""


class OperatorPrompts(Control):
    """Passes progress and instructions from the calibration thread to the window, and confirmations back.

    ``notices`` are collected for the end. ``live`` follows the samples of the instrument.
    """

    def __init__(self, stop: EmergencyStop, live: LiveCalibration | None = None) -> None:
        self.notices: list[str] = []
        self._live = live
        self._stop = stop
        self._prompts = PromptState()
        self._done = threading.Event()

    def opened(self, instrument: Instrument) -> None:
        """Follow the samples of the instrument from now on."""
        if self._live is not None:
            self._live.watch(instrument)

    def progress(self, fraction: float | None, step: str) -> None:
        """Show the fraction of a step that is done."""
        now = self._prompts
        self._prompts = replace(now, step=step, fraction=now.fraction if fraction is None else fraction)

    def notice(self, message: str) -> None:
        """Keep a notice for the end."""
        self.notices.append(message)

    @property
    def attended(self) -> bool:
        """There is a person at the window."""
        return True

    def ask(self, prompt: str) -> None:
        """Show an instruction; return when the person confirms that it is done.

        Raises:
            CancelledError: the stop was triggered.
        """
        self._done.clear()
        self._prompts = replace(self._prompts, instruction=prompt, answer=True)
        while not self._done.wait(_WAIT_S) and not self._stop.is_set():
            pass
        self.instruct("")
        self.check()

    def instruct(self, prompt: str) -> None:
        """Show an instruction that needs no confirmation; "" removes it."""
        self._prompts = replace(self._prompts, instruction=prompt, answer=False)

    def answer(self) -> None:
        """Confirm that the instruction was carried out."""
        self._done.set()

    def cancelled(self) -> bool:
        """Whether the calibration is being stopped."""
        return self._stop.is_set()

    def check(self) -> bool:
        """Return False, or raise if the stop was triggered.

        Raises:
            CancelledError: the stop was triggered; the message says why.
        """
        return self._stop.check()

    def snapshot(self) -> PromptState:
        """Return the current state."""
        return self._prompts


_CHUNK_S = 0.1
"""A level is averaged over this long for one point of the curve."""
_SETTLED_M = 20e-6
"""Greatest range of the position within such a stretch: the probe stands still."""
_LEAST_RUN_S = 0.5
_SAME_PLACE_M = 0.5e-3
"""A run this near to the one before takes its point over: the gentle test of a sweep, then the strong one."""


class LiveCalibration:
    """Follows one calibration. One thread passes samples to :meth:`take`, another calls the rest.

    ``sweep`` False: the curve is position (m) against current (A) wherever the probe stands still on the spring.
    True: it is the swing for an ampere (m/A, deviation of position over that of current) along the stroke (m), a
    point for each run.
    """

    def __init__(self, *, sweep: bool) -> None:
        self._sweep = sweep
        self._signals = LiveSignals()
        self._lock = threading.Lock()
        self._played: list[NDArray[np.void]] = []
        self._points: list[tuple[float, float]] = []

    def watch(self, instrument: Instrument) -> None:
        """Follow what this instrument samples, from now on."""
        from tissueid.instrument import SimulatedInstrument  # brings the compiler, which the window starts without

        winding = not isinstance(instrument, SimulatedInstrument)
        self._signals.begin(SafetyWatch(instrument.nominal, CLINICAL, winding=winding))
        instrument.observer = self.take

    def take(self, samples: NDArray[np.void]) -> None:
        """Add samples, shape (k,) of SAMPLE."""
        device = self._signals.device
        if device is None:
            return
        self._signals.add(Progress(Phase.STIMULUS, 0.0, samples), device)
        playing = (samples["flags"] & Flag.PLAYING > 0) & np.isfinite(samples["position"])
        if np.any(playing):
            self._played.append(samples[playing])
        rate = device.sample_rate_hz
        if self._sweep:
            if not np.all(playing) and self._played:
                self._end_run(rate)
        elif sum(part.size for part in self._played) >= _CHUNK_S * rate:
            self._end_chunk()

    def snapshot(self) -> Snapshot:
        """Return the newest signals and how safety stands."""
        return self._signals.snapshot()

    def curve(self) -> tuple[Array, Array]:
        """Return the points so far, shape (n,) each: where, and what was found there."""
        with self._lock:
            points = np.array(self._points, np.float64).reshape(-1, 2)
        return points[:, 0], points[:, 1]

    def _end_chunk(self) -> None:
        part, self._played = np.concatenate(self._played), []
        held = np.ptp(part["command"]) == 0.0 and np.ptp(part["position"]) < _SETTLED_M
        stroke_m = float("inf") if self._signals.device is None else self._signals.device.stroke_m
        # At the end of the travel, where the range of motion is found, the probe stands on the stop and on no spring.
        if held and _AT_STOP_M < float(part["position"].mean()) < stroke_m - _AT_STOP_M:
            self._add(float(part["current"].mean()), float(part["position"].mean()))

    def _end_run(self, rate_hz: float) -> None:
        run, self._played = np.concatenate(self._played), []
        if run.size >= _LEAST_RUN_S * rate_hz and (shaken := float(run["current"].std())) > 0.0:
            place_m = float(run["position"].mean())
            if self._points and abs(self._points[-1][0] - place_m) < _SAME_PLACE_M:
                with self._lock:
                    self._points.pop()
            self._add(place_m, float(run["position"].std()) / shaken)

    def _add(self, where: float, what: float) -> None:
        with self._lock:
            self._points.append((where, what))


class CalibrationController(QObject):
    """Starts calibrations and shows their progress and result; they share jobs and STOP with the tests."""

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
            self._context.state.instrument_answered.emit(self._url, outcome.nominal)

    def _failed(self, message: str) -> None:
        notices = [] if self._prompts is None else [sentence(translated(line)) for line in self._prompts.notices]
        self._close()
        self._page.clear()
        self._notice.say(" ".join([message, *notices]), problem=True, page=MEASURE)

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
        from tissueid.procedures.calibrations import run_static_calibration

        result = run_static_calibration(plan, prompts, trail, services.opener, services.now)
    else:
        from tissueid.procedures.calibrations import run_sweep

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
