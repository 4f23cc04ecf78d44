"""Recorder: writes a sitting into the journal, and creates its session file at the end."""

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
    RECOVER,
    SYNC_S,
    Entry,
    Journal,
    JournalError,
    encode_entry,
    encode_json,
    journal_path,
)
from tissueid.acquisition.quality import QualityGate
from tissueid.acquisition.recovery import write_journal_session
from tissueid.atomic_write import check_creatable
from tissueid.audit import AuditTrail
from tissueid.device import DeviceDescription
from tissueid.errors import (
    CancelledError,
    FirmwareFaultError,
    SessionExistsError,
    SessionFormatError,
    TissueIDError,
    UnattendedError,
)
from tissueid.instrument import CLINICAL, SAMPLE, SIGNALS, Limits, Run
from tissueid.language import marked
from tissueid.messages import Action, Message, codes_in
from tissueid.sessions import MAX_NUMBERS, Session, Subject, read_own_session
from tissueid.sessions.model import reason_of

MAX_UNWRITTEN_S = 30.0
"""Maximum length of unwritten samples, s; beyond it the test ends."""
MIN_FREE_BYTES = 32_000_000
"""Minimum free disk space after a test, bytes."""
_NUMBERS_PER_SAMPLE = len(SIGNALS) + 2
"""Numbers per sample in a session: recorded signals, force and time."""
_SESSION_BYTES = 8 * _NUMBERS_PER_SAMPLE + 2
"""Maximum bytes per sample in a session; compression usually halves them."""
HEAD_S = 1.0
"""Interval, s of samples, at which the journal repeats the header of the test, so that samples after a damage are
readable.
"""
_COPIES = 2
"""Number of times that a header is written: one flipped bit must not lose a whole test."""
_HEAD_SHARE = 0.1
"""Maximum share of the journal used by these repetitions."""
_CALIBRATION = ("state", "static_file", "static_date", "sweep_file", "sweep_date")
"""Entries of the active calibration in the audit log."""
_OUT_OPTION = Action("session.recover_out", "--out", marked("in another folder"))

_Result = TypeVar("_Result")


@dataclass
class RecordingPreparation:
    """State of the preparation of one test. An abandoned test is not logged as begun afterwards."""

    logged: bool = False
    abandoned: bool = False


