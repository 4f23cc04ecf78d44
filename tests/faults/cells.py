"""The matrix: every fault in every state of a sitting, and what must hold in each cell."""

from __future__ import annotations

import gc
import re
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from faults.desk import LIMITS, LONGEST_WAIT_S, Desk, FaultyLink, WatchedInstrument, WatchedRecorder, virtual_time
from feedback_kinds import PushBack

from firmware_sim.faults import PlannedFault
from firmware_sim.line_faults import LINE_KINDS
from tissueid.acquisition import GuidedTest, run_guided_test
from tissueid.calibration import check_coil
from tissueid.calibration.plans import StaticPlan
from tissueid.calibration.static_procedure import calibrate_static
from tissueid.errors import TissueIDError
from tissueid.instrument import Instrument
from tissueid.messages import codes_in
from tissueid.stimuli.base import Stimulus, preload_values
from tissueid.test_settings import TestSettings
from tissueid.wire import MessageType, State

RATE = 2000.0
PRELOAD_S, SECONDS = 0.5, 0.8
SURFACE_M = 0.01
ADVICE = re.compile(r"\b(check|connect|update|let|repeat|run|measure|wait|place|call|choose|close|switch|put)\b", re.I)
"""A message that says what to do has a word of this kind in it."""


def fault(kind: str, **options: Any) -> PlannedFault:
    """A fault that is let happen by hand: its timing does not matter."""
    return PlannedFault(kind=kind, after_start_s=0.0, **options)


def open_loop(seconds: float = SECONDS, seed: int = 0) -> GuidedTest:
    """3 N and a wave of up to 2.5 N about them, well within the limits; half a minute of it warms the coil little."""
    time = np.arange(round(seconds * RATE)) / RATE
    swing = 1.5 * np.sin(2 * np.pi * 11 * time + seed) + 1.0 * np.sin(2 * np.pi * 37 * time)
    values = np.concatenate([preload_values(3.0, PRELOAD_S, RATE), 3.0 + swing])
    stimulus = Stimulus(values, RATE, {"type": "waves"}, seed, 1.4, preload_s=PRELOAD_S)
    return GuidedTest(stimulus, TestSettings(site="left forearm"), limits=LIMITS)


def feedback(seconds: float = SECONDS, seed: int = 0) -> GuidedTest:
    """Set-points that follow the answers."""
    kind = PushBack(seconds=seconds, force_max_n=7.5, seed=seed)
    return GuidedTest(kind, TestSettings(site="left forearm"), limits=LIMITS, preload_s=PRELOAD_S)


# -- where a sitting stands -------------------------------------------------------------------------------------------


def _at(message: MessageType, state: State, count: int = 1) -> Callable[[FaultyLink], bool]:
    """The device is in that state, and has been sent the message that leads there."""
    return lambda link: link.sent[message] >= count and link.firmware.state is state


def _playing(seconds: float) -> Callable[[FaultyLink], bool]:
    """So much of a run is over."""
    return lambda link: link.sent[MessageType.START] > 0 and link.running >= round(seconds * RATE)


@dataclass(frozen=True)
class Standing:
    """A state of a sitting. ``moment`` says when the device is there; without it the host is between two things."""

    what: str
    moment: Callable[[FaultyLink], bool] | None = None


STATES = {
    "idle": Standing("open, nothing loaded"),
    "loading": Standing("a stimulus is being sent", _at(MessageType.STIMULUS_CHUNK, State.IDLE, 2)),
    "loaded": Standing("a stimulus is loaded", _at(MessageType.STIMULUS_COMMIT, State.LOADED)),
    "armed": Standing("the limits are agreed on", _at(MessageType.ARM, State.ARMED)),
    "preload": Standing("the load rises", _playing(0.1)),
    "stimulus": Standing("the stimulus is played", _playing(PRELOAD_S + 0.2)),
    "feedback": Standing("set-points follow the answers", _playing(PRELOAD_S + 0.2)),
    "release": Standing("the command is ramped to zero", _playing(PRELOAD_S + SECONDS)),
    "between": Standing("between two tests"),
    "checking": Standing("the electrical check holds its voltages", _playing(0.7)),
    "calibrating": Standing("the static calibration holds its voltages", _playing(0.7)),
}


# -- what befalls it, and what comes of it ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Ordeal:
    """A fault and what must come of it.

    ``codes`` are those of which the message has one where the test breaks off; empty where the fault is lived through.
    ``free_s`` is for how long the coil may still be energised after it began, ``free_in_s`` the same for states in
    which it takes longer to show.
    """

    fault: PlannedFault
    codes: frozenset[str] = frozenset()
    free_s: float = 0.0
    free_in_s: dict[str, float] = field(default_factory=dict)
    reopening: str = ""
    """Code of the error of opening as long as it lasts, "" where the instrument can be opened."""


