"""The newest head of a log in a small file next to it, which shows that the log was emptied, cut off or removed."""

from __future__ import annotations

import contextlib
import errno
import getpass
import hashlib
import os
import re
import stat
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from platformdirs import user_data_path

from tissueid.atomic_write import open_regular, private_folder, private_opener, sync_folder, write_all
from tissueid.audit.line import (
    CANCEL,
    CLOSED_OFF,
    LINES_MISSING,
    MAX_LINE,
    NOTHING_BEFORE,
    STARTED,
    LogLine,
    is_torn,
    make_line,
    read_line,
)
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message, Verbatim, joined
from tissueid.version import SOFTWARE

_HEAD = re.compile(rb"(\d{1,12}):([0-9a-f]{64})")
_LONGEST = 100


def newest_path(log: Path) -> Path:
    """Return the path of the newest head of a log."""
    return log.with_name(log.name + ".head")


def read_newest(log: Path) -> tuple[int, str] | None:
    """Return number and hash of the newest line ever written to a log; None if unknown."""
    try:
        with open_regular(newest_path(log)) as file:
            match = _HEAD.fullmatch(file.read(_LONGEST).partition(b"\n")[0])
    except OSError:
        return None
    return None if match is None else (int(match[1]), match[2].decode())


def write_newest(log: Path, head: str, like: os.stat_result) -> None:
    """Store the head of the newest line, with the group and mode of the log in ``like``.

    The file is not synced, so that it is never newer than the log. If it cannot be written, the older head stays,
    which the log still contains.
    """
    with contextlib.suppress(OSError):
        path = newest_path(log)
        made = not path.exists()
        descriptor = private_opener(str(path), os.O_WRONLY | os.O_CREAT | getattr(os, "O_NONBLOCK", 0))
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                return
            data = f"{head}\n".encode()
            write_all(descriptor, data)
            os.ftruncate(descriptor, len(data))
            if made and hasattr(os, "fchown"):
                os.fchown(descriptor, -1, like.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(like.st_mode) & 0o666)
        finally:
            os.close(descriptor)


ENVIRONMENT = "TISSUEID_AUDIT"
FORMAT = "tissueid-audit"
FORMAT_VERSION = "1.0"
LOCK_S = 10.0
"""Longest wait for another program that holds the log, s. Adding a line takes milliseconds."""
_RETRY_S = 0.01

_VERIFY = Action("audit.verify", "tissueid audit verify", marked("“Verify” in the audit log of the page Instrument"))
_NOT_ORDINARY = Message("file.not_ordinary", "it is not an ordinary file")
_HELD = Message("audit.held", "another program holds it and does not release it")


class AuditError(TissueIDError):
    """The audit log cannot be written or is damaged. Nothing new may begin; a running test ends normally."""


def default_path() -> Path:
    """Return the path of the log: ``TISSUEID_AUDIT``, or a file in the user's data folder."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else user_data_path("tissueid", appauthor=False) / "audit.jsonl"


def account() -> str:
    """Return the name of the user account that runs this program."""
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):  # a container without a list of users
        return f"uid {os.getuid()}" if hasattr(os, "getuid") else "unknown"


def now() -> datetime:
    """Return the current time, UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class _End:
    """End of a log: its newest complete line, and unfinished bytes after it."""

    line: LogLine | None
    size: int
    leftover: bytes = b""
    closed: bool = True
    """Whether the newest complete line ends with a newline."""