class SessionRecorder:
    """Recorder of one sitting. ``finish`` creates a session file; if the host crashes, the journal remains.

    With ``trail``, the audit log gets an entry before the sitting and before each test, which fail if it cannot be
    written, and one at the end of each test, without waiting (see ``trail.problem``).

    Raises:
        SessionFormatError: the session file already exists.
        JournalError: an unfinished journal exists, or the folder is not writable or full.
        AuditError: the sitting cannot be logged.
    """

    def __init__(
        self,
        path: Path,
        device: DeviceDescription,
        subject: Subject | None = None,
        *,
        trail: AuditTrail | None = None,
        sync_s: float = SYNC_S,
    ) -> None:
        if path.is_dir():
            raise SessionFormatError("session.is_folder", "{path} is a folder; name a session file", path=str(path))
        if path.exists():
            raise SessionExistsError(path)
        if not path.parent.is_dir():
            raise SessionFormatError("file.no_folder", "there is no folder {folder}", folder=str(path.parent))
        self.path = path
        self.session_id = str(uuid.uuid4())
        self.trail = trail
        self.tests_begun = 0
        self.samples_appended = 0
        self._ends_logged = False
        self.gate = QualityGate(device)
        """Quality gate of this sitting."""
        self._sample_rate_hz = device.sample_rate_hz
        self._head = b""
        """Head of the running test, which is repeated in the journal."""
        self._head_at = 0
        """Number of samples of the running test after which the next repetition is due."""
        self._sample_entries: deque[tuple[int, int]] = deque()
        self._run_samples = 0
        self._turn = threading.Lock()
        self._check_disk_space(0)
        self._explain_disk_failure(lambda: check_creatable(path))
        waiting = round(MAX_UNWRITTEN_S * device.sample_rate_hz * SAMPLE.itemsize)
        self.journal = Journal(journal_path(path), sync_s=sync_s, max_waiting=waiting)
        who = subject or Subject()
        try:
            if trail is not None:
                trail.record("session.begun", subject=self.session_id, new=_audit_values(device, who))
            sitting = {
                "session_id": self.session_id,
                "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
                "device": asdict(device),
                "subject": asdict(who),
                "sample_fields": [list(item) for item in SAMPLE.descr],
                "audit_head": "" if trail is None else trail.head,
            }
            self._sitting = encode_json(Entry.SITTING, sitting)
            self.journal.append(_COPIES * self._sitting)
        except BaseException:
            self._discard()
            raise

    def prepare(
        self,
        samples: int,
        *,
        limits: Limits = CLINICAL,
        preparation: RecordingPreparation | None = None,
        **about: str | float,
    ) -> None:
        """Check, before a test of ``samples`` samples, that it can be recorded, and log it; waits for the disk.

        ``about`` is stored in the audit log. ``preparation`` is for a caller that does not wait for the end of this
        call: see ``log_not_begun``.

        Raises:
            CancelledError: the test was abandoned meanwhile, and is not logged.
            JournalError: the recording failed, or the disk has not enough space for the test.
            SessionFormatError: the session would be too large to be read.
            AuditError: the test cannot be logged.
        """
        self.journal.check()
        if (self.samples_appended + samples) * _NUMBERS_PER_SAMPLE > MAX_NUMBERS:
            raise SessionFormatError(
                "session.too_large",
                "{path} would become too large to be read: continue in another session file",
                path=str(self.path),
            )
        self._check_disk_space(samples)
        if self.trail is not None:
            step = preparation or RecordingPreparation()
            if limits != CLINICAL:
                with self._unless_abandoned(step):
                    answer = self.trail.submit(
                        "limits.chosen", subject=self.session_id, old=asdict(CLINICAL), new=asdict(limits)
                    )
                answer.result()
            with self._unless_abandoned(step):
                answer = self.trail.submit("test.begun", subject=self._test(self.tests_begun + 1), new=about)
                step.logged = True
            answer.result()

    def begin_test(self, run: Run, **attributes: Any) -> int:
        """Record the beginning of a test with these attributes of ``sessions.Test``; return its number."""
        self.tests_begun += 1
        self._run_samples = 0
        entry = {"number": self.tests_begun, "run": asdict(run), "attributes": attributes}
        self._head = self._sitting + encode_json(Entry.TEST, entry | {"again": True})
        self._head_at = 0
        self._repeat_head_later()
        self.journal.append(self._sitting + _COPIES * encode_json(Entry.TEST, entry))
        return self.tests_begun

    def _repeat_head_later(self) -> None:
        least = len(self._head) / (_HEAD_SHARE * SAMPLE.itemsize)
        self._head_at += math.ceil(max(HEAD_S * self._sample_rate_hz, least))

    def add(self, samples: NDArray[np.void]) -> None:
        """Record samples of the running test, shape (k,) of instrument.SAMPLE.

        Raises:
            JournalError: writing failed, or too many samples are unwritten.
        """
        if samples.size:
            if self._run_samples >= self._head_at:
                self.journal.append(self._head)
                self._repeat_head_later()
            number = self.journal.append(encode_entry(Entry.SAMPLES, samples.tobytes()))
            self.samples_appended += samples.size
            self._run_samples += samples.size
            self._sample_entries.append((number, self.samples_appended))
            # Only the newest synced entry is needed; the others are dropped to limit memory.
            synced = self.journal.synced
            while len(self._sample_entries) > 1 and self._sample_entries[1][0] <= synced:
                self._sample_entries.popleft()

    @property
    def samples_acknowledged(self) -> int:
        """Number of samples of this sitting that are synced to the disk."""
        synced = self.journal.synced
        return max((total for number, total in tuple(self._sample_entries) if number <= synced), default=0)

    def event(self, kind: str, **details: Any) -> None:
        """Record an event such as a gap, a fault or a verdict. Never raises: other methods report a failed journal."""
        self.journal.append_unchecked(encode_json(Entry.EVENT, {"kind": kind, **details, "test": self.tests_begun}))

    def end_test(
        self, status: str, samples: int | None = None, *, cause: BaseException | None = None, **notes: str | float
    ) -> None:
        """Record the end of the running test, completed or aborted by ``cause``. Never raises and never waits.

        ``samples`` is the number of played samples of a test that was completed early.
        """
        entry: dict[str, Any] = {"test": self.tests_begun, "status": status, "notes": notes}
        if samples is not None:
            entry["samples"] = samples
        self.journal.append_unchecked(encode_json(Entry.TEST_END, entry))
        self._log_end(self.tests_begun, _end_name(status, cause), self._run_samples, reason_of(notes))

    def log_not_begun(self, cause: BaseException, reason: str, preparation: RecordingPreparation | None = None) -> None:
        """Log that the prepared test did not begin. Never raises and never waits.

        If the thread of ``preparation`` has not yet logged the beginning, it will not do so, and no end is logged.
        """
        with self._turn:
            if preparation is not None:
                preparation.abandoned = True
                if not preparation.logged:
                    return
            self._log_end(self.tests_begun + 1, _end_name("aborted", cause), 0, reason)

    @contextlib.contextmanager
    def _unless_abandoned(self, preparation: RecordingPreparation) -> Iterator[None]:
        """Hold the lock while an entry is logged, unless the test was abandoned.

        Raises:
            CancelledError: the test was abandoned.
        """
        with self._turn:
            if preparation.abandoned:
                raise CancelledError(Message("test.given_up", "the test was cancelled while it was prepared"))
            yield

    def write(self) -> None:
        """Write the session file from the journal, verify it, and remove the journal.

        Memory use is that of the longest test.

        Raises:
            JournalError: the session could not be written, or the journal is incomplete; the journal is kept for
                ``tissueid recover``.
        """
        try:
            self.journal.check()
            if self.trail is not None:
                self.trail.settle()
            self.journal.append_unchecked(
                encode_json(Entry.CLOSED, {"audit_head": "" if self.trail is None else self.trail.head})
            )
            self.journal.sync()
        finally:
            self.journal.close()
        self._explain_disk_failure(lambda: write_journal_session(self.path, self.journal.path, self.samples_appended))
        with contextlib.suppress(OSError):  # the session is complete; 'recover' removes the rest
            self.journal.path.unlink()
        if self.trail is not None:
            self.trail.note(
                "session.written",
                subject=self.session_id,
                new={"tests": self.tests_begun, "samples": self.samples_appended},
            )
            self.trail.settle()

    def finish(self) -> Session:
        """Write the session file (see ``write``) and return the session, read into memory.

        Raises:
            JournalError: see ``write``.
        """
        self.write()
        return read_own_session(self.path)

    def finish_or_discard(self, cause: BaseException | None = None) -> Session | None:
        """Write the samples so far as a session after a failure; without samples no file is left.

        If writing fails, the journal is kept for ``tissueid recover``.

        Raises:
            JournalError: see ``write``.
        """
        if self.trail is not None and cause is not None:
            if not self._ends_logged:
                self._log_end(self.tests_begun + 1, _end_name("aborted", cause), 0, _reason(cause))
            self.trail.note("session.broken_off", subject=self.session_id, new=_without_names(str(cause), self.path))
        if self.samples_appended:
            return self.finish()
        self._discard()
        if self.trail is not None:
            self.trail.settle()
        return None

    def abandon(self) -> None:
        """Close without writing a session; the journal is kept for ``tissueid recover``."""
        with contextlib.suppress(JournalError):  # closed when the disk responds
            self.journal.close()
        if self.trail is not None:
            self.trail.settle()

    def _discard(self) -> None:
        with contextlib.suppress(JournalError):
            self.journal.close()
        with contextlib.suppress(OSError):
            self.journal.path.unlink()

    def _check_disk_space(self, samples: int) -> None:
        """Check that the disk has enough space for a test of ``samples`` samples.

        Raises:
            JournalError: not enough space.
        """
        wanted = (
            round(samples * SAMPLE.itemsize * (1.0 + _HEAD_SHARE))
            + (self.samples_appended + samples) * _SESSION_BYTES
            + MIN_FREE_BYTES
        )
        free = self._explain_disk_failure(lambda: shutil.disk_usage(self.path.parent).free)
        if free < wanted:
            raise JournalError(
                "disk.full",
                "{folder} has {free:.0f} MB free, and {wanted:.0f} MB are needed: free some space, or choose a "
                "session file on another disk",
                folder=str(self.path.parent),
                free=free / 1e6,
                wanted=wanted / 1e6,
            )

    def _explain_disk_failure(self, work: Callable[[], _Result]) -> _Result:
        """Return the result of ``work``; if the disk fails, raise an error that says what is kept and how to recover
        it.

        Raises:
            JournalError: the disk failed.
        """
        try:
            return work()
        except (OSError, SessionFormatError) as error:
            reason = (error.strerror or str(error)) if isinstance(error, OSError) else error.message
            values = {"path": str(self.path), "reason": reason, "journal": str(journal_path(self.path))}
            if not self.samples_appended:
                message = Message("recording.none", "cannot write {path}: {reason}. Nothing was recorded", **values)
            elif isinstance(error, SessionExistsError):
                message = Message(
                    "recording.kept_exists",
                    "cannot write {path}: {reason}. The recording is kept in {journal}; move that file away or choose "
                    "another ({out}), and {action} makes the session",
                    **values,
                    out=_OUT_OPTION,
                    action=RECOVER,
                )
            else:
                message = Message(
                    "recording.kept",
                    "cannot write {path}: {reason}. The recording is kept in {journal}; when the cause is removed, "
                    "{action} makes the session from it, on another disk if you choose one ({out})",
                    **values,
                    out=_OUT_OPTION,
                    action=RECOVER,
                )
            raise JournalError(message) from error

    def _test(self, number: int) -> str:
        return f"{self.session_id} test {number}"

    def _log_end(self, number: int, what: str, samples: int, reason: str) -> None:
        self._ends_logged = True
        if self.trail is not None:
            new: dict[str, str | int | list[str]] = {"samples": samples}
            if reason:
                new["reason"] = _without_names(reason, self.path)
            if codes := codes_in(reason):
                new["codes"] = sorted(codes)
            self.trail.note(what, subject=self._test(number), new=new)


