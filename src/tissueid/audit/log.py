"""Adding lines to the audit log: locked between processes, synced, and safe from a computer that dies half-way."""

from __future__ import annotations

import contextlib
import errno
import getpass
import hashlib
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from platformdirs import user_data_path

from tissueid import __version__
from tissueid.audit.line import (
    CANCEL,
    CLOSED_OFF,
    LINES_MISSING,
    MAX_LINE,
    NOTHING_BEFORE,
    STARTED,
    Line,
    is_torn,
    make_line,
    read_line,
)
from tissueid.audit.newest import read_newest, write_newest
from tissueid.errors import TissueIDError
from tissueid.whole_file import private_folder, private_opener, sync_folder, write_all

ENVIRONMENT = "TISSUEID_AUDIT"
FORMAT = "tissueid-audit"
FORMAT_VERSION = "1.0"
LOCK_S = 10.0
"""A line takes milliseconds to be added; who holds the log for longer than this hangs."""
_RETRY_S = 0.01
_SOFTWARE = f"tissueid {__version__}"


class AuditError(TissueIDError):
    """The audit log cannot be written, or is no audit log. Nothing new is begun; what runs is ended in its own time."""


def default_path() -> Path:
    """Where the log of this computer lies: what ``TISSUEID_AUDIT`` says, or the user's own folder for data."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else user_data_path("tissueid", appauthor=False) / "audit.jsonl"


def account() -> str:
    """The operating system's name for whoever runs this program."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a container without a list of users
        return f"uid {os.getuid()}" if hasattr(os, "getuid") else "unknown"