WATCHDOG_S = 0.5 + 0.02
"""The firmware's watchdog, and a tick of either clock."""
AT_REST = {"preload": PRELOAD_S, "checking": 0.3 + 0.1, "calibrating": 0.6 + 0.1}
"""Under a steady force nothing moves, and a sensor that is stuck tells the same as one that is not: up to its end."""
FOR_GOOD = 600.0
GAPS = frozenset({"calibration.samples_lost.voltage", "calibration.samples_lost.rest"})
"""Codes of a calibration that makes nothing of what it did not receive."""
SILENT, BROKEN, RESTARTED = (frozenset({code}) for code in ("link.silent", "link.broken", "instrument.restarted"))
ONE_SAMPLE_S = 1.0 / RATE

ORDEALS = {
    "single bit flips, 5 % of frames": Ordeal(fault("bit_flips", share=0.05)),
    "bit flips in bursts": Ordeal(fault("bit_flips", pieces="bursts", share=0.003)),
    "lost frames, 5 %": Ordeal(fault("drops", share=0.05)),
    "lost bursts of bytes": Ordeal(fault("drops", pieces="bursts", share=0.003)),
    "frames twice, 10 %": Ordeal(fault("duplicates")),
    "bursts of bytes twice": Ordeal(fault("duplicates", pieces="bursts", share=0.003)),
    "frames out of order, 5 %": Ordeal(fault("reordering")),
    "bursts out of order": Ordeal(fault("reordering", pieces="bursts", share=0.003)),
    "clock 2 % fast": Ordeal(fault("drifting_clock", clock_error=0.02)),
    "clock 2 % slow": Ordeal(fault("drifting_clock", clock_error=-0.02)),
    "clock drifting, 1 % a second": Ordeal(fault("drifting_clock", clock_error=0.0, clock_drift_per_s=0.01)),
    "firmware hangs 0.1 s": Ordeal(fault("stall", seconds=0.1)),
    "firmware hangs 2 s": Ordeal(fault("stall"), SILENT, WATCHDOG_S),
    "reset": Ordeal(fault("reset"), RESTARTED),
    "brown-out": Ordeal(fault("brown_out"), frozenset({"fault.brown_out"})),
    "position stuck": Ordeal(fault("stuck_sensor", channel="position"), frozenset({"fault.sensor"}), 0.15, AT_REST),
    "current stuck": Ordeal(fault("stuck_sensor", channel="current"), frozenset({"fault.open_coil"}), 0.15, AT_REST),
    "temperature stuck": Ordeal(fault("stuck_sensor", channel="temperature")),
    "open coil": Ordeal(fault("open_coil"), frozenset({"fault.open_coil"}), 0.05),
    "another version after a reset": Ordeal(fault("wrong_version"), RESTARTED, reopening="handshake.software_too_old"),
    "frames of another version, 10 %": Ordeal(
        fault("wrong_version_frames", direction="to_host"), frozenset({"link.version_changed"}), WATCHDOG_S
    ),
    "the host hears nothing": Ordeal(
        fault("drops", share=1.0, direction="to_host", seconds=FOR_GOOD),
        SILENT,
        WATCHDOG_S,
        reopening="link.no_instrument",
    ),
    "the device hears nothing": Ordeal(
        fault("drops", share=1.0, direction="to_device", seconds=FOR_GOOD),
        frozenset({"link.silent", "link.no_answer", "fault.watchdog"}),
        WATCHDOG_S,
        reopening="link.no_instrument",
    ),
    "unplugged": Ordeal(fault("unplug"), BROKEN, WATCHDOG_S, reopening="link.not_opened"),
    "unplugged for 0.3 s": Ordeal(fault("unplug", seconds=0.3), BROKEN, WATCHDOG_S),
    "button": Ordeal(fault("button"), frozenset({"fault.button"}), ONE_SAMPLE_S),
}


@dataclass
class Outcome:
    """What came of a cell: whether it broke off and how, for how long the coil was energised, and what went wrong."""

    message: str | None = None
    energised_s: float = 0.0
    wait_s: float = 0.0
    lost_samples: int = 0
    problems: list[str] = field(default_factory=list)


def run_cell(name: str, state: str, folder: Path) -> Outcome:
    """A test, the fault in that state of what comes next, opening again, and one more test."""
    gc.collect()  # of the cell before: few objects, and in circles, but megabytes of samples
    with virtual_time():
        return _Sitting(ORDEALS[name], state, folder, zlib.crc32(f"{name} {state}".encode())).run()


