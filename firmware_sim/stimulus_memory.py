"""Memory for one stimulus: announced, filled in chunks, verified, and played from."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from tissueid import wire
from tissueid.wire import Result

Answer = tuple[Result, int]
"""Response to a request: the result, and a detail that depends on it."""


class StimulusMemory:
    """Codes of one stimulus with an id chosen by the host; independent of the state of the firmware."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.codes: NDArray[np.int16] = np.zeros(0, "<i2")
        self.id = 0
        self._crc = 0

    @property
    def size(self) -> int:
        """Number of samples of the stimulus."""
        return self.codes.size

    def begin(self, payload: bytes) -> Answer:
        """Allocate a stimulus, which replaces the previous one."""
        request, _ = wire.unpack(wire.STIMULUS_BEGIN, payload)
        if not request["samples"]:
            return Result.BAD_ARGUMENT, 0
        if request["samples"] > self.capacity:
            return Result.TOO_LARGE, self.capacity
        self.codes = np.zeros(request["samples"], "<i2")
        self.id, self._crc = request["stimulus_id"], request["crc32"]
        return Result.OK, 0

    def chunk(self, payload: bytes) -> Answer:
        """Store a chunk of the stimulus."""
        request, codes = wire.unpack(wire.STIMULUS_CHUNK, payload, tail=True)
        end = request["offset"] + len(codes) // 2
        if request["stimulus_id"] != self.id or len(codes) % 2 or end > self.size:
            return Result.BAD_ARGUMENT, 0
        self.codes[request["offset"] : end] = np.frombuffer(codes, "<i2")
        return Result.OK, end

    def commit(self, payload: bytes) -> Answer:
        """Verify that the stimulus is complete."""
        request, _ = wire.unpack(wire.STIMULUS_COMMIT, payload)
        if request["stimulus_id"] != self.id or self.size == 0:
            return Result.BAD_ARGUMENT, 0
        crc = zlib.crc32(self.codes.tobytes())
        if crc != self._crc:
            return Result.CHECKSUM, crc
        return Result.OK, self.size

    def forget(self) -> None:
        """Clear the memory."""
        self.codes = self.codes[:0]
