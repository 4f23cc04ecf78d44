"""Transmit queue: encoded frames that wait for the line, numbered in the order of creation."""

from __future__ import annotations

from collections import deque

from tissueid import wire
from tissueid.wire import Frame, MessageType

TRANSMIT_QUEUE_BYTES = 64 * 1024


class Outbox:
    """Queue of limited size. If the host does not read, whole frames are dropped: ``dropped_frames`` counts them."""

    def __init__(self, sample_rate_hz: float) -> None:
        self._rate = sample_rate_hz
        self.dropped_frames = 0
        self._frames: deque[bytes] = deque()
        self._bytes = 0
        self._sequence = 0

    def put(self, kind: MessageType, payload: bytes, index: int) -> None:
        """Queue a frame with sample index ``index``; a dropped frame leaves a gap in the sequence numbers."""
        frame = Frame(kind, self._sequence, round(index / self._rate * 1e6), index, payload)
        self._sequence = (self._sequence + 1) & 0xFFFF
        encoded = wire.encode_frame(frame)
        if self._bytes + len(encoded) > TRANSMIT_QUEUE_BYTES:
            self.dropped_frames += 1
            return
        self._frames.append(encoded)
        self._bytes += len(encoded)

    def take(self) -> bytes:
        """Return and remove all queued bytes."""
        data = b"".join(self._frames)
        self._frames.clear()
        self._bytes = 0
        return data
