"""Journal: append-only file of checksummed entries that stores a sitting until its session file is written.

An HDF5 file that is open for writing can be lost if the host crashes. A journal survives: a truncated last entry fails
its checksum, and all other entries remain readable, even after a damaged region (docs/decisions/0003-journal.md).
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import queue
import re
import struct
import threading
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import IO, Annotated, Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from tissueid.atomic_write import create_private, sync_folder, write_all
from tissueid.device import DeviceDescription
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.instrument import SAMPLE
from tissueid.messages import Action
from tissueid.sessions import Subject, Test
from tissueid.sessions.file_policy import RECOVER_PLACE
from tissueid.sessions.file_policy import journal_path as journal_path
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

    def leave_out(self, message: str) -> None:
        """Add a message about an omitted test."""
        self.places += 1
        self.left_out.append(message)


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
        offset = len(MAGIC)
        if not MAGIC.startswith(magic):
            if entry_at(file, offset, end) is None:
                raise UnusableInputError("journal.not_one", "{path} is not a journal of this software", path=str(path))
            damage.add(offset)
        budget = MAX_CHECKED
        while offset < end:
            entry = entry_at(file, offset, end)
            if entry is None:
                next_offset, budget = _next_entry(file, offset + 1, end, budget)
                if next_offset < end or not _cut_off(file, offset, end):
                    damage.add(next_offset - offset)
                offset = next_offset
                continue
            kind, payload = entry
            offset += _ENTRY.size + len(payload) + _CRC.size
            with contextlib.suppress(ValueError):  # a kind of a newer version
                yield Entry(kind), payload


def entry_at(file: IO[bytes], offset: int, end: int) -> tuple[int, bytes] | None:
    """Return kind and payload of the entry at ``place``; None without an intact entry."""
    file.seek(offset)
    head = file.read(_ENTRY.size)
    if len(head) < _ENTRY.size:
        return None
    kind, length = _ENTRY.unpack(head)
    if length > min(MAX_ENTRY, end - offset):
        return None
    payload, crc = file.read(length), file.read(_CRC.size)
    if len(crc) < _CRC.size or zlib.crc32(payload, zlib.crc32(head)) != _CRC.unpack(crc)[0]:
        return None
    return kind, payload


def _next_entry(file: IO[bytes], offset: int, end: int, budget: int) -> tuple[int, int]:
    """Return the offset of the next intact entry, or the end, and the remaining budget of bytes to check."""
    while offset < end:
        file.seek(offset)
        piece = file.read(_PIECE + _ENTRY.size - 1)
        if len(piece) < _ENTRY.size:
            break
        for match in _HEADS.finditer(piece):
            begin = offset + match.start()
            _, length = _ENTRY.unpack_from(piece, match.start())
            if begin + _ENTRY.size + length + _CRC.size > end:
                continue
            budget -= length
            if budget < 0:
                return end, 0
            if entry_at(file, begin, end) is not None:
                return begin, budget
        offset += _PIECE
    return end, budget


def _cut_off(file: IO[bytes], offset: int, end: int) -> bool:
    """Return whether the last bytes may be a truncated entry or unused space."""
    file.seek(offset)
    head = file.read(_ENTRY.size)
    if len(head) < _ENTRY.size:
        return True
    kind, length = _ENTRY.unpack(head)
    if kind > 0 and length <= MAX_ENTRY and offset + _ENTRY.size + length + _CRC.size > end:
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


SYNC_S = 1.0
"""Maximum time, s, from an entry to its sync to the disk."""
MAX_WAITING = 64 * 1024 * 1024
"""Maximum number of unwritten bytes; a recorder uses a lower limit."""
DISK_TIMEOUT_S = 30.0
"""Timeout, s, for a disk that does not respond at the end of a sitting. The coil is free meanwhile."""
_CHECK_S = 0.05
"""Interval, s, of the checks that the writer thread is alive."""
RECOVER = Action("session.recover", "tissueid recover", RECOVER_PLACE)


class JournalError(TissueIDError):
    """Error when writing the journal: disk full or failed. The test is stopped; synced entries are kept."""


@dataclass
class _Flush:
    """Request to the writer thread: sync all earlier entries, end if ``last``, then set ``done``."""

    last: bool = False
    done: threading.Event = field(default_factory=threading.Event)


class Journal:
    """Journal open for writing. A separate thread writes, so that a slow disk does not delay the heartbeat.

    After the first failure nothing more is written, because the disk is no longer reliable. At most ``max_waiting``
    bytes may be unwritten. ``sync`` and ``close`` wait at most ``disk_timeout_s``.

    Raises:
        JournalError: the file exists or cannot be created.
    """

    def __init__(
        self,
        path: Path,
        *,
        sync_s: float = SYNC_S,
        max_waiting: int = MAX_WAITING,
        disk_timeout_s: float = DISK_TIMEOUT_S,
    ) -> None:
        self.path = path
        self._sync_s = sync_s
        self.max_waiting = max_waiting
        self.disk_timeout_s = disk_timeout_s
        try:
            self._file: IO[bytes] = os.fdopen(create_private(path), "wb", buffering=0)
        except FileExistsError as error:
            raise JournalError(
                "journal.exists",
                "{path} exists: another window records to it now, or it is left from an unfinished session; then use "
                "{action} first",
                path=str(path),
                action=RECOVER,
            ) from error
        except OSError as error:
            raise JournalError(
                "file.not_writable", "cannot write {path}: {reason}", path=str(path), reason=str(error.strerror)
            ) from error
        try:
            lock(self._file)
            self._write(MAGIC)
        except OSError as error:
            self._file.close()
            with contextlib.suppress(OSError):
                path.unlink()
            raise JournalError(
                "journal.not_begun",
                "cannot write {path}: {reason}. Nothing was started",
                path=str(path),
                reason=str(error.strerror),
            ) from error
        self._queue: queue.SimpleQueue[bytes | _Flush] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._appended = self._synced = 0
        self._appended_bytes = self._written_bytes = 0
        self._named = self._ended = False
        self._last: _Flush | None = None
        self.writer = threading.Thread(target=self._write_all, name="journal", daemon=True)
        self.writer.start()

    def append(self, entry: bytes) -> int:
        """Queue an entry; return its number, for comparison with ``synced``.

        Raises:
            JournalError: an earlier write failed, or too many bytes are unwritten.
        """
        self.check()
        if self.unwritten_bytes > self.max_waiting:
            raise JournalError(
                "journal.disk_slow",
                "the disk is too slow to record into {path}. The written part is kept; when the disk responds "
                "again, {action} makes the session from it",
                path=str(self.path),
                action=RECOVER,
            )
        return self.append_unchecked(entry)

    def append_unchecked(self, entry: bytes) -> int:
        """Queue an entry without checks: for the end of a test, which must not fail because of the recording."""
        self._appended += 1
        self._appended_bytes += len(entry)
        self._queue.put(entry)
        return self._appended

    @property
    def unwritten_bytes(self) -> int:
        """Number of queued bytes that the writer thread has not processed yet."""
        return self._appended_bytes - self._written_bytes

    @property
    def synced(self) -> int:
        """Number of entries that are synced to the disk."""
        return self._synced

    def check(self) -> None:
        """Raise the error of the writer thread, if any.

        Raises:
            JournalError: an entry could not be written.
        """
        if isinstance(self._error, FileNotFoundError):
            raise JournalError(
                "journal.moved",
                "{path} was removed or moved while it was written; if it still exists, {action} makes the session "
                "from it",
                path=str(self.path),
                action=RECOVER,
            ) from self._error
        if self._error is not None:
            reason = getattr(self._error, "strerror", None) or str(self._error) or type(self._error).__name__
            raise JournalError(
                "journal.failed",
                "cannot write {path}: {reason}. The recording so far is kept in it; when the cause is removed, "
                "{action} makes the session from it",
                path=str(self.path),
                reason=reason,
                action=RECOVER,
            ) from self._error

    def sync(self) -> None:
        """Wait until all entries so far are on the disk.

        Raises:
            JournalError: they could not be written, or not in time.
        """
        self.drain()
        self.check()

    def drain(self) -> None:
        """Wait until the writer thread has processed all entries so far, written or not.

        Raises:
            JournalError: it did not in time.
        """
        self._wait_for(_Flush())

    def close(self) -> None:
        """Write the queued entries, sync, and close; ``check`` raises write errors.

        Raises:
            JournalError: the disk does not respond in time; the file is closed when it does.
        """
        if self._last is None:
            self._last = _Flush(last=True)
            self._wait_for(self._last)
        else:
            self._await(self._last)
        self.writer.join()

    def _wait_for(self, request: _Flush) -> None:
        if self._ended:
            return
        self._queue.put(request)
        self._await(request)

    def _await(self, request: _Flush) -> None:
        until = time.monotonic() + self.disk_timeout_s
        while not request.done.wait(max(0.0, min(_CHECK_S, until - time.monotonic()))):
            if not self.writer.is_alive() and not request.done.is_set():
                self.check()
                raise JournalError(
                    "journal.thread_ended",
                    "the writing of {path} ended unexpectedly. The recording so far is kept in it; {action} makes "
                    "the session from it",
                    path=str(self.path),
                    action=RECOVER,
                )
            if time.monotonic() >= until:
                raise JournalError(
                    "journal.no_answer",
                    "the disk of {path} does not respond. The written part is kept; when the disk responds again, "
                    "{action} makes the session from it",
                    path=str(self.path),
                    action=RECOVER,
                )

    def _write_all(self) -> None:
        try:
            self._take_all()
        except BaseException as error:  # noqa: BLE001 - ``check`` raises it
            self._fail(error)
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def _take_all(self) -> None:
        """Write queued entries until the last request."""
        written = 0
        sync_at: float | None = None
        while True:
            item = self._next(sync_at)
            try:
                if self._error is None and isinstance(item, bytes):
                    self._write(item)
                    written += 1
                    sync_at = sync_at or time.monotonic() + self._sync_s
                due = not isinstance(item, bytes) or (sync_at or 0.0) <= time.monotonic()
                if self._error is None and due and written > self._synced:
                    self._sync()
                    self._synced, sync_at = written, None
            except Exception as error:  # noqa: BLE001 - exhausted memory loses entries as a full disk does
                self._fail(error)
                sync_at = None
            if isinstance(item, bytes):
                self._written_bytes += len(item)
            elif isinstance(item, _Flush):
                if item.last:
                    try:
                        self._file.close()  # which releases its lock
                    except OSError as error:
                        self._fail(error)
                    self._ended = True
                item.done.set()
                if item.last:
                    return

    def _fail(self, error: BaseException) -> None:
        """Store the first error; if the file was removed, and its content is lost, nothing counts as synced."""
        self._error = self._error or error
        with contextlib.suppress(OSError, ValueError):  # unknown, for instance after a disconnected disk
            if not os.fstat(self._file.fileno()).st_nlink:
                self._synced = 0

    def _next(self, sync_at: float | None) -> bytes | _Flush | None:
        """Return the next item, or None when a sync is due."""
        try:
            return self._queue.get(timeout=None if sync_at is None else max(0.0, sync_at - time.monotonic()))
        except queue.Empty:
            return None

    def _write(self, data: bytes) -> None:
        write_all(self._file.fileno(), data)

    def _sync(self) -> None:
        """Sync the file and, once, its folder.

        Raises:
            FileNotFoundError: the file was renamed or removed.
            OSError: the disk failed.
        """
        os.fsync(self._file.fileno())
        if not self._named:
            sync_folder(self.path.parent)
            self._named = True
        if not os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))


def lock(file: IO[bytes]) -> None:
    """Lock the file until it is closed, so that no other process recovers a journal in use.

    Raises:
        JournalError: another process has locked it.
    """
    try:
        import fcntl
    except ImportError:  # Windows does not rename or delete an open file, which has the same effect
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise JournalError(
            "journal.running", "{path} is being written by a test that still runs", path=str(file.name)
        ) from error
