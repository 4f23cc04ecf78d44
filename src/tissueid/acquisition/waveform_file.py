"""Waveforms from files: CSV or text of one or two columns, and .npy, at the sample rate of the instrument."""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.atomic_write import open_regular
from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.stimuli.base import MAX_SAMPLES, Stimulus, Unit
from tissueid.stimuli.kinds.waveform import Waveform
from tissueid.test_settings import FILE_RATES_HZ

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".npy")
"""Suffixes of files that are read as waveforms; any other file is read as a saved stimulus."""
_MAX_BYTES = 128 * 1024 * 1024
_LARGEST = 1e9
"""Largest magnitude of a time or value; more is no waveform."""
_SAME_RATE = 1e-6
"""Relative difference of sample rates below which samples are taken as they are."""
_UNEVEN = 0.05
"""Largest deviation of a time from even spacing, as a share of the spacing."""
_MAX_DENOMINATOR = 1000
"""Largest term of the ratio of two sample rates."""
_NPY = b"\x93NUMPY"
_LONGEST_NPY_HEADER = 10_000
_HEADER = (
    re.compile(r"'descr': ?'([<>|=]?(?:[iu][1248]|f[248]))'"),
    re.compile(r"'fortran_order': ?(True|False)"),
    re.compile(r"'shape': ?\(([0-9]{1,12}(?:, ?[0-9]{1,12}){0,9},?)\)"),
)
"""Entries of the header of a .npy file. A pattern reads them without evaluating what a file contains."""
_LONGEST_SHOWN = 30
_UNITS: dict[str, Unit] = {"force_n": "N", "voltage_v": "V"}
"""Names of the column of values in a file of samples that ``tissueid stimulus --csv`` wrote."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Columns:
    """Values (n,) of a file, their times (n,), s, if it has any, and their unit."""

    values: Array
    times: Array | None = None
    unit: Unit = "N"


def is_waveform(path: Path) -> bool:
    """Return whether a file is read as a waveform, by its suffix."""
    return path.suffix.lower() in SUFFIXES


def load_waveform(
    path: Path, sample_rate_hz: float, *, file_rate_hz: float | None = None, scale: float = 1.0, offset: float = 0.0
) -> Stimulus:
    """Read a waveform: its samples at the rate of the instrument, times ``scale``, plus ``offset``; no preload.

    A file of another rate is resampled by a band-limited filter, whose ends continue the line from the first to the
    last sample.

    Args:
        path: the file; one column of values, or two of time, s, and value. Values are in N, or in V in a file of
            ``tissueid stimulus --csv`` that says so.
        sample_rate_hz: sample rate of the instrument, Hz.
        file_rate_hz: sample rate of a file without times, Hz; that of the instrument by default.
        scale: factor of all samples.
        offset: added to them after that, in their unit.

    Raises:
        UnusableInputError: no such file; it is too large, no waveform, or not finite; its times are not even; or a rate
            is given twice or is out of bounds.
    """
    too_large = Message("waveform.large", "{path} is larger than {most} MB", path=str(path), most=_MAX_BYTES >> 20)
    columns = _columns(path, read_at_most(path, _MAX_BYTES, too_large))
    rate = _rate(path, columns, file_rate_hz)
    if rate is None:
        rate = sample_rate_hz
    values = _resampled(path, columns.values, rate, sample_rate_hz)
    digest = hashlib.sha256(np.ascontiguousarray(values, dtype="<f8").tobytes()).hexdigest()
    specification = Waveform.from_options(
        {
            "file": path.name[-255:],
            "sha256": digest,
            "samples": int(values.size),
            "unit": columns.unit,
            "scale": scale,
            "offset": offset,
            "sample_rate": sample_rate_hz,
        }
    )
    return specification.from_samples(values)


def read_at_most(path: Path, most_bytes: int, too_large: Message) -> bytes:
    """Return the content of a file.

    Raises:
        UnusableInputError: there is no such file, it cannot be read, or it is larger than ``most_bytes``.
    """
    try:
        with open_regular(path) as file:
            data = file.read(most_bytes + 1)
    except FileNotFoundError as error:
        raise UnusableInputError("file.missing", "{path}: no such file", path=str(path)) from error
    except OSError as error:
        raise UnusableInputError(
            "file.not_readable", "cannot read {path}: {reason}", path=str(path), reason=str(error.strerror)
        ) from error
    if len(data) > most_bytes:
        raise UnusableInputError(too_large)
    return data


def _columns(path: Path, data: bytes) -> _Columns:
    columns = _of_npy(path, data) if data.startswith(_NPY) or path.suffix.lower() == ".npy" else _of_text(path, data)
    for values in (columns.values,) if columns.times is None else (columns.times, columns.values):
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise UnusableInputError(
                "waveform.not_finite", "{path}: sample {row} is not a finite number", path=str(path), row=row
            )
        if float(np.max(np.abs(values), initial=0.0)) > _LARGEST:
            raise UnusableInputError(
                "waveform.magnitude",
                "{path}: sample {row} exceeds {most:g}: check its unit",
                path=str(path),
                row=int(np.argmax(np.abs(values) > _LARGEST)) + 1,
                most=_LARGEST,
            )
    return columns


def _check_count(path: Path, count: int) -> None:
    if count > MAX_SAMPLES:
        raise UnusableInputError(
            "waveform.samples",
            "{path} has {samples:.3g} samples; the maximum is {limit:.3g}: shorten it or lower its sample rate",
            path=str(path),
            samples=count,
            limit=MAX_SAMPLES,
        )
    if count < 2:
        raise UnusableInputError("waveform.short", "{path} has fewer than two samples", path=str(path))


def _of_npy(path: Path, data: bytes) -> _Columns:
    """Return the columns of a .npy file. Its header is checked before its samples are touched; objects are refused."""
    damaged = UnusableInputError("waveform.npy", "{path} is damaged, or not a .npy file", path=str(path))
    start = {1: 10, 2: 12}.get(data[6] if len(data) > 6 else 0, 0)
    end = start + int.from_bytes(data[8:start], "little")
    if not data.startswith(_NPY) or not start or not start <= end <= min(len(data), _LONGEST_NPY_HEADER):
        raise damaged
    header = data[start:end].decode("latin-1")
    parts = [pattern.search(header) for pattern in _HEADER]
    described, ordered, shaped = (None if part is None else part.group(1) for part in parts)
    if ordered is None or shaped is None:
        raise damaged
    if described is None:
        raise UnusableInputError(
            "waveform.npy_type", "{path} holds values of another type: it must hold real numbers", path=str(path)
        )
    dtype = np.dtype(described)
    shape = tuple(int(size) for size in shaped.replace(",", " ").split())
    width = 1 if len(shape) == 1 else shape[1] if len(shape) == 2 else 0
    if width not in (1, 2):
        raise UnusableInputError(
            "waveform.npy_shape",
            "{path} holds an array of the shape ({shape}); it must be (samples,), or (samples, 2) with time and value",
            path=str(path),
            shape=Verbatim(shaped[:_LONGEST_SHOWN]),
        )
    _check_count(path, shape[0])
    if len(data) - end < shape[0] * width * dtype.itemsize:
        raise damaged
    flat = np.frombuffer(data, dtype, count=shape[0] * width, offset=end).astype(np.float64)
    table = flat.reshape((shape[0], width), order="F" if ordered == "True" else "C")
    return _Columns(np.ascontiguousarray(table[:, -1]), np.ascontiguousarray(table[:, 0]) if width == 2 else None)


def _of_text(path: Path, data: bytes) -> _Columns:
    """Return the columns of a text file: cells by semicolon, tab, comma or blanks; decimal comma unless by comma."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnusableInputError("waveform.not_text", "{path} is not text", path=str(path)) from error
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise UnusableInputError("waveform.short", "{path} has fewer than two samples", path=str(path))
    delimiter = next(
        (sign for sign in (";", "\t", ",") if sign in "".join(line for _number_of, line in lines[:2])), " "
    )
    unit: Unit = "N"
    most = 2
    head = _cells(lines[0][1], delimiter)
    if _number(head[0], delimiter) is None and head[0].strip().lower() not in {"", "nan", "na", "-"}:
        names = [cell.strip().lower() for cell in head]
        if len(names) == 3 and names[0] == "time_s" and names[1] in _UNITS:
            unit, most = _UNITS[names[1]], 3  # written by tissueid stimulus --csv; the third column is the command
        else:
            _check_units(path, head)
        lines = lines[1:]
    _check_count(path, len(lines))
    table = np.empty((len(lines), 2))
    width = len(_cells(lines[0][1], delimiter))
    for row, (number, line) in enumerate(lines):
        cells = _cells(line, delimiter)
        if len(cells) != width or not 1 <= width <= most:
            raise UnusableInputError(
                "waveform.columns",
                "{path}, line {line}: {found} columns; a waveform has one column of values, or two of time and value",
                path=str(path),
                line=number,
                found=len(cells),
            )
        for column, cell in enumerate(cells[:2]):
            value = _number(cell, delimiter)
            if value is None or not math.isfinite(value):
                raise UnusableInputError(
                    "waveform.cell",
                    "{path}, line {line}: {cell} is not a finite number",
                    path=str(path),
                    line=number,
                    cell=Verbatim(repr(cell.strip()[:_LONGEST_SHOWN])),
                )
            table[row, column] = value
    if width == 1:
        return _Columns(table[:, 0].copy(), None, unit)
    return _Columns(table[:, 1].copy(), table[:, 0].copy(), unit)