class _Sitting:
    """The sitting of one cell."""

    def __init__(self, ordeal: Ordeal, state: str, folder: Path, seed: int) -> None:
        self.ordeal = ordeal
        self.state = state
        self.folder = folder
        self.desk = Desk(seed, "calibration-spring" if state == "calibrating" else "left-posterior-forearm")
        self.out = Outcome()

    def run(self) -> Outcome:
        desk, out = self.desk, self.out
        instrument = desk.open()
        recorder = desk.recorder(self.folder / "sitting.h5", instrument)
        run_guided_test(instrument, open_loop(seed=1), recorder, surface_m=SURFACE_M)
        recorder.journal.sync()
        first_run = desk.bench.samples
        out.message = self._attempt(instrument, recorder)
        out.wait_s = desk.link.longest_wait_s
        if desk.begun is None:
            out.problems.append("the fault did not happen")
            desk.begun = first_run
        if self.ordeal.fault.kind in LINE_KINDS and not desk.link.faults.line.touched:
            out.problems.append("the fault touched nothing")
        if out.message is not None:
            desk.settle(0.7)
            out.energised_s = desk.energised_since(desk.begun)
            if desk.firmware.energised:
                out.problems.append("the coil is energised after the test")
            self._judge_message(out.message)
        elif self.ordeal.codes:
            out.problems.append("nothing was noticed")
        recorder.journal.sync()
        out.problems += desk.lost_in_a_power_cut(recorder, self.folder)
        self._go_on(recorder)
        out.wait_s = max(out.wait_s, desk.link.longest_wait_s)
        if out.wait_s > LONGEST_WAIT_S:
            out.problems.append(f"nothing happened for {out.wait_s:.2f} s")
        out.problems += desk.beyond_limits()
        return out

    def _attempt(self, instrument: WatchedInstrument, recorder: WatchedRecorder) -> str | None:
        """What comes next, with the fault in it; its message where it broke off."""
        desk, state = self.desk, self.state
        try:
            if state == "idle":
                instrument.close()
                instrument = desk.open()
            moment = STATES[state].moment
            if moment is None:
                rest(instrument, 0.1)
                desk.befall(self.ordeal.fault)
                rest(instrument, 1.5)
            else:
                rest(instrument, 0.1)  # the release of the test before is over
                desk.befall_when(moment, self.ordeal.fault)
            if state == "checking":
                check_coil(instrument, LIMITS)
            elif state == "calibrating":
                calibrate_static(instrument, StaticPlan(steps=("electrical", "range")))
            else:
                test = feedback(seed=2) if state == "feedback" else open_loop(seed=2)
                run_guided_test(instrument, test, recorder, surface_m=SURFACE_M)
            if state == "release":
                # The run was over: it shows while nothing is played, or in the next test.
                rest(instrument, 1.5)
                run_guided_test(instrument, open_loop(seed=4), recorder, surface_m=SURFACE_M)
        except TissueIDError as error:
            return error.message
        finally:
            desk.link.progress()
            instrument.close()
        return None

    def _judge_message(self, message: str) -> None:
        ordeal, problems = self.ordeal, self.out.problems
        codes = codes_in(message)
        if not ordeal.codes and codes & GAPS and self.state in ("checking", "calibrating"):
            return
        if not ordeal.codes:
            problems.append(f"it should have been lived through: {message}")
        elif not codes & ordeal.codes:
            problems.append(f"the message is of something else: {message}")
        if "\n" in message or not ADVICE.search(message):
            problems.append(f"the message does not say in a line what to do: {message}")
        most = ordeal.free_in_s.get(self.state, ordeal.free_s)
        if self.out.energised_s > most + 1e-9:
            problems.append(f"the coil was energised for {self.out.energised_s:.4f} s, {most:g} s at most")

    def _go_on(self, recorder: WatchedRecorder) -> None:
        """The fault is over: the same program opens the instrument again and completes a test."""
        desk, problems = self.desk, self.out.problems
        if self.ordeal.reopening:
            try:
                desk.open().close()
                problems.append("it could be opened although the fault lasted")
            except TissueIDError as error:
                if error.code != self.ordeal.reopening or "\n" in str(error):
                    problems.append(f"opening said: {error}")
        desk.link.faults.clear()
        desk.link.progress()
        try:
            instrument = desk.open()
            instrument.move_stage(SURFACE_M)  # a calibration leaves it anywhere
            last = run_guided_test(instrument, open_loop(seed=3), recorder, surface_m=SURFACE_M)
            instrument.close()
        except TissueIDError as error:
            problems.append(f"it does not go on: {error}")
            recorder.abandon()
            return
        session = recorder.finish()
        if session.test(1).status != "completed" or session.test(last).status != "completed":
            problems.append("a test without a fault was not completed")
        for number in (1, last):
            if np.isnan(session.test(number).signals["position"]).any():
                problems.append(f"test {number} has gaps")
        self.out.lost_samples = sum(int(np.isnan(test.signals["position"]).sum()) for test in session.tests)
        problems += desk.invented(recorder, session)


def rest(instrument: Instrument, seconds: float) -> None:
    """The host keeps reading, and plays nothing."""
    link = instrument.link  # type: ignore[attr-defined]
    end = link.now + seconds
    while link.now < end:
        instrument.poll(0.05)
