"""What several tests need: a firmware on a loopback link with a clock of its own, so that nothing ever waits."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from firmware_sim.scenario import Scenario
from tissueid.acquisition import Progress, SessionRecorder, journal_path
from tissueid.errors import FirmwareFaultError, LinkLostError
from tissueid.instrument import SerialInstrument
from tissueid.instrument.link import broken_error

TICK_S = 0.01
"""Step of the virtual clock, s: the device sends one frame in each."""

SAMPLES_PER_TICK = 20
LONG_TICK_S = 0.05
"""For long recordings that depend on no timing of frames: 100 samples per frame, of which the protocol allows 128."""


def softly(volts: np.ndarray, loaded: int | None = None) -> np.ndarray:
    """What a run of these volts plays: in sample k of the first 100 no more than sin(90 deg (k + 1)/100) of the most.

    The most is that of the first 100 of the ``loaded`` samples of the stimulus; a set-point's own where it is more.
    """
    played = [float(value) for value in volts]
    most = max((abs(value) for value in played[: min(100, len(played) if loaded is None else loaded)]), default=0.0)
    for k in range(min(100, len(played))):
        bound = max(most, abs(played[k])) * math.sin(math.radians(0.9 * (k + 1)))
        played[k] = max(-bound, min(bound, played[k]))
    return np.array(played)


class LoopbackLink:
    """A cable without a cable: reading moves the virtual clock on, and the firmware with it."""

    def __init__(self, firmware: Firmware) -> None:
        self.name = "loopback"
        self.firmware = firmware
        firmware.samples_per_frame = round(TICK_S * firmware.sample_rate_hz)
        self.now = 0.0
        self.plugged = True
        self.closed = False
        self.to_host: Callable[[bytes], bytes] = lambda data: data
        self.to_device: Callable[[bytes], bytes] = lambda data: data

    def clock(self) -> float:
        return self.now

    def tick(self) -> None:
        self.now += TICK_S
        self.firmware.advance(round(TICK_S * self.firmware.sample_rate_hz), self.now)

    def read(self, timeout_s: float) -> bytes:
        deadline = self.now + timeout_s
        while True:
            if not self.plugged:
                raise broken_error(self.name, OSError("unplugged"))
            self.tick()
            data = self.to_host(self.firmware.transmit(self.now))
            if data or self.now >= deadline:
                return data

    def write(self, data: bytes) -> None:
        if not self.plugged:
            raise broken_error(self.name, OSError("unplugged"))
        self.firmware.receive(self.to_device(data), self.now)

    def close(self) -> None:
        self.closed = True

    def run_for(self, seconds: float) -> None:
        """Let the device live on without a host."""
        end = self.now + seconds
        while self.now < end:
            self.tick()


def connect(
    preset: str = "left-posterior-forearm", seed: int = 1, identity: Identity | None = None
) -> SerialInstrument:
    """A driver on a simulated firmware; its link is ``instrument.link``."""
    link = LoopbackLink(Firmware(Bench(preset, seed=seed), identity, seed=seed))
    return SerialInstrument(link, clock=link.clock)


def connect_scenario(scenario: Scenario) -> SerialInstrument:
    """A driver on the simulated instrument that a scenario describes."""
    link = LoopbackLink(Firmware(scenario.bench(), scenario.identity(), seed=scenario.seed))
    return SerialInstrument(link, clock=link.clock)


MISHAPS = pytest.mark.parametrize(
    ("mishap", "error"),
    [
        (lambda link: setattr(link, "plugged", False), LinkLostError),
        (lambda link: link.firmware.reboot(), FirmwareFaultError),
        (lambda link: link.firmware.stall(link.now + 10), LinkLostError),
        (lambda link: setattr(link.firmware.bench, "button", True), FirmwareFaultError),
    ],
    ids=["unplug", "reset", "stall", "button"],
)
"""What can happen to a link and the device at its end while a test runs, and the error by which the test ends."""


def halfway(instrument: SerialInstrument, mishap: Callable[[LoopbackLink], None]) -> Callable[[Progress], None]:
    """A test's ``progress`` by which a mishap happens, once, when half of the test is over."""
    pending = [mishap]

    def progress(item: Progress) -> None:
        if item.fraction > 0.5 and pending:
            pending.pop()(instrument.link)

    return progress


def left_by_a_power_cut(recorder: SessionRecorder, session: Path) -> Callable[[Progress], None]:
    """A test's ``progress`` that keeps what is on the disk when most of it is over, as the journal of ``session``."""
    left = journal_path(session)

    def progress(item: Progress) -> None:
        if item.fraction > 0.6 and not left.exists():
            recorder.journal.sync()
            shutil.copyfile(journal_path(recorder.path), left)

    return progress
