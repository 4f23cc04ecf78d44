"""The recorder: takes a sitting into the journal, and makes its session file at the end."""

from __future__ import annotations

import contextlib
import math
import shutil
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.journal import (
    SYNC_S,
    Entry,
    Journal,
    JournalError,
    encode_entry,
    encode_json,
    journal_path,
)
from tissueid.acquisition.quality import QualityGate
from tissueid.acquisition.recovery import session_into
from tissueid.audit import Trail
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, SessionExistsError, SessionFormatError
from tissueid.instrument import CLINICAL, SAMPLE, SIGNALS, Limits, Run
from tissueid.sessions import MAX_NUMBERS, Session, Subject, read_own_session

WAITING_S = 30.0
"""Seconds of samples that may wait for a disk that stands still; then the test ends."""
ROOM_LEFT = 32_000_000
"""Bytes that must be free beyond what a test is reckoned to take."""
_NUMBERS = len(SIGNALS) + 2
"""Of a sample in a session: what was recorded, force and time."""
_IN_SESSION = 8 * _NUMBERS + 2
"""Bytes of a sample in a session at the worst; most are compressed to half."""
HEAD_S = 1.0
"""Seconds of samples after which the journal says again whose they are: what follows a damage is read by it."""
_HEAD_SHARE = 0.1
"""Of the journal at most, however long the description of a stimulus is."""
_CALIBRATION = ("state", "static_file", "static_date", "sweep_file", "sweep_date")
"""What the audit log keeps of the calibration in force."""

_Result = TypeVar("_Result")


@dataclass
class Preparation:
    """How far it has come to prepare one test; whoever gave it up is not told of its beginning afterwards."""

    logged: bool = False
    given_up: bool = False


