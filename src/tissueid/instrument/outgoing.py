"""What goes out to a device besides plain requests: greeting, stimulus, set-points, limits, where the stage goes."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from tissueid import __version__, wire
from tissueid.instrument.answers import refusal
from tissueid.instrument.conversation import Conversation
from tissueid.instrument.limits import Limits
from tissueid.instrument.setpoints import SetpointSender
from tissueid.wire import Frame, MessageType, Result

CHUNK_CODES = 480

STAGE_TRIES = 100
"""A stage that has far to go answers when it is there: half a minute is enough for any."""


def send_hello(talk: Conversation) -> None:
    """Say who asks, and which versions of the protocol it speaks. The answer is not an ACK."""
    hello = wire.pack(
        wire.HELLO,
        protocol_min=wire.PROTOCOL_VERSION,
        protocol_max=wire.PROTOCOL_VERSION,
        host=f"tissueid {__version__}".encode(),
    )
    talk.send(MessageType.HELLO, hello)


def send_stimulus(talk: Conversation, stimulus_id: int, codes: NDArray[np.int16]) -> None:
    """A stimulus, shape (n,), in chunks that are acknowledged one by one and repeated when lost.

    Raises:
        InstrumentError: the firmware refuses it.
    """
    key = {"stimulus_id": stimulus_id}
    begin = wire.pack(wire.STIMULUS_BEGIN, samples=codes.size, crc32=zlib.crc32(codes.tobytes()), **key)
    talk.request(MessageType.STIMULUS_BEGIN, begin)
    for offset in range(0, codes.size, CHUNK_CODES):
        chunk = wire.pack(wire.STIMULUS_CHUNK, offset=offset, **key)
        talk.request(MessageType.STIMULUS_CHUNK, chunk + codes[offset : offset + CHUNK_CODES].tobytes())
    talk.request(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, **key))


def send_following(talk: Conversation, stimulus_id: int, samples: int, hold_code: int) -> None:
    """So many set-points will follow the stimulus; where one is missing, the level to hold is that code.

    Raises:
        InstrumentError: they are too many, or the firmware is too old for it.
    """
    payload = wire.pack(wire.FOLLOW, stimulus_id=stimulus_id, samples=samples, hold_code=hold_code)
    talk.request(MessageType.FOLLOW, payload)


def send_setpoints(
    talk: Conversation, sender: SetpointSender, token: int, offset: int, codes: NDArray[np.int16]
) -> None:
    """Set-points, shape (k,), from a run's sample ``offset`` on; ``sender`` repeats what is not acknowledged."""
    for first in range(offset, offset + codes.size, CHUNK_CODES):
        part = codes[first - offset : first - offset + CHUNK_CODES]
        payload = wire.pack(wire.SETPOINTS, token=token, offset=first) + part.tobytes()
        sequence = talk.number()
        frame = wire.encode_frame(Frame(MessageType.SETPOINTS, sequence, payload=payload))
        sender.put(sequence, first, first + part.size, frame)


def send_limits(talk: Conversation, token: int, stimulus_id: int, limits: Limits, sample_rate_hz: float) -> None:
    """ARM: agree on limits for one run of a stimulus, which START names by the token.

    Raises:
        LimitError: they go beyond what the device allows.
        InstrumentError: the firmware refuses it.
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
    talk.request(MessageType.ARM, payload)


def send_stage(talk: Conversation, position_m: float | None) -> bool:
    """Move the stage and wait until it is there; None: out of reach. False where there is none.

    Raises:
        InstrumentError: it cannot go there, or not now.
    """
    payload = wire.pack(wire.STAGE, position_m=np.nan if position_m is None else position_m)
    result, detail = talk.ask(MessageType.STAGE, payload, tries=STAGE_TRIES)
    if result not in (Result.OK, Result.UNKNOWN):
        raise refusal(MessageType.STAGE, result, detail)
    return result == Result.OK