def _check_units(path: Path, head: list[str]) -> None:
    """Check that a header states no other units than s and N.

    Raises:
        UnusableInputError: it does; values in mN would be played in N.
    """
    from tissueid.sessions.imports.imported_table import Column  # takes long to import
    from tissueid.sessions.imports.stated_units import unit_of

    for index, cell in enumerate(head):
        is_time = index == 0 and len(head) > 1
        roles = (("time", "s"),) if is_time else (("force", "N"), ("voltage", "V"))
        stated = next((text for role in roles if (text := Column.headed(cell).unit_for(*role))), "")
        unit = unit_of(stated, roles[0][1])
        if stated and (unit is None or (unit.si, unit.scale) != (roles[0][1], 1.0)):
            raise UnusableInputError(
                "waveform.unit",
                "{path}: column '{column}' is in {unit}; times of a waveform are in s and values in N: convert them",
                path=str(path),
                column=Verbatim(cell.strip()[:_LONGEST_SHOWN]),
                unit=Verbatim(stated[:_LONGEST_SHOWN]),
            )


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.split(delimiter)


def _number(cell: str, delimiter: str) -> float | None:
    """Return a cell as a number; None if it is none."""
    text = cell.strip() if delimiter == "," else cell.strip().replace(",", ".")
    try:
        return None if "_" in text else float(text)  # Python accepts underscores between digits, data files do not
    except ValueError:
        return None


