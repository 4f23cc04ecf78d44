"""The machine of the host and the firmwares through the same sequences: the coil is off for both in time."""

import random

import numpy as np
import pytest
from reference.lines import PythonLine, ReferenceLine

from tissueid import wire
from tissueid.errors import TissueIDError
from tissueid.instrument import Limits, SerialInstrument
from tissueid.instrument.run_machine import Mode
from tissueid.wire import Flag, MessageType
from tissueid_lab.conformance.exchange import Act

LIMITS = Limits(max_force_n=1.0, min_position_m=-0.0009, max_position_m=0.0328)
WATCHDOG_S = 0.5
FRAME_S = 0.02
"""A frame of samples, and one turn of the host."""
SILENCE_S = 1.1
"""Time after which the host ends a run of which it hears nothing, s."""


DISTURBANCES = {
    "button": (Act.PRESS_BUTTON, Act.RELEASE_BUTTON),
    "supply": (Act.LOWER_SUPPLY, Act.RESTORE_SUPPLY),
}


SEEDS = [*range(5), *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(5, 200))]


class WatchedLine:
    """A line that can be cut in either direction. What the device plays is read before the cut.

    ``late_s`` is the longest time that the coil was on after the host's run had ended.
    """

    name = "line"

    def __init__(self, line):
        self.line = line
        self.clock = line.clock
        self.cut = set()
        self.host = None
        self.energised = False
        self.ended_s = None
        self.late_s = 0.0
        self._decoder = wire.FrameDecoder()

    def read(self, timeout_s):
        self.line.pause(0.001)  # an answer takes time
        data = self.line.read(min(timeout_s, 0.009))
        for frame in self._decoder.feed(data):
            if frame.type == MessageType.DATA and frame.payload:
                flags = np.frombuffer(frame.payload, wire.SAMPLE)["flags"]
                self.energised = bool(flags[-1] & Flag.ENERGISED)
        self.look()
        return b"" if "to_host" in self.cut else data

    def look(self):
        now = self.clock()
        if self.host is None or self.host.state.limits is not None:
            self.ended_s = None
        elif self.ended_s is None:
            self.ended_s = now
        elif self.energised:
            self.late_s = max(self.late_s, now - self.ended_s)

    def write(self, data):
        if "to_device" not in self.cut:
            self.line.write(data)

    def pause(self, seconds):
        """The host hangs."""
        for _ in range(round(seconds / 0.01)):
            self.read(0.01)

    def close(self):
        pass


def opened(line):
    """A new host on the line: nothing of the old one counts for it."""
    line.host = None
    instrument = SerialInstrument(line, clock=line.clock)
    line.host = instrument
    return instrument


def sequence(seed):
    """What happens, in which order."""
    chance = random.Random(seed)
    events = ["run", "run", "run", "follow", "points", "finish", "release", "poll", "poll", "hang", "button", "supply"]
    cuts = ["cut to_host", "cut to_device", "mend", "clear"]
    happened = [(chance.choice([*events, *cuts]), chance.choice([0.05, 0.2, 0.6])) for _ in range(12)]
    return [("run", 0.1), *happened, ("mend", 0.0), ("open", 0.0), ("run", 0.2)], chance.choice(
        ["release", "cut both", "button", "hang"]
    )


def happen(line, instrument, what, seconds):
    match what.split():
        case ["run" | "follow" as kind]:
            instrument.load(np.full(3000, 1.0))
            if kind == "follow":
                instrument.follow(400, 0.5)
            instrument.arm(LIMITS)
            instrument.start()
        case ["points"]:
            instrument.send(3000, np.full(50, 1.0))
        case ["finish"]:
            instrument.finish()
        case ["release"]:
            instrument.release()
        case ["hang"]:
            line.pause(seconds)
        case ["button" | "supply" as kind]:
            begin, end = DISTURBANCES[kind]
            line.line.perform(begin)
            line.pause(0.01)
            line.line.perform(end)
        case ["cut", way]:
            line.cut |= {"to_host", "to_device"} if way == "both" else {way}
        case ["mend"]:
            line.cut.clear()
        case ["clear"]:
            instrument.clear_faults()
        case _:
            end = line.clock() + seconds
            while line.clock() < end:
                instrument.poll(0.01)


def play_through(line, seed):
    """Play a sequence; return the line, and the times from its end until the coil was off for device and host."""
    events, end = sequence(seed)
    instrument = opened(line)
    for what, seconds in events:
        if what == "open":
            line.pause(0.7)
            assert not line.energised
            instrument = opened(line)
            continue
        try:
            happen(line, instrument, what, seconds)
            happen(line, instrument, "poll", 0.05)
        except TissueIDError:
            instrument.release()
    assert instrument.state.mode is Mode.RUNNING
    assert line.energised
    began = line.clock()
    times = {"device": None, "host": None}
    try:
        happen(line, instrument, end, 0.6)
        while line.clock() < began + 2.0:
            instrument.poll(0.01)
            times["device"] = times["device"] or (None if line.energised else line.clock() - began)
            times["host"] = times["host"] or (None if instrument.state.limits else line.clock() - began)
    except TissueIDError:
        times["host"] = line.clock() - began
        line.pause(0.02)
        times["device"] = times["device"] or line.clock() - began
        assert not line.energised
    line.pause(0.7)
    assert not line.energised
    assert line.late_s <= WATCHDOG_S + FRAME_S
    return end, times


@pytest.mark.parametrize("seed", SEEDS)
def test_the_python_firmware_and_the_host_have_the_coil_off_in_time(seed):
    judge(*play_through(WatchedLine(PythonLine()), seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_c_firmware_and_the_host_have_the_coil_off_in_time(program, seed):
    line = ReferenceLine(program)
    try:
        judge(*play_through(WatchedLine(line), seed))
    finally:
        line.close()


def judge(end, times):
    """Both are off within the watchdog where they hear each other; a host that hears nothing, after its silence."""
    assert times["device"] <= (WATCHDOG_S if end != "hang" else 0.6) + FRAME_S
    assert times["host"] <= (SILENCE_S if end == "cut both" else 0.6) + FRAME_S
