"""The HDF5 session file, version 1.0: written whole, verified, then renamed into place; read with suspicion."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError
from tissueid.sessions.model import SIGNAL_NAMES, SIGNAL_UNITS, STATUSES, Session, Subject, Test
from tissueid.sessions.outline import Outline, TestOutline
from tissueid.whole_file import whole_file

FORMAT = "tissueid-session"
FORMAT_VERSION = "1.0"
MAX_SAMPLES = 20_000_000
MAX_NUMBERS = 200_000_000
"""In all signals of all tests together: 1.6 GB once they are read."""
MAX_TESTS = 10_000
MAX_TEXT = 1_000_000
_REQUIRED_TEST = ("kind", "sample_rate_hz")


# -- writing --------------------------------------------------------------------------------------------------


def write_session(
    path: Path, session: Session, *, tests: Iterable[Test] | None = None, overwrite: bool = False
) -> None:
    """Write a session so that ``path`` is either not there or whole.

    The file is written beside ``path`` under a temporary name, read back and compared, synced, then renamed. ``tests``
    stand in for those of ``session``, and are asked for one by one: a long sitting need not be in memory.

    Raises:
        SessionFormatError: ``path`` is there already, or what was read back differs from what was written.
        OSError: the disk is full or not writable; nothing is left behind.
    """
    if path.exists() and not overwrite:
        raise SessionFormatError(f"{path} is there already; sessions are never overwritten")
    if not path.parent.is_dir():
        raise SessionFormatError(f"there is no folder {path.parent}")
    with whole_file(path, synced=True) as partial:
        try:
            with h5py.File(partial, "w", libver="v110") as file:
                digests = _write(file, session, session.tests if tests is None else tests)
        except (OSError, RuntimeError) as error:  # h5py wraps a full disk in a text of its own
            number = re.search(r"errno = (\d+)", str(error))
            reason = os.strerror(int(number[1])) if number else str(error).splitlines()[0]
            raise OSError(int(number[1]) if number else 0, reason, str(path)) from error
        _verify(partial, session.session_id, digests)


_Digests = dict[int, dict[str, bytes]]
"""What was written, by test and signal."""


def _digest(values: np.ndarray) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(values, dtype=np.float64).data).digest()


def _write(file: h5py.File, session: Session, tests: Iterable[Test]) -> _Digests:
    file.attrs.update(
        format=FORMAT,
        format_version=FORMAT_VERSION,
        session_id=session.session_id,
        created=session.created,
        software=session.software,
    )
    if session.audit_head:
        file.attrs["audit_head"] = session.audit_head
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
        _write_test(group.create_group(f"{test.number:04d}"), test)
        digests[test.number] = {name: _digest(values) for name, values in test.signals.items() if name != "time"}
    return digests


def _write_test(group: h5py.Group, test: Test) -> None:
    group.attrs.update(test.notes)
    group.attrs.update(
        kind=test.kind,
        configuration=test.configuration,
        site=test.site,
        sample_rate_hz=test.sample_rate_hz,
        preload_s=test.preload_s,
        surface_position_m=test.surface_position_m,
        stimulus=json.dumps(test.stimulus),
        seed=test.seed,
        repeat_of="" if test.repeat_of is None else f"{test.repeat_of:04d}",
        status=test.status,
    )
    signals = group.create_group("signals")
    time = signals.create_dataset("time", data=np.arange(test.samples) / test.sample_rate_hz)
    time.make_scale("time")
    for name, values in test.signals.items():
        if name == "time":
            continue
        dataset = signals.create_dataset(name, data=values, compression="gzip", compression_opts=4, shuffle=True)
        dataset.dims[0].attach_scale(time)
    for name, dataset in signals.items():
        dataset.attrs["units"] = test.unit(name) or "1"
        dataset.attrs["long_name"] = SIGNAL_NAMES.get(name, name)


def _verify(path: Path, session_id: str, digests: _Digests) -> None:
    """Read back what was written, one test at a time.

    Raises:
        SessionFormatError: it differs, or could not be read by anybody else.
    """
    with _opened(path) as file:
        stored = _read_all_but_tests(file)
        tests = _group(file, "tests")
        if stored.session_id != session_id or len(tests) != len(digests):
            raise SessionFormatError("the session reads back differently")
        for number, written in digests.items():
            test = _read_test(name := f"{number:04d}", _group(tests, name))
            for signal, digest in written.items():
                if signal not in test.signals or _digest(test.signals[signal]) != digest:
                    raise SessionFormatError(f"test {number}, {signal} reads back differently")


# -- reading --------------------------------------------------------------------------------------------------


def read_session(path: Path) -> Session:
    """Read a session. Files come from anywhere: sizes, types and links are checked before anything is loaded.

    Raises:
        SessionFormatError: not there, not a session, or one that breaks the format; says where.
    """
    with _opened(path) as file:
        session = _read_all_but_tests(file)
        tests = _group(file, "tests")
        return replace(session, tests=tuple(_read_test(name, _group(tests, name)) for name in sorted(tests)))


def read_session_head(path: Path) -> Session:
    """Read a session but for its tests: who and what it is, with the same suspicion.

    Raises:
        SessionFormatError: not there, not a session, or one that breaks the format; says where.
    """
    with _opened(path) as file:
        return _read_all_but_tests(file)


def read_outline(path: Path) -> Outline:
    """Read all of a session but its signals, with the same suspicion: a few milliseconds, however long the tests are.

    Raises:
        SessionFormatError: not there, not a session, or one that breaks the format; says where.
    """
    with _opened(path) as file:
        head = _read_head(file)
        tests = _tests(file)
        outline = Outline(head, tuple(_outline(name, _group(tests, name)) for name in sorted(tests)))
        _check_numbers(sum(test.samples * len(test.signals) for test in outline.tests))
        return outline


def read_test(path: Path, number: int) -> Test:
    """Read one test of a session, and none of the others' signals.

    Raises:
        SessionFormatError: not there, not a session, one that breaks the format, or one without such a test.
    """
    with _opened(path) as file:
        _read_all_but_tests(file)
        tests = _group(file, "tests")
        name = next((name for name in tests if name.isascii() and name.isdigit() and int(name) == number), None)
        if name is None:
            raise SessionFormatError(f"the session has no test {number}")
        return _read_test(name, _group(tests, name))


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """The file, open to be read; whatever is wrong with it is said as what it is.

    Raises:
        SessionFormatError: says what.
    """
    try:
        with h5py.File(path, "r") as file:
            yield file
    except SessionFormatError as error:
        raise SessionFormatError(f"{path}: {error}") from error
    except FileNotFoundError as error:
        raise SessionFormatError(f"{path}: no such file") from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError) as error:
        # h5py tells damage in any of these; whatever it says, the file is of no use.
        kind = "is a folder" if path.is_dir() else "is damaged, or not an HDF5 session"
        raise SessionFormatError(f"{path} {kind}") from error


def _read_all_but_tests(file: h5py.File) -> Session:
    head = _read_head(file)
    tests = _tests(file)
    _check_numbers(sum(dataset.size for name in tests for _, dataset in _signal_datasets(tests, name)))
    return head


def _check_numbers(numbers: int) -> None:
    if numbers > MAX_NUMBERS:
        raise SessionFormatError(f"the tests hold {numbers} numbers; at most {MAX_NUMBERS} are read")


def _tests(file: h5py.File) -> h5py.Group:
    tests = _group(file, "tests")
    if len(tests) > MAX_TESTS:
        raise SessionFormatError(f"{len(tests)} tests; at most {MAX_TESTS} are read")
    return tests


def _read_head(file: h5py.File) -> Session:
    if _text(file.attrs, "format", "") != FORMAT:
        raise SessionFormatError("not a TissueID session (no format attribute)")
    version = _text(file.attrs, "format_version", "")
    if version.split(".")[0] != FORMAT_VERSION.split(".")[0]:
        raise SessionFormatError(f"format version {version or 'missing'}; this software reads {FORMAT_VERSION}")
    return Session(
        instrument=_read_instrument(_group(file, "instrument")),
        subject=_read_subject(file),
        session_id=_text(file.attrs, "session_id", ""),
        created=_text(file.attrs, "created", ""),
        software=_text(file.attrs, "software", ""),
        audit_head=_text(file.attrs, "audit_head", ""),
    )


def _read_instrument(group: h5py.Group) -> DeviceDescription:
    values: dict[str, Any] = {}
    for field in fields(DeviceDescription):
        if field.name == "calibration":
            values["calibration"] = _json_object(_text(group.attrs, "calibration", "{}"), "calibration")
        elif field.name in group.attrs:
            read = _text if field.type == "str" else _number
            values[field.name] = read(group.attrs, field.name)
    return DeviceDescription(**values)


def _read_subject(file: h5py.File) -> Subject:
    if "subject" not in file:
        return Subject()
    attributes = _group(file, "subject").attrs
    others = {name: _plain(attributes[name]) for name in attributes if name != "pseudonym"}
    return Subject(_text(attributes, "pseudonym", "anonymous"), others)


def _outline(name: str, group: h5py.Group) -> TestOutline:
    sizes = {signal: dataset.size for signal, dataset in _datasets(_group(group, "signals"))}
    if len(set(sizes.values())) != 1:
        raise SessionFormatError(f"tests/{name}: its signals are not of one length")
    return TestOutline(_read_test(name, group, signals=False), next(iter(sizes.values())), tuple(sizes))


def _read_test(name: str, group: h5py.Group, *, signals: bool = True) -> Test:
    if not (name.isascii() and name.isdigit()):
        raise SessionFormatError(f"tests/{name}: tests are numbered")
    attributes = group.attrs
    try:
        for required in _REQUIRED_TEST:
            if required not in attributes:
                raise SessionFormatError(f"the attribute {required} is missing")
        rate = _number(attributes, "sample_rate_hz")
        if not rate > 0:
            raise SessionFormatError(f"a sample rate of {rate} Hz")
        repeat = _text(attributes, "repeat_of", "")
        status = _text(attributes, "status", "completed")
        known = {"kind", "configuration", "site", "sample_rate_hz", "preload_s", "surface_position_m"}
        known |= {"stimulus", "seed", "repeat_of", "status"}
        return Test(
            number=int(name),
            kind=_text(attributes, "kind"),
            signals=_read_signals(_group(group, "signals")) if signals else {},
            sample_rate_hz=rate,
            configuration=_text(attributes, "configuration", "indentation"),
            site=_text(attributes, "site", ""),
            preload_s=max(0.0, _number(attributes, "preload_s", 0.0)),
            surface_position_m=_number(attributes, "surface_position_m", math.nan),
            stimulus=_json_object(_text(attributes, "stimulus", "{}"), "stimulus"),
            seed=int(_number(attributes, "seed", 0)),
            repeat_of=int(repeat) if repeat else None,
            status=status if status in STATUSES else "completed",
            notes={key: _plain(attributes[key]) for key in attributes if key not in known},
            units=_read_units(_group(group, "signals")) if signals else {},
        )
    except SessionFormatError as error:
        raise SessionFormatError(f"tests/{name}: {error}") from error


def _read_signals(group: h5py.Group) -> dict[str, np.ndarray]:
    signals: dict[str, np.ndarray] = {}
    length: int | None = None
    for name, dataset in _datasets(group):
        if dataset.ndim != 1 or dataset.dtype.kind not in "fiu":
            raise SessionFormatError(f"signals/{name} is not a row of numbers")
        if not 0 < dataset.size <= MAX_SAMPLES:
            raise SessionFormatError(f"signals/{name} has {dataset.size} samples")
        if length is not None and dataset.size != length:
            raise SessionFormatError(f"signals/{name} has {dataset.size} samples where others have {length}")
        length = dataset.size
        signals[name] = dataset[:].astype(np.float64)
    if len(set(signals) - {"time"}) < 2:
        raise SessionFormatError("a test needs at least one input and one output")
    return signals


def _read_units(group: h5py.Group) -> dict[str, str]:
    """Units of the signals that are none of the format's own; those of the format are SI, and need no reading."""
    units = {
        name: str(_plain(dataset.attrs["units"]))
        for name, dataset in _datasets(group)
        if name not in SIGNAL_UNITS and "units" in dataset.attrs
    }
    return {name: unit for name, unit in units.items() if unit not in ("", "1")}


