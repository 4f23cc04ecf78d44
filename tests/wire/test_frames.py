"""Frames: what goes in comes out, and nothing else ever does."""

import random
import zlib

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from tissueid.wire import HEADER, MAX_PAYLOAD, Frame, FrameDecoder, encode_frame

frames = st.builds(
    Frame,
    type=st.integers(0, 255),
    sequence=st.integers(0, 0xFFFF),
    device_time_us=st.integers(0, 2**64 - 1),
    sample_index=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=MAX_PAYLOAD),
    version=st.integers(0, 255),
)


@given(st.lists(frames, max_size=5), st.integers(1, 50))
def test_frames_survive_any_cut_of_the_stream(sent, step):
    stream = b"".join(encode_frame(frame) for frame in sent)
    decoder = FrameDecoder()
    received = [frame for i in range(0, len(stream), step) for frame in decoder.feed(stream[i : i + step])]
    assert received == sent
    assert decoder.statistics.refused == 0


def test_a_frame_on_the_wire_byte_by_byte():
    """The worked example of docs/protocol.md: HEARTBEAT, sequence 0x0102."""
    raw = encode_frame(Frame(type=0x30, sequence=0x0102))
    body = bytes([1, 0x30, 0x02, 0x01]) + bytes(16)
    assert cobs.decode(raw[:-1]) == body + zlib.crc32(body).to_bytes(4, "little")
    assert raw[-1] == 0
    assert raw.hex() == "0501300201" + "01" * 15 + "05154d06dd00"
    assert HEADER.size == 20


def test_damage_costs_only_the_frame_that_it_touches():
    first, second, third = (encode_frame(Frame(0x83, i, payload=bytes(range(100)))) for i in range(3))
    damaged = bytearray(second)
    damaged[30] ^= 0x10
    decoder = FrameDecoder()
    assert [frame.sequence for frame in decoder.feed(first + bytes(damaged) + third)] == [0, 2]
    assert decoder.statistics.refused == 1


def test_line_noise_without_an_end_does_not_fill_the_memory():
    decoder = FrameDecoder()
    for _ in range(1000):
        assert decoder.feed(b"\x55" * 1000) == []
    assert decoder.pending_bytes < 5000
    good = encode_frame(Frame(1))
    assert [frame.type for frame in decoder.feed(b"\0" + good)] == [1]


def test_an_oversized_payload_is_refused_by_the_sender():
    with pytest.raises(ValueError, match="exceeds"):
        encode_frame(Frame(1, payload=bytes(MAX_PAYLOAD + 1)))


def fuzz(count: int, seed: int) -> FrameDecoder:
    """``count`` random and ``count`` mutated frames; the mutated ones are never accepted changed."""
    rng = random.Random(seed)
    decoder = FrameDecoder()
    template = encode_frame(Frame(0x83, 7, 123_456, 9_000, bytes(range(256)) + bytes(64)))
    original = FrameDecoder().feed(template)[0]
    for _ in range(count):
        assert decoder.feed(rng.randbytes(rng.randrange(1, 400)) + b"\0") == []
        mutated = bytearray(template)
        for _ in range(rng.randrange(1, 6)):
            position = rng.randrange(len(mutated) - 1)
            match rng.randrange(3):
                case 0:
                    mutated[position] ^= 1 << rng.randrange(8)
                case 1:
                    del mutated[position]
                case 2:
                    mutated.insert(position, rng.randrange(256))
        for frame in decoder.feed(bytes(mutated) + b"\0"):
            assert frame == original, "a damaged frame was accepted"
    return decoder


def test_random_and_mutated_frames_are_refused():
    decoder = fuzz(5_000, seed=1)
    assert decoder.statistics.refused > 8_000


@pytest.mark.soak
def test_a_million_random_and_a_million_mutated_frames():
    fuzz(1_000_000, seed=2)
