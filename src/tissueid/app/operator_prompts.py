"""Communication between the window and the calibration thread: progress, prompts to the person, and samples."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playback import Phase, Progress
from tissueid.app.calibration_state import CalibrationState
from tissueid.app.emergency import EmergencyStop
from tissueid.app.live_signals import Array, LiveSignals, Snapshot
from tissueid.app.safety import SafetyWatch
from tissueid.calibration.file import Calibration
from tissueid.device import DeviceDescription
from tissueid.instrument import CLINICAL, Instrument
from tissueid.procedures.control import Control
from tissueid.wire import Flag

_WAIT_S = 0.1
_AT_STOP_M = 0.5e-3
"""Distance from the ends of the stroke within which the probe stands on a stop, m."""


@dataclass(frozen=True)
class CalibrationOutcome:
    """The result. ``remarks`` are further messages, ``state`` is the new state of the instrument's calibration.

    ``nominal`` is the instrument as it answered, without a calibration.

    ``report`` is None if it could not be written; the calibration is valid without it.
    """

    calibration: Calibration
    path: Path
    report: Path | None
    remarks: tuple[str, ...]
    state: CalibrationState = field(default_factory=CalibrationState)
    nominal: DeviceDescription | None = None


@dataclass(frozen=True)
class PromptState:
    """State of a running calibration: its step, the fraction done, and the instruction to the person.

    With ``answer`` the person has to confirm that it is done; otherwise the instrument detects it.
    """

    step: str = ""
    fraction: float = 0.0
    instruction: str = ""
    answer: bool = False


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
