"""The journal: every prefix recovers every complete batch, and no kill loses what was acknowledged."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from coded import coded, says, shows

from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover
from tissueid.acquisition import journal as journal_module
from tissueid.acquisition.journal import MAGIC, Damage, Entry, Journal, encode_entry, encode_json, read_entries
from tissueid.acquisition.recovery import session_from_entries, write_journal_session
from tissueid.audit import last_lines
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, Run
from tissueid.instrument.interface import empty_samples
from tissueid.sessions import Subject, read_session
from tissueid.wire import Flag

BATCH = 5
ATTRIBUTES = dict(kind="stochastic", site="forearm", sample_rate_hz=2000.0, preload_s=0.0)


def batch(first: int, count: int = BATCH) -> np.ndarray:
    samples = np.zeros(count, SAMPLE)
    samples["index"] = first + np.arange(count)
    samples["flags"] = Flag.PLAYING
    for field, name in enumerate(SAMPLE.names[1:-1]):
        samples[name] = 10.0 * field + samples["index"]
    return samples


def record(path: Path, batches: int, *, finish: bool = True, first: int = 1000) -> SessionRecorder:
    recorder = SessionRecorder(path, DeviceDescription(), Subject("P1"))
    recorder.begin_test(Run(first, batches * BATCH), **ATTRIBUTES)
    for number in range(batches):
        recorder.add(batch(first + number * BATCH))
    if finish:
        recorder.end_test("completed")
        recorder.finish()
    else:
        recorder.abandon()
    return recorder


def test_a_finished_session_leaves_no_journal(tmp_path):
    record(tmp_path / "s.h5", 10)
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]
    test = read_session(tmp_path / "s.h5").test()
    assert test.status == "completed"
    np.testing.assert_array_equal(test.signals["position"], 30.0 + 1000 + np.arange(50))
    np.testing.assert_array_equal(test.signals["force"], 3.0 * test.signals["current"])


def test_every_prefix_recovers_every_complete_batch(tmp_path):
    path = tmp_path / "s.h5"
    record(path, 6, finish=False)
    journal = journal_path(path)
    whole = journal.read_bytes()
    ends, offset = [], len(MAGIC)
    for kind, payload in read_entries(journal):
        offset += len(encode_entry(kind, payload))
        ends.append((offset, kind))
    assert offset == len(whole)
    sitting_end = ends[0][0]
    for length in range(len(whole), -1, -1):
        os.truncate(journal, length)
        complete = BATCH * sum(end <= length for end, kind in ends if kind is Entry.SAMPLES)
        if length < sitting_end:
            with pytest.raises(UnusableInputError, check=coded("recovery.cut_off")):
                session_from_entries(read_entries(journal))
            continue
        session = session_from_entries(read_entries(journal))
        assert sum(test.samples for test in session.tests) == complete
        if complete:
            assert session.tests[0].status == "recovered"
            np.testing.assert_array_equal(session.tests[0].signals["position"], 1030.0 + np.arange(complete))


def entries_of(journal: Path) -> list[tuple[int, int, Entry]]:
    """Begin, end and kind of every entry of a whole journal."""
    found, offset = [], len(MAGIC)
    for kind, payload in read_entries(journal):
        end = offset + len(encode_entry(kind, payload))
        found.append((offset, end, kind))
        offset = end
    return found


def spoil(journal: Path, place: int) -> None:
    raw = bytearray(journal.read_bytes())
    raw[place] ^= 4
    journal.write_bytes(raw)


def test_a_flipped_bit_costs_the_batch_it_is_in_and_no_other(tmp_path):
    path = tmp_path / "s.h5"
    record(path, 10, finish=False)
    journal = journal_path(path)
    whole = journal.read_bytes()
    batches = [(begin, end) for begin, end, kind in entries_of(journal) if kind is Entry.SAMPLES]
    ends = {place for begin, end, _ in entries_of(journal) for place in (*range(begin, begin + 6), end - 1)}
    for place in sorted(ends | set(range(len(MAGIC), len(whole), 101))):
        spoil(journal, place)
        damage = Damage()
        session = session_from_entries(read_entries(journal, damage))
        position = 1030.0 + np.arange(50)
        hit = next((number for number, (begin, end) in enumerate(batches) if begin <= place < end), None)
        if hit is not None:
            position[hit * BATCH : (hit + 1) * BATCH] = np.nan
        if hit == len(batches) - 1:
            position = position[:-BATCH]  # a test without an end is as long as what was received
            length = place - batches[-1][0] in range(1, 5)  # may as well be cut off: its length says so
            assert damage.places == 1 or length
        else:
            assert damage.places == 1
        np.testing.assert_array_equal(session.tests[0].signals["position"], position)
        journal.write_bytes(whole)


def test_a_journal_whose_first_bytes_are_damaged_is_still_one(tmp_path):
    record(tmp_path / "s.h5", 4, finish=False)
    spoil(journal_path(tmp_path / "s.h5"), 2)
    assert recover(tmp_path / "s.h5")[1].test().samples == 20
    assert (tmp_path / "s.h5.journal.damaged").exists()


@pytest.mark.parametrize("left", [b"", b"\x03", b"\x03\x10\x00\x00\x00abc", bytes(3), bytes(5000)])
def test_an_end_that_was_cut_off_is_no_damage(tmp_path, left):
    record(tmp_path / "s.h5", 4, finish=False)
    journal = journal_path(tmp_path / "s.h5")
    journal.write_bytes(journal.read_bytes() + left)
    damage = Damage()
    assert len(list(read_entries(journal, damage))) == 9
    assert damage == Damage()
    reported: list[str] = []
    assert recover(tmp_path / "s.h5", report=reported.append)[1].test().samples == 20
    assert reported == []
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5"]


def test_rubbish_at_the_end_that_was_not_cut_off_is_damage(tmp_path):
    record(tmp_path / "s.h5", 4, finish=False)
    journal = journal_path(tmp_path / "s.h5")
    journal.write_bytes(journal.read_bytes() + b"\x03\x02\x00\x00\x00abcdefghi")
    damage = Damage()
    assert len(list(read_entries(journal, damage))) == 9
    assert damage == Damage(1, 14)


def test_the_search_after_a_damage_ends(tmp_path, monkeypatch):
    """A file made so that everything in it may be an entry costs no more than its share of the time."""
    path = tmp_path / "j"
    path.write_bytes(MAGIC + encode_json(Entry.EVENT, {}) + b"\x03\xff\xff\x00\x00" * 50_000)
    monkeypatch.setattr(journal_module, "MAX_CHECKED", 10_000_000)
    calls = []
    sound = journal_module.entry_at
    monkeypatch.setattr(journal_module, "entry_at", lambda *where: calls.append(1) or sound(*where))
    damage = Damage()
    assert len(list(read_entries(path, damage))) == 1
    assert len(calls) < 200
    assert damage.bytes == 250_000


@pytest.fixture
def spoiled(tmp_path):
    """A sitting of 8000 samples, of which the disk turned one bit over before its end."""
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), Subject("P1"))
    recorder.begin_test(Run(0, 8000), **ATTRIBUTES)
    for number in range(400):
        recorder.add(batch(20 * number, 20))
    recorder.end_test("completed")
    recorder.journal.sync()
    journal = journal_path(tmp_path / "s.h5")
    spoil(journal, [begin for begin, _, kind in entries_of(journal) if kind is Entry.SAMPLES][100] + 300)
    return recorder


def test_a_sitting_whose_journal_was_damaged_is_not_called_written(spoiled, tmp_path):
    with pytest.raises(JournalError, check=coded("recovery.damaged", received=7980, samples=8000)) as raised:
        spoiled.finish()
    assert "\n" not in str(raised.value)
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5.journal"]


def test_a_damaged_journal_is_recovered_around_its_hole_and_kept(spoiled, tmp_path, audit_file, capsys):
    with pytest.raises(JournalError):
        spoiled.finish()
    kept = journal_path(tmp_path / "s.h5").read_bytes()
    (tmp_path / "s.h5.journal.damaged").write_bytes(b"an earlier one")
    assert main(["recover", str(tmp_path / "s.h5"), "--json", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().err
    assert shows(said, "recovery.damage", places=1, bytes=1329)
    assert f"kept as {tmp_path / 's.h5.journal.damaged2'}" in said
    assert json.loads((tmp_path / "a.json").read_text())["warnings"] == [said.strip()]
    assert (tmp_path / "s.h5.journal.damaged").read_bytes() == b"an earlier one"
    assert (tmp_path / "s.h5.journal.damaged2").read_bytes() == kept
    assert not journal_path(tmp_path / "s.h5").exists()
    test = read_session(tmp_path / "s.h5").test()
    position = 30.0 + np.arange(8000)
    position[2000:2020] = np.nan
    np.testing.assert_array_equal(test.signals["position"], position)
    assert (test.status, test.notes["samples_lost"]) == ("completed", 20)
    assert last_lines(audit_file, 1)[0].new == {"tests": 1, "samples": 8000, "damaged_bytes": 1329}


def test_a_damaged_journal_that_cannot_be_renamed_stays(spoiled, tmp_path, monkeypatch):
    spoiled.abandon()

    def fails(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "rename", fails)
    reported: list[str] = []
    recover(tmp_path / "s.h5", tmp_path / "out.h5", report=reported.append)
    assert says(reported[0], "recovery.damage", path=str(tmp_path / "s.h5.journal"))
    assert journal_path(tmp_path / "s.h5").exists()


def test_a_journal_that_lost_its_end_is_not_called_written(tmp_path):
    """Nothing in it is damaged, but it holds less than went into it."""
    recorder = record(tmp_path / "s.h5", 10, finish=False)
    journal = journal_path(tmp_path / "s.h5")
    os.truncate(journal, entries_of(journal)[-3][1])
    with pytest.raises(JournalError, check=coded("recovery.damaged", received=40, samples=50)):
        write_journal_session(tmp_path / "s.h5", journal, recorder.samples_appended)
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5.journal"]


def test_the_end_of_a_test_whose_beginning_is_lost_is_given_to_no_other(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    for number, status in enumerate(("aborted", "completed")):
        recorder.begin_test(Run(1000 * number, 100), **ATTRIBUTES)
        recorder.add(batch(1000 * number, 40 + number))
        recorder.event("gap", first_index=1000 * number, count=1)
        recorder.end_test(status, None, reason=status)
    recorder.abandon()
    journal = journal_path(tmp_path / "s.h5")
    for begin, _, _ in [entry for entry in entries_of(journal) if entry[2] is Entry.TEST][2:]:
        spoil(journal, begin + 20)
    reported: list[str] = []
    test = recover(tmp_path / "s.h5", report=reported.append)[1].test()
    assert (test.status, test.samples, test.notes["reason"]) == ("aborted", 40, "aborted")
    assert test.notes["events"] == '[{"kind": "gap", "first_index": 0, "count": 1}]'
    assert says(reported[0], "recovery.damage", places=1)


def test_a_damaged_journal_of_which_nothing_can_be_made_is_left(tmp_path):
    record(tmp_path / "s.h5", 3, finish=False)
    journal = journal_path(tmp_path / "s.h5")
    for begin, _, kind in entries_of(journal):
        if kind is Entry.SITTING:
            spoil(journal, begin + 20)
    with pytest.raises(UnusableInputError, check=coded("recovery.unreadable")):
        recover(tmp_path / "s.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["s.h5.journal"]


def test_recover_finishes_what_a_dead_host_left(tmp_path):
    path = tmp_path / "s.h5"
    record(path, 10, finish=False)
    target, session = recover(path)
    assert target == path
    assert session.subject.pseudonym == "P1"
    assert session.test().status == "recovered"
    assert [item.name for item in tmp_path.iterdir()] == ["s.h5"]


def test_recover_takes_the_journal_s_own_name_too(tmp_path):
    record(tmp_path / "s.h5", 3, finish=False)
    assert recover(tmp_path / "s.h5.journal")[1].test().samples == 15


def test_recover_can_write_elsewhere(tmp_path):
    record(tmp_path / "s.h5", 3, finish=False)
    target, _ = recover(tmp_path / "s.h5", tmp_path / "elsewhere.h5")
    assert target == tmp_path / "elsewhere.h5"
    assert [item.name for item in tmp_path.iterdir()] == ["elsewhere.h5"]


def test_a_death_between_rename_and_removal_is_mended(tmp_path):
    path = tmp_path / "s.h5"
    record(path, 4, finish=False)
    kept = journal_path(path).read_bytes()
    recover(path)
    journal_path(path).write_bytes(kept)
    before = path.read_bytes()
    recover(path)
    assert path.read_bytes() == before
    assert not journal_path(path).exists()


def test_recover_does_not_touch_another_session(tmp_path):
    record(tmp_path / "other.h5", 3)
    record(tmp_path / "s.h5", 3, finish=False)
    (tmp_path / "other.h5").rename(tmp_path / "s.h5")
    with pytest.raises(UnusableInputError, check=coded("recovery.other_session")):
        recover(tmp_path / "s.h5")
    assert journal_path(tmp_path / "s.h5").exists()


def test_a_running_test_cannot_be_recovered(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    with pytest.raises(JournalError, check=coded("journal.running")):
        recover(tmp_path / "s.h5")
    recorder.abandon()


def test_nothing_to_recover(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("recovery.no_file")):
        recover(tmp_path / "s.h5")
    record(tmp_path / "s.h5", 2)
    with pytest.raises(UnusableInputError, check=coded("recovery.no_journal")):
        recover(tmp_path / "s.h5")
    (tmp_path / "t.h5.journal").write_bytes(b"something else entirely")
    with pytest.raises(UnusableInputError, check=coded("journal.not_one")):
        recover(tmp_path / "t.h5")


def test_an_empty_journal_is_taken_out_of_the_way(tmp_path):
    journal = tmp_path / "s.h5.journal"
    journal.write_bytes(b"")
    with pytest.raises(UnusableInputError, check=coded("recovery.empty")):
        recover(tmp_path / "s.h5")
    assert not journal.exists()
    record(tmp_path / "s.h5", 2)


def test_a_journal_without_an_entry_is_kept_and_can_be_deleted(tmp_path):
    journal = tmp_path / "s.h5.journal"
    journal.write_bytes(MAGIC)
    with pytest.raises(UnusableInputError, check=coded("recovery.delete", path=str(journal))):
        recover(tmp_path / "s.h5")
    assert journal.exists()


def test_an_empty_test_is_not_made_up(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.abandon()
    with pytest.raises(UnusableInputError, check=coded("recovery.nothing")):
        recover(tmp_path / "s.h5")


def test_an_unfinished_session_is_not_written_over(tmp_path):
    record(tmp_path / "s.h5", 2, finish=False)
    with pytest.raises(JournalError, check=coded("journal.exists")):
        SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    record(tmp_path / "t.h5", 2)
    with pytest.raises(SessionFormatError, check=coded("session.exists")):
        SessionRecorder(tmp_path / "t.h5", DeviceDescription())


def test_lost_samples_stay_nan_and_are_counted(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 30), **ATTRIBUTES)
    recorder.add(batch(0, 10))
    recorder.add(empty_samples(10, 5))
    recorder.add(batch(20, 10))  # 15 to 19 never came, not even as a gap
    recorder.event("gap", first_index=10, count=5)
    recorder.end_test("completed")
    test = recorder.finish().test()
    assert np.flatnonzero(np.isnan(test.signals["position"])).tolist() == list(range(10, 20))
    assert test.notes["samples_lost"] == 10
    assert '"kind": "gap"' in test.notes["events"]


def test_samples_outside_the_run_are_left_out(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(100, 20), **ATTRIBUTES)
    recorder.add(batch(90, 50))
    recorder.end_test("completed")
    assert recorder.finish().test().signals["position"].tolist() == (30.0 + np.arange(100, 120)).tolist()


def test_a_full_disk_is_said_and_nothing_acknowledged_is_lost(tmp_path, monkeypatch):
    journal = Journal(tmp_path / "j", sync_s=0.0)
    journal.append(encode_json(Entry.EVENT, {"n": 1}))
    journal.sync()
    assert journal.synced == 1

    def full(_self, _data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Journal, "_write", full)
    journal.append(encode_json(Entry.EVENT, {"n": 2}))
    with pytest.raises(JournalError, check=coded("journal.failed", reason="No space left on device")):
        journal.sync()
    with pytest.raises(JournalError, check=coded("journal.failed", reason="No space left on device")):
        journal.append(encode_json(Entry.EVENT, {"n": 3}))
    assert journal.synced == 1
    journal.close()
    assert len(list(read_entries(tmp_path / "j"))) == 1


@pytest.mark.parametrize(
    "entries",
    [
        [encode_json(Entry.SITTING, {})],
        [encode_entry(Entry.SITTING, b"not json")],
        [encode_json(Entry.SITTING, {"sample_fields": [["index", "<u8"]]})],
        [encode_json(Entry.TEST, {"number": 1, "run": {"first_index": 0, "samples": 10**12}, "attributes": {}})],
        [],
    ],
)
def test_an_invalid_journal_is_refused(tmp_path, entries):
    path = tmp_path / "s.h5.journal"
    path.write_bytes(MAGIC + b"".join(entries))
    with pytest.raises(UnusableInputError):
        recover(path)
    assert path.exists()


def kill_while_recording(folder: Path, times: int, seed: int) -> str:
    worker = Path(__file__).with_name("kill_worker.py")
    result = subprocess.run(
        [sys.executable, str(worker), str(folder), str(times), str(seed)], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_kills_lose_no_acknowledged_batch(tmp_path):
    assert "10 kills" in kill_while_recording(tmp_path, 10, seed=1)


@pytest.mark.soak
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_fifty_kills_lose_no_acknowledged_batch(tmp_path):
    assert "50 kills" in kill_while_recording(tmp_path, 50, seed=2)
