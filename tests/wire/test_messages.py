"""Messages: fixed sizes, and refusal of anything else."""

import pytest

from tissueid import wire

SIZES = {
    "HELLO": 32,
    "HELLO_ACK": 172,
    "CHANNEL": 40,
    "STREAM": 1,
    "STIMULUS_BEGIN": 12,
    "STIMULUS_CHUNK": 8,
    "STIMULUS_COMMIT": 4,
    "FOLLOW": 10,
    "SETPOINTS": 8,
    "ARM": 44,
    "START": 4,
    "ACK": 12,
    "STATUS": 20,
    "STATUS_SETPOINTS": 8,
    "SAMPLE": 16,
}


@pytest.mark.parametrize(("name", "size"), SIZES.items())
def test_sizes_are_those_of_the_protocol_document(name, size):
    assert getattr(wire, name).itemsize == size


def test_a_message_comes_back_with_its_tail():
    raw = wire.pack(wire.STIMULUS_CHUNK, stimulus_id=7, offset=480) + b"tail"
    assert wire.unpack(wire.STIMULUS_CHUNK, raw, tail=True) == ({"stimulus_id": 7, "offset": 480}, b"tail")


@pytest.mark.parametrize("raw", [b"", b"\0\0\0", b"\0" * 5])
def test_a_payload_of_the_wrong_length_is_refused(raw):
    with pytest.raises(wire.PayloadError, match="bytes where the message has 4"):
        wire.unpack(wire.START, raw)


def test_every_field_must_be_given_and_no_other():
    with pytest.raises(KeyError):
        wire.pack(wire.STIMULUS_BEGIN, stimulus_id=1)
    with pytest.raises(TypeError, match="no such fields: volume"):
        wire.pack(wire.START, token=1, volume=11)


def test_text_fields_never_carry_control_characters():
    assert wire.text(b"SIM-0001\0\0") == "SIM-0001"
    assert wire.text(b"\x1b[2Jbell\x07") == "?[2Jbell?"
