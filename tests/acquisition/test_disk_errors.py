"""A disk that is full, fails, stands still or goes away: the coil is released, everything acknowledged is kept."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from coded import coded, says
from failing_disk import (
    ATTRIBUTES,
    SECONDS,
    Disk,
    Sitting,
    a_sitting,
    batch,
    calls_of_a_whole_sitting,
    check_failing_at,
    check_one_line,
    posix,
)

from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover
from tissueid.acquisition import recorder as recording
from tissueid.acquisition.journal import Journal
from tissueid.audit import AuditLog, AuditTrail
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import hdf5_session, read_session

RELEASED_S = 0.06
"""One poll after a failure the coil is free."""
PLACES = {"before", "before the first sample", "during a test", "at the end"}


@pytest.mark.parametrize("part", [0, 13])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_at_any_call_of_a_recording(tmp_path, monkeypatch, number, part):
    calls = calls_of_a_whole_sitting(tmp_path, monkeypatch, guided=False)
    assert {
        check_failing_at(tmp_path / str(call), monkeypatch, call, number, part, guided=False)[0]
        for call in range(1, calls + 1)
    } == PLACES


@pytest.mark.parametrize("call", [2, 8, 15, 22])
def test_a_disk_that_fails_while_a_coil_is_on(tmp_path, monkeypatch, call):
    place, seconds = check_failing_at(tmp_path / "x", monkeypatch, call, errno.ENOSPC, 13)
    assert seconds <= RELEASED_S
    assert place == ("before the first sample" if call == 2 else "during a test")


@pytest.mark.soak
@pytest.mark.parametrize(
    ("number", "part", "every"),
    [(errno.ENOSPC, 13, 1), (errno.EIO, 0, 1), (errno.EDQUOT, 1, 5), (errno.EROFS, 0, 5)],
)
def test_every_failure_at_every_call_of_a_sitting(tmp_path, monkeypatch, number, part, every):
    calls = calls_of_a_whole_sitting(tmp_path, monkeypatch, guided=True)
    places = [
        check_failing_at(tmp_path / str(call), monkeypatch, call, number, part) for call in range(1, calls + 1, every)
    ]
    assert {place for place, _ in places} >= (PLACES if every == 1 else {"during a test"})
    assert max(seconds for _, seconds in places) <= RELEASED_S


@pytest.mark.parametrize("number", [errno.EIO, errno.EDQUOT, errno.EROFS])
def test_other_failures_in_mid_test(tmp_path, monkeypatch, number):
    assert check_failing_at(tmp_path / "x", monkeypatch, 9, number, 0)[0] == "during a test"


def test_short_and_interrupted_writes_lose_nothing(tmp_path, monkeypatch):
    sound, calls = os.write, []
    sitting = Sitting(tmp_path)

    def slow(descriptor, data):
        if len(data) <= 8:
            return sound(descriptor, data)
        calls.append(1)
        if len(calls) % 2:
            raise InterruptedError(errno.EINTR, "interrupted")
        return sound(descriptor, bytes(data)[: max(8, len(data) // 3)])

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", slow)
        sitting.run(1)
    assert sitting.error is None
    sitting.recorder.finish()
    sitting.check_recovery(sitting.path)
    assert sitting.acknowledged == round(2000 * SECONDS)


def test_what_could_not_be_synced_is_never_acknowledged_later(tmp_path, monkeypatch):
    """After a sync that failed the system may say that all is well: it has thrown away what it could not write."""
    with monkeypatch.context() as patch:
        disk = Disk(patch, tmp_path / "j", fails_at=3)
        disk.on = ("fsync",)
        journal = Journal(tmp_path / "j", sync_s=1e9)
        for _ in range(2):
            journal.append(b"entry")
            journal.sync()
        journal.append(b"entry")
        with pytest.raises(JournalError):
            journal.sync()
        disk.fails_at = None
        with pytest.raises(JournalError):
            journal.sync()
        with pytest.raises(JournalError):
            journal.append(b"entry")
        journal.append_unchecked(b"entry")
        journal.close()
    assert journal.synced == 2


# -- a disk that stands still --------------------------------------------------------------------------------
class Standstill:
    """A disk that takes nothing until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
        self.go_on, self._path, self._sound = threading.Event(), path, os.write
        monkeypatch.setattr(os, "write", self.write)

    def write(self, descriptor: int, data: bytes) -> int:
        if len(data) > 1000 and os.path.samestat(os.fstat(descriptor), self._path.stat()):
            self.go_on.wait()
        return self._sound(descriptor, data)


