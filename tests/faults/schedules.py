"""Half a minute of tests one after another, while faults come as they like. Everything follows from the seed."""

from __future__ import annotations

import gc
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from faults.cells import ADVICE, SURFACE_M, feedback, open_loop, rest
from faults.desk import LIMITS, LONGEST_WAIT_S, Desk, WatchedInstrument, WatchedRecorder, virtual_time

from firmware_sim.faults import FAULT_KINDS, FaultInjector, PlannedFault
from firmware_sim.line_faults import LINE_KINDS
from tissueid.acquisition import GuidedTest, run_guided_test
from tissueid.errors import CancelledError, TissueIDError
from tissueid.sessions import Session
from tissueid.stimuli.base import FeedbackKind, to_voltage
from tissueid.wire import State

SECONDS = 30.0
MOST_ENERGISED_S = LIMITS.max_seconds + 1.0
RELEASED_S = 0.6
"""After a test broke off, the firmware's watchdog has spoken, whatever the host could say."""
ONE_CODE_V = 60.0 / 32768.0


def schedule(seed: int, seconds: float = SECONDS) -> list[PlannedFault]:
    """Some faults: any kind, at any time or in any state, of any strength, for up to some seconds."""
    rng = random.Random(seed)
    faults = []
    for _ in range(rng.randint(2, 3 + round(seconds / 5.0))):
        kind = rng.choice([name for name in FAULT_KINDS if name != "replug"])
        options: dict[str, Any] = {"seconds": round(rng.choice([0.05, 0.3, 1.0, 3.0]) * rng.uniform(0.5, 1.5), 3)}
        if kind in LINE_KINDS:
            options["direction"] = rng.choice(["both", "to_host", "to_device"])
            options["share"] = rng.choice([0.01, 0.05, 0.2, 1.0])
            options["pieces"] = "frames" if kind == "wrong_version_frames" else rng.choice(["frames", "bursts"])
        elif kind == "stuck_sensor":
            options["channel"] = rng.choice(["position", "current", "temperature"])
        elif kind == "drifting_clock":
            options |= {"clock_error": rng.uniform(-0.02, 0.02), "clock_drift_per_s": rng.uniform(-0.01, 0.01)}
        if rng.random() < 0.4:
            options["in_state"] = rng.choice(["idle", "loaded", "armed", "running", "running"])
            options["after_s"] = round(rng.uniform(0.0, 0.8), 3) if options["in_state"] == "running" else 0.0
        else:
            options["after_start_s"] = round(rng.uniform(0.0, 0.9 * seconds), 3)
        faults.append(PlannedFault(kind=kind, **options))
    return faults


@dataclass
class Report:
    """What came of one schedule."""

    problems: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    completed: int = 0
    broken_off: int = 0
    happened: int = 0
    wait_s: float = 0.0
    """The longest that the host went without getting anywhere."""
    free_s: float = 0.0
    """The longest that the coil was energised after a test had broken off."""
    greatest_force_n: float = 0.0


def run_schedule(seed: int, folder: Path, seconds: float = SECONDS) -> Report:
    """Tests until the time is over, whatever happens; then all that was recorded is looked at."""
    with virtual_time():
        report = _Sitting(seed, folder, seconds).run()
    gc.collect()  # few objects, and in circles, but ten megabytes of samples
    return report


