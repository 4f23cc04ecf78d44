"""Journal entries (kind, length, payload, checksum): encoding, search in a damaged file, and validation of content."""

from __future__ import annotations

import contextlib
import json
import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import IO, Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import SAMPLE
from tissueid.sessions import Subject, Test
from tissueid.sessions.model import TestNumber, stored_test
from tissueid.untrusted_input import StoredName, StoredText, StoredValue

MAGIC = b"TIDJ\x01\r\n\x00"
_ENTRY = struct.Struct("<BI")
_CRC = struct.Struct("<I")
MAX_ENTRY = 64 * 1024 * 1024
_HEADS = re.compile(rb"(?=[\x01-\x06].{3}[\x00-\x04])", re.DOTALL)
"""Pattern of the start of an entry: a known kind and a length (little-endian) up to MAX_ENTRY."""
_PIECE = 1 << 20
MAX_CHECKED = 1 << 30
"""Maximum number of bytes checked in the search for the next entry after a damage: about a second."""


class Entry(IntEnum):
    """Kind of an entry; all but SAMPLES hold JSON."""

    SITTING = 1
    TEST = 2
    SAMPLES = 3
    EVENT = 4
    TEST_END = 5
    CLOSED = 6


def encode_entry(kind: Entry, payload: bytes) -> bytes:
    """Return an entry: kind, length, payload, and CRC-32 of all three."""
    body = _ENTRY.pack(kind, len(payload)) + payload
    return body + _CRC.pack(zlib.crc32(body))


def encode_json(kind: Entry, value: dict[str, Any]) -> bytes:
    """Return an entry that holds JSON."""
    return encode_entry(kind, json.dumps(value).encode())


@dataclass
class Damage:
    """Damaged or invalid regions of a journal. A truncated last entry is not counted."""

    places: int = 0
    bytes: int = 0
    left_out: list[str] = field(default_factory=list)
    """Messages about tests that are omitted because too few samples can be read."""

    def add(self, count: int) -> None:
        """Count a damaged region of ``count`` bytes."""
        self.places += 1
        self.bytes += count

    def leave_out(self, words: str) -> None:
        """Add a message about an omitted test."""
        self.places += 1
        self.left_out.append(words)


def read_entries(path: Path, damage: Damage | None = None) -> Iterator[tuple[Entry, bytes]]:
    """Yield the intact entries of a journal in order, including those after a damaged region.

    Skipped regions are counted in ``damage``; a truncated last entry is ignored.

    Raises:
        UnusableInputError: the file is not a journal.
    """
    damage = Damage() if damage is None else damage
    with path.open("rb") as file:
        end = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        place = len(MAGIC)
        if not MAGIC.startswith(magic):
            if entry_at(file, place, end) is None:
                raise UnusableInputError("journal.not_one", "{path} is not a journal of this software", path=str(path))
            damage.add(place)
        budget = MAX_CHECKED
        while place < end:
            entry = entry_at(file, place, end)
            if entry is None:
                found, budget = _next_entry(file, place + 1, end, budget)
                if found < end or not _cut_off(file, place, end):
                    damage.add(found - place)
                place = found
                continue
            kind, payload = entry
            place += _ENTRY.size + len(payload) + _CRC.size
            with contextlib.suppress(ValueError):  # a kind of a newer version
                yield Entry(kind), payload


def entry_at(file: IO[bytes], place: int, end: int) -> tuple[int, bytes] | None:
    """Return kind and payload of the entry at ``place``; None without an intact entry."""
    file.seek(place)
    head = file.read(_ENTRY.size)
    if len(head) < _ENTRY.size:
        return None
    kind, length = _ENTRY.unpack(head)
    if length > min(MAX_ENTRY, end - place):
        return None
    payload, crc = file.read(length), file.read(_CRC.size)
    if len(crc) < _CRC.size or zlib.crc32(payload, zlib.crc32(head)) != _CRC.unpack(crc)[0]:
        return None
    return kind, payload


