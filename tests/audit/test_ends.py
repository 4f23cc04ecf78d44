"""The end of an audit log: cut off, replaced, left unfinished by a crash, or another file."""

from __future__ import annotations

import os
from datetime import timedelta
from pathlib import Path

import pytest
from audit_logs import START, a_log, forget, rows
from coded import coded, codes, holding, part_of, says

from tissueid.audit import (
    AuditError,
    AuditLog,
    AuditTrail,
    LogDamage,
    check_head,
    last_lines,
    verification,
    verify,
)
from tissueid.audit.log import newest_path
from tissueid.errors import UnusableInputError


def test_a_log_that_is_cut_off_is_detected_by_a_head_from_another_file(path):
    head = verify(path).head
    lines = rows(path)
    forget(path)  # by who may write both
    for kept in range(1, len(lines)):
        path.write_bytes(b"".join(lines[:kept]))
        assert verify(path).whole
        broken = verify(path, {head: "session.h5"}).broken
        assert broken.damage is LogDamage.CUT
        assert says(broken.message, "audit.cut_off", where="session.h5", number=5, lines=kept)
        assert verify(path, {head.partition(":")[2]: "it"}).broken.damage is LogDamage.CUT


def test_a_new_log_is_detected_by_a_head_from_another_file(path):
    head = verify(path).head
    path.unlink()
    forget(path)
    log = a_log(path, 7)
    assert verify(path, {head: "session.h5"}).broken is None, "the same lines at the same time are the same log"
    path.unlink()
    forget(path)
    for _ in range(9):
        log.record("clinician", "test.begun")
    broken = verify(path, {head: "session.h5"}).broken
    assert broken.damage is LogDamage.FOREIGN
    assert broken.message.code == "audit.other_log"


def damaged_log(error):
    return error.code in ("audit.last_line_damaged", "audit.end_damaged")


@pytest.mark.parametrize("head", ["", "5", "5:abc", "x:" + "0" * 64, "0" * 63])
def test_heads_that_are_none_are_refused(head):
    with pytest.raises(UnusableInputError, check=coded("audit.head")):
        check_head(head)


def test_what_a_dying_computer_left_is_closed_off_and_nothing_after_it_is_lost(tmp_path):
    path = tmp_path / "a.jsonl"
    whole = a_log(path, 2).path.read_bytes()
    second_last = len(rows(path)[0] + rows(path)[1])
    for length in range(len(whole) - 1, second_last, -1):
        path.write_bytes(whole[:length])
        forget(path)
        result = verify(path)
        assert result.whole
        assert len(result.remarks) == 1
        AuditLog(path).record("clinician", "test.begun", subject="after")
        result = verify(path)
        assert result.whole
        complete = length == len(whole) - 1
        assert [line.what for line in last_lines(path, 9)[2:]] == (
            ["test.begun", "test.begun"] if complete else ["audit.closed_off", "test.begun"]
        )
        assert last_lines(path, 1)[0].subject == "after"
        assert codes(result.remarks) == ([] if complete else ["audit.closed_off"])
        assert all(says(remark, "audit.closed_off", line=3) for remark in result.remarks)


def test_a_computer_that_dies_again_and_again_while_it_closes_off(tmp_path):
    path = tmp_path / "a.jsonl"
    a_log(path, 1)
    path.write_bytes(path.read_bytes() + b'{"number":3,"ti')
    for cut in (-1, -40, -500, -600, -2, -300):
        AuditLog(path).record("clinician", "test.begun")
        os.truncate(path, path.stat().st_size + cut)
        forget(path)
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
        forget(path)
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
    assert broken.damage is LogDamage.INSERTED
    assert broken.message.code == "audit.foreign_bytes"


@pytest.mark.parametrize(
    "change", [lambda raw: raw.replace(b"P3", b"P4"), lambda raw: raw[:-3] + b"\n", lambda raw: raw[:-1] + b"x"]
)
def test_nothing_is_added_to_a_log_whose_end_was_tampered_with(path, change):
    damaged = change(path.read_bytes())
    path.write_bytes(damaged)
    with pytest.raises(AuditError, check=damaged_log) as caught:
        AuditLog(path).record("clinician", "test.begun")
    assert caught.value.message.values["verify"].command == "tissueid audit verify"
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == damaged
    assert not verify(path).whole


