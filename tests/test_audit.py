"""The audit log: nothing can be done to a line that is not seen, and nothing that happens to a computer loses one."""

from __future__ import annotations

import errno
import getpass
import io
import json
import os
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.acquisition import SessionRecorder
from tissueid.audit import (
    AuditError,
    AuditLog,
    Damage,
    Trail,
    check_head,
    default_path,
    last_lines,
    role_in_force,
    verify,
)
from tissueid.audit import log as audit_log
from tissueid.audit.line import fields_of, make_line
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, UnusableInputError
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import Session, write_session

START = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


class Clock:
    """A second a line."""

    def __init__(self) -> None:
        self.now = START

    def __call__(self) -> datetime:
        self.now += timedelta(seconds=1)
        return self.now


def a_log(path: Path, lines: int = 4) -> AuditLog:
    log = AuditLog(path, Clock())
    for number in range(lines):
        log.record(
            "researcher", "test.begun", subject=f"P{number}", old=number, new={"site": "forearm [x]\n", "n": 1.5}
        )
    return log


@pytest.fixture
def path(tmp_path: Path) -> Path:
    a_log(tmp_path / "audit.jsonl")
    return tmp_path / "audit.jsonl"


def chain_by_hand(path: Path) -> list[dict]:
    """The chain as docs/audit.md says it, reckoned without the package."""
    previous, lines = "0" * 64, []
    for number, raw in enumerate(path.read_bytes().splitlines(), start=1):
        body, _, tail = raw.rpartition(b',"hash":"')
        line = json.loads(raw)
        assert tail == line["hash"].encode() + b'"}'
        assert line["hash"] == sha256(body).hexdigest()
        assert (line["previous"], line["number"]) == (previous, number)
        previous = line["hash"]
        lines.append(line)
    return lines


# -- what is written ------------------------------------------------------------------------------------------


def test_each_line_is_bound_to_the_one_before(path):
    lines = chain_by_hand(path)
    assert [line["what"] for line in lines] == ["audit.started"] + ["test.begun"] * 4
    assert lines[0]["new"] == {"format": "tissueid-audit", "format_version": "1.0"}
    second = lines[2]
    assert second | {"previous": "", "hash": ""} == {
        "number": 3,
        "time": "2026-03-04T05:06:09.000Z",
        "role": "researcher",
        "who": getpass.getuser(),
        "what": "test.begun",
        "subject": "P1",
        "old": 1,
        "new": {"site": "forearm [x]\n", "n": 1.5},
        "software": lines[0]["software"],
        "previous": "",
        "hash": "",
    }


def test_a_whole_log_is_said_to_be(path):
    result = verify(path)
    assert result.whole
    assert (result.lines, result.remarks) == (5, ())
    assert result.head == f"5:{chain_by_hand(path)[-1]['hash']}"
    assert [line.subject for line in last_lines(path, 2)] == ["P2", "P3"]


def test_record_returns_the_head(tmp_path):
    head = a_log(tmp_path / "a.jsonl", 1).record("technician", "calibration.made")
    assert verify(tmp_path / "a.jsonl").head == head


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        (float("nan"), None),
        (Path("a"), "a"),
        ((1, "b"), [1, "b"]),
        ({1: 2}, {"1": 2}),
        ("\udc80", "\udc80"),
        (True, True),
    ],
)
def test_values_of_all_kinds_are_kept(tmp_path, value, kept):
    log = AuditLog(tmp_path / "a.jsonl")
    log.record("clinician", "settings.changed", old=value, new="ä")
    line = last_lines(log.path, 1)[0]
    assert (line.old, line.new) == (kept, "ä")
    assert verify(log.path).whole


def test_values_beyond_all_bounds_are_told_by_their_hash(tmp_path):
    log = AuditLog(tmp_path / "a.jsonl")
    log.record("clinician", "x", new=["y" * 1000] * 1000)
    log.record("clinician", "z" * 5000)
    assert str(last_lines(log.path, 2)[0].new).startswith("1004000 bytes that are not kept here, SHA-256 ")
    assert verify(log.path).whole


