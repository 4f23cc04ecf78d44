"""Read vectors of a MAT file of version 7.3, which is an HDF5 file; runs in the reading process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.sessions.hdf5_members import HDF5_ERRORS, check_dataset, check_heaps, open_hdf5, unavailable
from tissueid.untrusted_input import MAX_COLUMNS, MAX_SAMPLES, allowed_unpacked_bytes

_NUMERIC = frozenset(
    {"double", "single", "logical", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}
)
_DEEPEST = 3
"""Largest nesting depth of structures."""

Part = tuple[int | slice, ...]
"""An index into a variable that selects one vector."""

Place = tuple[str, tuple[int, ...], Part]
"""Location of a vector: path of the variable in the file, its shape in MATLAB, and the part."""


def holds_vectors(shape: Sequence[int]) -> bool:
    """Return whether a variable is a vector, or a matrix of a few of them."""
    few = len(shape) == 1 or (len(shape) == 2 and 0 < min(shape) <= MAX_COLUMNS)
    return few and 1 <= max(shape) <= MAX_SAMPLES


def vector_parts(name: str, shape: Sequence[int]) -> Iterator[tuple[str, Part]]:
    """Yield the vectors of a variable, along its longer side.

    A row or column has the name of the variable, others are named as MATLAB indexes them.
    """
    every = slice(None)
    if len(shape) == 1:
        yield name, (every,)
        return
    tall = shape[0] >= shape[1]
    for k in range(min(shape)):
        index = f"(:,{k + 1})" if tall else f"({k + 1},:)"
        yield f"{name}{index if min(shape) > 1 else ''}", (every, k) if tall else (k, every)


def hdf5_vectors(path: Path) -> Iterator[dict[str, Place]]:
    """Yield the vectors of a MAT 7.3 file by their displayed names.

    Raises:
        UnusableInputError: it is damaged, or a session.
    """
    with _opened(path) as file:
        if file.attrs.get("format") in ("tissueid-session", b"tissueid-session"):
            raise UnusableInputError("import.is_session", "is a session already: it needs no import")
        most, items = allowed_unpacked_bytes(path.stat().st_size), iter(range(MAX_COLUMNS))
        yield {name: (where, shape, part) for name, where, shape, part in _vectors(file, "", 0, items, most)}


def hdf5_values(path: Path, where: str, index: tuple[int | slice, ...]) -> Iterator[NDArray[np.generic]]:
    """Yield a part of one variable of a MAT 7.3 file.

    Raises:
        UnusableInputError: it is damaged.
    """
    with _opened(path) as file:
        yield file[where][index]


def _vectors(
    group: h5py.Group, before: str, depth: int, items: Iterator[int], most: int
) -> Iterator[tuple[str, str, tuple[int, ...], Part]]:
    """Yield name, path in the file, shape in MATLAB, and part, of every vector of real numbers.

    Every visited object takes one of ``items``, which limits the walk: groups may contain each other.
    """
    for name in group:
        if next(items, None) is None:
            return
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        item = group[name]
        if isinstance(item, h5py.Group):
            if depth < _DEEPEST:
                yield from _vectors(item, f"{before}{name}.", depth + 1, items, most)
        elif isinstance(item, h5py.Dataset) and _is_plain(item):
            if item.size * item.dtype.itemsize > most:
                raise UnusableInputError(
                    "import.mat_variable",
                    "{name} is larger than can be read from a file of its size",
                    name=Verbatim(name),
                )
            check_dataset(name, item)
            shape = tuple(reversed(item.shape))
            for column, part in vector_parts(f"{before}{name}", shape):
                yield column, item.name, shape, part


def _is_plain(dataset: h5py.Dataset) -> bool:
    kind = dataset.attrs.get("MATLAB_class", b"double")
    kind = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    own = dataset.external is None and not dataset.is_virtual
    empty = "MATLAB_empty" in dataset.attrs
    return own and not empty and kind in _NUMERIC and dataset.dtype.kind in "fiu" and holds_vectors(dataset.shape)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file; raise any error of the file as one kind of error.

    Raises:
        UnusableInputError: it is damaged.
    """
    try:
        check_heaps(path)
        with open_hdf5(path) as file:
            yield file
    except HDF5_ERRORS as error:
        reason = unavailable(error) or Message("import.mat_damaged", "is damaged, or not a MAT file")
        raise UnusableInputError(reason) from error
