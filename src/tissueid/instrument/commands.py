"""Requests with a payload: HELLO, stimulus, set-points, limits and stage position."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__, wire
from tissueid.instrument.limits import Limits
from tissueid.instrument.replies import refusal
from tissueid.instrument.requests import RequestChannel
from tissueid.instrument.setpoints import SetpointSender
from tissueid.wire import Frame, MessageType, Result

CHUNK_CODES = 480
"""Converter codes in one frame, 960 bytes."""

STAGE_TRIES = 100
"""Attempts of STAGE, whose answer arrives after the movement: 30 s, enough for the full travel."""


def send_hello(channel: RequestChannel) -> None:
    """Send HELLO with the name of this software and its protocol versions. The answer is a HELLO_ACK."""
    hello = wire.pack(
        wire.HELLO,
        protocol_min=wire.PROTOCOL_VERSION,
        protocol_max=wire.PROTOCOL_VERSION,
        host=f"tissueid {__version__}".encode(),
    )
    channel.send(MessageType.HELLO, hello)


def send_stimulus(channel: RequestChannel, stimulus_id: int, codes: NDArray[np.int16]) -> None:
    """Send the codes of a stimulus, shape (n,), in chunks. Each is acknowledged, and repeated if it is lost.

    Raises:
        InstrumentError: the firmware refuses the stimulus.
    """
    key = {"stimulus_id": stimulus_id}
    begin = wire.pack(wire.STIMULUS_BEGIN, samples=codes.size, crc32=zlib.crc32(codes.tobytes()), **key)
    channel.request(MessageType.STIMULUS_BEGIN, begin)
    for offset in range(0, codes.size, CHUNK_CODES):
        chunk = wire.pack(wire.STIMULUS_CHUNK, offset=offset, **key)
        channel.request(MessageType.STIMULUS_CHUNK, chunk + codes[offset : offset + CHUNK_CODES].tobytes())
    channel.request(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, **key))


def send_following(channel: RequestChannel, stimulus_id: int, samples: int, hold_code: int) -> None:
    """Announce ``samples`` set-points after the stimulus; ``hold_code`` is played where a set-point is missing.

    Raises:
        InstrumentError: there are too many set-points, or the firmware is too old.
    """
    payload = wire.pack(wire.FOLLOW, stimulus_id=stimulus_id, samples=samples, hold_code=hold_code)
    channel.request(MessageType.FOLLOW, payload)


def send_setpoints(
    channel: RequestChannel, sender: SetpointSender, token: int, offset: int, codes: NDArray[np.int16]
) -> None:
    """Send the codes of set-points, shape (k,), from sample ``offset`` of a run; ``sender`` repeats lost blocks."""
    for first in range(offset, offset + codes.size, CHUNK_CODES):
        part = codes[first - offset : first - offset + CHUNK_CODES]
        payload = wire.pack(wire.SETPOINTS, token=token, offset=first) + part.tobytes()
        sequence = channel.next_number()
        frame = wire.encode_frame(Frame(MessageType.SETPOINTS, sequence, payload=payload))
        sender.put(sequence, first, first + part.size, frame)


def send_limits(channel: RequestChannel, token: int, stimulus_id: int, limits: Limits, sample_rate_hz: float) -> None:
    """Send ARM: limits for one run of a stimulus. START refers to it by the token.

    Raises:
        LimitError: the limits exceed those of the device.
        InstrumentError: the firmware refuses.
    """
    payload = wire.pack(
        wire.ARM,
        token=token,
        stimulus_id=stimulus_id,
        max_force_n=limits.max_force_n,
        min_position_m=limits.min_position_m,
        max_position_m=limits.max_position_m,
        max_temperature_c=limits.max_temperature_c,
        max_samples=round(limits.max_seconds * sample_rate_hz),
    )
    channel.request(MessageType.ARM, payload)


def send_stage(channel: RequestChannel, position_m: float | None) -> bool:
    """Move the stage to a position, m, or out of reach with None, and wait. Return False without a stage.

    Raises:
        InstrumentError: the stage cannot move to this position, or not at this time.
    """
    payload = wire.pack(wire.STAGE, position_m=np.nan if position_m is None else position_m)
    result, detail = channel.result_of(MessageType.STAGE, payload, tries=STAGE_TRIES)
    if result not in (Result.OK, Result.UNKNOWN):
        raise refusal(MessageType.STAGE, result, detail)
    return result == Result.OK
