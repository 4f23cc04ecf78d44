"""Journals whose checksums are right and whose contents are not, or whose beginning is gone."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from coded import coded, says
from failing_disk import ATTRIBUTES, batch

from tissueid.acquisition import JournalError, SessionRecorder, journal_path, recover
from tissueid.acquisition.journal import MAGIC, Damage, Entry, encode_entry, read_entries
from tissueid.acquisition.recovery import session_from_entries
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.instrument import SAMPLE, Run
from tissueid.sessions import Subject, read_session

RATE = 2000
DEEP = b'{"a":' * 200_000 + b"1" + b"}" * 200_000
VALUES = (
    *(None, True, [], {}, [None], {"x": None}, "", "x", "\0", "a\0b", "1e5", -1, 0, 1, 2, 2**31, 2**63, 2**64, 10**30),
    *(0.5, -1.5, 1e300, 1e-300, float("nan"), float("inf"), "x" * 1_100_000, [1, 2], {"": 1}, {"\0": 1}, "é\x1b[31m"),
)


def sitting(path: Path, tests: int = 2, seconds: float = 0.1) -> list[tuple[Entry, bytes]]:
    """The entries of a journal that a dead host left."""
    recorder = SessionRecorder(path, DeviceDescription(), Subject("P1", {"age": 30.0}))
    for number in range(tests):
        count = round(RATE * seconds)
        run = Run(100_000 * number, count)
        recorder.begin_test(run, **ATTRIBUTES, stimulus={"type": "x", "n": [1.0]}, notes={"a": 1.0}, seed=3)
        for first in range(0, count, 20):
            recorder.add(batch(run.first_index + first, 20))
        recorder.event("gap", first_index=run.first_index, count=1)
        recorder.end_test("completed", count, reason="x")
    recorder.abandon()
    found = list(read_entries(journal_path(path)))
    journal_path(path).unlink()
    return found


def write(path: Path, entries: list[tuple[Entry, bytes]]) -> Path:
    path.write_bytes(MAGIC + b"".join(encode_entry(kind, payload) for kind, payload in entries))
    return path


def places_in(value: object, place: tuple = ()) -> list[tuple]:
    """Every place in a JSON value, the value itself included."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place, *(found for key, item in inner for found in places_in(item, (*place, key)))]


def put(value: object, place: tuple, new: object) -> object:
    if not place:
        return new
    inner = value
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = new
    return value


def mutated(entries: list[tuple[Entry, bytes]], rng: random.Random) -> list[tuple[Entry, bytes]]:
    changed = list(entries)
    which = rng.randrange(len(changed))
    kind, payload = changed[which]
    match rng.randrange(8):
        case 0:
            changed.insert(rng.randrange(len(changed)), changed[which])
        case 1:
            changed[which] = (rng.choice(list(Entry)), payload)
        case 2:
            changed[which] = (kind, payload[: rng.randrange(len(payload))])
        case 3:
            changed[which] = (kind, rng.choice([DEEP, b"", b"null", b'"\\ud800"', b"\xff", b"[1]", b"{}"]))
        case _:
            which = rng.choice([number for number, (kind, _) in enumerate(changed) if kind is not Entry.SAMPLES])
            kind, payload = changed[which]
            try:
                value = json.loads(payload)
            except (ValueError, RecursionError):  # it was changed before
                return changed
            new = rng.choice(VALUES)
            payload = json.dumps(put(value, rng.choice(places_in(value)), new)).encode()
            if rng.randrange(6) == 0:
                payload = payload.replace(b'x"', b'\\ud800"')
            same = [number for number, entry in enumerate(changed) if entry == changed[which]]
            for number in same if rng.randrange(2) else [which]:
                changed[number] = (kind, payload)
    return changed


