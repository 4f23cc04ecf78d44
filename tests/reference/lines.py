"""Lines of the conformance suite to the firmwares, in simulated time."""

import math

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.reference.emulator import EmulatedLockstep
from firmware_sim.reference.lockstep import Disturbance, Lockstep
from firmware_sim.tissue import FREE_AIR
from tissueid_lab.conformance.device import Confirmed, DeviceUnderTest
from tissueid_lab.conformance.exchange import Act
from tissueid_lab.conformance.suite import run_suite

STEP = 4
"""Samples between two looks at the line while nothing arrives, by default."""

DISTURBANCES = {
    Act.PRESS_BUTTON: (Disturbance.BUTTON, True),
    Act.RELEASE_BUTTON: (Disturbance.BUTTON, False),
    Act.LOWER_SUPPLY: (Disturbance.SUPPLY_LOW, True),
    Act.RESTORE_SUPPLY: (Disturbance.SUPPLY_LOW, False),
    Act.DISCONNECT_POSITION: (Disturbance.POSITION_STUCK, True),
    Act.CONNECT_POSITION: (Disturbance.POSITION_STUCK, False),
    Act.DISCONNECT_COIL: (Disturbance.COIL_OPEN, True),
    Act.CONNECT_COIL: (Disturbance.COIL_OPEN, False),
}


class SimulatedLine:
    """A line whose time advances when something waits for it; it also plays the person at the device."""

    rate_hz = 2000
    step = STEP

    def __init__(self):
        self.samples = 0
        self.disturbance = Disturbance.NONE

    def clock(self):
        return self.samples / self.rate_hz

    def close(self):
        pass

    def read(self, timeout_s):
        left = math.ceil(timeout_s * self.rate_hz)
        while not (data := self.received()) and left > 0:
            step = min(left, self.step)
            self._advance(step)
            left -= step
        return data

    def pause(self, seconds):
        self._advance(round(seconds * self.rate_hz))

    def perform(self, act):
        bit, on = DISTURBANCES[act]
        self.disturbance = self.disturbance | bit if on else self.disturbance & ~bit
        self.disturb()
        return 0.1

    def _advance(self, samples):
        self.samples += samples
        self.advance(samples)


class ReferenceLine(SimulatedLine):
    """A line to the C firmware in lockstep."""

    def __init__(self, program, *options):
        super().__init__()
        self.device = Lockstep(program, *options)

    def write(self, data):
        self.device.receive(data, round(self.samples / self.rate_hz * 1e6))

    def close(self):
        self.device.close()

    def received(self):
        return self.device.transmit()

    def advance(self, samples):
        self.device.interrupts(samples)

    def disturb(self):
        self.device.disturb(self.disturbance)


class EmulatedLine(SimulatedLine):
    """A line to the C firmware on an emulated microcontroller, whose time passes in grants."""

    def __init__(self, program, plant="free"):
        super().__init__()
        self.device = EmulatedLockstep(program, plant)

    def write(self, data):
        self.device.receive(data)

    def close(self):
        self.device.close()

    def received(self):
        self.device.interrupts(0)
        return self.device.transmit()

    def advance(self, samples):
        self.device.interrupts(samples)

    def disturb(self):
        self.device.disturb(self.disturbance)


class PythonLine(SimulatedLine):
    """A line to the Python firmware."""

    def __init__(self, tissue=FREE_AIR, firmware=Firmware):
        super().__init__()
        self.bench = Bench(tissue, seed=3)
        self.firmware = firmware(self.bench)

    def write(self, data):
        self.firmware.receive(data, self.clock())

    def received(self):
        return self.firmware.transmit(self.clock())

    def advance(self, samples):
        self.firmware.advance(samples, self.clock())

    def disturb(self):
        self.bench.button = Disturbance.BUTTON in self.disturbance
        self.bench.supply_share = 0.1 if Disturbance.SUPPLY_LOW in self.disturbance else 1.0
        self.bench.stuck = {"position"} if Disturbance.POSITION_STUCK in self.disturbance else set()
        self.bench.coil_open = Disturbance.COIL_OPEN in self.disturbance


def run_on(line, only=None, max_force_n=1.0):
    """Run the suite on a line; return the results by id."""
    device = DeviceUnderTest(line, Confirmed("free-coil", max_force_n, 80.0), line)
    try:
        return {item.id: item for item in run_suite(device, only)}
    finally:
        line.close()