def test_a_disk_that_takes_seconds_for_a_write_does_not_stop_the_heartbeat(tmp_path, monkeypatch):
    sitting = Sitting(tmp_path, in_step=False)
    disk = Standstill(monkeypatch, journal_path(sitting.path))
    sitting.run(1, seconds=6.0)  # of the device's clock: its watchdog bites after a tenth of a second
    assert sitting.error is None
    assert sitting.acknowledged == 0
    disk.go_on.set()
    sitting.recorder.finish()
    sitting.check_recovery(sitting.path)
    assert read_session(sitting.path).test().status == "completed"
    assert read_session(sitting.path).test().samples == 12_000


def test_a_disk_that_stands_still_ends_the_test_before_memory_does(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "MAX_UNWRITTEN_S", 1.0)
    sitting = Sitting(tmp_path, in_step=False)
    disk = Standstill(monkeypatch, journal_path(sitting.path))
    sitting.run(1, seconds=6.0)
    check_one_line(sitting.error)
    assert says(sitting.error.message, "journal.disk_slow")
    assert sitting.released
    journal = sitting.recorder.journal
    assert 1900 < sitting.recorder.samples_appended < 2500
    assert journal.unwritten_bytes < 1.3 * 2000 * SAMPLE.itemsize
    journal.disk_timeout_s = 0.05
    with pytest.raises(JournalError, check=coded("journal.no_answer")) as raised:
        sitting.recorder.finish_or_discard()
    check_one_line(raised.value)
    sitting.recorder.abandon()
    with pytest.raises(JournalError, check=coded("journal.running")):
        recover(sitting.path)
    disk.go_on.set()
    journal.disk_timeout_s = 10.0
    sitting.recorder.abandon()
    recover(sitting.path)
    sitting.check_recovery(sitting.path)
    assert read_session(sitting.path).test().samples == sitting.recorder.samples_appended


def test_thirty_seconds_of_samples_may_wait(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(sample_rate_hz=10_000.0))
    assert recorder.journal.max_waiting == 300_000 * SAMPLE.itemsize
    recorder.abandon()


# -- a thread that dies --------------------------------------------------------------------------------------
def twenty_then(recorder: SessionRecorder, broken: Callable[[], None]) -> None:
    recorder.begin_test(Run(0, 1000), **ATTRIBUTES)
    recorder.add(batch(0, 20))
    recorder.journal.sync()
    broken()
    with contextlib.suppress(JournalError):
        for first in range(20, 1000, 20):
            recorder.add(batch(first, 20))


@pytest.mark.parametrize("error", [MemoryError(), ValueError("it cannot be")])
def test_any_error_of_the_writing_thread_is_reported(tmp_path, monkeypatch, error):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), sync_s=0.0)

    def fails(*_):
        raise error

    with monkeypatch.context() as patch:
        twenty_then(recorder, lambda: patch.setattr(Journal, "_write", fails))
        with pytest.raises(
            JournalError, check=coded("journal.failed", reason=str(error) or type(error).__name__)
        ) as raised:
            recorder.finish()
    check_one_line(raised.value)
    assert recorder.samples_acknowledged == 20
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5.journal"]
    assert recover(tmp_path / "s.h5")[1].test().samples == 20