class _Sitting:
    """The sitting of one schedule."""

    def __init__(self, seed: int, folder: Path, seconds: float) -> None:
        self.seed, self.seconds = seed, seconds
        self.rng = random.Random(seed + 1_000_000)
        self.folder = folder
        self.desk = Desk(seed)
        self.link = self.desk.link
        self.report = Report()
        self.planned: dict[int, GuidedTest] = {}

    def run(self) -> Report:
        open_now: WatchedInstrument | None = self.desk.open()
        recorder = self.desk.recorder(self.folder / "sitting.h5", open_now)
        self.link.faults = FaultInjector(
            self.desk.firmware, self.link, schedule(self.seed, self.seconds), seed=self.seed
        )
        self.link.to_host, self.link.to_device = self.link.faults.line.to_host, self.link.faults.line.to_device
        while self.link.now < self.seconds:
            try:
                if open_now is None:
                    open_now = self.desk.open()
                self._one_test(open_now, recorder)
                rest(open_now, self.rng.uniform(0.0, 0.5))
            except TissueIDError as error:
                self._broke_off(error, recorder)
                if open_now is not None:
                    open_now.close()
                open_now = None
                self.desk.settle(self.rng.uniform(0.1, 1.0))
        self._end(open_now, recorder)
        return self.report

    def _one_test(self, instrument: WatchedInstrument, recorder: WatchedRecorder) -> None:
        """A test of either kind; sometimes it is cancelled, or enough is known, or the probe is placed first."""
        rng, link = self.rng, self.link
        make = feedback if rng.random() < 0.4 else open_loop
        test = make(seconds=rng.uniform(0.5, 2.5), seed=rng.randrange(100))
        stop_s = link.now + rng.uniform(0.5, 2.0) if rng.random() < 0.1 else np.inf
        enough_s = link.now + rng.uniform(1.0, 2.0) if rng.random() < 0.1 else np.inf
        self.planned[recorder.tests_begun + 1] = test
        run_guided_test(
            instrument,
            test,
            recorder,
            surface_m=None if rng.random() < 0.15 else SURFACE_M,
            cancelled=lambda: link.now >= stop_s,
            enough=lambda: link.now >= enough_s,
        )
        self.report.completed += 1
        if rng.random() < 0.3:
            recorder.journal.sync()
            self.report.problems += self.desk.lost_in_a_power_cut(recorder, self.folder)

    def _broke_off(self, error: TissueIDError, recorder: WatchedRecorder) -> None:
        """The message helps, the coil is free in time, and what is acknowledged would survive a power cut now."""
        desk, report = self.desk, self.report
        report.broken_off += 1
        report.messages.append(str(error))
        self.link.progress()
        if "\n" in str(error) or not (isinstance(error, CancelledError) or ADVICE.search(str(error))):
            report.problems.append(f"the message does not say in a line what to do: {error}")
        before = desk.bench.samples
        desk.settle(RELEASED_S)
        report.free_s = max(report.free_s, desk.energised_since(before))
        if desk.firmware.energised:
            report.problems.append(f"the coil is energised {RELEASED_S} s after: {error}")
        if self.rng.random() < 0.5:
            recorder.journal.sync()
        report.problems += desk.lost_in_a_power_cut(recorder, self.folder)

    def _end(self, instrument: WatchedInstrument | None, recorder: WatchedRecorder) -> None:
        desk, report = self.desk, self.report
        if instrument is not None:
            instrument.close()
        report.happened = desk.link.faults.happened
        desk.link.faults.clear()
        desk.settle()
        if desk.firmware.energised or desk.firmware.state in (State.ARMED, State.RUNNING):
            report.problems.append("the coil is not free at the end")
        try:
            last = desk.open()
            self.planned[recorder.tests_begun + 1] = test = open_loop()
            run_guided_test(last, test, recorder, surface_m=SURFACE_M)
            last.close()
        except TissueIDError as error:
            report.problems.append(f"it does not go on when all is over: {error}")
        self._look_at(recorder, recorder.finish())
        report.wait_s = desk.link.longest_wait_s
        if report.wait_s > LONGEST_WAIT_S:
            report.problems.append(f"nothing happened for {report.wait_s:.2f} s")
        energised = desk.bench.energised()
        edges = np.flatnonzero(np.diff(np.concatenate([[0], energised.astype(np.int8), [0]])))
        if (longest := float(np.max(np.diff(edges)[::2], initial=0)) / 2000.0) > MOST_ENERGISED_S:
            report.problems.append(f"the coil was energised for {longest:.1f} s at a stretch")
        force = np.abs(desk.bench.truth("current")) * desk.bench.parameters.force_constant_n_per_a
        report.greatest_force_n = float(force.max())
        report.problems += desk.beyond_limits()

    def _look_at(self, recorder: WatchedRecorder, session: Session) -> None:
        """Everything recorded is there, was measured, and what is called complete was played as it was planned."""
        self.report.problems += self.desk.invented(recorder, session)
        for test in session.tests:
            planned = self.planned.get(test.number)
            if test.status != "completed" or planned is None or isinstance(planned.stimulus, FeedbackKind):
                continue
            command = np.asarray(test.signals["command"])
            wanted = to_voltage(planned.stimulus.values, session.instrument)[: command.size]
            if np.nanmax(np.abs(command - wanted)) > ONE_CODE_V:
                self.report.problems.append(f"test {test.number} is complete, and another command was played")