def _rate(path: Path, columns: _Columns, given_hz: float | None) -> float | None:
    """Return the sample rate of a file, Hz: by its times, or as given; None if neither is there.

    Raises:
        UnusableInputError: both are there, the times are not even, or the rate is out of bounds.
    """
    times = columns.times
    rate = given_hz
    if times is not None:
        if given_hz is not None:
            raise UnusableInputError(
                "waveform.two_rates", "{path} has times of its own: leave out --file-rate", path=str(path)
            )
        step = float(times[-1] - times[0]) / (times.size - 1)
        away = np.abs(times - times[0] - step * np.arange(times.size))
        if not step > 0.0 or float(away.max()) > _UNEVEN * step:
            raise UnusableInputError(
                "waveform.times",
                "{path}: the times do not rise evenly, first at sample {row}: resample it",
                path=str(path),
                row=int(np.argmax(away > _UNEVEN * max(step, 0.0))) + 1,
            )
        rate = 1.0 / step
    if rate is not None and not FILE_RATES_HZ[0] <= rate <= FILE_RATES_HZ[1]:
        raise UnusableInputError(
            "waveform.rate",
            "{path}: the sample rate must be {low:g} to {high:g} Hz, got {rate:g} Hz",
            path=str(path),
            low=FILE_RATES_HZ[0],
            high=FILE_RATES_HZ[1],
            rate=rate,
        )
    return rate


def _resampled(path: Path, values: Array, from_hz: float, to_hz: float) -> Array:
    """Return values (n,) at another sample rate, (n * to_hz / from_hz,).

    Raises:
        UnusableInputError: the result has too many samples or fewer than two.
    """
    if math.isclose(from_hz, to_hz, rel_tol=_SAME_RATE):
        return values
    _check_count(path, round(values.size * to_hz / from_hz))
    ratio = Fraction(to_hz / from_hz).limit_denominator(_MAX_DENOMINATOR)
    if ratio == 0:
        ratio = Fraction(to_hz / from_hz).limit_denominator(round(2 * from_hz / to_hz))
    return np.asarray(
        scipy.signal.resample_poly(values, ratio.numerator, ratio.denominator, padtype="line"), dtype=np.float64
    )
