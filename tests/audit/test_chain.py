"""The audit log: nothing can be done to a line that is not seen."""

from __future__ import annotations

import getpass
import io
import json
import os
from hashlib import sha256
from pathlib import Path

import pytest
from audit_logs import a_log, chain_by_hand, forget, rows
from coded import coded, is_german, says
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.audit import (
    AuditLog,
    LogDamage,
    active_role,
    default_path,
    last_lines,
    verification,
    verify,
)
from tissueid.audit import log as audit_log
from tissueid.audit.line import MAX_LINE
from tissueid.errors import UnusableInputError

# -- what is written -----------------------------------------------------------------------------------------


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


def test_too_long_values_are_replaced_by_their_hash(tmp_path):
    log = AuditLog(tmp_path / "a.jsonl")
    log.record("clinician", "x", new=["y" * 1000] * 1000)
    log.record("clinician", "z" * 5000)
    assert str(last_lines(log.path, 2)[0].new).startswith("1004000 bytes that are not kept here, SHA-256 ")
    assert verify(log.path).whole


def test_who_is_named_where_there_is_no_list_of_users(tmp_path, monkeypatch):
    def no_user() -> str:
        raise KeyError("uid not found")

    monkeypatch.setattr(getpass, "getuser", no_user)
    assert audit_log.account() in (f"uid {os.getuid()}", "unknown")


def test_where_the_log_lies(monkeypatch, audit_file):
    assert default_path() == audit_file
    monkeypatch.delenv("TISSUEID_AUDIT")
    assert default_path().name == "audit.jsonl"


def test_roles(monkeypatch):
    assert active_role("researcher") == "researcher"
    monkeypatch.setenv("TISSUEID_ROLE", "Technician")
    assert active_role("researcher") == "technician"
    monkeypatch.setenv("TISSUEID_ROLE", "boss")
    with pytest.raises(UnusableInputError, check=coded("audit.role", variable="TISSUEID_ROLE", value="boss")):
        active_role("researcher")


# -- what is done to it --------------------------------------------------------------------------------------


@pytest.fixture
def found(monkeypatch):
    """Whether verification says anything at all of bytes, but that all is well; they are on no disk, for speed."""

    def looked_at(raw: bytes) -> bool:
        def lines(_path):
            file = io.BytesIO(raw)
            return iter(lambda: file.readline(MAX_LINE), b"")

        monkeypatch.setattr(verification, "_raw_lines", lines)
        result = verify(Path("nowhere"))
        return not result.whole or result.remarks != ()

    return looked_at


def test_every_single_byte_that_is_changed_is_found(tmp_path, found):
    whole = a_log(tmp_path / "a.jsonl", 2).path.read_bytes()
    assert not found(whole)
    for place in range(len(whole)):
        for value in {whole[place] ^ 1, whole[place] ^ 0x20, 0, 10, 24, 125} - {whole[place]}:
            assert found(whole[:place] + bytes([value]) + whole[place + 1 :]), (place, value)


def test_every_single_byte_that_is_removed_or_put_in_is_found(tmp_path, found):
    whole = a_log(tmp_path / "a.jsonl", 2).path.read_bytes()
    for place in range(len(whole) + 1):
        assert place == len(whole) or found(whole[:place] + whole[place + 1 :]), place
        for value in (b"\n", b" ", b"0", b"\x18", b"}"):
            assert found(whole[:place] + value + whole[place:]), (place, value)


def test_every_removal_of_lines_is_found(path):
    lines = rows(path)
    for first in range(len(lines) - 1):
        for last in range(first + 1, len(lines)):
            path.write_bytes(b"".join(lines[:first] + lines[last:]))
            broken = verify(path).broken
            assert broken.damage is LogDamage.REMOVED
            assert broken.line == first + 1