def _signal_datasets(tests: h5py.Group, name: str) -> Iterator[tuple[str, h5py.Dataset]]:
    group = _group(tests, name)
    return _datasets(_group(group, "signals")) if "signals" in group else iter(())


def _datasets(group: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    for name in group:
        item = _own(group, name)
        if not isinstance(item, h5py.Dataset):
            continue  # the format may grow; a reader passes over what it does not know
        if item.external is not None or item.is_virtual:
            raise SessionFormatError(f"{name} points outside the file")
        yield name, item


def _group(parent: h5py.Group, name: str) -> h5py.Group:
    if name not in parent:
        raise SessionFormatError(f"the group {name} is missing")
    item = _own(parent, name)
    if not isinstance(item, h5py.Group):
        raise SessionFormatError(f"{name} is not a group")
    return item


def _own(parent: h5py.Group, name: str) -> Any:
    """A member of this very file: links that lead elsewhere are not followed."""
    if not isinstance(parent.get(name, getlink=True), h5py.HardLink):
        raise SessionFormatError(f"{name} is a link")
    return parent[name]


def _plain(value: Any) -> str | float:
    """An attribute as text or number; what is neither becomes its text."""
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return value[:MAX_TEXT]
    array = np.asarray(value)
    return float(array) if array.size == 1 and array.dtype.kind in "fiub" else str(array.tolist())[:MAX_TEXT]


def _text(attributes: h5py.AttributeManager, name: str, default: str | None = None) -> str:
    if name not in attributes and default is not None:
        return default
    value = _plain(attributes[name])
    if not isinstance(value, str):
        raise SessionFormatError(f"the attribute {name} is not text")
    return value


def _number(attributes: h5py.AttributeManager, name: str, default: float | None = None) -> float:
    if name not in attributes and default is not None:
        return default
    value = _plain(attributes[name])
    if isinstance(value, str):
        raise SessionFormatError(f"the attribute {name} is not a number")
    return value


def _json_object(raw: str, name: str) -> dict[str, Any]:
    """JSON that describes something; what is not an object is kept as text under ``type``."""
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError):
        return {"type": raw}
    return value if isinstance(value, dict) else {"type": raw, "of": name}
