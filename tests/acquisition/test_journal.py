"""The journal: every prefix recovers every complete batch, and no kill loses what was acknowledged."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover
from tissueid.acquisition.journal import MAGIC, Entry, Journal, encode_entry, encode_json, read_entries
from tissueid.acquisition.recovery import session_from_entries
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, Run
from tissueid.instrument.interface import empty_samples
from tissueid.sessions import Subject, read_session

BATCH = 5
ATTRIBUTES = dict(kind="stochastic", site="forearm", sample_rate_hz=2000.0, preload_s=0.0)


def batch(first: int, count: int = BATCH) -> np.ndarray:
    samples = np.zeros(count, SAMPLE)
    samples["index"] = first + np.arange(count)
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
    record(path, 30, finish=False)
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
            with pytest.raises(UnusableInputError, match="cut off before anything"):
                session_from_entries(read_entries(journal))
            continue
        session = session_from_entries(read_entries(journal))
        assert sum(test.samples for test in session.tests) == complete
        if complete:
            assert session.tests[0].status == "recovered"
            np.testing.assert_array_equal(session.tests[0].signals["position"], 1030.0 + np.arange(complete))


def test_a_flipped_bit_ends_the_journal_there(tmp_path):
    path = tmp_path / "s.h5"
    record(path, 10, finish=False)
    raw = bytearray(journal_path(path).read_bytes())
    raw[-400] ^= 4
    journal_path(path).write_bytes(raw)
    session = session_from_entries(read_entries(journal_path(path)))
    assert 0 < session.tests[0].samples < 50


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
    with pytest.raises(UnusableInputError, match="is another session"):
        recover(tmp_path / "s.h5")
    assert journal_path(tmp_path / "s.h5").exists()


def test_a_running_test_cannot_be_recovered(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    with pytest.raises(JournalError, match="still runs"):
        recover(tmp_path / "s.h5")
    recorder.abandon()


def test_nothing_to_recover(tmp_path):
    with pytest.raises(UnusableInputError, match="nothing to recover"):
        recover(tmp_path / "s.h5")
    record(tmp_path / "s.h5", 2)
    with pytest.raises(UnusableInputError, match="nothing to recover"):
        recover(tmp_path / "s.h5")
    (tmp_path / "t.h5.journal").write_bytes(b"something else entirely")
    with pytest.raises(UnusableInputError, match="not a journal"):
        recover(tmp_path / "t.h5")


def test_an_empty_test_is_not_made_up(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 100), **ATTRIBUTES)
    recorder.abandon()
    with pytest.raises(UnusableInputError, match="holds no sample"):
        recover(tmp_path / "s.h5")


def test_an_unfinished_session_is_not_written_over(tmp_path):
    record(tmp_path / "s.h5", 2, finish=False)
    with pytest.raises(JournalError, match="run 'tissueid recover' first"):
        SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    record(tmp_path / "t.h5", 2)
    with pytest.raises(SessionFormatError, match="never overwritten"):
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
    with pytest.raises(JournalError, match="No space left on device"):
        journal.sync()
    with pytest.raises(JournalError, match="No space left on device"):
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
def test_a_journal_that_makes_no_sense_is_refused(tmp_path, entries):
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
