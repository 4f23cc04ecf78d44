"""The button, the supply and the reset: what frees the coil without any host."""

import random

import numpy as np
import pytest
from safety.rigs import WIDE, last_energised, rig, volts

from tissueid import wire
from tissueid.errors import FirmwareFaultError, InstrumentError
from tissueid.wire import Fault, Flag, MessageType, State


def running(instrument):
    instrument.load(volts(10.0, 5.0))
    instrument.arm(WIDE)
    instrument.start()
    for _ in range(10):
        instrument.poll(0.05)
    assert instrument._link.firmware.energised
    return instrument._link


def press(link):
    """Hold the button down for a fiftieth of a second, with nobody at the other end; the samples until it was free."""
    firmware = link.firmware
    before = firmware.sample_index
    firmware.bench.button = True
    link.run_for(0.02)
    firmware.bench.button = False
    return before


def silent(link):
    """The host hangs."""


def talking_rubbish(link):
    random.seed(4)
    link.firmware.receive(random.randbytes(20_000), link.now)


def flooding(link):
    for number in range(3000):
        frame = wire.Frame(MessageType.HEARTBEAT if number % 2 else MessageType.STATUS_REQUEST, number & 0xFFFF)
        link.firmware.receive(wire.encode_frame(frame), link.now)


def asking_for_more(link):
    """It sends every request that there is, over and over, and reads nothing."""
    for number in range(500):
        for kind in (MessageType.START, MessageType.ARM, MessageType.SETPOINTS, MessageType.STAGE):
            link.firmware.receive(wire.encode_frame(wire.Frame(kind, number, payload=b"\1" * 8)), link.now)


@pytest.mark.parametrize("host", [silent, talking_rubbish, flooding, asking_for_more])
def test_the_button_frees_the_coil_whatever_the_host_does(host):
    instrument = rig()
    link = running(instrument)
    host(link)
    before = press(link)
    firmware = link.firmware
    assert firmware.faults == Fault.BUTTON
    assert not firmware.energised
    assert firmware.sample_index - before == 40
    link.run_for(1.0)
    assert not firmware.energised, "letting go of the button starts nothing"
    assert firmware.faults == Fault.BUTTON


def test_the_button_frees_the_coil_within_one_frame_and_the_host_says_what_to_do():
    instrument = rig()
    link = running(instrument)
    onset = link.firmware.sample_index
    link.firmware.bench.button = True
    blocks = []
    with pytest.raises(FirmwareFaultError, match="the button was pressed: let go of it, then measure again"):
        while True:
            blocks.append(instrument.poll(0.05))
    assert last_energised(np.concatenate(blocks)) <= onset


def test_the_button_works_while_the_firmware_hears_and_says_nothing():
    instrument = rig()
    link = running(instrument)
    link.firmware.stall(link.now + 10.0)
    press(link)
    assert not link.firmware.energised


def test_the_button_takes_the_arming_back():
    instrument = rig()
    instrument.load(volts(10.0, 1.0))
    instrument.arm(WIDE)
    firmware = instrument._link.firmware
    assert firmware.state is State.ARMED
    press(instrument._link)
    assert firmware.state is State.FAULT
    assert firmware.faults == Fault.BUTTON
    with pytest.raises(FirmwareFaultError, match="the button was pressed"):
        instrument.start()


@pytest.mark.parametrize(
    "do",
    [lambda i: i.arm(WIDE), lambda i: i.move_stage(0.01)],
    ids=["arm", "stage"],
)
def test_nothing_moves_while_the_button_is_held_down(do):
    instrument = rig()
    instrument.load(volts(10.0, 1.0))
    bench = instrument._link.firmware.bench
    bench.button = True
    with pytest.raises(FirmwareFaultError, match="button was pressed: let go of it"):
        do(instrument)
    assert instrument._link.firmware.state is State.LOADED
    bench.button = False
    do(instrument)


def test_start_is_refused_while_the_button_is_held_down():
    instrument = rig()
    instrument.load(volts(10.0, 1.0))
    instrument.arm(WIDE)
    link = instrument._link
    link.firmware.bench.button = True
    payload = wire.pack(wire.START, token=instrument._token)
    link.firmware.receive(wire.encode_frame(wire.Frame(MessageType.START, 60_000, payload=payload)), link.now)
    assert not link.firmware.energised


@pytest.mark.parametrize("state", ["idle", "loaded", "armed", "running"])
def test_a_brown_out_frees_the_coil_and_latches(state):
    instrument = rig()
    if state != "idle":
        instrument.load(volts(10.0, 5.0))
    if state in ("armed", "running"):
        instrument.arm(WIDE)
    if state == "running":
        instrument.start()
        instrument.poll(0.3)
    link = instrument._link
    link.firmware.brown_out()
    assert not link.firmware.energised
    assert link.firmware.state is State.FAULT
    if state in ("armed", "running"):
        with pytest.raises(FirmwareFaultError, match="released the coil: the supply voltage sagged: check the power"):
            for _ in range(5):
                instrument.poll(0.05)
    with pytest.raises(FirmwareFaultError, match="refuses after a fault: the supply voltage sagged"):
        instrument.load(volts(1.0, 0.1))
    instrument.clear_faults()
    instrument.load(volts(1.0, 0.1))


def test_a_reset_leaves_the_coil_free_and_everything_to_be_agreed_anew():
    instrument = rig()
    link = running(instrument)
    link.firmware.reboot()
    link.tick()
    assert not link.firmware.energised
    assert link.firmware.state is State.IDLE
    with pytest.raises(FirmwareFaultError, match=r"restarted by itself; the coil is free\. Connect again"):
        for _ in range(5):
            instrument.poll(0.05)
    with pytest.raises(InstrumentError):
        instrument.start()
    assert not link.firmware.energised


def test_a_press_is_recorded_with_the_samples():
    instrument = rig()
    instrument._link.firmware.bench.button = True
    seen = np.concatenate([instrument.poll(0.05) for _ in range(4)])
    assert np.all(seen["flags"][-20:] & Flag.BUTTON)
