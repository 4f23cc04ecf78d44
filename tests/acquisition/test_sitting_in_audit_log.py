"""The audit log of a sitting: what is in it, and that it holds up no release."""

from __future__ import annotations

import threading

import pytest
from coded import coded, holding
from failing_disk import (
    ATTRIBUTES,
    FULL,
    Disk,
    a_sitting,
    batch,
    guided,
)
from support import connect

from tissueid.acquisition import JournalError, SessionRecorder, run_guided_test
from tissueid.acquisition import recorder as recording
from tissueid.audit import AuditError, AuditLog, AuditTrail, last_lines, verify
from tissueid.audit import log as audit_trail
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError, FirmwareFaultError, LinkLostError
from tissueid.instrument import Run
from tissueid.sessions import read_session_head


def test_a_sitting_is_logged_and_its_session_carries_the_head(tmp_path):
    log = AuditLog(tmp_path / "audit.jsonl")
    a_sitting(tmp_path / "jane-doe.h5", trail=AuditTrail(log, "clinician")).finish()
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
    recorder = SessionRecorder(tmp_path / "jane.h5", instrument.device, trail=AuditTrail(log, "clinician"))

    def press(progress):
        instrument.link.firmware.bench.button = progress.fraction > 0.5

    with pytest.raises(FirmwareFaultError, check=holding("fault.button")):
        run_guided_test(instrument, guided(), recorder, surface_m=0.01, progress=press)
    refused = FirmwareFaultError("it refuses")
    recorder.prepare(1000, site="forearm")
    recorder.log_not_begun(refused, str(refused))
    recorder.finish_or_discard(JournalError(f"cannot write {recorder.path}: {FULL}"))
    lines = last_lines(log.path, 100)
    assert [line.what for line in lines[2:]] == [
        "test.begun",
        "test.fault",
        "test.begun",
        "test.fault",
        "session.broken_off",
        "session.written",
    ]
    assert lines[3].new["codes"] == ["fault.button", "instrument.released", "remedy.release_button"]
    assert lines[3].new["samples"] > 0
    assert lines[5].new["samples"] == 0
    assert lines[6].new == f"cannot write the session: {FULL}"


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
    ("owner", "name", "only", "expected"),
    [
        (SessionRecorder, "_check_disk_space", "", []),
        (AuditLog, "record", "test.begun", ["test.begun", "test.stopped"]),
    ],
)
def test_a_test_that_is_cancelled_while_it_is_prepared_has_an_end_in_the_log_or_no_beginning(
    tmp_path, monkeypatch, owner, name, only, expected
):
    log = AuditLog(tmp_path / "audit.jsonl")
    instrument = connect()
    trail = AuditTrail(log, "clinician")
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device, trail=trail)
    late = Late(monkeypatch, owner, name, only)
    monkeypatch.setattr(audit_trail, "SETTLE_S", 0.01)
    with pytest.raises(CancelledError) as cancelled:
        run_guided_test(instrument, guided(), recorder, surface_m=0.01, cancelled=late.reached.is_set)
    trail.note("session.broken_off", new=str(cancelled.value))
    late.go_on.set()
    late.gone.wait()
    for thread in threading.enumerate():
        if thread.name in ("background work", "audit"):
            thread.join()
    trail.settle()
    whats = [line.what for line in last_lines(log.path, 100)]
    assert whats == ["audit.started", "session.begun", *expected, "session.broken_off"]
    recorder.abandon()


def test_limits_other_than_the_default_are_logged(tmp_path):
    log = AuditLog(tmp_path / "audit.jsonl")
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=AuditTrail(log, "researcher"))
    recorder.prepare(100)
    recorder.prepare(100, limits=recording.Limits())
    recorder.finish_or_discard()
    lines = last_lines(log.path, 2)
    assert lines[0].what == "limits.chosen"
    assert (lines[0].old["max_force_n"], lines[0].new["max_force_n"]) == (12.0, 15.0)


def test_what_cannot_be_logged_is_not_begun(tmp_path):
    (tmp_path / "file").touch()
    trail = AuditTrail(AuditLog(tmp_path / "file" / "audit.jsonl"), "clinician")
    with pytest.raises(AuditError, check=coded("audit.unwritable")):
        SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=trail)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_log_that_fails_during_a_test_does_not_break_it_off(tmp_path, monkeypatch):
    log = AuditLog(tmp_path / "audit.jsonl")
    instrument = connect()
    recorder = SessionRecorder(tmp_path / "s.h5", instrument.device, trail=AuditTrail(log, "clinician"))
    disk = Disk(monkeypatch, log.path)

    def fail(_):
        disk.fails_at = disk.calls + 1

    run_guided_test(instrument, guided(), recorder, surface_m=0.01, progress=fail)
    with pytest.raises(AuditError, check=coded("audit.unwritable", why=FULL)):
        run_guided_test(instrument, guided(), recorder, surface_m=0.01)
    assert not instrument.link.firmware.energised
    session = recorder.finish()
    assert [test.status for test in session.tests] == ["completed"]
    assert FULL in recorder.trail.problem
    assert verify(log.path).whole


def test_a_log_that_stands_still_does_not_hold_up_a_release(tmp_path, monkeypatch):
    hold = threading.Event()
    log = AuditLog(tmp_path / "audit.jsonl")
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), trail=AuditTrail(log, "clinician"))
    recorder.prepare(100)
    monkeypatch.setattr(AuditLog, "record", lambda *_, **__: str(hold.wait()))
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.add(batch(0, 50))
    recorder.end_test("aborted", cause=LinkLostError("unplugged"), reason="unplugged")  # returns at once
    hold.set()
    assert recorder.finish().test().status == "aborted"
