"""Every reader answers to any file with a result or with one line, in time and in little memory.

Files are made by code and changed at random, by seed: a few hundred in `make test`, many thousands in `make soak`. A
seed that failed is kept in ``FAILED_ONCE``.
"""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from fuzz.mutations import changed
from known_calibrations import made
from sessions import hostile

from tissueid.acquisition.stimulus_choice import load_stimulus, save_stimulus
from tissueid.acquisition.waveform_file import load_waveform
from tissueid.calibration.file import read_calibration, to_toml
from tissueid.errors import TissueIDError
from tissueid.instrument.twin_file import TwinSource, content_of, read_twin, write_twin
from tissueid.sessions import read_session
from tissueid.sessions.imports import Choices, Source, export_session, import_test
from tissueid.stimuli import get_stimulus
from tissueid.twin.catalogue import effect
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue
from tissueid.twin.simulation import ActiveEffect, NamedTwin
from tissueid.untrusted_input import MEMORY_BYTES, SECONDS

U = np.random.default_rng(5).standard_normal((40, 2))
CASES = 120
SOAK = 4000
FAILED_ONCE: tuple[tuple[str, int], ...] = (("MAT 5", 556),)
"""Reader and seed of every case that broke a reader."""


@dataclass(frozen=True)
class Reader:
    """A good file, made in a folder; how it is read; and what kind of changes it gets."""

    make: Callable[[Path], Path]
    read: Callable[[Path], object]
    text: bool
    places: Callable[[bytes], list[int]] = lambda _: []


def _imported(path: Path) -> object:
    wanted = {"input": ("u", "V"), "output": ("y", "V")}
    rate_hz = None if path.suffix == ".lvm" else 1e3
    return import_test(Source.parsed(str(path)), wanted, Choices(), rate_hz=rate_hz)


def _mat_5(folder: Path, *, packed: bool = False) -> Path:
    path = folder / "a.mat"
    scipy.io.savemat(path, {"s": {"v": U}, "u": U[:, 0], "y": U[:, 1].astype("f4")}, do_compression=packed)
    return path


def _mat_4(folder: Path) -> Path:
    path = folder / "a.mat"
    scipy.io.savemat(path, {"u": U[:, 0], "y": U[:, 1]}, format="4")
    return path


def _mat_73(folder: Path) -> Path:
    path = folder / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("u", U[:, :1]), ("y", U[:, 1:]), ("g/v", U)):
            file.create_dataset(name, data=values, compression="gzip")
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    return path


def _csv(folder: Path) -> Path:
    path = folder / "a.csv"
    path.write_text("# rig 1\nu [V];y [V]\n" + "".join(f"{u};{y}\n" for u, y in U), encoding="utf-8")
    return path


def _lvm(folder: Path) -> Path:
    path = folder / "a.lvm"
    head = "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\tNo\nDecimal_Separator\t.\n***End_of_Header***\t\n"
    head += "Channels\t2\nSamples\t40\t40\nX0\t0.0\t0.0\nDelta_X\t0.001\t0.001\n***End_of_Header***\t\n"
    head += "X_Value\tu\ty\tComment\n"
    path.write_text(head + "".join(f"\t{u}\t{y}\n" for u, y in U), encoding="utf-8")
    return path


def _calibration(folder: Path) -> Path:
    path = folder / "a.toml"
    column = {"depth_m": (0.001, 0.002), "value_n_per_a": (2.9, 3.0)}
    made_of = made(0.0, conditions={"by": "x", "room_c": 20.5}, tables={"force_constant": column})
    assert made_of.calibration is not None
    path.write_text(to_toml(made_of.calibration), encoding="utf-8")
    return path


