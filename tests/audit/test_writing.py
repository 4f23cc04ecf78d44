"""Writing the audit log: no crash loses a line, and no caller waits for the disk."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from audit_logs import Clock
from coded import coded, holding, says

from tissueid.audit import (
    AuditError,
    AuditLog,
    AuditTrail,
    last_lines,
    verify,
)
from tissueid.audit import log as audit_log

# -- the disk, and other programs ----------------------------------------------------------------------------


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_failed_write_is_reported_and_leaves_the_log_unchanged(path, monkeypatch, call, number):
    before, sound = path.read_bytes(), getattr(os, call)

    def fails(descriptor, *data):
        if data:
            sound(descriptor, bytes(data[0])[:100])  # a part of it gets there
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, fails)
        with pytest.raises(AuditError, check=coded("audit.unwritable", why=os.strerror(number))):
            AuditLog(path).record("clinician", "test.begun")
    assert path.read_bytes() == before
    AuditLog(path).record("clinician", "test.begun")
    assert verify(path).whole


def test_a_file_that_can_only_be_added_to_keeps_the_chain(path, monkeypatch):
    sound = os.write

    def fails(descriptor, data):
        sound(descriptor, bytes(data)[:100])
        raise OSError(errno.ENOSPC, "full")

    def never(*_):
        raise PermissionError(errno.EPERM, "append only")

    monkeypatch.setattr(os, "ftruncate", never)
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", fails)
        with pytest.raises(AuditError):
            AuditLog(path).record("clinician", "test.begun")
    AuditLog(path).record("clinician", "test.begun")
    assert verify(path).whole
    assert [line.what for line in last_lines(path, 2)] == ["audit.closed_off", "test.begun"]


def test_short_writes_and_interrupted_ones_are_gone_on_with(path, monkeypatch):
    sound, calls = os.write, []

    def slow(descriptor, data):
        calls.append(1)
        if len(calls) % 3 == 0:
            raise InterruptedError
        return sound(descriptor, bytes(data)[:7])

    monkeypatch.setattr(os, "write", slow)
    AuditLog(path).record("clinician", "test.begun")
    monkeypatch.undo()
    assert verify(path).whole
    assert len(calls) > 50


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_what_is_no_file_is_refused(tmp_path, make):
    make(tmp_path / "a.jsonl")
    with pytest.raises(AuditError, check=coded("audit.unwritable", path=str(tmp_path / "a.jsonl"))):
        AuditLog(tmp_path / "a.jsonl").record("clinician", "test.begun")


def test_a_program_that_holds_the_log_is_not_waited_for_for_ever(path, monkeypatch):
    monkeypatch.setattr(audit_log, "LOCK_S", 0.0)
    with audit_log.open_locked(path), pytest.raises(AuditError, check=holding("audit.held")):
        AuditLog(path).record("clinician", "test.begun")


def test_a_log_that_is_moved_away_while_it_is_waited_for_gets_no_line(path, monkeypatch):
    """It was opened under its name and held under another: what is added belongs to the log of this year."""
    moved, before, sound = path.with_name("2025.jsonl"), path.read_bytes(), audit_log.lock

    def lock(descriptor: int) -> bool:
        if not moved.exists():
            path.rename(moved)
        return sound(descriptor)

    monkeypatch.setattr(audit_log, "lock", lock)
    AuditLog(path).record("clinician", "test.begun")
    assert moved.read_bytes() == before
    assert [line.what for line in last_lines(path, 9)] == ["audit.started", "audit.lines_missing", "test.begun"]


def test_programs_and_threads_add_to_one_log_in_turn(tmp_path):
    path = tmp_path / "a.jsonl"
    program = (
        "import sys\nfrom pathlib import Path\nfrom tissueid.audit import AuditLog\n"
        "log = AuditLog(Path(sys.argv[1]))\n"
        "for n in range(40): log.record('clinician', 'x', subject=sys.argv[2], new=n)\n"
    )
    processes = [subprocess.Popen([sys.executable, "-c", program, str(path), f"p{n}"]) for n in range(2)]
    log = AuditLog(path)
    threads = [
        threading.Thread(target=lambda k=k: [log.record("clinician", "x", subject=f"t{k}", new=n) for n in range(40)])
        for k in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [process.wait() for process in processes] == [0, 0]
    assert verify(path).whole
    lines = last_lines(path, 1000)
    assert len(lines) == 161
    for who in ("p0", "p1", "t0", "t1"):
        assert [line.new for line in lines if line.subject == who] == list(range(40))


# -- trails --------------------------------------------------------------------------------------------------


def test_notes_are_written_in_order_and_in_their_own_time(path):
    trail = AuditTrail(AuditLog(path, Clock()), "clinician")
    for number in range(20):
        trail.note("test.completed", subject=str(number))
    assert trail.settle() == ""
    trail.record("test.begun")
    lines = last_lines(path, 21)
    assert [line.subject for line in lines] == [*map(str, range(20)), ""]
    assert trail.head == lines[-1].head
    assert verify(path).whole
    assert not [thread for thread in threading.enumerate() if thread.name == "audit"]


def test_a_failed_note_is_reported_and_never_raised(tmp_path):
    (tmp_path / "file").touch()
    trail = AuditTrail(AuditLog(tmp_path / "file" / "audit.jsonl"), "clinician")
    trail.note("test.aborted")
    assert says(trail.settle(), "audit.unwritable")
    with pytest.raises(AuditError):
        trail.record("test.begun")


def test_a_disk_that_does_not_answer_blocks_nothing(path, monkeypatch):
    hold = threading.Event()
    monkeypatch.setattr(AuditLog, "record", lambda *_, **__: str(hold.wait()))
    trail = AuditTrail(AuditLog(path), "clinician")
    trail.note("test.aborted")
    assert says(trail.settle(0.01), "audit.no_answer")
    hold.set()
    trail.settle()
