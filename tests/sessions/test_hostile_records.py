"""Records from elsewhere that would take much memory or time, or that break a reader: refused in one line."""

from __future__ import annotations

import json
import struct
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
from coded import says, shows
from sessions import hostile

from tissueid.cli import main
from tissueid.errors import UnusableInputError
from tissueid.sessions.imports import Choices, Source, import_test

WANTED = {"input": ("u", "V"), "output": ("y", "V")}
MAPPED = ("--map", "input=u:V", "--map", "output=y:V")
U = np.random.default_rng(3).standard_normal((400, 2))


def refused(path, rate_hz=1000.0, wanted=WANTED):
    with pytest.raises(UnusableInputError) as raised:
        import_test(Source.parsed(str(path)), wanted, Choices(), rate_hz=rate_hz)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def peak_of(action):
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def mat_5(path, *, sides=(5, b"\x90\1\0\0\1\0\0\0"), packed=0):
    """A MAT file of one variable u; its dimensions stored as wanted, or so many zeros, compressed."""
    values = element(9, bytes(8 * 400))
    matrix = element(6, struct.pack("<II", 6, 0)) + element(*sides) + element(1, b"u") + values
    whole = element(14, matrix)
    if packed:
        packer = zlib.compressobj(9)
        head = element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", packed // 8, 1)) + element(1, b"u")
        parts = [packer.compress(struct.pack("<II", 14, packed + len(head) + 8) + head + struct.pack("<II", 9, packed))]
        parts += [packer.compress(bytes(1 << 20)) for _ in range(packed >> 20)]
        data = b"".join([*parts, packer.flush()])
        whole = struct.pack("<II", 15, len(data)) + data
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\0\1IM" + whole)
    return path


@pytest.mark.parametrize("size", [(400.0, 1.0), (np.nan, 1.0), (np.inf, 1.0)])
def test_dimensions_that_are_no_whole_numbers(size, tmp_path):
    assert "damaged" in refused(mat_5(tmp_path / "a.mat", sides=(9, struct.pack("<dd", *size))))


@pytest.mark.parametrize("length", [np.nan, np.inf, 8.0])
def test_lengths_of_fields_that_are_no_whole_numbers(length, tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"s": {"u": U[:, 0]}})
    data = path.read_bytes()
    at = data.find(struct.pack("<HH", 5, 4))
    size = struct.pack("<II", 14, len(data) - 128)  # of the structure, 8 bytes more than before
    path.write_bytes(data[:128] + size + data[136:at] + element(9, struct.pack("<d", length)) + data[at + 8 :])
    assert "damaged" in refused(path)


def test_zeros_that_are_packed_tight(tmp_path):
    path = mat_5(tmp_path / "a.mat", packed=128 << 20)
    assert peak_of(lambda: refused(path)) < 50_000_000


def hdf5_mat(path, **options):
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("u", **options)
        file["u"].attrs["MATLAB_class"] = np.bytes_("double")
    return path


def test_a_large_chunk_of_a_mat_7_3(tmp_path):
    path = hdf5_mat(
        tmp_path / "a.mat", shape=(9000,), dtype="f8", maxshape=(None,), chunks=(500_000_000,), compression="gzip"
    )
    assert shows(refused(path), "session.chunks", size=4000000000)


def test_fill_values_of_a_mat_7_3(tmp_path):
    path = hdf5_mat(tmp_path / "a.mat", shape=(20_000_000,), dtype="f8", chunks=(100_000,))
    assert shows(refused(path), "import.mat_variable")


def test_an_endless_heap_in_a_mat_7_3(tmp_path):
    path = hostile.a_session(tmp_path / "a.mat")
    hostile.endless_heap(path)
    assert shows(refused(path), "session.heap_overlap")


@pytest.mark.parametrize("mark", ["1,", "1;", "a ", '"",', "\t"])
def test_long_lines(mark, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("".join(mark * (390_000 // len(mark)) + "\n" for _ in range(4)), encoding="utf-8")
    assert peak_of(lambda: refused(path)) < 200_000_000
    path.write_text(mark * 300_000, encoding="utf-8")
    refused(path)


@pytest.mark.soak
def test_many_long_lines_are_read_in_small_blocks(tmp_path):
    path = tmp_path / "a.csv"
    cells = ",".join(["0.125"] * 5000)
    path.write_text("u,y," + ",".join("x" * 4998) + "\n" + f"{cells}\n" * 300, encoding="utf-8")
    wanted = {"input": ("1", "V"), "output": ("2", "V")}

    def read():
        found = import_test(Source.parsed(str(path)), wanted, Choices(), rate_hz=1e3)
        assert says(found.notices[-1], "import.constant")

    assert peak_of(read) < 60_000_000


@pytest.mark.parametrize("step", ["0", "1e-320", "1e-310", "-1", "1e300", "nan", "inf"])
@pytest.mark.parametrize("columns", ["No", "One"])
def test_steps_of_an_lvm_that_make_no_clock(step, columns, tmp_path):
    path = tmp_path / "a.lvm"
    head = f"LabVIEW Measurement\t\nX_Columns\t{columns}\n***End_of_Header***\t\n"
    head += f"Channels\t2\nDelta_X\t{step}\t{step}\n***End_of_Header***\t\nX_Value\tu\ty\tComment\n"
    x = [float(step) * k if columns == "One" else "" for k in range(50)]
    path.write_text(head + "".join(f"{x[k]}\t{u}\t{y}\n" for k, (u, y) in enumerate(U[:50])), encoding="utf-8")
    refused(path, rate_hz=None)


@pytest.mark.parametrize("options", [("--site", "\udce9"), ("--subject", "a\0"), ("--instrument", "model=\udce9")])
def test_options_that_no_file_can_hold(options, tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("u,y\n" + "".join(f"{u},{y}\n" for u, y in U), encoding="utf-8")
    assert main(["import", str(path), "--out", str(tmp_path / "s.h5"), "--rate", "1000", *MAPPED, *options]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "s.h5").exists()


@pytest.mark.parametrize("text", ["\ud800", "\0", "\udfff\0"])
@pytest.mark.parametrize("where", [("instrument", "model"), ("instrument", "calibration"), ("test", "site")])
def test_texts_in_the_attributes_of_an_export(text, where, tmp_path, capsys):
    session = hostile.a_session(tmp_path / "s.h5")
    assert main(["export", str(session), "--out", str(tmp_path / "out"), "--format", "csv"]) == 0
    path = tmp_path / "out" / "test-0001.json"
    stored = json.loads(path.read_text(encoding="utf-8"))
    stored[where[0]][where[1]] = {text: text} if where[1] == "calibration" else text
    path.write_text(json.dumps(stored), encoding="utf-8")
    capsys.readouterr()
    status = main(["import", str(path.with_suffix(".csv")), "--out", str(tmp_path / "again.h5")])
    assert status == (2 if "\0" in text else 0)
