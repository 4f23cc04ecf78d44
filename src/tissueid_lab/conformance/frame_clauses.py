"""Clauses of docs/protocol.md, sections 2, 3 and 4.1 to 4.2: frames, messages, handshake, repeated requests."""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise

import numpy as np
from cobs import cobs

import tissueid.wire as wire
from tissueid.language import marked
from tissueid.wire import Flag, MessageType, Result, State
from tissueid_lab.conformance.clause import clause, require
from tissueid_lab.conformance.device import DeviceUnderTest

OBEYED = (MessageType.STOP, MessageType.RELEASE, MessageType.FINISH)
"""Requests that are always obeyed."""
REQUESTS = tuple(kind for kind in MessageType if MessageType.STREAM <= kind <= MessageType.STAGE)
_KNOWN_FLAGS = 0x7F
_LONGEST_ENCODED = 2072 + 2072 // 254 + 1
_RATE_TOLERANCE = 0.02
"""Largest relative difference between the announced sample rate and that by the host's clock."""


def _frame(kind: int, payload: bytes = b"") -> bytes:
    """Return a frame without encoding."""
    body = wire.HEADER.pack(wire.PROTOCOL_VERSION, kind, 0xFFF0, 0, 0) + payload
    return body + struct.pack("<I", zlib.crc32(body))


def _encoded(raw: bytes) -> bytes:
    """Return bytes in COBS encoding with their zero, whatever they are."""
    return bytes(cobs.encode(raw)) + b"\0"


@clause("2a", marked("A frame with a wrong CRC is dropped without an answer, and counted"))
def _damaged(device: DeviceUnderTest) -> None:
    raw = _frame(MessageType.STREAM, b"\1")
    device.expect_silence(_encoded(raw[:-1] + bytes((raw[-1] ^ 1,))), "a frame with a wrong CRC")
    flipped = raw[:20] + b"\0" + raw[21:]
    device.expect_silence(_encoded(flipped), "a frame with a damaged payload")


@clause("2b", marked("A frame whose COBS encoding is invalid is dropped, and counted"))
def _invalid_encoding(device: DeviceUnderTest) -> None:
    device.expect_silence(b"\x20\x01\x02\0", "an invalid encoding")


@clause("2c", marked("A frame shorter than 24 bytes is dropped, and counted"))
def _short(device: DeviceUnderTest) -> None:
    body = b"\1\2\0\0"
    device.expect_silence(_encoded(body + struct.pack("<I", zlib.crc32(body))), "a frame of 8 bytes")


@clause("2d", marked("A frame longer than 2072 bytes is dropped, and the next one is answered"))
def _long(device: DeviceUnderTest) -> None:
    device.expect_silence(_encoded(_frame(MessageType.STREAM, bytes(wire.MAX_PAYLOAD + 1))), "a frame of 2073 bytes")
    device.expect_silence(b"\x01" * 5000 + b"\0", "5000 bytes without a zero")
    tail = b"\x01" * _LONGEST_ENCODED + b"\x01" + _encoded(_frame(MessageType.STREAM, b"\1"))
    device.expect_silence(tail, "a frame at the end of an overlong one")
    device.expect(Result.OK, MessageType.STREAM, b"\0")


@clause("2e", marked("A frame that is cut costs only itself"))
def _cut(device: DeviceUnderTest) -> None:
    whole = _encoded(_frame(MessageType.STREAM, b"\1"))
    device.expect_silence(whole[:11] + b"\0", "half a frame")
    device.expect(Result.OK, MessageType.STREAM, b"\0")
    device.line.write(b"\0\0\0")
    device.expect(Result.OK, MessageType.STREAM, b"\0")


@clause("2f", marked("An unknown type is answered with UNKNOWN"))
def _unknown(device: DeviceUnderTest) -> None:
    for kind in (0x0F, 0x2F, 0x7F):
        device.expect(Result.UNKNOWN, kind)


@clause("2g", marked("Every frame of the device is valid, and their sequence numbers increase by one"))
def _own_frames(device: DeviceUnderTest) -> None:
    device.stream()
    device.pump(0.1)
    frames = device.pump(0.5)
    require(len(frames) >= 10, "DATA while streaming", f"{len(frames)} frames in 0.5 s")
    for before, after in pairwise(frames):
        require(after.version == wire.PROTOCOL_VERSION, f"version {wire.PROTOCOL_VERSION}", after.version)
        expected = (before.sequence + 1) & 0xFFFF
        require(after.sequence == expected, f"sequence number {expected}", after.sequence)


