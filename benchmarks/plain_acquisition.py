"""Acquisition in plain Python: bytes up to a zero, one frame at a time, one sample at a time."""

from __future__ import annotations

import struct
import time
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_HEADER = struct.Struct("<BBHQQ")
_SAMPLE = struct.Struct("<7hH")
_ROW = struct.Struct("<Q7dH")
_DATA = 0x83


def _unstuffed(encoded: bytes) -> bytes:
    """Decode COBS, byte by byte."""
    out, place = bytearray(), 0
    while place < len(encoded):
        code = encoded[place]
        out += encoded[place + 1 : place + code]
        place += code
        if code < 0xFF and place < len(encoded):
            out.append(0)
    return bytes(out)


def record(
    pieces: list[bytes], gains: list[float], offsets: list[float], path: Path
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the seconds for each piece of the stream, shape (k,), and all rows in order of time, shape (n, 9)."""
    rows: list[tuple[float, ...]] = []
    seconds, pending = [], b""
    with path.open("wb") as file:
        for piece in pieces:
            begin = time.thread_time()
            pending += piece
            while b"\0" in pending:
                encoded, pending = pending.split(b"\0", 1)
                raw = _unstuffed(encoded)
                if zlib.crc32(raw[:-4]) != int.from_bytes(raw[-4:], "little"):
                    continue
                _, kind, _, _, index = _HEADER.unpack(raw[: _HEADER.size])
                if kind != _DATA:
                    continue
                for number, codes in enumerate(_SAMPLE.iter_unpack(raw[_HEADER.size : -4])):
                    values = [
                        gain * code + offset for gain, code, offset in zip(gains, codes[:7], offsets, strict=True)
                    ]
                    rows.append((index + number, *values, codes[7]))
                    file.write(_ROW.pack(index + number, *values, codes[7]))
            seconds.append(time.thread_time() - begin)
    return np.array(seconds), np.array(rows)