def _next_entry(file: IO[bytes], place: int, end: int, budget: int) -> tuple[int, int]:
    """Return the offset of the next intact entry, or the end, and the remaining budget of bytes to check."""
    while place < end:
        file.seek(place)
        piece = file.read(_PIECE + _ENTRY.size - 1)
        if len(piece) < _ENTRY.size:
            break
        for match in _HEADS.finditer(piece):
            begin = place + match.start()
            _, length = _ENTRY.unpack_from(piece, match.start())
            if begin + _ENTRY.size + length + _CRC.size > end:
                continue
            budget -= length
            if budget < 0:
                return end, 0
            if entry_at(file, begin, end) is not None:
                return begin, budget
        place += _PIECE
    return end, budget


def _cut_off(file: IO[bytes], place: int, end: int) -> bool:
    """Return whether the last bytes may be a truncated entry or unused space."""
    file.seek(place)
    head = file.read(_ENTRY.size)
    if len(head) < _ENTRY.size:
        return True
    kind, length = _ENTRY.unpack(head)
    if kind > 0 and length <= MAX_ENTRY and place + _ENTRY.size + length + _CRC.size > end:
        return True
    while head and not head.strip(b"\0"):
        head = file.read(_PIECE)
    return not head


MAX_RUN_SAMPLES = 20_000_000
"""Maximum number of samples of a run."""
MAX_JSON = 4 * 1024 * 1024
"""Maximum size of a JSON entry, bytes: four times the longest text in a session."""


class _Content(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")


class SittingContent(_Content):
    """Subject and instrument of a sitting. ``sample_fields`` are those of ``instrument.SAMPLE``."""

    session_id: StoredText
    created: StoredText
    device: DeviceDescription
    subject: Subject
    sample_fields: list[tuple[str, str]]
    audit_head: StoredText = ""

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.sample_fields != [tuple(item) for item in SAMPLE.descr]:
            raise ValueError("its samples have a layout that this software does not know")
        return self


class RunContent(_Content):
    """Content of an ``instrument.Run``."""

    first_index: Annotated[int, Field(ge=0, lt=2**62)]
    samples: Annotated[int, Field(gt=0, le=MAX_RUN_SAMPLES)]


class TestContent(_Content):
    """Header of a test; ``again`` marks a repetition during the test."""

    __test__ = False

    number: TestNumber
    run: RunContent
    attributes: dict[str, Any]
    again: bool = False

    @cached_property
    def test(self) -> Test:
        """The test, without signals."""
        return stored_test(self.number, self.attributes)

    @model_validator(mode="after")
    def _usable(self) -> Self:
        assert self.test is not None
        return self


class TestEndContent(_Content):
    """End of a test; ``samples`` is its length if it ended early."""

    __test__ = False

    status: StoredText
    notes: dict[StoredName, StoredValue] = {}
    test: TestNumber | None = None
    samples: int | None = None


class ClosedContent(_Content):
    """End of a sitting."""

    audit_head: StoredText | None = None


class EventContent(BaseModel):
    """An event with arbitrary names and values."""

    model_config = ConfigDict(strict=True, frozen=True, extra="allow")
    __pydantic_extra__: dict[str, JsonValue]

    kind: StoredText
    test: TestNumber | None = None

    def as_note(self) -> dict[str, Any]:
        """Return the event without the number of its test."""
        return self.model_dump(exclude={"test"})


_Model = TypeVar("_Model", bound=BaseModel)


def content_of(model: type[_Model], payload: bytes, damage: Damage) -> _Model | None:
    """Return the validated content of an entry; count an invalid one as damage and return None."""
    try:
        if len(payload) > MAX_JSON:
            raise ValueError("longer than any entry that this software writes")
        return model.model_validate_json(payload)
    except (ValidationError, ValueError, RecursionError):
        damage.add(len(payload))
        return None
