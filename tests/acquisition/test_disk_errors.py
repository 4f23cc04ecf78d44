"""A disk that is full, fails, stands still or goes away: the coil is released, everything acknowledged is kept."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import threading
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from failing_disk import (
    ATTRIBUTES,
    SECONDS,
    Disk,
    Sitting,
    batch,
    calls_of_a_whole_sitting,
    check_failing_at,
    guided,
    told_in_one_line,
)
from support import connect

from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover, run_guided_test
from tissueid.acquisition import recorder as recording
from tissueid.acquisition.journal import Journal
from tissueid.audit import AuditError, AuditLog, Trail, last_lines, verify
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, LinkLostError, SessionFormatError
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import read_session, read_session_head, write_session

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs limits and signals of POSIX")


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
        journal.leave(b"entry")
        journal.close()
    assert journal.synced == 2


# -- a disk that stands still ---------------------------------------------------------------------------------


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
    monkeypatch.setattr(recording, "WAITING_S", 1.0)
    sitting = Sitting(tmp_path, in_step=False)
    disk = Standstill(monkeypatch, journal_path(sitting.path))
    sitting.run(1, seconds=6.0)
    told_in_one_line(sitting.error, "the disk does not take what is recorded", "is kept", "'tissueid recover'")
    assert sitting.released
    journal = sitting.recorder._journal
    assert 1900 < sitting.recorder.samples_appended < 2500
    assert journal._appended_bytes - journal._written_bytes < 1.3 * 2000 * SAMPLE.itemsize
    journal._patience_s = 0.05
    with pytest.raises(JournalError, match="does not answer") as told:
        sitting.recorder.finish_or_discard()
    told_in_one_line(told.value, "What reached it is kept", "'tissueid recover'")
    sitting.recorder.abandon()
    with pytest.raises(JournalError, match="still runs"):
        recover(sitting.path)
    disk.go_on.set()
    journal._patience_s = 10.0
    sitting.recorder.abandon()
    recover(sitting.path)
    sitting.check_recovery(sitting.path)
    assert read_session(sitting.path).test().samples == sitting.recorder.samples_appended


def test_thirty_seconds_of_samples_may_wait(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(sample_rate_hz=10_000.0))
    assert recorder._journal._max_waiting == 300_000 * SAMPLE.itemsize
    recorder.abandon()


# -- a thread that dies ---------------------------------------------------------------------------------------


def twenty_then(recorder: SessionRecorder, broken: Callable[[], None]) -> None:
    recorder.begin_test(Run(0, 1000), **ATTRIBUTES)
    recorder.add(batch(0, 20))
    recorder._journal.sync()
    broken()
    with contextlib.suppress(JournalError):
        for first in range(20, 1000, 20):
            recorder.add(batch(first, 20))


@pytest.mark.parametrize("error", [MemoryError(), ValueError("it cannot be")])
def test_whatever_fails_the_thread_that_writes_is_told(tmp_path, monkeypatch, error):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), sync_s=0.0)

    def fails(*_):
        raise error

    with monkeypatch.context() as patch:
        twenty_then(recorder, lambda: patch.setattr(Journal, "_write", fails))
        with pytest.raises(JournalError, match=str(error) or type(error).__name__) as told:
            recorder.finish()
    told_in_one_line(told.value, "is kept in it", "'tissueid recover'")
    assert recorder.samples_acknowledged == 20
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5.journal"]
    assert recover(tmp_path / "s.h5")[1].test().samples == 20


def test_a_thread_that_is_gone_is_told_at_once(tmp_path, monkeypatch):
    """Not where it works but where it waits: whatever ends it, the journal is let go of and nobody waits for it."""
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), sync_s=0.0)
    thread = recorder._journal._thread

    def fails(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        twenty_then(recorder, lambda: patch.setattr(Journal, "_next", fails))
        thread.join()
        with pytest.raises(JournalError, match="MemoryError"):
            recorder.finish()
    recorder.abandon()
    assert recover(tmp_path / "s.h5")[1].test().samples >= 20


def test_a_thread_that_ended_without_a_word_is_not_taken_for_one_that_has_done_its_work(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Journal, "_write_all", lambda _: None)
        journal = Journal(tmp_path / "j")
    journal._thread.join()
    journal.append(b"entry")
    for wait in (journal.sync, journal.close):
        with pytest.raises(JournalError, match="ended before its time") as told:
            wait()
    told_in_one_line(told.value, "is kept in it", "'tissueid recover'")
    journal._file.close()


# -- a disk that goes away ------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize("how", ["removed", "moved", "exchanged"])
def test_a_folder_that_goes_away_ends_the_test(tmp_path, how):
    folder, elsewhere = tmp_path / "folder", tmp_path / "elsewhere"
    folder.mkdir()
    recorder = SessionRecorder(folder / "s.h5", DeviceDescription(), sync_s=0.0)
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.add(batch(0, 50))
    recorder._journal.sync()
    assert recorder.samples_acknowledged == 50
    if how == "removed":
        shutil.rmtree(folder)
    else:
        folder.rename(elsewhere)
        if how == "exchanged":
            folder.mkdir()
            (folder / "s.h5.journal").touch()
    with pytest.raises(JournalError, match="removed or moved away while it was written") as told:
        recorder.add(batch(50, 50))
        recorder._journal.sync()
    told_in_one_line(told.value, "'tissueid recover'")
    assert recorder.samples_acknowledged == (0 if how == "removed" else 50)
    with pytest.raises(JournalError):
        recorder.finish_or_discard()
    if how != "removed":
        assert recover(elsewhere / "s.h5")[1].test().samples >= 50


# -- the end of a sitting -------------------------------------------------------------------------------------


def a_sitting(path: Path, tests: int = 2, count: int = 500, trail: Trail | None = None) -> SessionRecorder:
    recorder = SessionRecorder(path, DeviceDescription(), trail=trail)
    for number in range(tests):
        recorder.prepare(count)
        recorder.begin_test(Run(1000 * number, count), **ATTRIBUTES)
        recorder.add(batch(1000 * number, count))
        recorder.end_test("completed")
    return recorder


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize(
    "place",
    [
        "h5py.File",
        "tissueid.sessions.file._write_test",
        "tissueid.whole_file.os.fsync",
        "tissueid.whole_file.Path.replace",
    ],
)
def test_a_session_that_cannot_be_written_leaves_its_journal_and_nothing_else(tmp_path, monkeypatch, place, number):
    recorder = a_sitting(tmp_path / "s.h5")
    recorder._journal.sync()
    kept = journal_path(tmp_path / "s.h5")

    def fails(*_, **__):
        if place.endswith("fsync") and not list(tmp_path.glob(".s.h5*")):
            return  # that of the journal
        raise OSError(number, f"[Errno {number}] Unable to write (errno = {number}, error message = 'x')")

    with monkeypatch.context() as patch:
        patch.setattr(place, fails)
        with pytest.raises(JournalError) as told:
            recorder.finish()
    told_in_one_line(told.value, "cannot write", "s.h5", "is kept in", "'tissueid recover'", "--out on another disk")
    if place.startswith(("h5py", "tissueid.sessions")):
        assert os.strerror(number) in str(told.value)
    assert list(tmp_path.iterdir()) == [kept]
    _, session = recover(tmp_path / "s.h5")
    assert [test.samples for test in session.tests] == [500, 500]
    assert [test.status for test in session.tests] == ["completed", "completed"]
    assert not kept.exists()


def test_a_name_that_could_not_be_synced_keeps_the_journal(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")
    recorder._journal.sync()

    def fails(_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr("tissueid.whole_file.sync_folder", fails)
        with pytest.raises(JournalError, match="Input/output error"):
            recorder.finish()
    assert journal_path(tmp_path / "s.h5").exists()
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]


def test_a_journal_that_cannot_be_removed_does_not_cost_the_session(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")

    def fails(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fails)
        assert len(recorder.finish().tests) == 2
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2


def test_a_journal_that_cannot_be_read_back_is_not_removed(tmp_path, monkeypatch):
    recorder = a_sitting(tmp_path / "s.h5")

    def fails(*_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
        yield

    with monkeypatch.context() as patch:
        patch.setattr("tissueid.acquisition.recovery.read_entries", fails)
        with pytest.raises(JournalError, match="Input/output error"):
            recorder.finish()
    assert len(recover(tmp_path / "s.h5")[1].tests) == 2


def test_another_failure_is_not_hidden_by_that_of_the_disk(tmp_path, monkeypatch):
    """The cable breaks, and the disk is full as well: the test ends for the first reason."""
    sitting = Sitting(tmp_path)
    disk = Disk(monkeypatch, journal_path(sitting.path))

    def unplug(progress):
        if progress.fraction > 0.5:
            sitting.instrument._link.plugged = False
            disk.fails_at = disk.calls + 1

    recorder = SessionRecorder(sitting.path, sitting.instrument.device)
    with pytest.raises(LinkLostError):
        run_guided_test(sitting.instrument, guided(), recorder, surface_m=0.01, progress=unplug)
    with pytest.raises(JournalError):
        recorder.finish_or_discard()


# -- before it begins -----------------------------------------------------------------------------------------

Usage = namedtuple("Usage", "total used free")


def test_a_disk_without_room_is_told_before_a_coil_is_energised(tmp_path, monkeypatch):
    instrument = connect()
    free = [50_000_000]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, free[0]))
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device)
    free[0] = 32_100_000
    energised = []
    with pytest.raises(
        JournalError, match=r"has 32 MB free, and 32 MB are wanted: make room, or name a session"
    ) as told:
        run_guided_test(
            instrument,
            guided(),
            recorder,
            surface_m=0.01,
            progress=lambda _: energised.append(instrument._link.firmware.energised),
        )
    told_in_one_line(told.value)
    assert energised == []
    assert recorder.finish_or_discard() is None
    free[0] = 1_000_000
    with pytest.raises(JournalError, match=r"has 1 MB free, and 32 MB are wanted"):
        SessionRecorder(tmp_path / "s.h5", instrument.device)
    assert list(tmp_path.iterdir()) == []


def test_what_is_wanted_is_more_than_is_taken(tmp_path, monkeypatch):
    """The worst case: signals that no compression makes smaller."""
    asked = []
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, 10**12))
    monkeypatch.setattr(recording, "ROOM_LEFT", 0)
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    noise = np.random.default_rng(1).standard_normal(20_000)
    samples = batch(0, 20_000)
    for name in SAMPLE.names[1:-1]:
        samples[name] = noise * (1 + len(name))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(0, 0, 0))
    with pytest.raises(JournalError, match="are wanted") as told:
        recorder.prepare(20_000)
    asked.append(float(str(told.value).split("and ")[1].split(" MB")[0]) * 1e6)
    recorder.begin_test(Run(0, 20_000), **ATTRIBUTES)
    recorder.add(samples)
    recorder.end_test("completed")
    recorder._journal.sync()
    taken = journal_path(recorder.path).stat().st_size
    recorder.write()
    taken += recorder.path.stat().st_size
    assert 0.8 * asked[0] < taken < asked[0] + 0.5e6


def test_a_sitting_that_nobody_could_read_again_is_refused(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.samples_appended = 22_000_000
    with pytest.raises(SessionFormatError, match="grow too large to be read: go on in another session file"):
        recorder.prepare(1_000_000)
    recorder.samples_appended = 0
    recorder.finish_or_discard()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_journal_that_cannot_be_begun_leaves_nothing(tmp_path, monkeypatch, number):
    def fails(*_):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", fails)
        with pytest.raises(JournalError, match=f"{os.strerror(number)}. Nothing was begun"):
            SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    assert list(tmp_path.iterdir()) == []


# -- the audit log of a sitting -------------------------------------------------------------------------------


def test_a_sitting_is_logged_and_its_session_carries_the_head(tmp_path):
    log = AuditLog(tmp_path / "audit.jsonl")
    a_sitting(tmp_path / "jane-doe.h5", trail=Trail(log, "clinician")).finish()
    lines = last_lines(log.path, 100)
    assert [line.what for line in lines] == [
        "audit.started",
        "session.begun",
        "test.begun",
        "test.completed",
        "test.begun",
        "test.completed",
        "session.written",
    ]
    head = read_session_head(tmp_path / "jane-doe.h5").audit_head
    assert head == lines[-2].head
    assert lines[-1].subject == read_session_head(tmp_path / "jane-doe.h5").session_id
    assert "jane" not in log.path.read_text()
    assert verify(log.path, {head: "session"}).whole


def test_how_a_test_ended_is_logged_without_names_of_files(tmp_path):
    log = AuditLog(tmp_path / "audit.jsonl")
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "jane.h5", instrument.device, trail=Trail(log, "clinician"))

    def press(progress):
        instrument._link.firmware.bench.button = progress.fraction > 0.5

    with pytest.raises(Exception, match="button"):
        run_guided_test(instrument, guided(), recorder, surface_m=0.01, progress=press)
    refused = FirmwareFaultError("it refuses")
    recorder.prepare(1000, site="forearm")
    recorder.not_begun(refused, str(refused))
    recorder.finish_or_discard(JournalError(f"cannot write {recorder.path}: No space left on device"))
    lines = last_lines(log.path, 100)
    assert [line.what for line in lines[2:]] == [
        "test.begun",
        "test.fault",
        "test.begun",
        "test.fault",
        "session.broken_off",
        "session.written",
    ]
    assert "button" in lines[3].new["reason"]
    assert lines[3].new["samples"] > 0
    assert lines[5].new["samples"] == 0
    assert lines[6].new == "cannot write the session: No space left on device"


class Late:
    """A step of the preparation that waits, in the thread that was given up, until it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: type, name: str, only: str = "") -> None:
        self.reached, self.go_on, self.gone = threading.Event(), threading.Event(), threading.Event()
        sound = getattr(owner, name)

        def step(*arguments, **more):
            late = threading.current_thread() is not threading.main_thread() and (not only or only in arguments)
            if late:
                self.reached.set()
                self.go_on.wait()
            try:
                return sound(*arguments, **more)
            finally:
                if late:
                    self.gone.set()

        monkeypatch.setattr(owner, name, step)