def test_a_dead_writing_thread_is_reported_at_once(tmp_path, monkeypatch):
    """The thread fails while it waits for an entry: the journal is released, and no caller waits for it."""
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), sync_s=0.0)
    thread = recorder.journal.writer

    def fails(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        twenty_then(recorder, lambda: patch.setattr(Journal, "_next", fails))
        thread.join()
        with pytest.raises(JournalError, check=coded("journal.failed", reason="MemoryError")):
            recorder.finish()
    recorder.abandon()
    assert recover(tmp_path / "s.h5")[1].test().samples >= 20


def test_a_writing_thread_that_ends_silently_is_an_error(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "_write_all", lambda _: None)
        journal = Journal(tmp_path / "j")
    journal.writer.join()
    journal.append(b"entry")
    for wait in (journal.sync, journal.close):
        with pytest.raises(JournalError, check=coded("journal.thread_ended")) as raised:
            wait()
    check_one_line(raised.value)
    journal._file.close()


# -- a disk that goes away -----------------------------------------------------------------------------------
@posix
@pytest.mark.parametrize("how", ["removed", "moved", "exchanged"])
def test_a_folder_that_goes_away_ends_the_test(tmp_path, how):
    folder, elsewhere = tmp_path / "folder", tmp_path / "elsewhere"
    folder.mkdir()
    recorder = SessionRecorder(folder / "s.h5", DeviceDescription(), sync_s=0.0)
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.add(batch(0, 50))
    recorder.journal.sync()
    assert recorder.samples_acknowledged == 50
    if how == "removed":
        shutil.rmtree(folder)
    else:
        folder.rename(elsewhere)
        if how == "exchanged":
            folder.mkdir()
            (folder / "s.h5.journal").touch()
    with pytest.raises(JournalError, check=coded("journal.moved")) as raised:
        recorder.add(batch(50, 50))
        recorder.journal.sync()
    check_one_line(raised.value)
    assert recorder.samples_acknowledged == (0 if how == "removed" else 50)
    with pytest.raises(JournalError):
        recorder.finish_or_discard()
    if how != "removed":
        assert recover(elsewhere / "s.h5")[1].test().samples >= 50


# -- files of others -----------------------------------------------------------------------------------------
def test_a_file_that_appears_while_the_session_is_written_is_not_overwritten(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")
    sound = hdf5_session.verify

    def appears(*arguments):
        sound(*arguments)
        recorder.path.write_text("another's")

    with monkeypatch.context() as patch:
        patch.setattr(hdf5_session, "verify", appears)
        with pytest.raises(JournalError) as raised:
            recorder.finish()
    journal = journal_path(recorder.path)
    check_one_line(raised.value)
    assert says(raised.value.message, "recording.kept_exists", journal=str(journal))
    assert recorder.path.read_text() == "another's"
    assert sorted(tmp_path.iterdir()) == [recorder.path, journal]
    recorder.path.unlink()
    assert [test.samples for test in recover(recorder.path)[1].tests] == [500, 500]


def test_a_file_that_appears_while_the_test_runs_is_not_overwritten_and_the_journal_not_blamed(tmp_path):
    recorder = a_sitting(tmp_path / "s.h5")
    recorder.path.write_text("another's")
    with pytest.raises(JournalError, check=coded("recording.kept_exists")) as raised:
        recorder.finish()
    check_one_line(raised.value)
    assert recorder.path.read_text() == "another's"
    recover(recorder.path, tmp_path / "t.h5")


@posix
def test_what_a_kill_at_the_end_left_is_removed_by_recover(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")
    monkeypatch.setattr(secrets, "token_hex", lambda _: "0a" * 8)
    kept = tmp_path / "kept"

    def dies(partial, *_):
        os.link(partial, kept)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(hdf5_session, "verify", dies)
        with pytest.raises(KeyboardInterrupt):
            recorder.finish()
    recorder.abandon()
    os.link(kept, tmp_path / ".s.h5.00000000000000bb.partial")
    journal = journal_path(recorder.path).read_bytes()
    for again in (False, True):  # again: it was killed after the session had its name
        journal_path(recorder.path).write_bytes(journal)
        os.link(kept, tmp_path / f".s.h5.00000000000000b{again:d}.partial")
        recover(recorder.path)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["kept", "s.h5"]


@posix
@pytest.mark.parametrize("umask", [0, 0o777])
def test_sessions_journals_and_the_audit_log_are_for_their_owner_alone(tmp_path, audit_file, umask):
    before = os.umask(umask)
    try:
        recorder = a_sitting(tmp_path / "s.h5", trail=AuditTrail(AuditLog(audit_file), "researcher"))
        modes = [stat.S_IMODE(path.stat().st_mode) for path in (journal_path(recorder.path), audit_file)]
        recorder.finish()
    finally:
        os.umask(before)
    assert [*modes, stat.S_IMODE(recorder.path.stat().st_mode)] == [0o600] * 3