def now() -> datetime:
    """The time, UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class _End:
    """How a log ends: its newest whole line, and what a dying computer left after it."""

    line: Line | None
    size: int
    leftover: bytes = b""
    closed: bool = True
    """Whether the newest whole line has its newline."""


@dataclass(frozen=True)
class AuditLog:
    """A log of which lines are only ever added. ``path`` is made when the first line is."""

    path: Path
    clock: Callable[[], datetime] = now

    def record(
        self,
        role: str,
        what: str,
        *,
        subject: str = "",
        old: Any = None,
        new: Any = None,
        when: datetime | None = None,
    ) -> str:
        """Add one line and sync it: ``what`` was done (``calibration.made``, ...), to which ``subject``.

        ``when`` is for what happened before it could be written. Never a person's name: subjects of tests are
        pseudonyms. Returns the head, number and hash of the line.

        Raises:
            AuditError: it could not be written, or the file is no audit log, or its end is damaged.
        """
        moment = when or self.clock()
        try:
            if os.environ.get(ENVIRONMENT) == str(self.path) and not self.path.parent.exists():
                raise FileNotFoundError(errno.ENOENT, f"there is no folder {self.path.parent}")
            private_folder(self.path.parent)
            with _held(self.path) as descriptor:
                end = _end_of(descriptor, self.path)
                missing = _missing_head(end, self.path)
                data, head = self._lines(end, missing, role, what, moment, subject=subject, old=old, new=new)
                _append(descriptor, data, end.size)
                write_newest(self.path, head, os.fstat(descriptor))
                if end.size == 0:
                    sync_folder(self.path.parent)
        except OSError as error:
            raise AuditError(
                f"cannot write the audit log {self.path}: {error.strerror or error}. Nothing is begun that cannot be "
                f"logged: mend that, or name another file with {ENVIRONMENT}"
            ) from error
        return head

    def _lines(
        self, end: _End, missing: str, role: str, what: str, moment: datetime, **values: Any
    ) -> tuple[bytes, str]:
        """What is to be added, before it what the log itself has to say, and the head after it."""
        data, last = b"" if end.closed else b"\n", end.line

        def add(what: str, **values: Any) -> None:
            nonlocal data, last
            last, line = make_line(
                number=1 if last is None else last.number + 1,
                time=moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
                role=role,
                who=account(),
                what=what,
                **{"subject": "", "old": None, "new": None} | values,
                software=_SOFTWARE,
                previous=NOTHING_BEFORE if last is None else last.hash,
            )
            data += line

        if end.leftover:
            left = end.leftover + CANCEL + b"\n"
            data += CANCEL + b"\n"
            add(CLOSED_OFF, new={"bytes": len(left), "sha256": hashlib.sha256(left).hexdigest()})
        if last is None or (last.what == CLOSED_OFF and last.number == 1):
            add(STARTED, new={"format": FORMAT, "format_version": FORMAT_VERSION})
        if missing:
            add(LINES_MISSING, old=missing)
        add(what, **values)
        assert last is not None
        return data, last.head


def _missing_head(end: _End, path: Path) -> str:
    """The head of the newest line that was ever written, where the log does not have it any more; or nothing."""
    newest = read_newest(path)
    line = end.line
    if newest is None or (line is not None and (line.number > newest[0] or line.hash == newest[1])):
        return ""
    return f"{newest[0]}:{newest[1]}"


def _append(descriptor: int, data: bytes, size: int) -> None:
    """Add and sync; what could not be synced is taken back, so that no later line continues what may be lost."""
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    except OSError:
        with contextlib.suppress(OSError):  # a file that can only be added to: the next line closes it off
            os.ftruncate(descriptor, size)
            os.fsync(descriptor)
        raise


def _end_of(descriptor: int, path: Path) -> _End:
    """How the log ends.

    Raises:
        AuditError: it is no audit log, or its end is not as it was written.
    """
    size = os.lseek(descriptor, 0, os.SEEK_END)
    first = max(0, size - 4 * MAX_LINE)
    os.lseek(descriptor, first, os.SEEK_SET)
    raw = b""
    while block := os.read(descriptor, size - first - len(raw)):
        raw += block
    if first > 0:
        raw = raw[raw.find(b"\n") + 1 :]
    *whole, last = raw.split(b"\n")
    leftover = last
    while whole and whole[-1].endswith(CANCEL):
        leftover = whole.pop() + b"\n" + leftover
    line = None
    if whole or first > 0:
        line = read_line(whole[-1]) if whole else None
        if line is None:
            raise AuditError(
                f"the last line of the audit log {path} is damaged or not of this software; 'tissueid audit verify' "
                "tells more. Keep it under another name, and a new log is begun"
            )
    number = 1 if line is None else line.number + 1
    if (complete := read_line(leftover)) is not None and complete.number == number:
        return _End(complete, size, closed=False)
    if not all(is_torn(piece.removesuffix(CANCEL), number) for piece in leftover.split(b"\n")):
        raise AuditError(
            f"the end of the audit log {path} is damaged, or it is another file; 'tissueid audit verify' tells more. "
            "Keep it under another name, and a new log is begun"
        )
    return _End(line, size, leftover)


@contextmanager
def _held(path: Path) -> Iterator[int]:
    """The file, open to be added to, and held against every other program that would.

    Raises:
        AuditError: it is held for too long.
        OSError: it cannot be opened.
    """
    deadline = time.monotonic() + LOCK_S
    while True:
        descriptor = private_opener(str(path), os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0))
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError(errno.EINVAL, "it is not an ordinary file")
            while not _lock(descriptor):
                if time.monotonic() > deadline:
                    raise OSError(errno.EAGAIN, "another program holds it and does not let go")
                time.sleep(_RETRY_S)
            if _is_at(descriptor, path):
                yield descriptor
                return
        finally:
            os.close(descriptor)  # lets go of the lock, too


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether the open file still has its name: somebody may have moved it away before it was locked."""
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


def _lock(descriptor: int) -> bool:
    """Take the lock if it is free. Readers take none: a line that is being added is one that is not finished."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 2**30, os.SEEK_SET)  # a place that nobody reads
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True
