"""Requests at the edges of the protocol, frame by frame (docs/protocol.md, sections 3 and 4)."""

import itertools
import zlib

import numpy as np
import pytest

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.wire import Fault, MessageType, Result, State

HELLO = wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"test")
FREEING = (MessageType.STOP, MessageType.RELEASE, MessageType.FINISH)


def host(firmware):
    """Say something to a firmware, and hear the result and the detail of its answer."""
    numbers, decoder = itertools.count(), wire.FrameDecoder()

    def ask(kind, payload=b""):
        number = next(numbers)
        firmware.receive(wire.encode_frame(wire.Frame(kind, number, payload=payload)), 0.0)
        acks = [frame for frame in decoder.feed(firmware.transmit(0.0)) if frame.type == MessageType.ACK]
        return wire.unpack(wire.ACK, acks[-1].payload)[0]["result"] if acks else None

    return ask


def running():
    """A firmware that plays, and its host."""
    firmware = Firmware(Bench("linear-demo"))
    ask = host(firmware)
    ask(MessageType.HELLO, HELLO)
    codes = np.full(400, 1000, "<i2").tobytes()
    begin = wire.pack(wire.STIMULUS_BEGIN, stimulus_id=1, samples=400, crc32=zlib.crc32(codes))
    assert ask(MessageType.STIMULUS_BEGIN, begin) == Result.OK
    chunk = wire.pack(wire.STIMULUS_CHUNK, stimulus_id=1, offset=0) + codes
    assert ask(MessageType.STIMULUS_CHUNK, chunk) == Result.OK
    assert ask(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, stimulus_id=1)) == Result.OK
    limits = dict(max_force_n=10.0, min_position_m=0.0003, max_position_m=0.0317, max_temperature_c=80.0)
    arm = wire.pack(wire.ARM, token=5, stimulus_id=1, max_samples=400, **limits)
    assert ask(MessageType.ARM, arm) == Result.OK
    assert ask(MessageType.START, wire.pack(wire.START, token=5)) == Result.OK
    firmware.advance(60, 0.01)
    assert firmware.energised
    return firmware, ask


@pytest.mark.parametrize("kind", [item for item in MessageType if 0x02 <= item <= 0x2F])
def test_before_any_hello_nothing_is_done_but_what_frees_the_coil(kind):
    firmware = Firmware(Bench("linear-demo"))
    assert host(firmware)(kind, b"\1") == (Result.OK if kind in FREEING else Result.BAD_STATE)
    assert (firmware.state, firmware.streaming) == (State.IDLE, False)


@pytest.mark.parametrize("kind", FREEING)
@pytest.mark.parametrize("payload", [b"", b"\0", bytes(100)])
def test_what_frees_the_coil_is_obeyed_whatever_comes_with_it(kind, payload):
    firmware, ask = running()
    assert ask(kind, payload) == Result.OK
    firmware.advance(101, 0.02)
    assert not firmware.energised
    assert firmware.state is (State.IDLE if kind is MessageType.RELEASE else State.LOADED)


def test_a_stimulus_of_nothing_is_no_argument_and_one_too_long_is_too_large():
    firmware = Firmware(Bench("linear-demo"))
    ask = host(firmware)
    ask(MessageType.HELLO, HELLO)

    def begin(samples):
        return ask(MessageType.STIMULUS_BEGIN, wire.pack(wire.STIMULUS_BEGIN, stimulus_id=1, samples=samples, crc32=0))

    assert begin(0) == Result.BAD_ARGUMENT
    assert begin(firmware.stimulus_capacity) == Result.OK
    assert begin(firmware.stimulus_capacity + 1) == Result.TOO_LARGE


def test_heartbeats_of_a_connection_without_hello_do_not_keep_a_run_alive():
    firmware, ask = running()

    def half_a_second_of_heartbeats(begin):
        for k in range(1, 11):
            firmware.receive(wire.encode_frame(wire.Frame(MessageType.HEARTBEAT, k)), begin + 0.06 * k)
            firmware.advance(2, begin + 0.06 * k)

    half_a_second_of_heartbeats(0.01)
    assert firmware.state is State.RUNNING
    firmware.connected()
    assert firmware.state is State.RUNNING, "a new connection alone releases nothing"
    assert ask(MessageType.STREAM, b"\1") == Result.BAD_STATE
    half_a_second_of_heartbeats(0.61)
    assert firmware.faults == Fault.WATCHDOG
    assert not firmware.energised


def test_heartbeats_after_the_hello_of_a_new_connection_count():
    firmware, ask = running()
    firmware.connected()
    ask(MessageType.HELLO, HELLO)
    for k in range(1, 11):
        firmware.receive(wire.encode_frame(wire.Frame(MessageType.HEARTBEAT, k)), 0.06 * k)
        firmware.advance(2, 0.06 * k)
    assert firmware.state is State.RUNNING
