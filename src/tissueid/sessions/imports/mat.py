"""MAT files of MATLAB: versions 4 to 7.2, and 7.3, which is HDF5. Only numbers are read, never objects."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions.hdf5_mat import Place, holds_vectors, vector_parts
from tissueid.sessions.imports.imported_table import Column, ImportedTable, RowRange
from tissueid.sessions.reader_process import read_in_child
from tissueid.untrusted_input import MAX_COLUMNS, allowed_unpacked_bytes

LARGEST = 2_000_000_000
"""Largest size of all variables of a file together, uncompressed, bytes."""
_MOST_FIELDS = 10_000
_MOST_SIDES = 32
_DEEPEST = 3

_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Numeric data types of level 5."""
_STRUCT = 2
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800
_STORED_4 = ("f8", "f4", "i4", "i2", "u2", "u1")

Variable = tuple[str, "NDArray[np.generic]"]


class _DamagedError(UnusableInputError):
    def __init__(self) -> None:
        super().__init__(Message("import.mat_damaged", "is damaged, or not a MAT file"))


def variables(path: Path) -> Iterator[Variable]:
    """Yield names and values of all real, full variables of two dimensions; fields of structures as ``s.x``.

    Raises:
        UnusableInputError: the file is damaged, or its variables are too large.
    """
    if path.stat().st_size > LARGEST:
        raise UnusableInputError(
            "import.mat_size",
            "has more than {most} bytes; save only the needed variables, or save it as version 7.3",
            most=LARGEST,
        )
    data = memoryview(path.read_bytes())
    if len(data) < 20:
        raise _DamagedError
    if 0 in bytes(data[:4]):
        yield from _level_4(data)
        return
    mark = bytes(data[126:128])
    if mark not in (b"IM", b"MI"):
        raise _DamagedError
    reader = _Level5("<" if mark == b"IM" else ">", min(LARGEST, allowed_unpacked_bytes(len(data))))
    yield from reader.top(data[128:])


@dataclass
class _Level5:
    """Level 5: nested elements with a type, a length and data."""

    order: str
    budget: int

    def top(self, data: memoryview) -> Iterator[Variable]:
        at = 0
        while len(data) - at >= 8:
            kind, part, at = self._element(data, at, padded=False)
            if kind == _COMPRESSED:
                kind, part = self._inflated(part)
            if kind == _MATRIX:
                yield from self._matrix(part, "", 0)

    def _element(self, data: memoryview, at: int, *, padded: bool = True) -> tuple[int, memoryview, int]:
        """Return type and data of the element at an offset, and the offset after it."""
        if at + 8 > len(data):
            raise _DamagedError
        kind, size = struct.unpack_from(f"{self.order}II", data, at)
        if kind >> 16:  # a small element: type and length share four bytes, data are the other four
            size, kind = kind >> 16, kind & 0xFFFF
            if size > 4:
                raise _DamagedError
            return kind, data[at + 4 : at + 4 + size], at + 8
        first, end = at + 8, at + 8 + size
        if end > len(data):
            raise _DamagedError
        return kind, data[first:end], end + (-size % 8 if padded else 0)

    def _inflated(self, packed: memoryview) -> tuple[int, memoryview]:
        """Return type and data of a compressed element, limited to its stated size."""
        unpacker = zlib.decompressobj()
        try:
            tag = unpacker.decompress(packed, 8)
            if len(tag) < 8:
                raise _DamagedError
            kind, size = struct.unpack(f"{self.order}II", tag)
            self._spend(size)
            whole = unpacker.decompress(unpacker.unconsumed_tail, size) if size else b""
        except zlib.error as error:
            raise _DamagedError from error
        if len(whole) < size:
            raise _DamagedError
        return kind, memoryview(whole)

    def _spend(self, size: int) -> None:
        self.budget -= size
        if self.budget < 0:
            raise UnusableInputError(
                "import.mat_unpacked",
                "holds more than can be read from a file of its size; save fewer variables in MATLAB",
            )

    def _matrix(self, data: memoryview, before: str, depth: int) -> Iterator[Variable]:
        if not len(data):
            return
        _, flags, at = self._element(data, 0)
        if len(flags) < 8:
            raise _DamagedError
        word = struct.unpack_from(f"{self.order}I", flags)[0]
        kind = word & 0xFF
        if kind != _STRUCT and kind not in _NUMERIC:
            return
        stored, sides, at = self._element(data, at)
        shape = self._whole_numbers(stored, sides)
        _, name, at = self._element(data, at)
        path = before + bytes(name).split(b"\0")[0].decode("latin-1")
        if kind == _STRUCT:
            if math.prod(shape) == 1 and depth < _DEEPEST:
                yield from self._fields(data, at, path, depth)
        elif len(shape) == 2 and min(shape) > 0 and not word & _COMPLEX and path:
            stored, real, at = self._element(data, at)
            values = self._numbers(stored, real)
            if values.size != math.prod(shape):
                raise _DamagedError
            yield path, values.reshape(shape, order="F")

    def _fields(self, data: memoryview, at: int, path: str, depth: int) -> Iterator[Variable]:
        stored, length, at = self._element(data, at)
        lengths = self._whole_numbers(stored, length)
        _, names, at = self._element(data, at)
        if len(lengths) != 1 or not 0 < (each := lengths[0]) <= 1000 or len(names) > each * _MOST_FIELDS:
            raise _DamagedError
        for first in range(0, len(names) - each + 1, each):
            name = bytes(names[first : first + each]).split(b"\0")[0].decode("latin-1")
            kind, part, at = self._element(data, at)
            if kind == _MATRIX:
                yield from self._matrix(part, f"{path}.{name}", depth + 1)

    def _whole_numbers(self, stored: int, data: memoryview) -> list[int]:
        values = self._numbers(stored, data)
        if values.dtype.kind not in "iu":
            raise _DamagedError
        return [int(value) for value in values[:_MOST_SIDES]]

    def _numbers(self, stored: int, data: memoryview) -> NDArray[np.generic]:
        if stored not in _STORED:
            raise _DamagedError
        form = np.dtype(self.order + _STORED[stored])
        if len(data) % form.itemsize:
            raise _DamagedError
        return np.frombuffer(data, form)