class SessionRecorder:
    """One sitting being recorded. ``finish`` leaves a session file; a host that dies leaves the journal.

    What is done goes into the audit log by ``trail``, where one is given: before the sitting and before each test,
    which are refused where that fails; at the end of each test without waiting for it. See ``trail.problem``.

    Raises:
        SessionFormatError: the session file is there already.
        JournalError: an unfinished one is there, or the folder cannot be written, or is full.
        AuditError: the sitting cannot be logged.
    """

    def __init__(
        self,
        path: Path,
        device: DeviceDescription,
        subject: Subject | None = None,
        *,
        trail: Trail | None = None,
        sync_s: float = SYNC_S,
    ) -> None:
        if path.is_dir():
            raise SessionFormatError(f"{path} is a folder; name a session file")
        if path.exists():
            raise SessionExistsError(path)
        if not path.parent.is_dir():
            raise SessionFormatError(f"there is no folder {path.parent}")
        self.path = path
        self.session_id = str(uuid.uuid4())
        self.trail = trail
        self.tests_begun = 0
        self.samples_appended = 0
        self.gate = QualityGate(device)
        """Judges the tests of this sitting as they end, each against those before it."""
        self._sample_rate_hz = device.sample_rate_hz
        self._head = b""
        """Whose the samples of the running test are, to be repeated."""
        self._head_at = 0
        """Samples of the running test after which that is due."""
        self._sample_entries: deque[tuple[int, int]] = deque()
        self._run_samples = 0
        self._turn = threading.Lock()
        self._check_room(0)
        waiting = round(WAITING_S * device.sample_rate_hz * SAMPLE.itemsize)
        self._journal = Journal(journal_path(path), sync_s=sync_s, max_waiting=waiting)
        who = subject or Subject()
        try:
            if trail is not None:
                trail.record("session.begun", subject=self.session_id, new=_about(device, who))
            sitting = {
                "session_id": self.session_id,
                "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
                "device": asdict(device),
                "subject": asdict(who),
                "sample_fields": [list(item) for item in SAMPLE.descr],
                "audit_head": "" if trail is None else trail.head,
            }
            self._sitting = encode_json(Entry.SITTING, sitting)
            self._journal.append(_twice(self._sitting))
        except BaseException:
            self._discard()
            raise

    def prepare(
        self,
        samples: int,
        *,
        limits: Limits = CLINICAL,
        preparation: Preparation | None = None,
        **about: str | float,
    ) -> None:
        """Before a test of so many samples begins: whether it can be recorded and logged; waits for the disk.

        ``about`` goes into the audit log with it. ``preparation`` is for a caller that may not wait for the end of
        this: see ``not_begun``.

        Raises:
            CancelledError: it was given up meanwhile, and is not logged.
            JournalError: the recording has failed, or there is no room for the test.
            SessionFormatError: the session would be too large to be read again.
            AuditError: it cannot be logged.
        """
        self._journal.check()
        if (self.samples_appended + samples) * _NUMBERS > MAX_NUMBERS:
            raise SessionFormatError(f"{self.path} would grow too large to be read: go on in another session file")
        self._check_room(samples)
        if self.trail is not None:
            step = preparation or Preparation()
            if limits != CLINICAL:
                with self._wanted(step):
                    answer = self.trail.ask(
                        "limits.chosen", subject=self.session_id, old=asdict(CLINICAL), new=asdict(limits)
                    )
                answer.result()
            with self._wanted(step):
                answer = self.trail.ask("test.begun", subject=self._test(self.tests_begun + 1), new=about)
                step.logged = True
            answer.result()

    def begin_test(self, run: Run, **attributes: Any) -> int:
        """A test starts; ``attributes`` are those of ``sessions.Test``. Returns its number."""
        self.tests_begun += 1
        self._run_samples = 0
        entry = {"number": self.tests_begun, "run": asdict(run), "attributes": attributes}
        self._head = self._sitting + encode_json(Entry.TEST, entry | {"again": True})
        self._head_at = 0
        self._repeat_head_later()
        self._journal.append(self._sitting + _twice(encode_json(Entry.TEST, entry)))
        return self.tests_begun

    def _repeat_head_later(self) -> None:
        least = len(self._head) / (_HEAD_SHARE * SAMPLE.itemsize)
        self._head_at += math.ceil(max(HEAD_S * self._sample_rate_hz, least))

    def add(self, samples: NDArray[np.void]) -> None:
        """Samples of the running test, shape (k,) of instrument.SAMPLE.

        Raises:
            JournalError: they cannot be written, or wait for too long.
        """
        if samples.size:
            if self._run_samples >= self._head_at:
                self._journal.append(self._head)
                self._repeat_head_later()
            number = self._journal.append(encode_entry(Entry.SAMPLES, samples.tobytes()))
            self.samples_appended += samples.size
            self._run_samples += samples.size
            self._sample_entries.append((number, self.samples_appended))
            # What is on the disk is forgotten but for the newest: an hour of it is a great many.
            synced = self._journal.synced
            while len(self._sample_entries) > 1 and self._sample_entries[1][0] <= synced:
                self._sample_entries.popleft()

    @property
    def samples_acknowledged(self) -> int:
        """How many samples of this sitting are known to be on the disk."""
        synced = self._journal.synced
        return max((total for number, total in tuple(self._sample_entries) if number <= synced), default=0)

    def event(self, kind: str, **details: Any) -> None:
        """Something that happened: a gap, a fault, a verdict. Never fails; a journal that did is told by the others."""
        self._journal.leave(encode_json(Entry.EVENT, {"kind": kind, **details, "test": self.tests_begun}))

    def end_test(
        self, status: str, samples: int | None = None, *, cause: BaseException | None = None, **notes: str | float
    ) -> None:
        """The running test is over: ``status`` completed or aborted, by ``cause``. Never fails and never waits.

        ``samples`` is how many were played of a test that was completed before its time; all without it.
        """
        entry: dict[str, Any] = {"test": self.tests_begun, "status": status, "notes": notes}
        if samples is not None:
            entry["samples"] = samples
        self._journal.leave(encode_json(Entry.TEST_END, entry))
        self._log_end(self.tests_begun, _ending(status, cause), self._run_samples, str(notes.get("reason", "")))

    def not_begun(self, cause: BaseException, reason: str, preparation: Preparation | None = None) -> None:
        """The test that was prepared did not begin. Never fails and never waits.

        With a ``preparation`` that may still go on in another thread: what it has not logged by now it never will, and
        then there is no end to log either.
        """
        with self._turn:
            if preparation is not None:
                preparation.given_up = True
                if not preparation.logged:
                    return
            self._log_end(self.tests_begun + 1, _ending("aborted", cause), 0, reason)

    @contextlib.contextmanager
    def _wanted(self, preparation: Preparation) -> Iterator[None]:
        """Hand over a line of the log, unless its test was given up.

        Raises:
            CancelledError: it was.
        """
        with self._turn:
            if preparation.given_up:
                raise CancelledError("the test was given up while it was prepared")
            yield

    def write(self) -> None:
        """Write the session file from what the journal holds, verify it, and remove the journal.

        The memory that this takes is that of the longest test, however long the sitting was.

        Raises:
            JournalError: it could not be written, or the journal no longer holds all that went into it; the journal
                stays for ``tissueid recover``.
        """
        try:
            self._journal.check()
            if self.trail is not None:
                self.trail.settle()
            self._journal.leave(
                encode_json(Entry.CLOSED, {"audit_head": "" if self.trail is None else self.trail.head})
            )
            self._journal.sync()
        finally:
            self._journal.close()
        self._or_keep(lambda: session_into(self.path, self._journal.path, self.samples_appended))
        with contextlib.suppress(OSError):  # the session is whole; what is left over 'recover' takes away
            self._journal.path.unlink()
        if self.trail is not None:
            self.trail.note(
                "session.written",
                subject=self.session_id,
                new={"tests": self.tests_begun, "samples": self.samples_appended},
            )
            self.trail.settle()

    def finish(self) -> Session:
        """As ``write``; returns the session, all of it read into memory.

        Raises:
            JournalError: as ``write``.
        """
        self.write()
        return read_own_session(self.path)

    def finish_or_discard(self, cause: BaseException | None = None) -> Session | None:
        """After a failure: keep what was recorded as a session, or leave nothing when there is nothing.

        Where even that fails, the journal stays for ``tissueid recover``.

        Raises:
            JournalError: as ``write``.
        """
        if self.trail is not None and cause is not None:
            self.trail.note("session.broken_off", subject=self.session_id, new=self._without_names(str(cause)))
        if self.samples_appended:
            return self.finish()
        self._discard()
        if self.trail is not None:
            self.trail.settle()
        return None

    def abandon(self) -> None:
        """Close without a session; the journal stays for ``tissueid recover``."""
        with contextlib.suppress(JournalError):  # a disk that stands still: it is closed when that answers
            self._journal.close()
        if self.trail is not None:
            self.trail.settle()

    def _discard(self) -> None:
        with contextlib.suppress(JournalError):
            self._journal.close()
        with contextlib.suppress(OSError):
            self._journal.path.unlink()

    def _check_room(self, samples: int) -> None:
        """Refuse what would fill the disk: it is better said before a coil is energised.

        Raises:
            JournalError: says how much is free, and how much is wanted.
        """
        wanted = (
            round(samples * SAMPLE.itemsize * (1.0 + _HEAD_SHARE))
            + (self.samples_appended + samples) * _IN_SESSION
            + ROOM_LEFT
        )
        free = self._or_keep(lambda: shutil.disk_usage(self.path.parent).free)
        if free < wanted:
            raise JournalError(
                f"{self.path.parent} has {free / 1e6:,.0f} MB free, and {wanted / 1e6:,.0f} MB are wanted: make room, "
                "or name a session on another disk"
            )

    def _or_keep(self, work: Callable[[], _Result]) -> _Result:
        """What the work returns; where the disk fails it, say what is kept, and how the session is made from it.

        Raises:
            JournalError: it failed.
        """
        try:
            return work()
        except (OSError, SessionFormatError) as error:
            reason = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
            kept = "nothing was recorded"
            if self.samples_appended:
                then = "once that is mended, 'tissueid recover' makes the session from it, with --out on another disk"
                if isinstance(error, SessionExistsError):
                    then = "move that file away or name another with --out, and 'tissueid recover' makes the session"
                kept = f"what was recorded is kept in {journal_path(self.path)}; {then}"
            raise JournalError(f"cannot write {self.path}: {reason}. {kept[0].upper()}{kept[1:]}") from error

    def _test(self, number: int) -> str:
        return f"{self.session_id} test {number}"

    def _log_end(self, number: int, what: str, samples: int, reason: str) -> None:
        if self.trail is not None:
            new: dict[str, str | int] = {"samples": samples}
            if reason:
                new["reason"] = self._without_names(reason)
            self.trail.note(what, subject=self._test(number), new=new)

    def _without_names(self, words: str) -> str:
        """What goes into the audit log: the names of files may be those of people."""
        return words.replace(str(self.path), "the session").replace(str(self.path.parent), "its folder")


def _twice(entry: bytes) -> bytes:
    """What all that follows makes no sense without: one bit that turns over must not cost a whole test."""
    return 2 * entry


def _about(device: DeviceDescription, subject: Subject) -> dict[str, str | float]:
    """What the audit log keeps of whom and what a sitting measures."""
    in_force = {name: device.calibration[name] for name in _CALIBRATION if name in device.calibration}
    return {
        "pseudonym": subject.pseudonym,
        "model": device.model,
        "serial_number": device.serial_number,
        "firmware_version": device.firmware_version,
    } | in_force


def _ending(status: str, cause: BaseException | None) -> str:
    """What the audit log calls the end of a test."""
    if isinstance(cause, FirmwareFaultError):
        return "test.fault"
    if isinstance(cause, CancelledError | KeyboardInterrupt):
        return "test.stopped"
    return f"test.{status}"
