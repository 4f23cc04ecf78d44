"""Tolerated faults, streaming without loss, and processor time of the host."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from engine_claims.base import Claim
from faults.cells import ORDEALS, run_cell
from faults.schedules import run_schedule
from faults.test_matrix import REPRESENTATIVE
from faults.test_streaming import stream
from firmware_sim_process import firmware_process

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.instrument import Limits, SerialInstrument, SerialLink
from tissueid.stimuli.base import Stimulus
from tissueid.test_settings import TestSettings

SCHEDULES, SCHEDULE_S = 12, 10.0
STREAM_S = 300.0
REAL_S = 10.0
SHARE = 0.10


def claims() -> Iterator[Claim]:
    """A part of the matrix and of the schedules; some minutes of streaming; a real cable by the clock on the wall."""
    yield _matrix()
    yield from _schedules()
    yield _streaming()
    for rate in (2000.0, 10_000.0):
        yield _host_work(rate)


def _matrix() -> Claim:
    problems, longest_s, waited_s = [], 0.0, 0.0
    for name, state in sorted(REPRESENTATIVE):
        with tempfile.TemporaryDirectory() as folder:
            found = run_cell(name, state, Path(folder))
        problems += found.problems
        waited_s = max(waited_s, found.wait_s)
        if ORDEALS[name].codes:
            longest_s = max(longest_s, found.energised_s)
    return Claim(
        f"{len(REPRESENTATIVE)} cells of the fault matrix (docs/safety.md has all): failed cells; longest time that "
        "the coil was energised after a fault that ends a test; longest wait of the host",
        "0; 2 s",
        f"{len(problems)}; {1e3 * longest_s:.0f} ms; {waited_s:.2f} s",
        not problems and waited_s <= 2.0,
    )


def _schedules() -> Iterator[Claim]:
    reports = []
    for seed in range(SCHEDULES):
        with tempfile.TemporaryDirectory() as folder:
            reports.append(run_schedule(10_000 + seed, Path(folder), SCHEDULE_S))
    problems = [problem for report in reports for problem in report.problems]
    faults, broken = sum(item.happened for item in reports), sum(item.broken_off for item in reports)
    completed, waited_s = sum(item.completed for item in reports), max(item.wait_s for item in reports)
    yield Claim(
        f"{SCHEDULES} random schedules of {SCHEDULE_S:g} s (`make soak`: 500 of 30 s), {faults} faults, {completed} "
        f"tests completed, {broken} aborted: violated rules; longest wait of the host",
        "0; 2 s",
        f"{len(problems)}; {waited_s:.2f} s",
        not problems and waited_s <= 2.0,
    )


def _streaming() -> Claim:
    with (
        tempfile.TemporaryDirectory() as folder,
        firmware_process("--tcp=0", "--speed", "20", "--preset", "linear-demo") as (url, _),
    ):
        held, _ = stream(url, Path(folder) / "session.h5", STREAM_S)
    grown = held[-1].bytes - held[len(held) // 5].bytes
    return Claim(
        f"{STREAM_S / 60:g} minutes of tests back to back over TCP with a fast clock (`make soak`: an hour): samples "
        "lost; growth of the program's memory",
        "0; flat",
        f"0; {grown / 1e6:+.1f} MB",
        grown < 4e6,
    )


def _host_work(rate: float) -> Claim:
    """A guided test over a pseudo-terminal in real time: processor time of the whole host, its threads included."""
    count = round(REAL_S * rate)
    rise = np.minimum(np.arange(count) / (0.5 * rate), 1.0)
    values = rise * (2.0 + np.sin(2 * np.pi * 11 * np.arange(count) / rate))
    test = GuidedTest(
        Stimulus(values, rate, {"type": "wave"}, 0, 1.4, preload_s=0.5),
        TestSettings(site="forearm"),
        limits=Limits(max_force_n=6.0),
    )
    with (
        tempfile.TemporaryDirectory() as folder,
        firmware_process("--pty", "--rate", f"{rate:g}", "--preset", "linear-demo") as (url, _),
        SerialInstrument(SerialLink(url)) as instrument,
    ):
        recorder = SessionRecorder(Path(folder) / "session.h5", instrument.device)
        begun: list[tuple[float, float]] = []

        def progress(_: object) -> None:
            begun.append((time.process_time(), time.monotonic()))

        run_guided_test(instrument, test, recorder, surface_m=0.01, progress=progress)
        (used, at), (used_at_last, at_last) = begun[0], begun[-2]  # the last is after the end
        lost = sum(gap.count for gap in instrument.gaps)
        recorder.finish()
    share = (used_at_last - used) / (at_last - at)
    return Claim(
        f"{rate / 1e3:g} kHz x 8 channels over a pseudo-terminal in real time, {REAL_S:g} s: samples lost; processor "
        "time of driver, recorder and journal, of one core",
        "0; under 10 %" if rate == 2000.0 else "0; works",
        f"{lost}; {100 * share:.1f} %",
        lost == 0 and share < SHARE,
    )
