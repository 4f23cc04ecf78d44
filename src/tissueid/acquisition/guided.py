"""Guided test: place the probe, hold the mean load, play the stimulus, release (thesis 2.4.2, 7.1.1)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.playback import (
    Phase,
    Progress,
    SetPoints,
    ignore_progress,
    never_stop,
    play,
    preload_stimulus,
    rehearse,
    set_point_count,
)
from tissueid.acquisition.quality import Quality
from tissueid.acquisition.recorder import RecordingPreparation, SessionRecorder
from tissueid.acquisition.recovery import OpenTest
from tissueid.acquisition.stimulus_choice import PRELOAD_S
from tissueid.acquisition.surface_detection import PLACE_S, Placement, find_orientation, find_surface, place
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import InstrumentError, LimitError, TissueIDError, UnusableInputError
from tissueid.instrument import (
    CLINICAL,
    SAMPLE,
    Instrument,
    Limits,
    Run,
    check_stimulus,
    is_not_played,
    join_blocks,
    trim_at_release,
)
from tissueid.instrument.force_profile import recorded_force
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim
from tissueid.sessions.model import Test, reason_notes
from tissueid.stimuli.base import Array, FeedbackKind, Stimulus, Unit, to_voltage
from tissueid.test_settings import TestSettings
from tissueid.wire import Flag

__all__ = [
    "PLACE_S",
    "GuidedTest",
    "Phase",
    "Placement",
    "Progress",
    "check_test",
    "find_surface",
    "place",
    "play",
    "run_guided_test",
]

_ACCELEROMETER_END_M_S2 = 2.0 * GRAVITY_M_S2
"""Range of the accelerometer, m/s^2; the reaction of the coil can exceed it in a handheld device."""


@dataclass(frozen=True)
class GuidedTest:
    """Specification of a test: stimulus, settings and limits.

    An open-loop stimulus contains its preload; a feedback stimulus gets one of ``preload_s``. The settings and further
    ``notes`` are stored with the test.
    """

    stimulus: Stimulus | FeedbackKind
    settings: TestSettings
    kind: str = "stochastic"
    limits: Limits = CLINICAL
    repeat_of: int | None = None
    preload_s: float = PRELOAD_S
    notes: dict[str, str | float] = field(default_factory=dict)

    @property
    def opening(self) -> Stimulus:
        """Part that is loaded before the test: the whole stimulus, or the preload of a feedback stimulus.

        Raises:
            UnusableInputError: the preload is shorter than its rise.
        """
        if isinstance(self.stimulus, FeedbackKind):
            return preload_stimulus(self.stimulus, self.preload_s)
        return self.stimulus


_PRECISE = Message("test.precise", "the estimates were precise enough")


def _stop_reason(error: BaseException) -> str:
    """Return the reason why a test was stopped."""
    if isinstance(error, KeyboardInterrupt):
        return Message("test.interrupted", "interrupted")
    if isinstance(error, TissueIDError):
        return error.message
    return Message(
        "test.defect",
        "a defect of the software: {kind}: {error}",
        kind=type(error).__name__,
        error=Verbatim(error),
    )


def check_test(test: GuidedTest, device: DeviceDescription) -> NDArray[np.float64]:
    """Return the command of a test, shape (n,), V, after checking that it can be played.

    For a feedback stimulus the command is the preload; its full force range is checked, and it is rehearsed.

    Raises:
        LimitError: the stimulus exceeds a limit or the amplifier range.
        UnusableInputError: the sample rate differs from the device's, or the source leaves its range.
    """
    opening, kind = test.opening, test.stimulus
    if opening.sample_rate_hz != device.sample_rate_hz:
        raise UnusableInputError(
            "test.sample_rate",
            "the stimulus has a sample rate of {stimulus:g} Hz, the instrument one of {instrument:g} Hz",
            stimulus=opening.sample_rate_hz,
            instrument=device.sample_rate_hz,
        )
    command = _command(opening.values, opening.unit, device, test.limits)
    if isinstance(kind, FeedbackKind):
        ends = np.array([kind.force_min_n, kind.force_max_n])
        _command(np.resize(ends, command.size + set_point_count(kind)), "N", device, test.limits)
        rehearse(kind)
    return command


def _command(values: Array, unit: Unit, device: DeviceDescription, limits: Limits) -> NDArray[np.float64]:
    """Return the command, V, shape (n,), for values (n,); force limit errors are reported in the unit of the values.

    Raises:
        LimitError: the values exceed a limit.
    """
    peak = float(np.max(np.abs(values), initial=0.0))
    if unit == "N" and peak > limits.max_force_n:
        raise LimitError(
            "test.stimulus_force",
            "the stimulus reaches {force:.1f} N; the limit is {limit:.4g} N: reduce the force range with {options}",
            force=peak,
            limit=limits.max_force_n,
            options=Action("test.force_range", "--max-force, --min-force", marked("Lowest force, Highest force")),
        )
    command = to_voltage(values, device, unit)
    check_stimulus(command, device, limits)
    return command


class _Recording:
    """Record one test and judge it by the quality gate at its end."""

    def __init__(
        self,
        instrument: Instrument,
        test: GuidedTest,
        recorder: SessionRecorder,
        placement: Placement,
        progress: Callable[[Progress], None],
    ) -> None:
        self.opening = test.opening
        self.preload_samples = round(self.opening.preload_s * self.opening.sample_rate_hz)
        self.set_points: SetPoints | None = None
        self.planned: Run | None = None
        self.taken = 0
        self.after_release = 0
        self._instrument = instrument
        self._test = test
        self._recorder = recorder
        self._placement = placement
        self._progress = progress
        self._gaps_before = len(instrument.gaps)
        self._open: OpenTest | None = None
        self._preparation = RecordingPreparation()

    def prepare(self) -> None:
        """Check, before the coil is energised, that the test can be recorded and logged.

        Raises:
            JournalError, SessionFormatError, AuditError: it cannot.
        """
        samples = self.opening.values.size + (0 if self.set_points is None else self.set_points.samples)
        settings = self._test.settings
        about = {"site": settings.site, "kind": self._test.kind, "configuration": settings.configuration}
        self._recorder.prepare(samples, limits=self._test.limits, preparation=self._preparation, **about)

    def begin(self, run: Run) -> None:
        """Store the beginning of the run; the coil is energised now."""
        self.planned = run
        limits: dict[str, str | float] = {f"limit_{name}": value for name, value in asdict(self._test.limits).items()}
        attributes: dict[str, Any] = {
            "kind": self._test.kind,
            "configuration": self._test.settings.configuration,
            "site": self._test.settings.site,
            "sample_rate_hz": self._instrument.device.sample_rate_hz,
            "preload_s": self.opening.preload_s,
            "surface_position_m": self._placement.surface_m,
            "stimulus": self.opening.description,
            "seed": self.opening.seed,
            "repeat_of": self._test.repeat_of,
            "notes": limits
            | self._test.settings.as_notes()
            | self._placement.orientation.as_notes()
            | self._test.notes,
        }
        number = self._recorder.begin_test(run, **attributes)
        self._open = OpenTest(Test(number=number, signals={}, **attributes), run)

    def take(self, samples: NDArray[np.void], fraction: float) -> None:
        """Record samples of the run; those after a release are only counted."""
        played = samples[:0] if self.after_release else trim_at_release(samples)
        if played.size < samples.size:
            self.after_release += int(np.count_nonzero(is_not_played(samples[played.size :])))
        if self.after_release and not played.size:
            return
        samples = played
        self._recorder.add(samples)
        if self._open is not None:
            self._open.blocks.append(samples)
        self.taken += samples.size
        phase = Phase.PRELOAD if self.taken < self.preload_samples else Phase.STIMULUS
        self._progress(Progress(phase, fraction, samples))

    def end(self, run: Run, why: Callable[[], str]) -> None:
        """Close a test that was completed, or ended early because the estimates were precise enough."""
        assert self.planned is not None
        early: dict[str, str | float] = {}
        if run.samples < self.planned.samples:
            seconds = (run.samples - self.preload_samples) / self._instrument.device.sample_rate_hz
            reason = Message("test.ended", "ended after {seconds:.2f} s: {why}", seconds=seconds, why=why())
            early = reason_notes(reason) | {"ended_early_s": seconds}
        self._close("completed", run, early)
        self._progress(Progress(Phase.RELEASE, 1.0, np.zeros(0, SAMPLE)))

    def abort(self, error: BaseException) -> None:
        """Close a test that failed; does nothing if the test did not begin."""
        if self.planned is not None:
            self._close("aborted", self.planned, reason_notes(_stop_reason(error)), error)
        else:
            self._recorder.log_not_begun(error, _stop_reason(error), self._preparation)

    def _close(self, status: str, run: Run, notes: dict[str, str | float], cause: BaseException | None = None) -> None:
        for gap in self._instrument.gaps[self._gaps_before :]:
            self._recorder.event("gap", first_index=gap.first_index, count=gap.count)
        if self.set_points is not None:
            notes["late_blocks"] = float(self._instrument.late_blocks)
            notes["held_samples"] = float(self._instrument.held_samples)
            if (margin := self._instrument.setpoint_margin_s) is not None:
                notes["setpoint_margin_s"] = margin
            notes |= self.set_points.notes(run, whole=status == "completed")
        if self.after_release:
            notes["samples_after_release"] = float(self.after_release)
        notes |= self._figures()
        if (quality := self._quality(status, run, notes)) is not None:
            notes |= quality.as_notes()
        self._recorder.end_test(status, run.samples, cause=cause, **notes)

    def _figures(self) -> dict[str, str | float]:
        """Return the mean force on the tissue, including the weight, and the number of saturated samples."""
        samples = join_blocks(self._open.blocks if self._open else ())
        samples = samples[self.preload_samples :]  # during the preload the probe may start at the end of its stroke
        if not samples.size:
            return {}
        device = self._instrument.device
        still = np.abs(samples["acceleration_x"]) < _ACCELEROMETER_END_M_S2
        still &= np.abs(samples["acceleration_y"]) < _ACCELEROMETER_END_M_S2
        figures: dict[str, str | float] = {
            "saturated_samples": float(np.sum(still & ((samples["flags"] & Flag.SATURATED) != 0)))
        }
        if limited := int(np.count_nonzero(samples["flags"] & Flag.LIMITED)):
            figures["limited_samples"] = float(limited)
        coil = recorded_force(samples, device)
        if np.isfinite(coil).any():
            weight = device.weight_n(self._placement.orientation.along_m_s2)
            figures["net_force_n"] = float(np.nanmean(coil)) + weight
        return figures

    def _quality(self, status: str, run: Run, notes: dict[str, str | float]) -> Quality | None:
        """Return the result of the quality gate; None for a test without samples."""
        if self._open is None:
            return None
        self._open.end(status, dict(notes), run.samples)
        test = self._open.close(self._instrument.device)
        if test is None:
            return None
        gate = self._recorder.gate
        if status == "completed":
            try:
                return run_while_polling(self._instrument, lambda: gate.judge(test))
            except InstrumentError:
                pass  # the whole run was received; the error is raised at the next use of the instrument
        return gate.judge(test)


def run_guided_test(
    instrument: Instrument,
    test: GuidedTest,
    recorder: SessionRecorder,
    *,
    surface_m: float | Placement | None = None,
    progress: Callable[[Progress], None] = ignore_progress,
    cancelled: Callable[[], bool] = never_stop,
    enough: Callable[[], bool] = never_stop,
    why: Callable[[], str] = lambda: _PRECISE,
    clock: Callable[[], float] = time.perf_counter,
) -> int:
    """Run and record one guided test; return its number.

    A failed test is closed as aborted with the samples so far, and the error is raised. A test that ends after its
    preload because ``enough`` returned True is completed; its notes hold the time and the reason ``why``. ``surface_m``
    is the surface position or the result of ``place``; without it the probe is placed first, and with a bare position
    the orientation is measured now. ``clock`` measures the computing time of a feedback stimulus. The quality gate
    judges the test before it is closed; the notes hold the result.

    Raises:
        CancelledError, LimitError, InstrumentError, JournalError, AuditError, UnusableInputError.
    """
    device = instrument.device
    test = replace(test, limits=instrument.effective_limits(test.limits))
    command = run_while_polling(instrument, lambda: check_test(test, device), cancelled)
    if surface_m is None:
        placement = place(instrument, test.limits, progress=progress, cancelled=cancelled)
    elif isinstance(surface_m, Placement):
        placement = surface_m
    else:
        placement = Placement(surface_m, find_orientation(instrument, cancelled))
    recording = _Recording(instrument, test, recorder, placement, progress)
    if isinstance(test.stimulus, FeedbackKind):
        recording.set_points = SetPoints(test.stimulus, device, placement.surface_m, command.size, clock=clock)
    try:
        run_while_polling(instrument, recording.prepare, cancelled)
        run = play(
            instrument,
            command,
            test.limits,
            started=recording.begin,
            on_samples=recording.take,
            cancelled=cancelled,
            set_points=recording.set_points,
            enough=lambda: recording.taken > recording.preload_samples and enough(),
        )
    except BaseException as error:
        recording.abort(error)
        raise
    recording.end(run, why)
    return recorder.tests_begun