@pytest.mark.parametrize(
    ("owner", "name", "only", "told"),
    [
        (SessionRecorder, "_check_room", "", []),
        (AuditLog, "record", "test.begun", ["test.begun", "test.stopped"]),
    ],
)
def test_a_test_that_is_cancelled_while_it_is_prepared_has_an_end_in_the_log_or_no_beginning(
    tmp_path, monkeypatch, owner, name, only, told
):
    log = AuditLog(tmp_path / "audit.jsonl")
    instrument = connect()
    trail = Trail(log, "clinician")
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device, trail=trail)
    late = Late(monkeypatch, owner, name, only)
    monkeypatch.setattr("tissueid.audit.trail.SETTLE_S", 0.01)
    with pytest.raises(CancelledError) as cancelled:
        run_guided_test(instrument, guided(), recorder, surface_m=0.01, cancelled=late.reached.is_set)
    trail.note("session.broken_off", new=str(cancelled.value))
    late.go_on.set()
    late.gone.wait()
    for thread in threading.enumerate():
        if thread.name in ("work beside the instrument", "audit"):
            thread.join()
    trail.settle()
    whats = [line.what for line in last_lines(log.path, 100)]
    assert whats == ["audit.started", "session.begun", *told, "session.broken_off"]
    recorder.abandon()


