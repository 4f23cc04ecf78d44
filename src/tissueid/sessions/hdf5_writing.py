"""Write the HDF5 session file under a temporary name, read it back, compare, and rename it."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np

from tissueid.atomic_write import atomic_file
from tissueid.errors import SessionExistsError, SessionFormatError
from tissueid.sessions.hdf5_members import opened, subgroup
from tissueid.sessions.hdf5_reading import FORMAT, FORMAT_VERSION, read_all_but_tests, read_numbered
from tissueid.sessions.model import ORIGIN, SIGNAL_NAMES, Session, Test, attribute_types

_Digests = dict[int, dict[str, bytes]]
"""Digests of the written signals by test and signal."""


def write_session(path: Path, session: Session, *, tests: Iterable[Test] | None = None) -> None:
    """Write a session completely or not at all.

    The file is written in the same folder under a temporary name, read back, compared, synced and renamed. ``tests``
    replace those of ``session`` and are iterated once, so that a long sitting need not be in memory.

    Raises:
        SessionExistsError: ``path`` exists, or appeared while the session was written.
        SessionFormatError: the session reads back differently.
        OSError: the disk is full or not writable; no file remains.
    """
    if path.exists():
        raise SessionExistsError(path)
    if not path.parent.is_dir():
        raise SessionFormatError("file.no_folder", "there is no folder {folder}", folder=str(path.parent))
    try:
        with atomic_file(path, synced=True, new=True) as partial:
            verify(partial, session.session_id, _write_into(partial, path, session, tests))
    except FileExistsError as error:
        raise SessionExistsError(path) from error


def _write_into(partial: Path, path: Path, session: Session, tests: Iterable[Test] | None) -> _Digests:
    try:
        with h5py.File(partial, "w", libver="v110", locking=False) as file:  # atomic_file holds the lock
            return _write(file, session, session.tests if tests is None else tests)
    except (OSError, RuntimeError) as error:  # h5py reports a full disk as text only
        number = re.search(r"errno = (\d+)", str(error))
        reason = os.strerror(int(number[1])) if number else str(error).splitlines()[0]
        raise OSError(int(number[1]) if number else 0, reason, str(path)) from error


def _digest(values: np.ndarray) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(values, dtype=np.float64).data).digest()


def _write(file: h5py.File, session: Session, tests: Iterable[Test]) -> _Digests:
    file.attrs.update(
        format=FORMAT,
        format_version=FORMAT_VERSION,
        **{name: value for name in ORIGIN if (value := getattr(session, name)) or name != "audit_head"},
    )
    instrument = file.create_group("instrument")
    figures = asdict(session.instrument)
    calibration = figures.pop("calibration")
    instrument.attrs.update(figures)
    if calibration:
        instrument.attrs["calibration"] = json.dumps(calibration)
    subject = file.create_group("subject")
    subject.attrs.update(session.subject.demographics)
    subject.attrs["pseudonym"] = session.subject.pseudonym
    group = file.create_group("tests")
    digests: _Digests = {}
    for test in tests:
        write_test(group.create_group(f"{test.number:04d}"), test)
        digests[test.number] = {name: _digest(values) for name, values in test.signals.items() if name != "time"}
    return digests


def write_test(group: h5py.Group, test: Test) -> None:
    """Write a test into its group."""
    group.attrs.update(test.notes)
    for name, kind in attribute_types().items():
        value = getattr(test, name)
        if kind == int | None:
            value = "" if value is None else f"{value:04d}"
        group.attrs[name] = json.dumps(value) if isinstance(value, dict) else value
    signals = group.create_group("signals")
    times = np.arange(test.samples) / test.sample_rate_hz
    time = signals.create_dataset("time", data=times, chunks=True, fletcher32=True)
    time.make_scale("time")
    for name, values in test.signals.items():
        if name == "time":
            continue
        dataset = signals.create_dataset(
            name, data=values, compression="gzip", compression_opts=4, shuffle=True, fletcher32=True
        )
        dataset.dims[0].attach_scale(time)
    for name, dataset in signals.items():
        dataset.attrs["units"] = test.unit(name) or "1"
        dataset.attrs["long_name"] = SIGNAL_NAMES.get(name, name)


def verify(path: Path, session_id: str, digests: _Digests) -> None:
    """Read the file back, one test at a time, and compare it with the digests.

    Raises:
        SessionFormatError: it differs, or is not in accordance with the format.
    """
    with opened(path) as file:
        stored = read_all_but_tests(file)
        tests = subgroup(file, "tests")
        if stored.session_id != session_id or len(tests) != len(digests):
            raise SessionFormatError("session.differs", "the session reads back differently")
        for number, written in digests.items():
            test = read_numbered(name := f"{number:04d}", subgroup(tests, name))
            for signal, digest in written.items():
                if signal not in test.signals or _digest(test.signals[signal]) != digest:
                    raise SessionFormatError(
                        "session.test_differs",
                        "test {number}, {signal} reads back differently",
                        number=number,
                        signal=signal,
                    )
