"""The stage of the reference firmware while it moves, and the firmware as a process on a real port."""

import struct
import subprocess
import sys

import numpy as np
import pytest
from reference.lines import ReferenceLine

from firmware_sim.reference.lockstep import Disturbance
from tissueid.instrument import SerialLink
from tissueid.wire import Fault, Frame, MessageType, Result, State, encode_frame
from tissueid_lab.conformance.device import Confirmed, DeviceUnderTest
from tissueid_lab.conformance.exchange import LinkLine
from tissueid_lab.conformance.suite import run_suite

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


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX")
def test_heartbeats_of_a_connection_without_hello_do_not_keep_the_coil_armed(program):
    with subprocess.Popen([program, "--tcp", "0", "--plant", "free"], stdout=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().strip()
            link = SerialLink(url)
            first = DeviceUnderTest(LinkLine(link), Confirmed("free-coil", 1.0, 60.0))
            first.prepare()
            first.load(np.zeros(10, "<i2"))
            first.arm()
            link.close()
            first.line.pause(0.05)  # until the device has noticed
            link = SerialLink(url)
            second = DeviceUnderTest(LinkLine(link), Confirmed("free-coil", 1.0, 60.0))
            for _ in range(6):
                second.send(MessageType.HEARTBEAT)
                second.pump(0.1)
            assert second.require_state(State.FAULT)["faults"] == Fault.WATCHDOG
            second.expect(Result.BAD_STATE, MessageType.CLEAR_FAULTS)
            second.prepare()
            second.require_state(State.IDLE)
            link.close()
        finally:
            process.terminate()
