"""Frames: header, payload and CRC-32, COBS encoded, terminated by a zero byte (docs/protocol.md, section 2)."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

from cobs import cobs

PROTOCOL_VERSION = 1
"""Version of the written frames. Versions are compared in the handshake, not for every frame."""

HEADER = struct.Struct("<BBHQQ")
"""Version, type, sequence number, device time in microseconds, sample index."""

_CRC = struct.Struct("<I")
MAX_PAYLOAD = 2048
_MIN_FRAME = HEADER.size + _CRC.size
_MAX_FRAME = _MIN_FRAME + MAX_PAYLOAD
_MAX_ENCODED = _MAX_FRAME + _MAX_FRAME // 254 + 1


@dataclass(frozen=True, slots=True)
class Frame:
    """Decoded frame. ``type`` is a number, because a newer peer may send unknown types."""

    type: int
    sequence: int = 0
    device_time_us: int = 0
    sample_index: int = 0
    payload: bytes = b""
    version: int = PROTOCOL_VERSION


def encode_frame(frame: Frame) -> bytes:
    """Encode a frame, including the terminating zero byte.

    Raises:
        ValueError: the payload is longer than ``MAX_PAYLOAD``.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise ValueError(f"a payload of {len(frame.payload)} bytes exceeds {MAX_PAYLOAD}")
    body = (
        HEADER.pack(frame.version, frame.type, frame.sequence & 0xFFFF, frame.device_time_us, frame.sample_index)
        + frame.payload
    )
    encoded: bytes = cobs.encode(body + _CRC.pack(zlib.crc32(body)))
    return encoded + b"\0"


@dataclass(slots=True)
class FrameStatistics:
    """Counters of a decoder: accepted frames, and rejected frames by reason."""

    accepted: int = 0
    bad_cobs: int = 0
    bad_length: int = 0
    bad_crc: int = 0

    @property
    def refused(self) -> int:
        """Total number of rejected frames."""
        return self.bad_cobs + self.bad_length + self.bad_crc


@dataclass(slots=True)
class FrameDecoder:
    """Decoder of a byte stream into frames. Damaged bytes affect only the frames that contain them."""

    statistics: FrameStatistics = field(default_factory=FrameStatistics)
    _buffer: bytearray = field(default_factory=bytearray)
    _overlong: bool = False

    @property
    def pending_bytes(self) -> int:
        """Number of stored bytes of a frame that is not complete yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Process bytes and return the frames that they complete, in order."""
        self._buffer += data
        *complete, rest = self._buffer.split(b"\0")
        frames = []
        for encoded in complete:
            # The tail of an overlong run is not a frame of its own.
            if self._overlong:
                self._overlong = False
                self.statistics.bad_length += 1
            elif encoded and (frame := self._decode(bytes(encoded))) is not None:
                frames.append(frame)
        if len(rest) > _MAX_ENCODED:
            self._overlong = True
            rest = bytearray()
        self._buffer = rest
        return frames

    def _decode(self, encoded: bytes) -> Frame | None:
        try:
            raw = cobs.decode(encoded)
        except cobs.DecodeError:
            self.statistics.bad_cobs += 1
            return None
        if not _MIN_FRAME <= len(raw) <= _MAX_FRAME:
            self.statistics.bad_length += 1
            return None
        body, (crc,) = raw[: -_CRC.size], _CRC.unpack(raw[-_CRC.size :])
        if zlib.crc32(body) != crc:
            self.statistics.bad_crc += 1
            return None
        self.statistics.accepted += 1
        version, kind, sequence, time_us, index = HEADER.unpack_from(body)
        return Frame(kind, sequence, time_us, index, body[HEADER.size :], version)