def _audit_values(device: DeviceDescription, subject: Subject) -> dict[str, str | float]:
    """Return pseudonym, instrument and calibration for the audit log."""
    active = {name: device.calibration[name] for name in _CALIBRATION if name in device.calibration}
    return {
        "pseudonym": subject.pseudonym,
        "model": device.model,
        "serial_number": device.serial_number,
        "firmware_version": device.firmware_version,
    } | active


def log_no_recording(trail: AuditTrail, path: Path, subject: Subject, site: str, cause: BaseException) -> None:
    """Log the end of a test whose recording had not begun. Never raises and never waits.

    ``path`` is the session file that was planned.
    """
    reason = _reason(cause)
    new = {"site": site, "pseudonym": subject.pseudonym, "samples": 0, "reason": _without_names(reason, path)}
    trail.note(_end_name("aborted", cause), new=new | {"codes": sorted(codes_in(reason))})


def _reason(cause: BaseException) -> str:
    return cause.message if isinstance(cause, TissueIDError) else str(cause) or type(cause).__name__


def _without_names(text: str, path: Path) -> str:
    """Return a text for the audit log without file names, which may contain names of people."""
    return text.replace(str(path), "the session").replace(str(path.parent), "its folder")


def _end_name(status: str, cause: BaseException | None) -> str:
    """Return the name of the end of a test in the audit log."""
    if isinstance(cause, FirmwareFaultError):
        return "test.fault"
    if isinstance(cause, CancelledError | KeyboardInterrupt) and not isinstance(cause, UnattendedError):
        return "test.stopped"
    return f"test.{status}"