def _level_4(data: memoryview) -> Iterator[Variable]:
    """Yield the variables of level 4: for each a header of five numbers, a name, and the values."""
    order = "<" if struct.unpack_from("<I", data)[0] < 5000 else ">"
    at = 0
    while at < len(data):
        if at + 20 > len(data):
            raise _DamagedError
        form, rows, columns, imaginary, length = struct.unpack_from(f"{order}5I", data, at)
        at += 20
        machine, zero, stored, kind = form // 1000, form // 100 % 10, form // 10 % 10, form % 10
        if machine not in (0, 1) or zero or stored >= len(_STORED_4) or kind > 2 or imaginary > 1:
            raise _DamagedError
        dtype = np.dtype(order + _STORED_4[stored])
        end = at + length + dtype.itemsize * rows * columns * (1 + imaginary)
        if end > len(data):
            raise _DamagedError
        name = bytes(data[at : at + length]).split(b"\0")[0].decode("latin-1")
        if kind == 0 and not imaginary and name and rows and columns:
            values = np.frombuffer(data[at + length : end], dtype)
            yield name, values.reshape((rows, columns), order="F")
        at = end


HDF5_MARK = b"\x89HDF\r\n\x1a\n"
MARK = b"MATLAB "
_NOTHING = Message(
    "import.mat_nothing", "holds no vectors of real numbers: cells, objects, texts and tables cannot be read"
)

_WITHOUT_PATH = {
    "session.slow": Message("import.slow", "is damaged: it takes too long to be read"),
    "session.crashed": Message("import.crashed", "is damaged: it ends the reading process"),
    "session.memory": Message("import.too_much_memory", "is damaged: it would take too much memory"),
}
"""Errors of the reading process without the path, which the import adds."""


def open_mat(path: Path) -> ImportedTable:
    """Open a MAT file. Every vector is a column, the columns of a matrix are ``name(:,k)``, fields are ``s.x``.

    Raises:
        UnusableInputError: it is damaged, or holds no numbers.
    """
    with path.open("rb") as file:
        head = file.read(520)
    if head.startswith(HDF5_MARK) or head[512:].startswith(HDF5_MARK):
        return _open_hdf5(path)
    return _open_classic(path)


# -- up to version 7.2 ----------------------------------------------------------------------------------------


def _open_classic(path: Path) -> ImportedTable:
    vectors: dict[str, NDArray[np.generic]] = {}
    for name, values in variables(path):
        if len(vectors) > MAX_COLUMNS:
            raise UnusableInputError("import.mat_vectors", "holds more than {most} vectors", most=MAX_COLUMNS)
        if holds_vectors(values.shape):
            for column, part in vector_parts(name, values.shape):
                vectors[column] = values[part]
    if not vectors:
        raise UnusableInputError(_NOTHING)
    return _file({name: values.size for name, values in vectors.items()}, lambda name, rows: vectors[name][rows])


# -- version 7.3 ----------------------------------------------------------------------------------------------


def _open_hdf5(path: Path) -> ImportedTable:
    vectors: dict[str, Place] = {}
    for item in _in_child("MAT vectors", path):
        vectors |= item
    if not vectors:
        raise UnusableInputError(_NOTHING)

    def read(name: str, rows: slice) -> NDArray[np.generic]:
        where, _, part = vectors[name]
        # HDF5 stores the dimensions of MATLAB in reverse order
        index = tuple(reversed([rows if isinstance(side, slice) else side for side in part]))
        values: NDArray[np.generic] = _in_child("MAT values", path, where, index)[0]
        return values

    return _file({name: max(shape) for name, (_, shape, _) in vectors.items()}, read)


def _in_child(task: str, path: Path, *arguments: Any) -> list[Any]:
    try:
        return read_in_child(task, path, *arguments)
    except UnusableInputError as error:
        raise UnusableInputError(_WITHOUT_PATH.get(error.code, error.message)) from error


# -- both -----------------------------------------------------------------------------------------------------


def _file(lengths: dict[str, int], read: Callable[[str, slice], NDArray[np.generic]]) -> ImportedTable:
    names = list(lengths)

    def load(places: Sequence[int], rows: RowRange) -> tuple[list[NDArray[np.float64]], range]:
        chosen = [names[index] for index in places]
        if len({lengths[name] for name in chosen}) > 1:
            sizes = ", ".join(f"{name} {lengths[name]}" for name in chosen)
            raise UnusableInputError(
                "import.lengths", "its variables have different lengths: {variables}", variables=sizes
            )
        taken = rows.within(lengths[chosen[0]])
        part = slice(taken.start, taken.stop)
        with np.errstate(invalid="ignore"):  # damaged files can contain any float, also signalling NaN
            return [np.ascontiguousarray(read(name, part), dtype=np.float64) for name in chosen], taken

    return ImportedTable("mat", tuple(Column.headed(name) for name in names), load)