def _twin(folder: Path) -> Path:
    path = folder / "a.toml"
    known = effect("dry_friction")
    acting = ActiveEffect(known, np.array([(item.low + item.high) / 2 for item in known.parameters]))
    twin = NamedTwin("arm", 1, InstrumentParameters(), Tissue(), (acting,), 2000.0, {"mass_kg": 0.01})
    write_twin(path, content_of(twin, TwinSource(session_id="s", tests=(1, 2)), "2026-03-01", "tissueid 0"))
    return path


def _stimulus(folder: Path) -> Path:
    path = folder / "a.json"
    path.unlink(missing_ok=True)
    save_stimulus(path, get_stimulus("noise").from_options({"seconds": 0.5, "force_max_n": 7.5, "seed": 9}).build())
    return path


def _waveform(folder: Path) -> Path:
    path = folder / "a.csv"
    path.write_text("t;force\n" + "".join(f"{0.001 * k:.4f};{u}\n" for k, u in enumerate(U[:, 0])), encoding="utf-8")
    return path


def _waveform_npy(folder: Path) -> Path:
    path = folder / "a.npy"
    np.save(path, U[:, 0])
    return path


def _played(path: Path) -> object:
    return load_waveform(path, 2000.0)


def _export(folder: Path) -> Path:
    out = folder / "out"
    if not out.exists():
        export_session(read_session(hostile.a_session(folder / "s.h5", 60)), out, "csv")
    return out / "test-0001.json"


def _beside(path: Path) -> object:
    return import_test(Source.parsed(str(path.with_suffix(".csv"))), None, Choices())


READERS = {
    "session": Reader(
        lambda folder: hostile.a_session(folder / "s.h5", 60),
        read_session,
        False,
        lambda data: list(hostile.heap_objects(data)),
    ),
    "MAT 4": Reader(_mat_4, _imported, False),
    "MAT 5": Reader(_mat_5, _imported, False),
    "MAT 5, packed": Reader(lambda folder: _mat_5(folder, packed=True), _imported, False),
    "MAT 7.3": Reader(_mat_73, _imported, False),
    "CSV": Reader(_csv, _imported, True),
    "LVM": Reader(_lvm, _imported, True),
    "calibration": Reader(_calibration, read_calibration, True),
    "twin": Reader(_twin, read_twin, True),
    "stimulus": Reader(_stimulus, load_stimulus, True),
    "waveform": Reader(_waveform, _played, True),
    "waveform, npy": Reader(_waveform_npy, _played, False),
    "export": Reader(_export, _beside, True),
}


def _check(name: str, seeds: Iterable[int], folder: Path) -> None:
    """Read a file changed by each of the seeds: a result or a line; never another error, nor long, nor large."""
    reader = READERS[name]
    path = reader.make(folder)
    reader.read(path)
    whole = path.read_bytes()
    places = reader.places(whole)
    refused = lines = 0
    before = _peak()
    for seed in seeds:
        path.write_bytes(changed(whole, seed, text=reader.text, places=places))
        start = time.process_time()
        try:
            reader.read(path)
        except TissueIDError as error:
            refused += 1
            lines += str(error).count("\n")
        except Exception as error:
            raise AssertionError(f"{name}, seed {seed}: {error!r}") from error
        assert time.process_time() - start < SECONDS, (name, seed)
    assert refused
    assert not lines
    assert _peak() - before < MEMORY_BYTES


def _peak() -> int:
    """The most memory that this process has had so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.mark.parametrize("name", READERS)
def test_a_changed_file_is_read_or_refused(name: str, tmp_path: Path) -> None:
    _check(name, range(CASES), tmp_path)


@pytest.mark.parametrize(("name", "seed"), FAILED_ONCE)
def test_what_failed_once(name: str, seed: int, tmp_path: Path) -> None:
    reader = READERS[name]
    path = reader.make(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(changed(whole, seed, text=reader.text, places=reader.places(whole)))
    with contextlib.suppress(TissueIDError):
        reader.read(path)


@pytest.mark.soak
@pytest.mark.parametrize("name", READERS)
def test_many_changed_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    _check(name, range(CASES, CASES + SOAK), tmp_path)
