"""What the window meets in tests: instruments that are found and opened, and a pace that can be held."""

from __future__ import annotations

import threading

from tissueid.instrument import FoundInstrument, SimulatedInstrument

WAIT_MS = 20_000


def found(*, probe, opener=None):
    return [
        FoundInstrument(
            "/dev/ttyACM7", "serial port", True if probe else None, "desktop indenter, TEST-7" if probe else ""
        ),
        FoundInstrument("simulated://forearm", "simulation in this process", True),
        FoundInstrument("simulated://spring", "simulation in this process", True),
    ]


class Gate:
    """A pace for the simulation that lets so many polls pass and then holds the test until it is told to go on."""

    def __init__(self, passed):
        self.left = passed
        self.reached = threading.Event()
        self.opened = threading.Event()

    def wait(self, seconds):
        self.left -= 1
        if self.left < 0:
            self.reached.set()
            assert self.opened.wait(WAIT_MS / 1000)


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self):
        self.now = 1000.0

    def read(self):
        return self.now


class Bench:
    """Opens simulated instruments and keeps hold of them, to see afterwards what became of the coil."""

    def __init__(self):
        self.opened = []

    def open(self, url):
        instrument = SimulatedInstrument("baseline", seed=3)
        self.opened.append(instrument)
        return instrument