def test_every_swap_of_lines_is_found(path):
    lines = rows(path)
    for first in range(len(lines)):
        for second in range(first + 1, len(lines)):
            swapped = list(lines)
            swapped[first], swapped[second] = lines[second], lines[first]
            path.write_bytes(b"".join(swapped))
            broken = verify(path).broken
            assert broken.damage is LogDamage.REORDERED
            assert broken.line == first + 1


def test_every_copy_of_a_line_that_is_put_in_is_found(path):
    lines = rows(path)
    for copied in range(len(lines)):
        for place in range(copied + 1, len(lines) + 1):
            path.write_bytes(b"".join([*lines[:place], lines[copied], *lines[place:]]))
            broken = verify(path).broken
            assert broken.damage is LogDamage.INSERTED
            assert broken.line == place + 1


def test_a_line_made_up_and_put_in_is_found(path):
    lines = rows(path)
    for place in range(1, len(lines)):
        before = json.loads(lines[place - 1])
        made_up = before | {"number": place + 1, "subject": "P0", "previous": before["hash"]}
        del made_up["hash"]
        body = json.dumps(made_up, separators=(",", ":")).encode()[:-1]
        forged = body + f',"hash":"{sha256(body).hexdigest()}"}}\n'.encode()
        path.write_bytes(b"".join([*lines[:place], forged, *lines[place:]]))
        broken = verify(path).broken
        assert broken.damage is LogDamage.INSERTED
        assert says(broken.message, "audit.twice", line=place + 1)
        path.write_bytes(b"".join([*lines[:place], forged, *lines[place + 1 :]]))
        if place < len(lines) - 1:
            broken = verify(path).broken
            assert broken.damage is LogDamage.CHANGED
            assert broken.line == place + 1
            assert broken.message.code == "audit.exchanged"


def test_rubbish_between_two_lines_is_found(path):
    lines = rows(path)
    for place in range(len(lines)):
        for rubbish in (b"hello\n", b"\n", b"{}\n", b'{"number":2,"time":"\x18\n', b"\x18\n", b"x" * 200_000 + b"\n"):
            path.write_bytes(b"".join([*lines[:place], rubbish, *lines[place:]]))
            broken = verify(path).broken
            assert broken.damage is LogDamage.INSERTED, rubbish[:30]
            assert broken.line <= place + 1


def test_the_message_names_the_damage(path):
    lines = rows(path)
    for raw, code, values in (
        ([*lines[:2], lines[2].replace(b"P1", b"P9"), *lines[3:]], "audit.changed", {"line": 3}),
        ([*lines[:2], *lines[3:]], "audit.removed", {"line": 3, "last": None}),
        ([lines[0], *lines[4:]], "audit.removed", {"line": 2, "last": 4}),
        ([*lines[:3], lines[1], *lines[3:]], "audit.copy", {"copied": 2, "line": 4}),
        ([lines[0], lines[2], lines[1], *lines[3:]], "audit.reordered", {"found": 3, "line": 2}),
        (lines[3:], "audit.removed", {"line": 1, "last": 3}),
    ):
        path.write_bytes(b"".join(raw))
        assert says(verify(path).broken.message, code, **values)
        assert is_german(verify(path).broken.message)


@given(st.data())
@settings(max_examples=150, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_anything_that_is_done_to_a_log_is_found(tmp_path, found, data):
    """Detect every removed and inserted part, unless the bytes are the same or the end was cut off."""
    path = tmp_path / "a.jsonl"
    path.unlink(missing_ok=True)
    forget(path)
    whole = a_log(path, 3).path.read_bytes()
    begin = data.draw(st.integers(0, len(whole)))
    end = data.draw(st.integers(begin, min(len(whole), begin + 400)))
    put_in = data.draw(st.one_of(st.binary(max_size=20), st.sampled_from([whole[:50], whole[begin:end] * 2])))
    damaged = whole[:begin] + put_in + whole[end:]
    cut_off = damaged and whole.startswith(damaged) and damaged.endswith(b"\n")
    if damaged != whole and not cut_off and damaged:
        assert found(damaged)
