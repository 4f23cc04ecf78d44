"""The stage of the reference firmware while it moves, and the firmware as a process on a real port."""

import socket
import struct
import subprocess
import sys
import time

import pytest
from reference.lines import ReferenceLine

from firmware_sim.reference.build import QEMU, MissingToolError, build, qemu_command
from firmware_sim.reference.lockstep import Disturbance
from tissueid.errors import InstrumentError
from tissueid.instrument import SerialLink
from tissueid.instrument.conformance import Confirmed, DeviceUnderTest, LinkLine, run_suite
from tissueid.wire import Fault, Frame, MessageType, Result, State, encode_frame

SLOW = ("--plant", "free", "--stage", "0.02")


@pytest.fixture
def device(program):
    line = ReferenceLine(program, *SLOW)
    device = DeviceUnderTest(line, Confirmed("free-coil", 1.0, 60.0), line)
    device.prepare()
    yield device
    line.close()


def move(device, position_m=0.018):
    """Send STAGE once; 10 mm at 20 mm/s take half a second."""
    device.send(MessageType.STAGE, struct.pack("<d", position_m), sequence=0x600)


def acks(frames):
    return [
        frame.payload for frame in frames if frame.type == MessageType.ACK and frame.payload[0] == MessageType.STAGE
    ]


def test_a_stage_is_answered_once_when_it_has_arrived(device):
    move(device)
    assert acks(device.pump(0.2)) == []
    move(device)
    assert acks(device.pump(0.2)) == []
    device.expect(Result.BAD_STATE, MessageType.STAGE, struct.pack("<d", 0.01))
    (answer,) = acks(device.pump(0.3))
    assert answer[1] == Result.OK


@pytest.mark.parametrize(
    ("disturbance", "fault"), [(Disturbance.BUTTON, Fault.BUTTON), (Disturbance.SUPPLY_LOW, Fault.BROWN_OUT)]
)
def test_a_moving_stage_stops_on_button_and_supply(device, disturbance, fault):
    move(device)
    device.pump(0.1)
    device.line.device.disturb(disturbance)
    (answer,) = acks(device.pump(0.1))
    assert answer[1] == Result.FAULT_LATCHED
    assert device.require_state(State.FAULT)["faults"] == fault


def test_a_moving_stage_stops_on_stop(device):
    move(device)
    device.pump(0.1)
    device.expect(Result.OK, MessageType.STOP)
    (answer,) = acks([*device.frames, *device.pump(0.05)])
    assert answer[1] == Result.BAD_STATE


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX")
@pytest.mark.parametrize("port", [("--pty",), ("--tcp", "0")], ids=["pty", "tcp"])
def test_the_process_serves_a_port(program, port):
    with subprocess.Popen([program, *port, "--plant", "free"], stdout=subprocess.PIPE, text=True) as process:
        try:
            link = SerialLink(process.stdout.readline().strip())
            link.write(encode_frame(Frame(MessageType.STATUS_REQUEST)))
            device = DeviceUnderTest(LinkLine(link), Confirmed("free-coil", 1.0, 60.0))
            results = run_suite(device, ["2a", "2f", "4.3b", "5.3a"])
            assert [item.outcome for item in results] == ["passed"] * 4
            link.close()
        finally:
            process.terminate()


def test_the_core_is_built_for_a_microcontroller():
    try:
        assert build(QEMU).exists()
    except MissingToolError as error:
        pytest.skip(str(error))


EMULATED = (
    *("2a", "2b", "2c", "2f", "3a", "3b", "4.1b", "4.1c", "4.2a", "4.2c", "4.3a", "4.3b", "4.3c", "4.4a"),
    *("5.3a", "5.3b", "5.3c", "5.3d", "5.3e", "5.4b", "5.4d", "5.10a"),
)
"""Clauses without a statement about time: the emulation loses sample interrupts when the computer is busy."""


@pytest.mark.soak  # an emulated processor in real time
def test_the_firmware_conforms_on_an_emulated_microcontroller():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        command = qemu_command(build(QEMU), port)
    except MissingToolError as error:
        pytest.skip(str(error))
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as process:
        try:
            link = connected(f"socket://127.0.0.1:{port}")
            device = DeviceUnderTest(LinkLine(link), Confirmed("free-coil", 1.0, 60.0))
            results = run_suite(device, EMULATED)
            link.close()
        finally:
            process.kill()
    assert [(item.id, item.reason) for item in results if item.outcome == "failed"] == []


def connected(url):
    for _ in range(50):
        try:
            return SerialLink(url)
        except InstrumentError:
            time.sleep(0.1)
    raise AssertionError(f"nothing listens on {url}")