def check_nonsense(folder: Path, capsys: pytest.CaptureFixture, times: int, seed: int) -> None:
    """Each ends with status 2 and one line, or with a session that can be read; the journal is there afterwards."""
    rng = random.Random(seed)
    entries = sitting(folder / "s.h5")
    for number in range(times):
        changed = entries
        for _ in range(rng.choice((1, 1, 2, 4))):
            changed = mutated(changed, rng)
        path = folder / f"{number}.h5"
        whole = write(journal_path(path), changed).read_bytes()
        status = main(["recover", str(path)])
        said = capsys.readouterr().err
        kept = [found for found in folder.iterdir() if found.name.startswith(f"{number}.h5.journal")]
        assert status in (0, 2), said
        if status == 2:
            assert len(said.splitlines()) == 1
            assert not path.exists()
            assert [found.name for found in kept] == [f"{number}.h5.journal"]
        else:
            assert read_session(path).tests
            assert kept or not said
            path.unlink()
        for found in kept:
            assert found.read_bytes() == whole
            found.unlink()


def test_nonsense_with_a_right_checksum(tmp_path, capsys):
    check_nonsense(tmp_path, capsys, 40, seed=1)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(2, 5))
def test_much_nonsense_with_a_right_checksum(tmp_path, capsys, seed):
    check_nonsense(tmp_path, capsys, 2000, seed)


def a_test(number: int, samples: int, **more: object) -> bytes:
    run = {"first_index": 0, "samples": samples}
    return json.dumps({"number": number, "run": run, "attributes": dict(ATTRIBUTES), **more}).encode()


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (Entry.EVENT, b"null"),
        (Entry.EVENT, b'{"kind":"\\ud800"}'),
        (Entry.EVENT, DEEP),
        (Entry.TEST_END, b'{"test":2,"status":[],"notes":{}}'),
        (Entry.TEST_END, b'{"test":2,"status":"completed","notes":{},"samples":1000000}'),
        (Entry.TEST_END, b'{"test":2,"status":"completed","notes":{"a\\u0000":1}}'),
        (Entry.CLOSED, b"[]"),
        (Entry.SAMPLES, b"x" * (SAMPLE.itemsize + 1)),
        (Entry.TEST, a_test(1, 100)),
    ],
)
def test_an_invalid_entry_is_skipped_and_reported(tmp_path, kind, payload):
    """All that is right stays; what came to nothing is in the journal that is kept."""
    entries = sitting(tmp_path / "s.h5")
    last = max(number for number, (kind, _) in enumerate(entries) if kind is Entry.SAMPLES)
    write(tmp_path / "s.h5.journal", [*entries[: last + 1], (kind, payload), *entries[last + 1 :]])
    reported: list[str] = []
    _, session = recover(tmp_path / "s.h5", report=reported.append)
    assert [test.samples for test in session.tests] == [200, 200]
    assert session.tests[1].status == ("recovered" if kind is Entry.TEST else "completed")
    assert says(reported[0], "recovery.damage", places=1)
    assert (tmp_path / "s.h5.journal.damaged").exists()


def test_a_flood_of_events_does_not_make_the_session_unreadable(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 20), **ATTRIBUTES)
    recorder.add(batch(0, 20))
    for number in range(25_000):
        recorder.event("gap", first_index=number, count=1)
    recorder.end_test("completed")
    events = json.loads(recorder.finish().test().notes["events"])
    assert events[0] == {"kind": "gap", "first_index": 0, "count": 1}
    assert events[-1] == {"kind": "more", "count": 25_000 - len(events) + 1}


# -- little data that claims much ------------------------------------------------------------------------------


def claims(path: Path, tests: int, samples: int) -> Path:
    _, sitting_entry = sitting(path)[0]
    entries = [(Entry.SITTING, sitting_entry)]
    for number in range(1, tests + 1):
        ends = json.dumps({"test": number, "status": "completed", "notes": {}}).encode()
        entries += [
            (Entry.TEST, a_test(number, samples)),
            (Entry.SAMPLES, batch(0, 1).tobytes()),
            (Entry.TEST_END, ends),
        ]
    return write(journal_path(path), entries)


