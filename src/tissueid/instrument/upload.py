"""What goes out to a device besides plain requests: a stimulus in pieces, and where the stage is to go."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.instrument.answers import refusal
from tissueid.instrument.conversation import Conversation
from tissueid.wire import MessageType, Result

CHUNK_CODES = 480

STAGE_TRIES = 100
"""A stage that has far to go answers when it is there: half a minute is enough for any."""


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
