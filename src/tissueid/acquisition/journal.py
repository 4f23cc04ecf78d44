"""The journal: an append-only file of checksummed entries that holds a sitting until its session is written.

An HDF5 file that is open for writing is lost when its host dies at the wrong moment. A journal never is: whatever
was cut off at its end fails its checksum, and all that stands before it is whole (docs/decisions/0003-journal.md). So
is all that stands after a place that the disk damaged.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from tissueid.acquisition.entries import MAGIC, Damage, Entry, encode_entry, encode_json, read_entries
from tissueid.errors import TissueIDError
from tissueid.sessions.members import journal_path
from tissueid.whole_file import create_private, sync_folder, write_all

__all__ = [
    "MAGIC",
    "Damage",
    "Entry",
    "Journal",
    "JournalError",
    "encode_entry",
    "encode_json",
    "journal_path",
    "lock",
    "read_entries",
]

SYNC_S = 1.0
MAX_WAITING = 64 * 1024 * 1024
"""Bytes that wait for the disk; a recorder allows less."""
PATIENCE_S = 30.0
"""How long the end of a sitting waits for a disk that does not answer. No coil waits for it."""
_LOOK_S = 0.05
"""Between two looks whether the thread that writes is still there."""


class JournalError(TissueIDError):
    """The journal cannot be written: the disk is full, or failed. The test is stopped, what is synced is kept."""


@dataclass
class _Flush:
    """Asks the writing thread to sync what came before, and with ``last`` to end; then sets ``done``."""

    last: bool = False
    done: threading.Event = field(default_factory=threading.Event)


class Journal:
    """A journal being written. A thread does the writing, so that a slow disk does not starve the heartbeat.

    What fails once is final: nothing is written after it, for what a disk says after that is not to be relied on.
    ``max_waiting`` bytes may wait for a disk that stands still. Nobody waits longer than ``patience_s`` for it.

    Raises:
        JournalError: the file is there already, or cannot be made.
    """

    def __init__(
        self, path: Path, *, sync_s: float = SYNC_S, max_waiting: int = MAX_WAITING, patience_s: float = PATIENCE_S
    ) -> None:
        self.path = path
        self._sync_s = sync_s
        self._max_waiting = max_waiting
        self._patience_s = patience_s
        try:
            self._file: IO[bytes] = os.fdopen(create_private(path), "wb", buffering=0)
        except FileExistsError as error:
            raise JournalError(f"{path} is left from an unfinished session: run 'tissueid recover' first") from error
        except OSError as error:
            raise JournalError(f"cannot write {path}: {error.strerror}") from error
        try:
            lock(self._file)
            self._write(MAGIC)
        except OSError as error:
            self._file.close()
            _remove(path)
            raise JournalError(f"cannot write {path}: {error.strerror}. Nothing was begun") from error
        self._queue: queue.SimpleQueue[bytes | _Flush] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._appended = self._synced = 0
        self._appended_bytes = self._written_bytes = 0
        self._named = self._ended = False
        self._last: _Flush | None = None
        self._thread = threading.Thread(target=self._write_all, name="journal", daemon=True)
        self._thread.start()

    def append(self, entry: bytes) -> int:
        """Queue an entry; returns its number, to be compared with ``synced``.

        Raises:
            JournalError: an earlier write failed, or too much waits to be written.
        """
        self.check()
        if self._appended_bytes - self._written_bytes > self._max_waiting:
            raise JournalError(
                f"the disk does not take what is recorded into {self.path}. What reached it is kept; once the disk "
                "answers again, 'tissueid recover' makes the session from it"
            )
        return self.leave(entry)

    def leave(self, entry: bytes) -> int:
        """As ``append``, but never refused: for the end of a test, which must not fail over its recording."""
        self._appended += 1
        self._appended_bytes += len(entry)
        self._queue.put(entry)
        return self._appended

    @property
    def synced(self) -> int:
        """How many entries are known to be on the disk."""
        return self._synced

    def check(self) -> None:
        """Raise what the writing thread met, if anything."""
        if isinstance(self._error, FileNotFoundError):
            raise JournalError(
                f"{self.path} was removed or moved away while it was written; where it still is, 'tissueid recover' "
                "makes the session from it"
            ) from self._error
        if self._error is not None:
            reason = getattr(self._error, "strerror", None) or str(self._error) or type(self._error).__name__
            raise JournalError(
                f"cannot write {self.path}: {reason}. What was recorded before is kept in it; once that is mended, "
                "'tissueid recover' makes the session from it"
            ) from self._error

    def sync(self) -> None:
        """Wait until everything appended so far is on the disk.

        Raises:
            JournalError: it cannot be brought there, or not in time.
        """
        self._wait_for(_Flush())
        self.check()

    def close(self) -> None:
        """Write what is queued, sync, and close. Errors are left for ``check``.

        A disk that stands still is not waited for for ever: the file is closed when it answers.

        Raises:
            JournalError: it does not answer in time.
        """
        if self._last is None:
            self._last = _Flush(last=True)
            self._wait_for(self._last)
        else:
            self._await(self._last)
        self._thread.join()

    def _wait_for(self, request: _Flush) -> None:
        if self._ended:
            return
        self._queue.put(request)
        self._await(request)

    def _await(self, request: _Flush) -> None:
        until = time.monotonic() + self._patience_s
        while not request.done.wait(max(0.0, min(_LOOK_S, until - time.monotonic()))):
            if not self._thread.is_alive() and not request.done.is_set():
                self.check()
                raise JournalError(
                    f"the writing of {self.path} ended before its time. What was recorded before is kept in it; "
                    "'tissueid recover' makes the session from it"
                )
            if time.monotonic() >= until:
                raise self._no_answer()

    def _no_answer(self) -> JournalError:
        return JournalError(
            f"the disk of {self.path} does not answer. What reached it is kept; once it answers again, "
            "'tissueid recover' makes the session from it"
        )

    def _write_all(self) -> None:
        try:
            self._take_all()
        except BaseException as error:  # noqa: BLE001 - told by ``check``: a thread that is gone writes nothing
            self._fail(error)
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def _take_all(self) -> None:
        """Write what is queued until told to end."""
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
            except Exception as error:  # noqa: BLE001 - memory that ran out loses as much as a disk that did
                self._fail(error)
                sync_at = None
            if isinstance(item, bytes):
                self._written_bytes += len(item)
            elif isinstance(item, _Flush):
                if item.last:
                    self._end(item)
                    return
                item.done.set()

    def _end(self, request: _Flush) -> None:
        """Close the file, so that nobody holds it any more."""
        try:
            self._file.close()
        except OSError as error:
            self._fail(error)
        self._ended = True
        request.done.set()

    def _fail(self, error: BaseException) -> None:
        """Whatever comes after is not written; a file without a name keeps nothing that was."""
        self._error = self._error or error
        if not self._is_anywhere():
            self._synced = 0

    def _next(self, sync_at: float | None) -> bytes | _Flush | None:
        """The next item, or None when it is time to sync."""
        try:
            return self._queue.get(timeout=None if sync_at is None else max(0.0, sync_at - time.monotonic()))
        except queue.Empty:
            return None

    def _write(self, data: bytes) -> None:
        write_all(self._file.fileno(), data)

    def _sync(self) -> None:
        """Bring the file to the disk, and its name.

        Raises:
            FileNotFoundError: it has another name by now, or none.
            OSError: the disk failed.
        """
        os.fsync(self._file.fileno())
        if not self._named:
            sync_folder(self.path.parent)
            self._named = True
        if not os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))

    def _is_anywhere(self) -> bool:
        """Whether the file still has a name: without one, nothing that it holds can be found again."""
        try:
            return os.fstat(self._file.fileno()).st_nlink > 0
        except (OSError, ValueError):
            return True  # what cannot be asked any more may hold it all the same


def _remove(path: Path) -> None:
    """Remove a file; one that cannot be removed is in nobody's way."""
    with contextlib.suppress(OSError):
        path.unlink()


def lock(file: IO[bytes]) -> None:
    """Hold the file until it is closed, so that nobody recovers a journal that is being written.

    Raises:
        JournalError: another process holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows refuses to rename or delete an open file, which does the same
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise JournalError(f"{file.name} is being written by a test that still runs") from error