def test_who_is_named_where_there_is_no_list_of_users(tmp_path, monkeypatch):
    def nobody() -> str:
        raise KeyError("uid not found")

    monkeypatch.setattr(getpass, "getuser", nobody)
    assert audit_log.account() in (f"uid {os.getuid()}", "unknown")


def test_where_the_log_lies(monkeypatch, audit_file):
    assert default_path() == audit_file
    monkeypatch.delenv("TISSUEID_AUDIT")
    assert default_path().name == "audit.jsonl"


def test_roles(monkeypatch):
    assert role_in_force("researcher") == "researcher"
    monkeypatch.setenv("TISSUEID_ROLE", "Technician")
    assert role_in_force("researcher") == "technician"
    monkeypatch.setenv("TISSUEID_ROLE", "boss")
    with pytest.raises(UnusableInputError, match="clinician or researcher or technician, not 'boss'"):
        role_in_force("researcher")


# -- what is done to it ---------------------------------------------------------------------------------------


class InMemory:
    """A file that was never on a disk, so that thousands of them take seconds."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw

    def open(self, _mode: str) -> io.BytesIO:
        return io.BytesIO(self.raw)


def found(raw: bytes) -> bool:
    """Whether verification says anything at all of these bytes, but that all is well."""
    result = verify(InMemory(raw))
    return not result.whole or result.remarks != ()


def test_every_single_byte_that_is_changed_is_found(tmp_path):
    whole = a_log(tmp_path / "a.jsonl", 2).path.read_bytes()
    assert not found(whole)
    for place in range(len(whole)):
        for value in {whole[place] ^ 1, whole[place] ^ 0x20, 0, 10, 24, 125} - {whole[place]}:
            assert found(whole[:place] + bytes([value]) + whole[place + 1 :]), (place, value)


def test_every_single_byte_that_is_removed_or_put_in_is_found(tmp_path):
    whole = a_log(tmp_path / "a.jsonl", 2).path.read_bytes()
    for place in range(len(whole) + 1):
        assert place == len(whole) or found(whole[:place] + whole[place + 1 :]), place
        for value in (b"\n", b" ", b"0", b"\x18", b"}"):
            assert found(whole[:place] + value + whole[place:]), (place, value)


def rows(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)


def test_every_removal_of_lines_is_found(path):
    lines = rows(path)
    for first in range(len(lines) - 1):
        for last in range(first + 1, len(lines)):
            path.write_bytes(b"".join(lines[:first] + lines[last:]))
            broken = verify(path).broken
            assert broken.damage is Damage.REMOVED
            assert broken.place == first + 1


def test_every_swap_of_lines_is_found(path):
    lines = rows(path)
    for first in range(len(lines)):
        for second in range(first + 1, len(lines)):
            swapped = list(lines)
            swapped[first], swapped[second] = lines[second], lines[first]
            path.write_bytes(b"".join(swapped))
            broken = verify(path).broken
            assert broken.damage is Damage.REORDERED
            assert broken.place == first + 1


def test_every_copy_of_a_line_that_is_put_in_is_found(path):
    lines = rows(path)
    for copied in range(len(lines)):
        for place in range(copied + 1, len(lines) + 1):
            path.write_bytes(b"".join([*lines[:place], lines[copied], *lines[place:]]))
            broken = verify(path).broken
            assert broken.damage is Damage.INSERTED
            assert broken.place == place + 1


def test_a_line_made_up_and_put_in_is_found(path):
    lines = rows(path)
    for place in range(1, len(lines)):
        before = json.loads(lines[place - 1])
        made_up = before | {"number": place + 1, "subject": "nobody", "previous": before["hash"]}
        del made_up["hash"]
        body = json.dumps(made_up, separators=(",", ":")).encode()[:-1]
        forged = body + f',"hash":"{sha256(body).hexdigest()}"}}\n'.encode()
        path.write_bytes(b"".join([*lines[:place], forged, *lines[place:]]))
        broken = verify(path).broken
        assert broken.damage is Damage.INSERTED
        assert broken.words == f"two lines have number {place + 1}: one of them is not part of the log"
        path.write_bytes(b"".join([*lines[:place], forged, *lines[place + 1 :]]))
        if place < len(lines) - 1:
            broken = verify(path).broken
            assert broken.damage is Damage.CHANGED
            assert broken.place == place + 1
            assert "one of the two was exchanged" in broken.words


def test_rubbish_between_two_lines_is_found(path):
    lines = rows(path)
    for place in range(len(lines)):
        for rubbish in (b"hello\n", b"\n", b"{}\n", b'{"number":2,"time":"\x18\n', b"\x18\n", b"x" * 200_000 + b"\n"):
            path.write_bytes(b"".join([*lines[:place], rubbish, *lines[place:]]))
            broken = verify(path).broken
            assert broken.damage is Damage.INSERTED, rubbish[:30]
            assert broken.place <= place + 1


def test_the_words_say_what_was_done(path):
    lines = rows(path)
    for raw, words in (
        ([*lines[:2], lines[2].replace(b"P1", b"P9"), *lines[3:]], "line 3 was changed"),
        ([*lines[:2], *lines[3:]], "line 3 is not there"),
        ([lines[0], *lines[4:]], "lines 2 to 4 are not there"),
        ([*lines[:3], lines[1], *lines[3:]], "a copy of line 2 stands where line 4 should"),
        ([lines[0], lines[2], lines[1], *lines[3:]], "line 3 stands where line 2 should, which comes later"),
        (lines[3:], "lines 1 to 3 are not there"),
    ):
        path.write_bytes(b"".join(raw))
        assert verify(path).broken.words.startswith(words)


@given(st.data())
@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_anything_that_is_done_to_a_log_is_found(tmp_path, data):
    """Whatever is cut out and put in: unless the bytes are the same, or the end was cut off, it is told."""
    path = tmp_path / "a.jsonl"
    path.unlink(missing_ok=True)
    whole = a_log(path, 3).path.read_bytes()
    begin = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(begin, min(len(whole), begin + 400)))
    put_in = data.draw(st.one_of(st.binary(max_size=20), st.sampled_from([whole[:50], whole[begin:end] * 2])))
    damaged = whole[:begin] + put_in + whole[end:]
    cut_off = damaged and whole.startswith(damaged) and damaged.endswith(b"\n")
    if damaged != whole and not cut_off and damaged:
        assert found(damaged)


# -- its end --------------------------------------------------------------------------------------------------


def test_a_log_that_is_cut_off_is_told_by_a_head_from_elsewhere(path):
    head = verify(path).head
    lines = rows(path)
    for kept in range(1, len(lines)):
        path.write_bytes(b"".join(lines[:kept]))
        assert verify(path).whole
        broken = verify(path, {head: "session.h5"}).broken
        assert broken.damage is Damage.CUT
        assert broken.words == (
            f"session.h5 was written when the log had line 5, and it ends with line {kept}: its end was cut off"
        )
        assert verify(path, {head.partition(":")[2]: "it"}).broken.damage is Damage.CUT


def test_a_log_made_anew_is_told_by_a_head_from_elsewhere(path):
    head = verify(path).head
    path.unlink()
    log = a_log(path, 7)
    assert verify(path, {head: "session.h5"}).broken is None, "the same lines at the same time are the same log"
    path.unlink()
    for _ in range(9):
        log.record("clinician", "test.begun")
    broken = verify(path, {head: "session.h5"}).broken
    assert broken.damage is Damage.FOREIGN
    assert "another log, or one made anew" in broken.words


@pytest.mark.parametrize("head", ["", "5", "5:abc", "x:" + "0" * 64, "0" * 63])
def test_heads_that_are_none_are_refused(head):
    with pytest.raises(UnusableInputError, match="NUMBER:HASH"):
        check_head(head)


def test_what_a_dying_computer_left_is_closed_off_and_nothing_after_it_is_lost(tmp_path):
    path = tmp_path / "a.jsonl"
    whole = a_log(path, 2).path.read_bytes()
    second_last = len(rows(path)[0] + rows(path)[1])
    for length in range(len(whole) - 1, second_last, -1):
        path.write_bytes(whole[:length])
        told = verify(path)
        assert told.whole
        assert len(told.remarks) == 1
        AuditLog(path).record("clinician", "test.begun", subject="after")
        result = verify(path)
        assert result.whole
        complete = length == len(whole) - 1
        assert [line.what for line in last_lines(path, 9)[2:]] == (
            ["test.begun", "test.begun"] if complete else ["audit.closed_off", "test.begun"]
        )
        assert last_lines(path, 1)[0].subject == "after"
        assert result.remarks == (() if complete else ("before line 3 a line was left unfinished, and closed off",))


def test_a_computer_that_dies_again_and_again_while_it_closes_off(tmp_path):
    path = tmp_path / "a.jsonl"
    a_log(path, 1)
    path.write_bytes(path.read_bytes() + b'{"number":3,"ti')
    for cut in (-1, -40, -500, -600, -2, -300):
        AuditLog(path).record("clinician", "test.begun")
        os.truncate(path, path.stat().st_size + cut)
        assert verify(path).whole
    AuditLog(path).record("clinician", "test.ended")
    assert verify(path).whole
    assert last_lines(path, 1)[0].what == "test.ended"


def test_room_that_was_made_and_never_filled_is_closed_off(path):
    path.write_bytes(path.read_bytes() + b"\0" * 100)
    AuditLog(path).record("clinician", "test.begun")
    assert verify(path).whole


def test_a_first_line_that_was_never_finished(tmp_path):
    path = tmp_path / "a.jsonl"
    for left in (b"", b"{", b'{"number":1,"time":"20', b"\0\0"):
        path.write_bytes(left)
        AuditLog(path).record("clinician", "test.begun")
        assert verify(path).whole
        assert [line.what for line in last_lines(path, 9)][-2:] == ["audit.started", "test.begun"]


def test_what_was_closed_off_cannot_be_changed(tmp_path):
    path = tmp_path / "a.jsonl"
    a_log(path, 1)
    path.write_bytes(path.read_bytes() + b'{"number":3,"time":"2026')
    AuditLog(path).record("clinician", "test.begun")
    raw = path.read_bytes()
    place = raw.index(b"2026\x18")
    path.write_bytes(raw[:place] + b"2027" + raw[place + 4 :])
    broken = verify(path).broken
    assert broken.damage is Damage.INSERTED
    assert "does not account for them" in broken.words


@pytest.mark.parametrize(
    "change", [lambda raw: raw.replace(b"P3", b"P4"), lambda raw: raw[:-3] + b"\n", lambda raw: raw[:-1] + b"x"]
)
def test_nothing_is_added_to_a_log_whose_end_was_tampered_with(path, change):
    damaged = change(path.read_bytes())
    path.write_bytes(damaged)
    with pytest.raises(AuditError, match=r"damaged.*'tissueid audit verify' tells more.*a new log is begun") as told:
        AuditLog(path).record("clinician", "test.begun")
    assert "\n" not in str(told.value)
    assert path.read_bytes() == damaged
    assert not verify(path).whole


@pytest.mark.parametrize("foreign", [b"a,b,c\n1,2,3\n", b"PK\x03\x04", b"{}\n", b"\n", b"x" * 500_000])
def test_nothing_is_added_to_another_file(tmp_path, foreign):
    path = tmp_path / "a.jsonl"
    path.write_bytes(foreign)
    with pytest.raises(AuditError, match="damaged"):
        AuditLog(path).record("clinician", "test.begun")
    assert path.read_bytes() == foreign
    assert verify(path).broken.damage is Damage.FOREIGN


def test_a_log_that_was_moved_away_is_begun_anew(path):
    path.rename(path.with_name("2025.jsonl"))
    AuditLog(path).record("clinician", "test.begun")
    assert [line.what for line in last_lines(path, 9)] == ["audit.started", "test.begun"]
    assert verify(path.with_name("2025.jsonl")).whole


def test_a_clock_that_is_set_back_is_remarked(path):
    AuditLog(path, lambda: START - timedelta(days=1)).record("clinician", "test.begun")
    result = verify(path)
    assert result.whole
    assert result.remarks == (
        "the clock goes back at line 6, from 2026-03-04T05:06:11.000Z to 2026-03-03T05:06:07.000Z",
    )


# -- the disk, and other programs -----------------------------------------------------------------------------


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize("call", ["write", "fsync"])
def test_a_line_that_cannot_be_written_is_told_and_leaves_the_log_as_it_was(path, monkeypatch, call, number):
    before, sound = path.read_bytes(), getattr(os, call)

    def fails(descriptor, *data):
        if data:
            sound(descriptor, bytes(data[0])[:100])  # a part of it gets there
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, fails)
        with pytest.raises(AuditError, match=f"{os.strerror(number)}.*Nothing is begun that cannot be logged"):
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
    with pytest.raises(AuditError, match=r"cannot write the audit log .*a.jsonl"):
        AuditLog(tmp_path / "a.jsonl").record("clinician", "test.begun")


def test_a_program_that_holds_the_log_is_not_waited_for_for_ever(path, monkeypatch):
    monkeypatch.setattr(audit_log, "LOCK_S", 0.0)
    with audit_log._held(path), pytest.raises(AuditError, match="another program holds it"):
        AuditLog(path).record("clinician", "test.begun")


def test_a_log_that_is_moved_away_while_it_is_waited_for_gets_no_line(path, monkeypatch):
    """It was opened under its name and held under another: what is added belongs to the log of this year."""
    moved, before, sound = path.with_name("2025.jsonl"), path.read_bytes(), audit_log._lock

    def lock(descriptor: int) -> bool:
        if not moved.exists():
            path.rename(moved)
        return sound(descriptor)

    monkeypatch.setattr(audit_log, "_lock", lock)
    AuditLog(path).record("clinician", "test.begun")
    assert moved.read_bytes() == before
    assert [line.what for line in last_lines(path, 9)] == ["audit.started", "test.begun"]


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


# -- trails ---------------------------------------------------------------------------------------------------


def test_notes_are_written_in_order_and_in_their_own_time(path):
    trail = Trail(AuditLog(path, Clock()), "clinician")
    for number in range(20):
        trail.note("test.completed", subject=str(number))
    assert trail.settle() == ""
    trail.record("test.begun")
    lines = last_lines(path, 21)
    assert [line.subject for line in lines] == [*map(str, range(20)), ""]
    assert trail.head == lines[-1].head
    assert verify(path).whole
    assert not [thread for thread in threading.enumerate() if thread.name == "audit"]


def test_a_note_that_cannot_be_written_is_told_and_never_raised(tmp_path):
    (tmp_path / "file").touch()
    trail = Trail(AuditLog(tmp_path / "file" / "audit.jsonl"), "clinician")
    trail.note("test.aborted")
    assert trail.settle().startswith("cannot write the audit log")
    with pytest.raises(AuditError):
        trail.record("test.begun")


def test_a_disk_that_does_not_answer_holds_up_nobody(path, monkeypatch):
    hold = threading.Event()
    monkeypatch.setattr(AuditLog, "record", lambda *_, **__: str(hold.wait()))
    trail = Trail(AuditLog(path), "clinician")
    trail.note("test.aborted")
    assert "does not answer" in trail.settle(0.01)
    hold.set()
    trail.settle()


# -- commands -------------------------------------------------------------------------------------------------


def test_a_whole_log_ends_with_status_0(audit_file, capsys):
    a_log(audit_file)
    assert main(["audit", "verify"]) == 0
    assert "5 lines, all as they were written" in capsys.readouterr().out


def test_a_broken_log_ends_with_status_2_and_one_line(path, tmp_path, capsys):
    path.write_bytes(path.read_bytes().replace(b"P1", b"P2"))
    assert main(["audit", "verify", "--log", str(path), "--json", str(tmp_path / "a.json")]) == 2
    said = capsys.readouterr().err
    assert said == f"tissueid: {path}: line 3 was changed: it does not have the hash that it says\n"
    answer = json.loads((tmp_path / "a.json").read_text())
    assert (answer["whole"], answer["lines"], answer["broken"]["damage"]) == (False, 2, "changed")


def test_sessions_and_calibrations_tell_of_an_end_that_was_cut_off(path, tmp_path, capsys):
    head = verify(path).head
    session, calibration, none = (tmp_path / name for name in ("s.h5", "c.toml", "none.h5"))
    write_session(session, Session(DeviceDescription(), audit_head=head))
    write_session(none, Session(DeviceDescription()))
    calibration.write_text(f'[conditions]\naudit_head = "{head}"\n')
    arguments = ["audit", "verify", "--log", str(path)]
    assert main([*arguments, str(session), str(calibration), str(none), "--head", head]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "none.h5 carries no head of the log" in said
    assert "all 1 heads are in it" in said
    path.write_bytes(b"".join(rows(path)[:-1]))
    for file in (session, calibration):
        assert main([*arguments, str(file)]) == 2
        assert "the log had line 5, and it ends with line 4: its end was cut off" in capsys.readouterr().err


def test_show_prints_the_newest_lines(path, capsys):
    path.write_bytes(path.read_bytes())
    AuditLog(path).record("clinician", "settings.changed", old="dark", new="\x1b[31mlight")
    assert main(["audit", "show", "--log", str(path), "--last", "2"]) == 0
    said = capsys.readouterr().out
    assert "settings.changed" in said
    assert "?[31mlight" in said
    assert "P3" in said
    assert "P2" not in said
    assert main(["audit", "show", "--log", str(path), "--last", "1", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["old"] == "dark"


def test_refusals(tmp_path, capsys):
    (tmp_path / "x.toml").write_bytes(b"\xff")
    a_log(tmp_path / "a.jsonl", 1)
    for arguments, words in (
        (["audit", "verify", "--log", str(tmp_path / "none")], "there is no audit log"),
        (["audit", "show", "--log", str(tmp_path / "none")], "nothing has been logged yet, or it was moved"),
        (["audit", "verify", str(tmp_path / "x.toml")], "is not a calibration"),
        (["audit", "verify", str(tmp_path / "x.h5")], "no such file"),
        (["audit", "verify", "--log", str(tmp_path / "a.jsonl"), "--head", "5"], "NUMBER:HASH"),
        (["--role", "boss", "devices"], "clinician or researcher or technician"),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TISSUEID_ROLE", "clinician")
            assert main(arguments) == 2
        said = capsys.readouterr().err
        assert words in said
        assert said.count("\n") == 1


def run_a_test(out: Path, *more: str) -> int:
    arguments = ["test", "--device", "simulated://forearm", "--site", "forearm", "--seconds", "0.5"]
    return main([*arguments, "--subject", "B17", "--out", str(out), *more])


def test_a_test_from_the_shell_is_logged(audit_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("TISSUEID_ROLE", "clinician")
    assert run_a_test(tmp_path / "s.h5", "--limits", "research") == 0
    lines = last_lines(audit_file, 100)
    assert [line.what for line in lines] == [
        "audit.started",
        "calibration.in_force",
        "session.begun",
        "limits.chosen",
        "test.begun",
        "test.completed",
        "session.written",
    ]
    assert {line.role for line in lines} == {"clinician"}
    assert lines[2].new["pseudonym"] == "B17"
    assert lines[4].new["site"] == "forearm"
    assert lines[5].new["samples"] == 2000
    assert main(["audit", "verify", str(tmp_path / "s.h5")]) == 0
    audit_file.write_bytes(b"".join(rows(audit_file)[:-2]))
    assert main(["audit", "verify", str(tmp_path / "s.h5")]) == 2
    assert "its end was cut off" in capsys.readouterr().err


def test_a_test_that_cannot_be_logged_is_refused_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setenv("TISSUEID_AUDIT", str(tmp_path / "file" / "audit.jsonl"))
    assert run_a_test(tmp_path / "s.h5") == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("tissueid: cannot write the audit log ")
    assert said.endswith("mend that, or name another file with TISSUEID_AUDIT")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_recovery_is_logged_and_never_refused(audit_file, tmp_path, monkeypatch, capsys):
    for name in ("s.h5", "t.h5"):
        recorder = SessionRecorder(tmp_path / name, DeviceDescription())
        recorder.begin_test(Run(0, 10), kind="stochastic", site="forearm", sample_rate_hz=2000.0)
        samples = np.zeros(10, SAMPLE)
        samples["index"] = np.arange(10)
        recorder.add(samples)
        recorder.abandon()
    assert main(["recover", str(tmp_path / "s.h5")]) == 0
    line = last_lines(audit_file, 1)[0]
    assert (line.what, line.new) == ("session.recovered", {"tests": 1, "samples": 10})
    audit_file.write_bytes(b"something else\n")
    assert main(["recover", str(tmp_path / "t.h5")]) == 0
    assert (tmp_path / "t.h5").exists()
    assert "not in the audit log: the last line of the audit log" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("error", "what", "why"),
    [
        (KeyboardInterrupt(), "calibration.stopped", "KeyboardInterrupt"),
        (FirmwareFaultError("the button"), "calibration.broken_off", "the button"),
    ],
)
@pytest.mark.parametrize("kind", ["static", "sweep"])
def test_a_calibration_from_the_shell_that_broke_off_has_an_end_in_the_log(
    audit_file, tmp_path, monkeypatch, capsys, kind, error, what, why
):
    def fails(*_, **__):
        raise error

    monkeypatch.setattr("tissueid.cli.calibrate_static.calibrate_static", fails)
    monkeypatch.setattr("tissueid.cli.calibrate_sweep.Sweep.run", fails)
    assert main(["calibrate", kind, "--device", "simulated://forearm", "--out", str(tmp_path / "c.toml")]) != 0
    lines = [line for line in last_lines(audit_file, 100) if line.what.startswith("calibration.")]
    assert [line.what for line in lines] == ["calibration.begun", what]
    assert (lines[0].new, lines[1].new) == (kind, why)
    assert lines[0].subject == lines[1].subject != ""
    assert {line.role for line in lines} == {"technician"}


@pytest.mark.soak
def test_a_hundred_thousand_lines_are_verified_in_seconds(tmp_path):
    log = a_log(tmp_path / "a.jsonl", 1)
    last = last_lines(log.path, 1)[0]
    with log.path.open("ab") as file:
        while last.number < 100_000:
            fields = fields_of(last) | {"number": last.number + 1, "previous": last.hash}
            del fields["hash"]
            last, raw = make_line(**fields)
            file.write(raw)
    begin = time.perf_counter()
    assert verify(log.path).lines == 100_000
    assert time.perf_counter() - begin < 10.0
    log.record("clinician", "test.begun")
    assert verify(log.path).whole
