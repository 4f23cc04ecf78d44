"""The button, the supply and the reset: what frees the coil without any host."""

import random

import numpy as np
import pytest
from coded import coded
from safety.rigs import WIDE, last_energised, rig, volts

from tissueid import wire
from tissueid.errors import FirmwareFaultError, InstrumentError
from tissueid.instrument.replies import describe_faults
from tissueid.wire import Fault, Flag, MessageType, Result, State


def running(instrument):
    instrument.load(volts(10.0, 5.0))
    instrument.arm(WIDE)
    instrument.start()
    for _ in range(10):
        instrument.poll(0.05)
    assert instrument.link.firmware.energised
    return instrument.link


def press(link):
    """Hold the button down for a fiftieth of a second, without a host; return the samples until it was free."""
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
    with pytest.raises(FirmwareFaultError, check=coded("instrument.released", why=describe_faults(Fault.BUTTON))):
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
    firmware = instrument.link.firmware
    assert firmware.state is State.ARMED
    press(instrument.link)
    assert firmware.state is State.FAULT
    assert firmware.faults == Fault.BUTTON
    with pytest.raises(FirmwareFaultError, check=coded("instrument.released", why=describe_faults(Fault.BUTTON))):
        instrument.start()


@pytest.mark.parametrize(
    "do",
    [lambda i: i.arm(WIDE), lambda i: i.move_stage(0.01)],
    ids=["arm", "stage"],
)
def test_nothing_moves_while_the_button_is_held_down(do):
    instrument = rig()
    instrument.load(volts(10.0, 1.0))
    bench = instrument.link.firmware.bench
    bench.button = True
    with pytest.raises(FirmwareFaultError, check=coded("refused.fault", why=describe_faults(Fault.BUTTON))):
        do(instrument)
    assert instrument.link.firmware.state is State.LOADED
    bench.button = False
    do(instrument)


def test_start_is_refused_while_the_button_is_held_down():
    instrument = rig()
    instrument.load(volts(10.0, 1.0))
    instrument.arm(WIDE)
    link = instrument.link
    link.firmware.bench.button = True
    payload = wire.pack(wire.START, token=instrument.state.token)
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
    link = instrument.link
    link.firmware.brown_out()
    assert not link.firmware.energised
    assert link.firmware.state is State.FAULT
    if state in ("armed", "running"):
        with pytest.raises(
            FirmwareFaultError, check=coded("instrument.released", why=describe_faults(Fault.BROWN_OUT))
        ):
            for _ in range(5):
                instrument.poll(0.05)
    with pytest.raises(FirmwareFaultError, check=coded("refused.fault", why=describe_faults(Fault.BROWN_OUT))):
        instrument.load(volts(1.0, 0.1))
    instrument.clear_faults()
    instrument.load(volts(1.0, 0.1))


@pytest.mark.parametrize("state", ["loaded", "armed", "running"])
def test_a_supply_that_sags_is_noticed_before_the_next_sample_and_latches(state):
    instrument = rig()
    instrument.load(volts(10.0, 5.0))
    if state in ("armed", "running"):
        instrument.arm(WIDE)
    if state == "running":
        instrument.start()
        instrument.poll(0.3)
    firmware, now = instrument.link.firmware, instrument.link.now
    firmware.bench.supply_share = 0.41
    firmware.advance(5, now)
    assert firmware.faults == Fault.NONE
    firmware.bench.supply_share = 0.39
    firmware.advance(1, now)
    assert firmware.state is State.FAULT
    assert firmware.faults == Fault.BROWN_OUT
    assert not firmware.frame_samples["flags"][-1] & Flag.ENERGISED
    instrument.clear_faults()
    firmware.advance(1, instrument.link.now)
    assert firmware.faults == Fault.BROWN_OUT, "as long as the supply sags"
    firmware.bench.supply_share = 1.0
    instrument.clear_faults()
    instrument.load(volts(1.0, 0.1))


# -- what frees the coil is never refused ------------------------------------------------------------------------------


def another_version(link):
    """A host that speaks version 9 alone says HELLO."""
    hello = wire.pack(wire.HELLO, protocol_min=9, protocol_max=9, host=b"another")
    link.firmware.receive(wire.encode_frame(wire.Frame(MessageType.HELLO, 0, payload=hello)), link.now)


@pytest.mark.parametrize("state", ["armed", "running"])
def test_a_host_of_another_version_frees_the_coil(state):
    instrument = rig()
    link = instrument.link
    instrument.load(volts(10.0, 5.0))
    instrument.arm(WIDE)
    if state == "running":
        instrument.start()
        instrument.poll(0.3)
    another_version(link)
    assert link.firmware.state is State.LOADED
    assert not link.firmware.energised
    link.run_for(0.1)
    assert link.firmware.faults == Fault.NONE


@pytest.mark.parametrize(
    ("kind", "after"),
    [(MessageType.STOP, State.LOADED), (MessageType.RELEASE, State.IDLE), (MessageType.FINISH, State.LOADED)],
)
def test_stop_release_and_finish_are_obeyed_whatever_was_agreed_on(kind, after):
    instrument = rig()
    link = running(instrument)
    firmware = link.firmware
    firmware.greeted = False
    firmware.transmit(link.now)
    for number, request in enumerate((MessageType.CLEAR_FAULTS, kind)):
        firmware.receive(wire.encode_frame(wire.Frame(request, 50_000 + number)), link.now)
    acks = [frame for frame in wire.FrameDecoder().feed(firmware.transmit(link.now)) if frame.type == MessageType.ACK]
    results = [wire.unpack(wire.ACK, frame.payload)[0]["result"] for frame in acks]
    assert results == [Result.BAD_STATE, Result.OK]
    firmware.advance(120, link.now)
    assert firmware.state is after
    assert not firmware.energised


def test_a_reset_leaves_the_coil_free_and_discards_the_arming():
    instrument = rig()
    link = running(instrument)
    link.firmware.reboot()
    link.tick()
    assert not link.firmware.energised
    assert link.firmware.state is State.IDLE
    with pytest.raises(FirmwareFaultError, check=coded("instrument.restarted")):
        for _ in range(5):
            instrument.poll(0.05)
    with pytest.raises(InstrumentError):
        instrument.start()
    assert not link.firmware.energised


def test_a_press_is_recorded_with_the_samples():
    instrument = rig()
    instrument.link.firmware.bench.button = True
    seen = np.concatenate([instrument.poll(0.05) for _ in range(4)])
    assert np.all(seen["flags"][-20:] & Flag.BUTTON)