def test_limits_other_than_the_default_are_logged(tmp_path):
    log = AuditLog(tmp_path / "audit.jsonl")
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=Trail(log, "researcher"))
    recorder.prepare(100)
    recorder.prepare(100, limits=recording.Limits())
    recorder.finish_or_discard()
    lines = last_lines(log.path, 2)
    assert lines[0].what == "limits.chosen"
    assert (lines[0].old["max_force_n"], lines[0].new["max_force_n"]) == (12.0, 15.0)


def test_what_cannot_be_logged_is_not_begun(tmp_path):
    (tmp_path / "file").touch()
    trail = Trail(AuditLog(tmp_path / "file" / "audit.jsonl"), "clinician")
    with pytest.raises(AuditError, match="Nothing is begun that cannot be logged"):
        SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=trail)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_log_that_fails_during_a_test_does_not_break_it_off(tmp_path, monkeypatch):
    log = AuditLog(tmp_path / "audit.jsonl")
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device, trail=Trail(log, "clinician"))
    disk = Disk(monkeypatch, log.path)

    def fail(_):
        disk.fails_at = disk.calls + 1

    run_guided_test(instrument, guided(), recorder, surface_m=0.01, progress=fail)
    with pytest.raises(AuditError, match="No space left on device"):
        run_guided_test(instrument, guided(), recorder, surface_m=0.01)
    assert not instrument._link.firmware.energised
    session = recorder.finish()
    assert [test.status for test in session.tests] == ["completed"]
    assert "No space left on device" in recorder.trail.problem
    assert verify(log.path).whole


