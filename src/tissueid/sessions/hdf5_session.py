"""Read and validate the HDF5 session file, version 1.0 (docs/sessions.md)."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tissueid.atomic_write import atomic_file
from tissueid.device import DeviceDescription
from tissueid.errors import SessionExistsError, SessionFormatError
from tissueid.formatting import ANONYMOUS
from tissueid.sessions.file_policy import located
from tissueid.sessions.hdf5_members import (
    datasets,
    json_object,
    number_of,
    opened,
    plain_attributes,
    subgroup,
    text_of,
)
from tissueid.sessions.model import (
    ORIGIN,
    SIGNAL_NAMES,
    SIGNAL_UNITS,
    STATUSES,
    Outline,
    Session,
    Subject,
    Test,
    TestOutline,
    attribute_types,
)
from tissueid.untrusted_input import MAX_SAMPLES, MAX_TESTS, RATES_HZ, allowed_numbers

FORMAT = "tissueid-session"
FORMAT_VERSION = "1.0"


def read_session(path: Path) -> Session:
    """Read a session in this process, for files that this program has just written.

    Sizes, types and links are checked before anything is loaded, but time is not limited (``isolated_reading``).

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format.
    """
    return whole_session(session_parts(path))


def session_parts(path: Path) -> Iterator[Any]:
    """Yield a session without its tests, and then each test.

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format.
    """
    with opened(path) as file:
        yield read_all_but_tests(file)
        tests = subgroup(file, "tests")
        yield from (read_numbered(name, subgroup(tests, name)) for name in sorted(tests))


def whole_session(parts: Iterable[Any]) -> Session:
    """Return the session of ``session_parts``."""
    head, *tests = parts
    session: Session = replace(head, tests=tuple(tests))
    return session


def read_session_head(path: Path) -> Session:
    """Read a session without its tests.

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format.
    """
    with opened(path) as file:
        return read_all_but_tests(file)


def read_outline(path: Path) -> Outline:
    """Read a session without its signals, in a few milliseconds for tests of any length.

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format.
    """
    with opened(path) as file:
        head = _read_head(file)
        tests = _tests(file)
        outline = Outline(head, tuple(_outline(name, subgroup(tests, name)) for name in sorted(tests)))
        _check_numbers(file, sum(test.samples * len(test.signals) for test in outline.tests))
        return outline


def read_test(path: Path, number: int) -> Test:
    """Read one test of a session.

    Raises:
        SessionFormatError: missing, not a session, not in accordance with the format, or without this test.
    """
    with opened(path) as file:
        read_all_but_tests(file)
        tests = subgroup(file, "tests")
        name = next((name for name in tests if name.isascii() and name.isdigit() and int(name) == number), None)
        if name is None:
            raise SessionFormatError("session.no_test_number", "the session has no test {number}", number=number)
        return read_numbered(name, subgroup(tests, name))


def read_all_but_tests(file: h5py.File) -> Session:
    """Return the session of an open file without its tests, after checking the size of the tests.

    Raises:
        SessionFormatError: the file is not in accordance with the format.
    """
    head = _read_head(file)
    tests = _tests(file)
    _check_numbers(file, sum(dataset.size for name in tests for _, dataset in _signal_datasets(tests, name)))
    return head


def _check_numbers(file: h5py.File, numbers: int) -> None:
    most = allowed_numbers(file.id.get_filesize())
    if numbers > most:
        raise SessionFormatError(
            "session.too_many_numbers",
            "the tests hold {numbers} numbers; at most {most} are read from a file of this size",
            numbers=numbers,
            most=most,
        )


def _tests(file: h5py.File) -> h5py.Group:
    tests = subgroup(file, "tests")
    if len(tests) > MAX_TESTS:
        raise SessionFormatError(
            "session.too_many_tests", "{count} tests; at most {most} are read", count=len(tests), most=MAX_TESTS
        )
    places = {h5py.h5o.get_info(subgroup(tests, name).id).addr for name in tests}
    if len(places) < len(tests):
        raise SessionFormatError("session.same_test", "one test has several numbers")
    return tests


def _read_head(file: h5py.File) -> Session:
    if text_of(file.attrs, "format", "") != FORMAT:
        raise SessionFormatError("session.not_one", "not a TissueID session (no format attribute)")
    version = text_of(file.attrs, "format_version", "")
    if version.split(".")[0] != FORMAT_VERSION.split(".")[0]:
        raise SessionFormatError(
            "session.version",
            "format version '{version}'; this software reads {known}",
            version=version,
            known=FORMAT_VERSION,
        )
    origin: dict[str, Any] = {name: text_of(file.attrs, name, "") for name in ORIGIN}
    return Session(_read_instrument(subgroup(file, "instrument")), _read_subject(file), **origin)


def _read_instrument(group: h5py.Group) -> DeviceDescription:
    values: dict[str, Any] = {}
    for field in fields(DeviceDescription):
        if field.name == "calibration":
            values["calibration"] = json_object(text_of(group.attrs, "calibration", "{}"), "calibration")
        elif field.name in group.attrs:
            read = text_of if isinstance(field.default, str) else number_of
            values[field.name] = read(group.attrs, field.name)
    return DeviceDescription(**values)


def _read_subject(file: h5py.File) -> Subject:
    if "subject" not in file:
        return Subject()
    attributes = subgroup(file, "subject").attrs
    others = plain_attributes(attributes)
    others.pop("pseudonym", None)
    return Subject(text_of(attributes, "pseudonym", ANONYMOUS), others)


def _outline(name: str, group: h5py.Group) -> TestOutline:
    sizes = {signal: dataset.size for signal, dataset in datasets(subgroup(group, "signals"))}
    if len(set(sizes.values())) != 1:
        raise SessionFormatError("session.lengths", "tests/{test}: its signals have different lengths", test=name)
    return TestOutline(read_numbered(name, group, signals=False), next(iter(sizes.values())), tuple(sizes))


def read_numbered(name: str, group: h5py.Group, *, signals: bool = True) -> Test:
    """Return the test of a group; without its samples if ``signals`` is false.

    Raises:
        SessionFormatError: the test is not in accordance with the format.
    """
    if not (name.isascii() and name.isdigit()):
        raise SessionFormatError("session.test_name", "tests/{test}: tests are numbered", test=name)
    try:
        values = _attributes(group.attrs)
        if not RATES_HZ[0] <= values["sample_rate_hz"] <= RATES_HZ[1]:
            raise SessionFormatError(
                "session.sample_rate",
                "a sample rate of {rate:g} Hz; {low:g} to {high:g} Hz are read",
                rate=values["sample_rate_hz"],
                low=RATES_HZ[0],
                high=RATES_HZ[1],
            )
        if math.isinf(preload := max(0.0, values.get("preload_s", 0.0))):
            raise SessionFormatError("session.preload", "a preload of infinite length")
        if values.get("status") not in STATUSES:
            values["status"] = "completed"
        notes = {name: value for name, value in plain_attributes(group.attrs).items() if name not in values}
        values |= {"preload_s": preload, "notes": notes}
        if signals:
            members = subgroup(group, "signals")
            values |= {"units": _read_units(members), "signals": read_signals(members)}
        return Test(number=int(name), **({"signals": {}} | values))
    except SessionFormatError as error:
        raise SessionFormatError(located(f"tests/{name}", error.message)) from error


def _attributes(stored: h5py.AttributeManager) -> dict[str, Any]:
    """Return the attributes of a test that are stored.

    Raises:
        SessionFormatError: one has another type, or one without a default is missing.
    """
    values: dict[str, Any] = {}
    for name, kind in attribute_types().items():
        if name not in stored:
            continue
        if kind in (float, int):
            values[name] = kind(number_of(stored, name))
            continue
        text = text_of(stored, name)
        if kind == int | None:
            values[name] = int(text) if text else None
        else:
            values[name] = text if kind is str else json_object(text, name)
    for required in ("kind", "sample_rate_hz"):
        if required not in values:
            raise SessionFormatError("session.attribute_missing", "the attribute {name} is missing", name=required)
    return values


def read_signals(group: h5py.Group) -> dict[str, np.ndarray]:
    """Return the signals of a test by name."""
    signals: dict[str, np.ndarray] = {}
    length: int | None = None
    for name, dataset in datasets(group):
        if dataset.ndim != 1 or dataset.dtype.kind not in "fiu":
            raise SessionFormatError("session.signal_type", "signals/{signal} is not a row of numbers", signal=name)
        if not 0 < dataset.size <= MAX_SAMPLES:
            raise SessionFormatError(
                "session.signal_size", "signals/{signal} has {samples} samples", signal=name, samples=int(dataset.size)
            )
        if length is not None and dataset.size != length:
            raise SessionFormatError(
                "session.signal_length",
                "signals/{signal} has {samples} samples where others have {others}",
                signal=name,
                samples=int(dataset.size),
                others=length,
            )
        length = dataset.size
        with np.errstate(invalid="ignore"):  # damaged files can contain any float, also signalling NaN
            signals[name] = dataset[:].astype(np.float64)
    if len(set(signals) - {"time"}) < 2:
        raise SessionFormatError("session.few_signals", "a test needs at least one input and one output")
    return signals


def _read_units(group: h5py.Group) -> dict[str, str]:
    """Return the units of signals that the format does not define; those of the format are SI."""
    units = {
        name: text_of(dataset.attrs, "units")
        for name, dataset in datasets(group)
        if name not in SIGNAL_UNITS and "units" in dataset.attrs
    }
    return {name: unit for name, unit in units.items() if unit not in ("", "1")}


def _signal_datasets(tests: h5py.Group, name: str) -> Iterator[tuple[str, h5py.Dataset]]:
    group = subgroup(tests, name)
    return datasets(subgroup(group, "signals")) if "signals" in group else iter(())


# -- writing ---------------------------------------------------------------------------------------------------------

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