@clause("3a", marked("A payload of the wrong length is answered with BAD_ARGUMENT"))
def _wrong_length(device: DeviceUnderTest) -> None:
    device.expect_each(
        Result.BAD_ARGUMENT,
        (MessageType.STREAM, b"\1\1", "with 2 bytes"),
        (MessageType.STIMULUS_BEGIN, bytes(11), "with 11 bytes"),
        (MessageType.STIMULUS_CHUNK, bytes(7), "with 7 bytes"),
        (MessageType.STIMULUS_COMMIT, bytes(5), "with 5 bytes"),
    )
    device.load(np.zeros(10, "<i2"))
    device.expect_each(
        Result.BAD_ARGUMENT,
        (MessageType.FOLLOW, bytes(9), "with 9 bytes"),
        (MessageType.ARM, device.arm_payload() + b"\0", "with 45 bytes"),
        (MessageType.START, bytes(3), "with 3 bytes"),
    )


@clause("3b", marked("STOP, RELEASE and FINISH are obeyed with any payload"))
def _any_payload(device: DeviceUnderTest) -> None:
    for kind in OBEYED:
        for payload in (b"", b"\1", bytes(100)):
            device.load(np.zeros(10, "<i2"))
            device.arm()
            device.expect(Result.OK, kind, payload)
            state = device.status()["state"]
            require(state in (State.IDLE, State.LOADED), f"the coil released by {kind.name}", f"state {state}")
            device.expect(Result.OK, MessageType.RELEASE)


@clause("3c", marked("A HELLO that is longer than known is accepted"))
def _longer_hello(device: DeviceUnderTest) -> None:
    device.hello(tail=b"later versions")
    device.expect(Result.OK, MessageType.STREAM, b"\0")


@clause("3d", marked("DATA holds whole samples, without a gap in index and time"))
def _data(device: DeviceUnderTest) -> None:
    device.stream()
    device.pump(0.5)
    frames = [frame for frame in device.frames if frame.type == MessageType.DATA]
    require(len(frames) >= 20, "50 DATA frames in 0.5 s", len(frames))
    size = device.properties["samples_per_frame"] * wire.SAMPLE.itemsize
    expected = frames[0].sample_index
    for frame in frames:
        require(len(frame.payload) == size, f"{size} bytes of samples", len(frame.payload))
        require(frame.sample_index == expected, f"sample index {expected}", frame.sample_index)
        time_us = frame.sample_index / device.rate_hz * 1e6
        require(abs(frame.device_time_us - time_us) <= 1000.0, f"device time {time_us:.0f} us", frame.device_time_us)
        expected += len(frame.payload) // wire.SAMPLE.itemsize
    flags = np.bitwise_or.reduce(device.samples()["flags"])
    require(not int(flags) & ~_KNOWN_FLAGS, "no flags above 64", int(flags))
    require(not int(flags) & Flag.PLAYING, "no flag of a stimulus without a run", int(flags))


@clause("3e", marked("The sample rate is the announced one, by the host's clock"))
def _rate(device: DeviceUnderTest) -> None:
    device.stream()
    device.pump(0.1)
    device.blocks.clear()
    arrivals: list[tuple[float, int]] = []
    begin = device.line.clock()
    while device.line.clock() < begin + 2.0:
        device.pump(0.002)
        if device.blocks:
            index, block = device.blocks[-1]
            device.blocks.clear()
            arrivals.append((device.line.clock(), index + block.size))
    require(len(arrivals) >= 50, "DATA about 100 times a second", f"{len(arrivals) / 2.0:.0f} times")
    times, indices = np.array(arrivals).T
    slope, offset = np.polyfit(indices, times, 1)
    lateness = times - (slope * indices + offset)
    rate = 1.0 / slope
    device.measured = {
        "sample_rate_hz": float(rate),
        "arrival_jitter_s": float(lateness.std()),
        "latest_arrival_s": float(lateness.max()),
    }
    require(
        abs(rate / device.rate_hz - 1.0) <= _RATE_TOLERANCE, f"{device.rate_hz:.0f} Hz within 2 %", f"{rate:.0f} Hz"
    )


@clause("3f", marked("The detail of STREAM is the next sample index, and each answer carries the sample index"))
def _stream_detail(device: DeviceUnderTest) -> None:
    round_trips = []
    before = -1
    for _ in range(20):
        device.pump(0.005)
        begin = device.line.clock()
        answer = device.expect(Result.OK, MessageType.STREAM, b"\1")
        round_trips.append(device.line.clock() - begin)
        require(abs(answer.detail - answer.index) <= 2, f"detail {answer.index}", answer.detail)
        require(answer.detail > before, f"an index above {before} after 5 ms", answer.detail)
        before = answer.detail
    device.measured = {"round_trip_s": float(np.median(round_trips)), "longest_round_trip_s": max(round_trips)}
    require(max(round_trips) < 0.3, "each answer within 0.3 s", f"{max(round_trips):.2f} s")


