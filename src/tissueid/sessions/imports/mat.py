"""MAT files of MATLAB: versions 4 to 7.2, and 7.3, which is HDF5. Numbers only, never objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.sessions.heap_check import check_heaps
from tissueid.sessions.imports.mat_classic import variables
from tissueid.sessions.imports.table import MAX_COLUMNS, MAX_ROWS, Column, ForeignFile, Rows
from tissueid.sessions.members import check_dataset
from tissueid.sessions.reader_process import read_in_child
from tissueid.untrusted import most_unpacked

HDF5_MARK = b"\x89HDF\r\n\x1a\n"
MARK = b"MATLAB "
_NUMERIC = frozenset(
    {"double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
)
_DEEPEST = 3
_NOTHING = "holds no vectors of real numbers: cells, objects, texts and tables cannot be read"


def open_mat(path: Path) -> ForeignFile:
    """Look into a MAT file. Every vector is a column, every column of a matrix is ``name(:,k)``, fields are ``s.x``.

    Raises:
        UnusableInputError: it is damaged, or holds no numbers.
    """
    with path.open("rb") as file:
        head = file.read(520)
    if head.startswith(HDF5_MARK) or head[512:].startswith(HDF5_MARK):
        return _open_hdf5(path)
    return _open_classic(path)


# -- to version 7.2 -------------------------------------------------------------------------------------------


def _open_classic(path: Path) -> ForeignFile:
    vectors: dict[str, NDArray[np.generic]] = {}
    for name, values in variables(path):
        if len(vectors) > MAX_COLUMNS:
            raise UnusableInputError(f"holds more than {MAX_COLUMNS} vectors")
        if _fits(values.shape):
            for column, part in _columns(name, values.shape):
                vectors[column] = values[part]
    if not vectors:
        raise UnusableInputError(_NOTHING)
    return _file({name: values.size for name, values in vectors.items()}, lambda name, rows: vectors[name][rows])


# -- version 7.3 ----------------------------------------------------------------------------------------------


def _open_hdf5(path: Path) -> ForeignFile:
    found: dict[str, _Place] = {}
    for item in _in_child("MAT vectors", path):
        found |= item
    if not found:
        raise UnusableInputError(_NOTHING)

    def read(name: str, rows: slice) -> NDArray[np.generic]:
        where, _, part = found[name]
        # HDF5 has the sides of MATLAB turned round
        index = tuple(reversed([rows if isinstance(side, slice) else side for side in part]))
        values: NDArray[np.generic] = _in_child("MAT values", path, where, index)[0]
        return values

    return _file({name: max(shape) for name, (_, shape, _) in found.items()}, read)


def _in_child(task: str, path: Path, *arguments: Any) -> list[Any]:
    try:
        return read_in_child(task, path, *arguments)
    except UnusableInputError as error:
        raise UnusableInputError(str(error).removeprefix(f"{path} ")) from error


def hdf5_vectors(path: Path) -> Iterator[dict[str, _Place]]:
    """Yield the vectors of a MAT 7.3 file, by the names that they are offered by; for the reading process.

    Raises:
        UnusableInputError: it is damaged, or a session.
    """
    with _opened(path) as file:
        if file.attrs.get("format") in ("tissueid-session", b"tissueid-session"):
            raise UnusableInputError("is a session already: nothing needs to be imported")
        most, items = most_unpacked(path.stat().st_size), iter(range(MAX_COLUMNS))
        yield {name: (where, shape, part) for name, where, shape, part in _hdf5_vectors(file, "", 0, items, most)}


def hdf5_values(path: Path, where: str, index: tuple[int | slice, ...]) -> Iterator[NDArray[np.generic]]:
    """Yield a part of one variable of a MAT 7.3 file; for the reading process.

    Raises:
        UnusableInputError: it is damaged.
    """
    with _opened(path) as file:
        yield file[where][index]


def _hdf5_vectors(
    group: h5py.Group, before: str, depth: int, items: Iterator[int], most: int
) -> Iterator[tuple[str, str, tuple[int, ...], _Part]]:
    """Name, place in the file, shape as MATLAB has it, and part, of every vector of real numbers.

    Everything looked at takes one of ``items``: groups may hold each other, and a walk through them would not end.
    """
    for name in group:
        if next(items, None) is None:
            return
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            if depth < _DEEPEST:
                yield from _hdf5_vectors(item, f"{before}{name}.", depth + 1, items, most)
        elif isinstance(item, h5py.Dataset) and _is_plain(item):
            if item.size * item.dtype.itemsize > most:
                raise UnusableInputError(f"{name} is larger than can be read from a file of its size")
            check_dataset(name, item)
            shape = tuple(reversed(item.shape))
            for column, part in _columns(f"{before}{name}", shape):
                yield column, item.name, shape, part


def _is_plain(dataset: h5py.Dataset) -> bool:
    kind = dataset.attrs.get("MATLAB_class", b"double")
    kind = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    own = dataset.external is None and not dataset.is_virtual
    empty = "MATLAB_empty" in dataset.attrs
    return own and not empty and kind in _NUMERIC and dataset.dtype.kind in "fiu" and _fits(dataset.shape)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file, open; whatever is wrong with it is one kind of error.

    Raises:
        UnusableInputError: it is damaged.
    """
    try:
        check_heaps(path)
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError) as error:
        raise UnusableInputError("is damaged, or not a MAT file") from error


# -- both -----------------------------------------------------------------------------------------------------


_Part = tuple[int | slice, ...]
"""An index into a variable that takes one vector out of it."""

_Place = tuple[str, tuple[int, ...], _Part]
"""Where a vector is: the variable's path in the file, its shape as MATLAB has it, and the part."""


def _fits(shape: Sequence[int]) -> bool:
    """Whether a variable is a vector, or a matrix of a few of them."""
    few = len(shape) == 1 or (len(shape) == 2 and 0 < min(shape) <= MAX_COLUMNS)
    return few and 1 <= max(shape) <= MAX_ROWS


def _columns(name: str, shape: Sequence[int]) -> Iterator[tuple[str, _Part]]:
    """The vectors of a variable, along its longer side: a row or column by its name, others as MATLAB indexes them."""
    every = slice(None)
    if len(shape) == 1:
        yield name, (every,)
        return
    tall = shape[0] >= shape[1]
    for k in range(min(shape)):
        index = f"(:,{k + 1})" if tall else f"({k + 1},:)"
        yield f"{name}{index if min(shape) > 1 else ''}", (every, k) if tall else (k, every)


def _file(lengths: dict[str, int], read: Callable[[str, slice], NDArray[np.generic]]) -> ForeignFile:
    names = list(lengths)

    def load(places: Sequence[int], rows: Rows) -> tuple[list[NDArray[np.float64]], range]:
        chosen = [names[place] for place in places]
        if len({lengths[name] for name in chosen}) > 1:
            told = ", ".join(f"{name} {lengths[name]}" for name in chosen)
            raise UnusableInputError(f"its variables are not of one length: {told}")
        taken = rows.within(lengths[chosen[0]])
        part = slice(taken.start, taken.stop)
        with np.errstate(invalid="ignore"):  # any bits are a number in a damaged file, or NaN
            return [np.ascontiguousarray(read(name, part), dtype=np.float64) for name in chosen], taken

    return ForeignFile("mat", tuple(Column.headed(name) for name in names), load)