def test_a_log_that_stands_still_does_not_hold_up_a_release(tmp_path, monkeypatch):
    hold = threading.Event()
    log = AuditLog(tmp_path / "audit.jsonl")
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=Trail(log, "clinician"))
    recorder.prepare(100)
    monkeypatch.setattr(AuditLog, "record", lambda *_, **__: str(hold.wait()))
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.add(batch(0, 50))
    recorder.end_test("aborted", cause=LinkLostError("unplugged"), reason="unplugged")  # returns at once
    hold.set()
    assert recorder.finish().test().status == "aborted"


# -- real file systems ----------------------------------------------------------------------------------------

_CHILD = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from tissueid.acquisition import JournalError, SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
limit, fill = int(sys.argv[2]), sys.argv[3] == "fill"
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
if limit:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
recorder = SessionRecorder(Path(sys.argv[1]), DeviceDescription(), sync_s=0.0)
recorder.begin_test(Run(0, 400_000), kind="stochastic", site="forearm", sample_rate_hz=2000.0)

def fill_up():
    with (Path(sys.argv[1]).parent / "ballast").open("wb", buffering=0) as ballast:
        try:
            while ballast.write(bytes(65536)) == 65536:
                pass
        except OSError:
            pass

try:
    for first in range(0, 400_000, 1000):
        samples = np.zeros(1000, SAMPLE)
        samples["index"] = first + np.arange(1000)
        samples["position"] = samples["index"]
        recorder.add(samples)
        recorder._journal.sync()
        if fill and first == 10_000:
            fill_up()
    print("nothing failed")