@dataclass(frozen=True)
class AuditLog:
    """An append-only log. The file is created with its first line."""

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
        """Add one line, sync it to disk, and return its head (number and hash).

        Args:
            role: of the user.
            what: the action, such as ``calibration.made``.
            subject: of the action; a pseudonym, never the name of a person.
            old: value before the action.
            new: value after the action.
            when: time of the action, if it was earlier.

        Raises:
            AuditError: writing failed, or the file is not an audit log, or its end is damaged.
        """
        moment = when or self.clock()
        try:
            if os.environ.get(ENVIRONMENT) == str(self.path) and not self.path.parent.exists():
                folder = Message("file.no_folder", "there is no folder {folder}", folder=str(self.path.parent))
                raise FileNotFoundError(errno.ENOENT, folder)
            private_folder(self.path.parent)
            with open_locked(self.path) as descriptor:
                end = _end_of(descriptor, self.path)
                missing = _missing_head(end, self.path)
                data, head = self._lines(end, missing, role, what, moment, subject=subject, old=old, new=new)
                _append(descriptor, data, end.size)
                write_newest(self.path, head, os.fstat(descriptor))
                if end.size == 0:
                    sync_folder(self.path.parent)
        except OSError as error:
            raise AuditError(
                "audit.unwritable",
                "cannot write the audit log {path}: {why}. Nothing begins that cannot be logged: repair that, or "
                "name another file with {variable}",
                path=str(self.path),
                why=error.strerror or str(error),
                variable=ENVIRONMENT,
            ) from error
        return head

    def _lines(
        self, end: _End, missing: str, role: str, what: str, moment: datetime, **values: Any
    ) -> tuple[bytes, str]:
        """Return the bytes to add, with lines about the log itself before the new one, and the head after them."""
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
                software=SOFTWARE,
                previous=NOTHING_BEFORE if last is None else last.hash,
            )
            data += line

        if end.leftover:
            unfinished = end.leftover + CANCEL + b"\n"
            data += CANCEL + b"\n"
            add(CLOSED_OFF, new={"bytes": len(unfinished), "sha256": hashlib.sha256(unfinished).hexdigest()})
        if last is None or (last.what == CLOSED_OFF and last.number == 1):
            add(STARTED, new={"format": FORMAT, "format_version": FORMAT_VERSION})
        if missing:
            add(LINES_MISSING, old=missing)
        add(what, **values)
        assert last is not None
        return data, last.head


def _missing_head(end: _End, path: Path) -> str:
    """Return the head of the newest line ever written if the log no longer contains it; else ""."""
    newest = read_newest(path)
    line = end.line
    if newest is None or (line is not None and (line.number > newest[0] or line.hash == newest[1])):
        return ""
    return f"{newest[0]}:{newest[1]}"


def _append(descriptor: int, data: bytes, size: int) -> None:
    """Append and sync. Data that cannot be synced is removed, so that no later line continues data that may be lost."""
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    except OSError:
        with contextlib.suppress(OSError):  # an append-only file: the next line closes it off
            os.ftruncate(descriptor, size)
            os.fsync(descriptor)
        raise


def _end_of(descriptor: int, path: Path) -> _End:
    """Return the end of the log.

    Raises:
        AuditError: the file is not an audit log, or its end is damaged.
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
                "audit.last_line_damaged",
                "the last line of the audit log {path} is damaged or of other software; details: {verify}. Move "
                "the file, and a new log begins",
                path=str(path),
                verify=_VERIFY,
            )
    number = 1 if line is None else line.number + 1
    if (complete := read_line(leftover)) is not None and complete.number == number:
        return _End(complete, size, closed=False)
    if not all(is_torn(piece.removesuffix(CANCEL), number) for piece in leftover.split(b"\n")):
        raise AuditError(
            "audit.end_damaged",
            "the end of the audit log {path} is damaged, or it is another file; details: {verify}. Move the file, "
            "and a new log begins",
            path=str(path),
            verify=_VERIFY,
        )
    return _End(line, size, leftover)


@contextmanager
def open_locked(path: Path) -> Iterator[int]:
    """Open the file for appending and lock it.

    Raises:
        OSError: the file cannot be opened, or another program holds it for longer than ``LOCK_S``.
    """
    deadline = time.monotonic() + LOCK_S
    while True:
        descriptor = private_opener(str(path), os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0))
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise OSError(errno.EINVAL, _NOT_ORDINARY)
            while not lock(descriptor):
                if time.monotonic() > deadline:
                    raise OSError(errno.EAGAIN, _HELD)
                time.sleep(_RETRY_S)
            if _is_at(descriptor, path):
                yield descriptor
                return
        finally:
            os.close(descriptor)  # also releases the lock


def _is_at(descriptor: int, path: Path) -> bool:
    """Return whether ``path`` still names the open file, which may have been moved before it was locked."""
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


def lock(descriptor: int) -> bool:
    """Take the lock if it is free. Readers need no lock: they skip an unfinished line."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 2**30, os.SEEK_SET)  # beyond the end of the file
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
            return False
        raise
    return True