@clause("4.1a", marked("HELLO_ACK reports possible values and the protocol version"))
def _handshake(device: DeviceUnderTest) -> None:
    fields = device.properties
    require(fields["protocol_min"] <= 1 <= fields["protocol_max"], "protocol 1", fields["protocol_max"])
    require(device.rate_hz / 120 <= fields["samples_per_frame"] <= device.rate_hz / 80, "frames of about 10 ms", fields)


@clause("4.1b", marked("A host of another version is answered, and refused but for what releases the coil"))
def _other_version(device: DeviceUnderTest) -> None:
    for low, high in ((2, 9), (0, 0)):
        payload = device.hello(low, high)
        require(payload[0] <= 1 <= payload[1], "its own versions in HELLO_ACK", tuple(payload[:2]))
        for kind in REQUESTS:
            result = Result.OK if kind in OBEYED else Result.BAD_STATE
            device.expect(result, kind, b"\1", f"from a host of version {low} to {high}")
        device.send(MessageType.HEARTBEAT)
        device.require_state(State.IDLE)
    device.hello()
    device.expect(Result.OK, MessageType.STREAM, b"\0")


@clause("4.1c", marked("A HELLO of another version in ARMED releases the coil"))
def _other_version_armed(device: DeviceUnderTest) -> None:
    device.load(np.zeros(10, "<i2"))
    device.arm()
    device.hello(2, 9)
    device.require_state(State.LOADED, "after a HELLO of another version")


@clause("4.1d", marked("A HELLO of another version in RUNNING releases the coil"), drives=True)
def _other_version_running(device: DeviceUnderTest) -> None:
    device.begin_run(np.zeros(round(2 * device.rate_hz), "<i2"))
    device.pump(0.1)
    device.hello(2, 9)
    device.require_state(State.LOADED, "after a HELLO of another version")


@clause("4.1e", marked("STATUS carries the boot id of HELLO_ACK"))
def _boot_id(device: DeviceUnderTest) -> None:
    expected = device.properties["boot_id"]
    require(device.status()["boot_id"] == expected, f"boot id {expected}", device.status()["boot_id"])


@clause("4.2a", marked("A repeated request gets the same answer, and is not executed again"), drives=True)
def _repeated(device: DeviceUnderTest) -> None:
    first = device.ask(MessageType.STREAM, b"\1", sequence=0x4000)
    device.pump(0.05)
    again = device.ask(MessageType.STREAM, b"\1", sequence=0x4000)
    require(again.detail == first.detail, f"the first detail {first.detail}", again.detail)
    device.load(np.zeros(round(0.1 * device.rate_hz), "<i2"))
    device.arm()
    payload = wire.pack(wire.START, token=7)
    begun = device.ask(MessageType.START, payload, sequence=0x4001)
    require(begun.result == Result.OK, "OK to START", begun.result)
    device.wait(lambda: device.newest_state == State.LOADED, 1.0, "the end of the run")
    device.arm()
    again = device.ask(MessageType.START, payload, sequence=0x4001)
    require((again.result, again.detail) == (begun.result, begun.detail), "the first answer to START", again)
    device.require_state(State.ARMED, "after a repeated START")


@clause("4.2b", marked("HELLO empties the memory of answers"))
def _forgotten(device: DeviceUnderTest) -> None:
    first = device.ask(MessageType.STREAM, b"\1", sequence=0x4100)
    device.pump(0.05)
    device.hello()
    again = device.ask(MessageType.STREAM, b"\1", sequence=0x4100)
    require(again.detail > first.detail, "a new answer after HELLO", f"detail {again.detail}")


@clause("4.2c", marked("The last 64 answers are kept"))
def _kept_answers(device: DeviceUnderTest) -> None:
    first = device.ask(MessageType.STREAM, b"\0", sequence=0x4200)
    device.pump(0.05)
    for number in range(1, 64):
        device.ask(MessageType.STREAM, b"\0", sequence=0x4200 + number)
    again = device.ask(MessageType.STREAM, b"\0", sequence=0x4200)
    require(again.detail == first.detail, f"the first of 64 answers, {first.detail}", again.detail)
