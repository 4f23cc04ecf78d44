"""Limits that equal the end of a converter: no reading lies beyond them, so the end itself counts, on either side."""

import itertools
import zlib
from dataclasses import asdict, replace

import numpy as np
import pytest
from coded import coded
from safety.rigs import WIDE, rig

from firmware_sim.bench import Bench, Block
from firmware_sim.converters import CHANNELS, CODE_MAX, CODE_MIN
from firmware_sim.firmware import Firmware
from firmware_sim.limits import ArmedLimits
from firmware_sim.plant import PlantParameters
from tissueid import wire
from tissueid.errors import LimitError
from tissueid.instrument import Limits
from tissueid.instrument.interface import SIGNALS
from tissueid.wire import Fault, Flag, MessageType, Result, State

CHANNEL = {channel.name: channel for channel in CHANNELS}
REST = np.array([0, 0, 0, 0, -20000, 0, 0], "<i2")
"""Codes of a coil at rest in the middle of its stroke, at 24 degC."""
GENTLE = dict(max_force_n=2.0, min_position_m=-0.001, max_position_m=0.033)


def fault_of(channel, code, lifted=True, **limits):
    """The fault of one sample with this code, under limits that lie beyond every code of every channel."""
    wide = dict(max_force_n=90.0, min_position_m=-1.0, max_position_m=1.0, max_temperature_c=900.0, max_samples=9)
    codes = REST.copy()
    codes[list(CHANNEL).index(channel)] = code
    armed = ArmedLimits(token=1, **(wide | limits))
    block = Block(codes[None, :], np.zeros(1, np.uint16), False)
    return armed.first_violation(block, CHANNEL, PlantParameters(), 0, np.array([lifted]))[1]


@pytest.mark.parametrize(
    ("channel", "end", "fault"),
    [
        ("current", CODE_MIN, Fault.OVER_FORCE),
        ("current", CODE_MAX, Fault.OVER_FORCE),
        ("position", CODE_MIN, Fault.STROKE),
        ("position", CODE_MAX, Fault.STROKE),
        ("temperature", CODE_MAX, Fault.OVER_TEMPERATURE),
        ("temperature", CODE_MIN, Fault.NONE),
        ("voltage", CODE_MAX, Fault.NONE),
        ("accelerometer_x", CODE_MIN, Fault.NONE),
    ],
)
def test_the_firmware_takes_the_end_of_a_converter_for_a_reading_beyond_the_limit(channel, end, fault):
    assert fault_of(channel, end) == fault
    assert fault_of(channel, end - int(np.sign(end))) == Fault.NONE


def test_the_firmware_lets_a_gentle_probe_lean_on_an_end_and_a_free_one_lift_off():
    for end in (CODE_MIN, CODE_MAX):
        assert fault_of("position", end, **GENTLE) == Fault.NONE
    assert fault_of("position", CODE_MIN, lifted=False) == Fault.NONE


def answers_to_arm(**changed):
    """A firmware with a pull at the near end loaded, its host, and the answer to ARM."""
    firmware, numbers, decoder = Firmware(Bench(seed=1)), itertools.count(), wire.FrameDecoder()

    def ask(kind, payload):
        firmware.receive(wire.encode_frame(wire.Frame(kind, next(numbers), payload=payload)), 0.0)
        acks = [frame for frame in decoder.feed(firmware.transmit(0.0)) if frame.type == MessageType.ACK]
        return wire.unpack(wire.ACK, acks[-1].payload)[0]["result"] if acks else None

    codes = np.full(1500, -7.6 * 4.0 / 60.0 * 32768, "<i2").tobytes()
    ask(MessageType.HELLO, wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"test"))
    begin = wire.pack(wire.STIMULUS_BEGIN, stimulus_id=1, samples=1500, crc32=zlib.crc32(codes))
    assert ask(MessageType.STIMULUS_BEGIN, begin) == Result.OK
    for at in range(0, 1500, 500):
        chunk = wire.pack(wire.STIMULUS_CHUNK, stimulus_id=1, offset=at) + codes[2 * at : 2 * at + 1000]
        assert ask(MessageType.STIMULUS_CHUNK, chunk) == Result.OK
    assert ask(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, stimulus_id=1)) == Result.OK
    limits = dict(max_force_n=8.0, min_position_m=0.0, max_position_m=0.032, max_temperature_c=80.0) | changed
    return firmware, ask, ask(MessageType.ARM, wire.pack(wire.ARM, token=5, stimulus_id=1, max_samples=1500, **limits))


