"""Check of the text heaps in an HDF5 file before the HDF5 library reads them.

The library walks the objects of a global heap collection by their stored sizes. A damaged size can cause an endless
loop, which only the end of the process stops. These sizes are the only part of the format used by sessions without a
checksum. Source: "HDF5 File Format Specification", version 3.0, section III.E.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from tissueid.errors import SessionFormatError
from tissueid.messages import Message
from tissueid.untrusted_input import MAX_HEAP_BYTES

_MARK = b"GCOL\x01\0\0\0"
"""Signature, version and reserved bytes. Other data contain these eight bytes by chance once in 10^19."""
_HEAD = len(_MARK) + 8
_OBJECT = struct.Struct("<HHIQ")
_BLOCK = 16 << 20


def check_heaps(path: Path) -> None:
    """Check that the objects of every global heap collection are consecutive and within it.

    Raises:
        SessionFormatError: an object is not, or a collection is too large.
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        start, tail = 0, b""
        while block := file.read(_BLOCK):
            data = tail + block
            place = data.find(_MARK)
            while place >= 0:
                _check(file, start - len(tail) + place)
                place = data.find(_MARK, place + 1)
            start += len(block)
            tail = data[-len(_MARK) + 1 :]
            file.seek(start)


def _check(file: BinaryIO, place: int) -> None:
    file.seek(place)
    head = file.read(_HEAD)
    size = int.from_bytes(head[len(_MARK) :], "little")
    if size > MAX_HEAP_BYTES:
        raise SessionFormatError(
            Message(
                "session.heap",
                "its texts take {size} bytes in one piece; at most {most} are read",
                size=size,
                most=MAX_HEAP_BYTES,
            )
        )
    body = file.read(max(0, size - _HEAD))
    if len(head) < _HEAD or len(body) < size - _HEAD:
        raise SessionFormatError(Message("session.heap_truncated", "is damaged: the file ends within its texts"))
    at = 0
    while len(body) - at >= _OBJECT.size:
        index, _, _, length = _OBJECT.unpack_from(body, at)
        at += _OBJECT.size + length + -length % 8 if index else max(1, length) if length else len(body) + 1
        if at > len(body):
            raise SessionFormatError(Message("session.heap_overlap", "is damaged: its texts overlap"))
