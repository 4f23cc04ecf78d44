"""An hour of tests one after another on a real cable: no sample is lost, and the program does not grow."""

import os
import resource
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from firmware_sim_process import firmware_process

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.instrument import Limits, SerialInstrument, SerialLink
from tissueid.sessions import read_session
from tissueid.stimuli.base import Stimulus
from tissueid.test_settings import TestSettings

RATE = 2000.0
TEST_S = 20.0
LIMITS = Limits(max_force_n=3.0, max_seconds=25.0)
PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096
GROWTH_BYTES = 4e6
"""What the program may grow by in the last four fifths: less than the samples of 20 s take in memory."""
MOST_TO_WRITE_BYTES = 60e6
"""What writing the session may take: some tests of it, and not the hour, which is 660 MB."""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads the memory of a process as Linux tells it")


@dataclass(frozen=True)
class Usage:
    """What the program holds at one moment."""

    bytes: int
    threads: int
    files: int


def usage():
    resident = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE
    return Usage(resident, threading.active_count(), len(list(Path("/proc/self/fd").iterdir())))


def gentle(seconds):
    """1 N and a wave of half of it: an hour of it does not warm the coil."""
    time = np.arange(round(seconds * RATE)) / RATE
    rise = np.minimum(time / 0.5, 1.0)
    values = rise * (1.0 + 0.5 * np.sin(2 * np.pi * 7 * time))
    return GuidedTest(
        Stimulus(values, RATE, {"type": "wave"}, 0, 1.4, preload_s=0.5), TestSettings(site="forearm"), limits=LIMITS
    )


def stream(url, path, seconds):
    """Run tests back to back for a time of the device, s; return the memory of the program after each.

    The second figure is by how much more, in bytes, it held at its most while the session was written.
    """
    held = []
    with SerialInstrument(SerialLink(url)) as instrument:
        recorder = SessionRecorder(path, instrument.device)
        while len(held) * TEST_S < seconds:
            run_guided_test(instrument, gentle(TEST_S), recorder, surface_m=0.01)
            held.append(usage())
        assert instrument.gaps == []
        assert instrument.statistics.refused == 0
        assert instrument.status.dropped_frames == 0
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        recorder.write()
    return held, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before


def check(held):
    later = held[len(held) // 5 :]
    slope, _ = np.polyfit(np.arange(len(later)), [item.bytes for item in later], 1)
    assert slope * len(later) < GROWTH_BYTES, f"{slope:.0f} bytes a test, {[item.bytes for item in held]}"
    assert len({item.threads for item in later}) == 1
    assert max(item.files for item in later) == later[0].files


@pytest.mark.soak
@pytest.mark.parametrize("cable", ["--pty", "--tcp=0"])
def test_an_hour_of_tests_loses_nothing_and_does_not_grow(cable, tmp_path):
    hour = 3600.0
    with firmware_process(cable, "--speed", "20", "--preset", "linear-demo") as (url, _):
        held, at_the_end = stream(url, tmp_path / "session.h5", hour)
    check(held)
    assert at_the_end < MOST_TO_WRITE_BYTES
    session = read_session(tmp_path / "session.h5")
    assert len(session.tests) == len(held) == round(hour / TEST_S)
    for test in session.tests:
        assert test.status == "completed"
        assert test.samples == round(TEST_S * RATE)
        assert not any(np.isnan(signal).any() for signal in test.signals.values())
    print(
        f"{cable}: {held[0].bytes / 1e6:.0f} MB after the first test, {held[-1].bytes / 1e6:.0f} after the last; "
        f"at its most {at_the_end / 1e6:.0f} MB more while the session was written"
    )