def test_the_firmware_alone_releases_a_probe_that_is_pulled_against_the_near_end():
    firmware, ask, answer = answers_to_arm()
    assert answer == Result.OK
    ask(MessageType.STREAM, b"\1")
    assert ask(MessageType.START, wire.pack(wire.START, token=5)) == Result.OK
    firmware.advance(1600, 0.1)
    frames = wire.FrameDecoder().feed(firmware.transmit(0.1))
    samples = np.concatenate(
        [np.frombuffer(frame.payload, wire.SAMPLE) for frame in frames if frame.type == MessageType.DATA]
    )
    assert firmware.faults == Fault.STROKE
    on = (samples["flags"] & Flag.ENERGISED) > 0
    assert np.count_nonzero(samples["position"][on] == CODE_MIN) == 1, "the sample that ended it"


@pytest.mark.parametrize(
    ("changed", "answer"),
    [
        ({"max_force_n": 5e-324}, Result.BEYOND_LIMITS),
        ({"max_force_n": 5e-4}, Result.BEYOND_LIMITS),
        ({"max_temperature_c": -1e308}, Result.BEYOND_LIMITS),
        ({"max_temperature_c": -26.0}, Result.BEYOND_LIMITS),
        ({"max_temperature_c": 20.0}, Result.OK),
        ({"min_position_m": 0.01, "max_position_m": 0.01 + 1e-9}, Result.BEYOND_LIMITS),
        ({"min_position_m": 0.01, "max_position_m": 0.0101}, Result.OK),
        ({"min_position_m": 5e-324}, Result.OK),
    ],
)
def test_the_firmware_refuses_limits_that_no_reading_can_meet(changed, answer):
    firmware, _, result = answers_to_arm(**changed)
    assert result == answer
    assert firmware.state is (State.ARMED if answer is Result.OK else State.LOADED)


@pytest.mark.parametrize(
    ("signal", "gain", "name"),
    [
        ("position", 0.0314 / 65536, "min_position_m"),
        ("position", 0.0316 / 65536, "max_position_m"),
        ("current", 4.0 / 32768, "max_force_n"),
        ("temperature", 100.0 / 65536, "max_temperature_c"),
    ],
)
def test_the_host_alone_moves_a_limit_inside_the_range_of_its_converter(signal, gain, name):
    plain = rig().state.handshake
    assert plain.effective_limits(WIDE) == WIDE
    gains, offsets = plain.gains.copy(), plain.offsets.copy()
    k = SIGNALS.index(signal)
    gains[k] = gain
    if signal == "position":
        offsets[k] = gain * 32768 + (0.0004 if name == "min_position_m" else 0.0)
    if signal == "temperature":
        offsets[k] = 30.0
    read = gains * np.array([[-32768.0], [32767.0]]) + offsets
    effective = replace(plain, gains=gains, offsets=offsets).effective_limits(WIDE)
    changed = {item for item in asdict(WIDE) if getattr(effective, item) != getattr(WIDE, item)}
    assert changed == {name}
    value = getattr(effective, name)
    if name == "min_position_m":
        assert value > read[0, k]
    else:
        scale = 1.05 / 3.0 if signal == "current" else 1.0
        assert value * scale < read[1, k]


def test_the_host_lets_a_gentle_probe_lean_on_the_end_of_its_converter():
    gentle = Limits(**GENTLE)
    assert rig().state.handshake.effective_limits(gentle) == gentle


@pytest.mark.parametrize("force_n", [5e-324, 0.09])
def test_the_host_refuses_a_force_limit_within_the_noise(force_n):
    with pytest.raises(LimitError, check=coded("limit.too_small", name="max_force_n", value=force_n)):
        Limits(max_force_n=force_n)
    assert Limits(max_force_n=0.1).max_force_n == 0.1