except JournalError as error:
    print(recorder.samples_acknowledged, error)
"""


def in_a_child(path: Path, limit: int, fill: str) -> tuple[int, str]:
    command = [sys.executable, "-c", _CHILD, str(path), str(limit), fill]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    acknowledged, _, words = done.stdout.strip().partition(" ")
    return int(acknowledged), words


@posix
def test_a_file_that_the_system_lets_grow_no_further(tmp_path):
    acknowledged, words = in_a_child(tmp_path / "s.h5", 1_000_000, "no")
    assert words.startswith(
        f"cannot write {tmp_path / 's.h5.journal'}: File too large. What was recorded before is kept"
    )
    assert acknowledged == 15_000
    position = recover(tmp_path / "s.h5")[1].test().signals["position"]
    np.testing.assert_array_equal(position, np.arange(acknowledged))


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 80 MB in memory, where this user may mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=80m", "tmpfs", str(place)]
    if (
        sys.platform != "linux"
        or os.geteuid() != 0
        or subprocess.run(command, capture_output=True, check=False).returncode
    ):
        pytest.skip("no file system can be mounted here")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)  # a test that failed may still have files open


@pytest.mark.soak
def test_a_file_system_that_is_really_full(tmp_path, small_disk):
    acknowledged, words = in_a_child(small_disk / "s.h5", 0, "fill")
    assert "No space left on device. What was recorded before is kept" in words
    out = tmp_path / "out.h5"
    with pytest.raises(OSError, match="No space left on device"):
        recover(small_disk / "s.h5")
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "s.h5.journal"]
    position = recover(small_disk / "s.h5", out)[1].test().signals["position"]
    np.testing.assert_array_equal(position, np.arange(position.size))
    assert position.size >= acknowledged >= 11_000


@pytest.mark.soak
def test_a_session_that_fills_the_file_system_leaves_no_half_of_it(small_disk):
    recorder = a_sitting(small_disk / "s.h5", tests=2, count=100_000)
    recorder._journal.sync()
    with (small_disk / "ballast").open("wb") as ballast:
        ballast.truncate(0)
        os.posix_fallocate(ballast.fileno(), 0, shutil.disk_usage(small_disk).free - 300_000)
    with pytest.raises(JournalError, match=r"No space left on device.*is kept in"):
        recorder.finish()
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "s.h5.journal"]
    (small_disk / "ballast").unlink()
    assert [test.samples for test in recover(small_disk / "s.h5")[1].tests] == [100_000, 100_000]


# -- memory ---------------------------------------------------------------------------------------------------

_LONG = """
import resource, sys
from pathlib import Path
import numpy as np
from tissueid.acquisition import SessionRecorder
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run
tests = int(sys.argv[2])
recorder = SessionRecorder(Path(sys.argv[1]), DeviceDescription())
samples = np.zeros(60_000, SAMPLE)
for number in range(tests):
    samples["index"] = 100_000 * number + np.arange(60_000)
    recorder.begin_test(Run(100_000 * number, 60_000), kind="stochastic", site="x", sample_rate_hz=2000.0)
    recorder.add(samples)
    recorder._journal.sync()
    recorder.end_test("completed")
recorder.write()
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@posix
@pytest.mark.soak
def test_a_long_sitting_is_written_in_the_memory_of_its_longest_test(tmp_path):
    most = []
    for tests in (4, 60):
        command = [sys.executable, "-c", _LONG, str(tmp_path / f"{tests}.h5"), str(tests)]
        most.append(int(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    assert most[1] - most[0] < 20_000, "kilobytes; the samples of the longer one alone are 240 MB"
    assert len(read_session_head(tmp_path / "60.h5").session_id) == 36


def test_write_session_and_the_recorder_agree(tmp_path):
    """Streamed or whole, a session is the same."""
    recorder = a_sitting(tmp_path / "s.h5")
    session = recorder.finish()
    write_session(tmp_path / "t.h5", session)
    again = read_session(tmp_path / "t.h5")
    assert [test.samples for test in again.tests] == [test.samples for test in session.tests]
    assert (again.session_id, again.created) == (session.session_id, session.created)