Role = Literal["clinician", "researcher", "technician"]
ROLES: tuple[Role, ...] = get_args(Role)
ROLE_ENVIRONMENT = "TISSUEID_ROLE"
SETTLE_S = 10.0
"""Longest wait for lines that are being written, s."""


def active_role(default: Role) -> Role:
    """Return the role in ``TISSUEID_ROLE``, or the default without one.

    Raises:
        UnusableInputError: the variable names no role.
    """
    named = os.environ.get(ROLE_ENVIRONMENT, "").strip().lower()
    for role in ROLES:
        if named == role:
            return role
    if named:
        raise UnusableInputError(
            "audit.role",
            "{variable} must be {roles}, not '{value}'",
            variable=ROLE_ENVIRONMENT,
            roles=joined(ROLES, last=marked(" or ")),
            value=Verbatim(named),
        )
    return default


@dataclass
class AuditTrail:
    """Lines of one role. Use ``record`` before an action, and ``note`` while the coil may be energised.

    ``head`` is the head of the newest line written here. ``problem`` is the reason why the first lost note could not
    be written; empty without one.
    """

    log: AuditLog
    role: Role
    head: str = ""
    problem: str = ""
    _waiting: deque[tuple[partial[str], Future[str] | None]] = field(default_factory=deque, repr=False)
    _writing: bool = False
    _thread: threading.Thread | None = field(default=None, repr=False)
    _change: threading.Condition = field(default_factory=threading.Condition, repr=False)

    def record(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Add a line after the noted ones, and wait for the disk.

        Raises:
            AuditError: writing failed; the action must not begin.
        """
        self.submit(what, subject=subject, old=old, new=new).result()
        self._join_idle()

    def submit(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> Future[str]:
        """Add a line as ``record`` does, without waiting: the future gives its head or the error."""
        answer: Future[str] = Future()
        self._add(what, subject, old, new, answer)
        return answer

    def note(self, what: str, *, subject: str = "", old: Any = None, new: Any = None) -> None:
        """Add a line in the background. Never waits and never raises; see ``settle``."""
        self._add(what, subject, old, new, None)

    def _add(self, what: str, subject: str, old: Any, new: Any, answer: Future[str] | None) -> None:
        with self._change:
            when: datetime = self.log.clock()
            line = partial(self.log.record, self.role, what, subject=subject, old=old, new=new, when=when)
            self._waiting.append((line, answer))
            if not self._writing:
                self._writing = True
                self._thread = threading.Thread(target=self._write_all, name="audit", daemon=True)
                self._thread.start()

    def _join_idle(self) -> None:
        """Join a thread that has nothing more to write."""
        with self._change:
            thread = None if self._writing else self._thread
        if thread is not None:
            thread.join()

    def settle(self, timeout_s: float = SETTLE_S) -> str:
        """Wait until all notes are written or have failed; return ``problem``."""
        with self._change:
            if not self._change.wait_for(lambda: not self._writing, timeout_s) and not self.problem:
                self.problem = Message(
                    "audit.no_answer",
                    "writing to the audit log {path} takes too long: the disk does not answer",
                    path=str(self.log.path),
                )
        self._join_idle()
        return self.problem

    def _write_all(self) -> None:
        while True:
            with self._change:
                if not self._waiting:
                    self._writing = False
                    self._change.notify_all()
                    return
                line, answer = self._waiting.popleft()
            try:
                before, self.head = self.head, line()
                if before and _number(self.head) <= _number(before):
                    self.problem = self.problem or Message(
                        "audit.replaced",
                        "lines up to {line}, which were written before: {path} was emptied, removed or replaced while "
                        "it was in use",
                        line=_number(before),
                        path=str(self.log.path),
                    )
            except Exception as error:  # noqa: BLE001 - reported by the future or by settle(); the thread continues
                if answer is not None:
                    answer.set_exception(error)
                elif isinstance(error, AuditError):
                    self.problem = self.problem or error.message
                else:
                    self.problem = self.problem or Message(
                        "audit.failed",
                        "the audit log failed: {kind}: {why}",
                        kind=type(error).__name__,
                        why=str(error),
                    )
            else:
                if answer is not None:
                    answer.set_result(self.head)


def _number(head: str) -> int:
    return int(head.partition(":")[0])
