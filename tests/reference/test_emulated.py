"""The cross-compiled firmware on an emulated microcontroller, in lockstep: its time passes in grants of the test."""

import struct
import subprocess
import sys

import pytest
from reference.lines import EmulatedLine, run_on

from firmware_sim.reference.bounds import TIMINGS, bounds_of
from tissueid.instrument import SerialLink
from tissueid.wire import Frame, FrameDecoder, MessageType, encode_frame
from tissueid_lab.conformance.clause import CLAUSES
from tissueid_lab.conformance.device import Confirmed, DeviceUnderTest
from tissueid_lab.conformance.exchange import LinkLine
from tissueid_lab.conformance.suite import run_suite

QUICK = ("2a", "4.6c", "5.3a")


@pytest.mark.parametrize(
    ("plant", "clauses"),
    [
        ("free", QUICK),
        pytest.param("free", tuple(CLAUSES), marks=pytest.mark.soak),
        pytest.param("dummy", tuple(CLAUSES), marks=pytest.mark.soak),
    ],
)
def test_the_emulated_firmware_conforms(emulated, plant, clauses):
    line = EmulatedLine(emulated, plant)
    results = run_on(line, clauses)
    assert {item.id: (item.outcome, item.reason) for item in results.values() if item.outcome != "passed"} == {}
    assert results.keys() == set(clauses)
    assert line.device.counted_instructions < bounds_of(emulated, TIMINGS["qemu"]).instructions
    assert line.device.masked_instructions < 600
    print(
        f"{line.device.counted_instructions:.0f} instructions of a sample interrupt, masked for "
        f"{line.device.masked_instructions:.0f}"
    )


UNTIMED = (
    *("2a", "2b", "2c", "2f", "3a", "3b", "4.1b", "4.1c", "4.2a", "4.2c", "4.3a", "4.3b", "4.3c", "4.4a"),
    *("5.3a", "5.3b", "5.3c", "5.3d", "5.3e", "5.4b", "5.4d", "5.10a"),
)
"""Clauses without a statement about time: in real time this computer may be busy."""


@pytest.mark.soak
def test_the_emulated_firmware_conforms_over_a_port_in_real_time(emulated):
    server = [sys.executable, "-m", "firmware_sim.reference.emulator", "--plant", "free"]
    with subprocess.Popen(server, stdout=subprocess.PIPE, text=True) as process:
        link = SerialLink(process.stdout.readline().strip())
        device = DeviceUnderTest(LinkLine(link), Confirmed("free-coil", 1.0, 60.0))
        results = run_suite(device, UNTIMED)
        link.close()
        process.terminate()
    assert {item.id: (item.outcome, item.reason) for item in results if item.outcome != "passed"} == {}


def test_two_runs_of_the_emulator_are_the_same(emulated):
    """Time is counted in instructions: the samples do not depend on how busy this computer is."""

    def samples():
        line = EmulatedLine(emulated)
        try:
            line.write(encode_frame(Frame(MessageType.HELLO, 1, payload=b"\1\1" + bytes(30))))
            line.write(encode_frame(Frame(MessageType.STREAM, 2, payload=b"\1")))
            line.advance(201)  # the first one only sets a command
            return line.received()
        finally:
            line.close()

    first, second = samples(), samples()
    assert first == second
    frames = [frame for frame in FrameDecoder().feed(first) if frame.type == MessageType.DATA]
    assert [frame.sample_index for frame in frames] == list(range(0, 200, 20))
    assert len({struct.unpack_from("<h", frame.payload, 4) for frame in frames}) > 1
