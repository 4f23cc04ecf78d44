"""Whatever a session file holds, reading it ends, in a session or in one line."""

from __future__ import annotations

import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest
from coded import coded
from sessions import hostile

from tissueid.cli import main
from tissueid.errors import SessionFormatError
from tissueid.sessions import read_outline, read_session, read_session_head
from tissueid.sessions.hdf5_members import check_heaps
from tissueid.sessions.reader_process import ReaderProcess


@pytest.fixture
def path(tmp_path):
    return hostile.a_session(tmp_path / "s.h5")


def test_every_flipped_bit_of_a_size_in_the_heap_is_met(path):
    whole = path.read_bytes()
    objects = list(hostile.heap_objects(whole))
    assert len(objects) > 20
    refused = 0
    for at in objects:
        for bit in range(12):
            data = bytearray(whole)
            data[at + 8 + bit // 8] ^= 1 << bit % 8
            path.write_bytes(data)
            try:
                read_session(path)
            except SessionFormatError:
                refused += 1
    assert refused > len(objects)


def test_an_endless_heap_is_refused_before_the_library_reads_it(path):
    check_heaps(path)
    hostile.endless_heap(path)
    with pytest.raises(SessionFormatError, check=coded("session.heap_overlap")):
        check_heaps(path)
    with pytest.raises(SessionFormatError, check=coded("session.heap_overlap", path=str(path))):
        read_session_head(path)


def test_a_file_that_makes_the_library_loop_costs_the_child_alone(path, tmp_path):
    good = hostile.a_session(tmp_path / "good.h5")
    hostile.endless_heap(path, unseen=True)
    check_heaps(path)
    reader = ReaderProcess(lambda size: 0.2)
    with pytest.raises(SessionFormatError, check=coded("session.slow")):
        reader.read("head", path)
    assert reader.read("head", good)[0].subject.pseudonym == "B5978"
    reader.close()


def test_an_interrupt_ends_the_wait_for_a_file_that_hangs(path):
    hostile.endless_heap(path, unseen=True)
    program = (
        "import signal, sys; from pathlib import Path; from tissueid.cli import main\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored where the tests run in the background
        "from tissueid.sessions import reader_process as r\n"
        "asked = r.ReaderProcess._running\n"
        "r.ReaderProcess._running = lambda self: (asked(self), print('asked', flush=True))[0]\n"
        "sys.exit(main(['quality', sys.argv[1]]))"
    )
    command = [sys.executable, "-c", program, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"asked\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=15)
    assert process.returncode == 130
    assert errors.count(b"\n") == 1


@pytest.mark.parametrize("what", hostile.REFUSED)
def test_what_is_too_much_is_refused(what, path):
    hostile.changed(path, hostile.REFUSED[what])
    with pytest.raises(SessionFormatError):
        read_session(path)


@pytest.mark.parametrize("what", hostile.CLEANED)
def test_what_cannot_be_written_is_not_read(what, path, tmp_path, capsys):
    hostile.changed(path, hostile.CLEANED[what])
    for kind in ("csv", "mat"):
        assert main(["export", str(path), "--out", str(tmp_path / kind), "--format", kind]) == 0
    capsys.readouterr()
    assert main(["import", str(tmp_path / "csv" / "test-0001.csv"), "--out", str(tmp_path / "again.h5")]) == 0


def test_damaged_samples_are_an_error_and_never_other_numbers(path):
    with h5py.File(path) as file:
        places = []
        for name, dataset in file[hostile.SIGNALS].items():
            assert dataset.fletcher32, name
            chunk = dataset.id.get_chunk_info(0)
            places += [chunk.byte_offset, chunk.byte_offset + chunk.size // 2, chunk.byte_offset + chunk.size - 5]
    whole = path.read_bytes()
    for place in places:
        data = bytearray(whole)
        data[place] ^= 4
        path.write_bytes(data)
        with pytest.raises(SessionFormatError, check=coded("session.damaged")):
            read_session(path)


def test_sessions_without_checksums_are_read(path):
    with h5py.File(path, "r+") as file:
        values = file[hostile.SIGNALS]["force"][:]
        del file[hostile.SIGNALS]["force"]
        file[hostile.SIGNALS].create_dataset("force", data=values, compression="gzip")
    np.testing.assert_array_equal(read_session(path).tests[0].signals["force"], values)
    assert read_outline(path).tests[0].samples == 900


@pytest.mark.parametrize("command", [("quality",), ("export", "--format", "csv", "--out", "out")])
def test_texts_of_a_session_do_not_steer_the_terminal(path, tmp_path, monkeypatch, capsys, command):
    with h5py.File(path, "r+") as file:
        file["tests/0001"].attrs.update(site="\x1b[31mred\x9b2J", kind="\x1b]0;title\x07kind")
    monkeypatch.chdir(tmp_path)
    assert main([command[0], str(path), *command[1:]]) == 0
    out = "".join(capsys.readouterr())
    assert "kind" in out
    assert all(mark.isprintable() or mark in "\n\xa0\u202f" for mark in out)


def test_names_of_signals_are_no_formulas_of_a_spreadsheet(path, tmp_path, capsys):
    names = ("=cmd|'calc'!A0", "@SUM(1+1)", "+1", "-x", "plain")
    with h5py.File(path, "r+") as file:
        for name in names:
            file[hostile.SIGNALS][name] = np.arange(900.0)
    assert main(["export", str(path), "--out", str(tmp_path / "out"), "--format", "csv"]) == 0
    header = (tmp_path / "out" / "test-0001.csv").read_text(encoding="utf-8").splitlines()[0]
    assert not any(cell.startswith(("=", "+", "-", "@")) for cell in header.replace('"', "").split(","))
    assert main(["import", str(tmp_path / "out" / "test-0001.csv"), "--out", str(tmp_path / "again.h5")]) == 0
    assert set(names) <= set(read_session(tmp_path / "again.h5").tests[0].signals)