@pytest.mark.parametrize("foreign", [b"a,b,c\n1,2,3\n", b"PK\x03\x04", b"{}\n", b"\n", b"x" * 500_000])
def test_nothing_is_added_to_another_file(tmp_path, foreign):
    path = tmp_path / "a.jsonl"
    path.write_bytes(foreign)
    with pytest.raises(AuditError, check=damaged_log):
        AuditLog(path).record("clinician", "test.begun")
    assert path.read_bytes() == foreign
    assert verify(path).broken.damage is LogDamage.FOREIGN


def test_a_log_that_was_moved_away_is_begun_again_and_says_so(path):
    head = verify(path).head
    moved = path.rename(path.with_name("2025.jsonl"))
    AuditLog(path).record("clinician", "test.begun")
    lines = last_lines(path, 9)
    assert [line.what for line in lines] == ["audit.started", "audit.lines_missing", "test.begun"]
    assert lines[1].old == head
    broken = verify(path).broken
    assert (broken.line, broken.damage) == (2, LogDamage.CUT)
    assert verify(path, after=[moved]).whole
    moved.write_bytes(b"".join(rows(moved)[:-1]))
    assert verify(path, after=[moved]).broken.damage is LogDamage.CUT
    moved.write_bytes(b"something else\n")
    with pytest.raises(UnusableInputError, check=holding("audit.earlier_damaged", path=str(moved))):
        verify(path, after=[moved])


@pytest.mark.parametrize("kept", range(5))
def test_a_log_that_is_cut_off_or_emptied_is_found_by_the_note_of_its_newest_line(path, kept):
    path.write_bytes(b"".join(rows(path)[:kept]))
    broken = verify(path).broken
    assert broken.damage is LogDamage.CUT
    assert says(broken.message, "audit.cut_off", number=5, lines=kept)
    AuditLog(path).record("clinician", "test.begun")  # which hides nothing
    assert verify(path).broken.damage is LogDamage.CUT
    assert "audit.lines_missing" in [line.what for line in last_lines(path, 9)]


@pytest.mark.parametrize("note", [b"", b"x", b"\xff" * 200, b"5:abc\n", b"99999999999999:" + b"0" * 64])
def test_a_note_that_is_none_is_passed_over_and_written_again(path, note):
    newest_path(path).write_bytes(note)
    assert verify(path).whole
    AuditLog(path).record("clinician", "test.begun")
    assert newest_path(path).read_text() == verify(path).head + "\n"


@pytest.mark.parametrize("how", ["emptied", "removed", "replaced"])
@pytest.mark.parametrize("noted", [True, False])
def test_a_log_that_is_taken_away_while_it_is_in_use_is_said(path, how, noted):
    trail = AuditTrail(AuditLog(path), "clinician")
    trail.record("session.begun")
    path.unlink()
    if how != "removed":
        path.touch()
    if how == "replaced":
        forget(path)
        a_log(path, 1)
    if not noted:
        forget(path)
    trail.note("test.begun")
    assert says(part_of(trail.settle(), "audit.replaced"), "audit.replaced", line=6, path=str(path))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.jsonl")
    for path in (tmp_path / "a.jsonl", Path("/dev/zero")):
        for read in (verify, lambda path: last_lines(path, 5)):
            with pytest.raises(OSError, match="not an ordinary file"):
                read(path)


def test_a_log_that_is_too_large_is_refused_and_one_of_zeros_ends(path, monkeypatch):
    with path.open("ab") as file:
        file.truncate(path.stat().st_size + 40_000_000)
    assert verify(path).broken.damage is LogDamage.CHANGED
    monkeypatch.setattr(verification, "MAX_BYTES", 1_000_000)
    with pytest.raises(UnusableInputError, check=coded("audit.too_large", most=1.0)):
        verify(path)


def test_a_clock_that_is_set_back_is_remarked(path):
    AuditLog(path, lambda: START - timedelta(days=1)).record("clinician", "test.begun")
    result = verify(path)
    assert result.whole
    (remark,) = result.remarks
    assert says(remark, "audit.clock", line=6, old="2026-03-04T05:06:11.000Z", new="2026-03-03T05:06:07.000Z")