def test_few_samples_that_claim_to_be_many_are_left_out(tmp_path):
    journal = claims(tmp_path / "s.h5", 3, 20_000_000)
    with pytest.raises(UnusableInputError, check=coded("recovery.too_few")) as raised:
        recover(tmp_path / "s.h5")
    assert "\n" not in str(raised.value)
    assert [path.name for path in tmp_path.iterdir()] == [journal.name]


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_no_memory_is_taken_for_samples_that_are_not_there(tmp_path):
    claims(tmp_path / "s.h5", 3, 20_000_000)
    program = "import resource, sys; resource.setrlimit(resource.RLIMIT_DATA, (5 << 27, 5 << 27))\n"
    program += "from tissueid.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, "recover", str(tmp_path / "s.h5")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr


def test_many_tests_of_few_samples_share_one_allowance(tmp_path):
    claims(tmp_path / "s.h5", 12, 100_000)
    reported: list[str] = []
    session = recover(tmp_path / "s.h5", report=reported.append)[1]
    assert [test.number for test in session.tests] == [1, 2, 3, 4, 5]
    assert says(reported[0], "recovery.damage_left_out")
    assert says(reported[0].values["tests"].items[0], "recovery.sparse", number=6, received=1, samples=100_000)


# -- a beginning that is lost ----------------------------------------------------------------------------------


def test_what_follows_the_loss_of_both_beginnings_is_read_by_the_next_repetition(tmp_path):
    """As when another program cuts a journal short in mid-test: what is written next stands after a hole."""
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription(), Subject("P1"))
    recorder.begin_test(Run(100, 10_000), **ATTRIBUTES)
    for first in range(0, 10_000, 100):
        recorder.add(batch(100 + first, 100))
        if first == 2500:
            recorder.journal.sync()
            with journal_path(tmp_path / "s.h5").open("rb+") as other:
                other.truncate(100)
    recorder.end_test("completed")
    with pytest.raises(JournalError, check=coded("recovery.damaged")):
        recorder.finish()
    reported: list[str] = []
    session = recover(tmp_path / "s.h5", report=reported.append)[1]
    assert session.subject.pseudonym == "P1"
    assert session.session_id == recorder.session_id
    position = session.test().signals["position"]
    assert np.flatnonzero(~np.isnan(position)).tolist() == list(range(2600, 10_000))
    assert session.test().status == "completed"
    assert says(reported[0], "recovery.damage", places=1)


def test_samples_before_a_repetition_are_given_to_no_other_test(tmp_path):
    """The end of the first test and the beginning of the second are lost, and the second is shorter than a second."""
    entries = sitting(tmp_path / "s.h5", tests=3, seconds=0.1)
    tests = [number for number, (kind, _) in enumerate(entries) if kind is Entry.TEST]
    pieces = [encode_entry(kind, payload) for kind, payload in entries]
    for number in tests[2:4]:
        pieces[number] = b"\xff" * len(pieces[number])
    journal_path(tmp_path / "s.h5").write_bytes(MAGIC + b"".join(pieces))
    session = recover(tmp_path / "s.h5")[1]
    assert [(test.number, test.samples) for test in session.tests] == [(1, 200), (3, 200)]
    assert all(np.isfinite(test.signals["position"]).all() for test in session.tests)


def test_a_journal_without_repetitions_is_read_as_before(tmp_path):
    entries = [entry for entry in sitting(tmp_path / "s.h5", seconds=2.5) if b'"again"' not in entry[1]]
    first = next(number for number, (kind, _) in enumerate(entries) if kind is not Entry.SITTING)
    old = entries[:first] + [entry for entry in entries[first:] if entry[0] is not Entry.SITTING]
    session = session_from_entries(iter(old))
    assert [test.samples for test in session.tests] == [5000, 5000]


def test_repetitions_take_little_room(tmp_path):
    recorder = SessionRecorder(tmp_path / "s.h5", DeviceDescription())
    recorder.begin_test(Run(0, 20_000), **ATTRIBUTES, stimulus={"type": "x" * 30_000})
    for first in range(0, 20_000, 100):
        recorder.add(batch(first, 100))
    recorder.abandon()
    damage = Damage()
    kinds = [kind for kind, _ in read_entries(journal_path(tmp_path / "s.h5"), damage)]
    assert kinds.count(Entry.TEST) == 2 + 4  # a tenth of 1.3 MB are four of 31 kB
    assert damage == Damage()
