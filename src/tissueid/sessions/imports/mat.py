"""MAT files of MATLAB: versions 4 to 7.2, and 7.3, which is HDF5. Only numbers are read, never objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions.hdf5_mat import Place, holds_vectors, vector_parts
from tissueid.sessions.imports.imported_table import Column, ImportedTable, Rows
from tissueid.sessions.imports.mat_classic import variables
from tissueid.sessions.reader_process import read_in_child
from tissueid.untrusted_input import MAX_COLUMNS

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
            raise UnusableInputError(Message("import.mat_vectors", "holds more than {most} vectors", most=MAX_COLUMNS))
        if holds_vectors(values.shape):
            for column, part in vector_parts(name, values.shape):
                vectors[column] = values[part]
    if not vectors:
        raise UnusableInputError(_NOTHING)
    return _file({name: values.size for name, values in vectors.items()}, lambda name, rows: vectors[name][rows])


# -- version 7.3 ----------------------------------------------------------------------------------------------


def _open_hdf5(path: Path) -> ImportedTable:
    found: dict[str, Place] = {}
    for item in _in_child("MAT vectors", path):
        found |= item
    if not found:
        raise UnusableInputError(_NOTHING)

    def read(name: str, rows: slice) -> NDArray[np.generic]:
        where, _, part = found[name]
        # HDF5 stores the dimensions of MATLAB in reverse order
        index = tuple(reversed([rows if isinstance(side, slice) else side for side in part]))
        values: NDArray[np.generic] = _in_child("MAT values", path, where, index)[0]
        return values

    return _file({name: max(shape) for name, (_, shape, _) in found.items()}, read)


def _in_child(task: str, path: Path, *arguments: Any) -> list[Any]:
    try:
        return read_in_child(task, path, *arguments)
    except UnusableInputError as error:
        raise UnusableInputError(_WITHOUT_PATH.get(error.code, error.message)) from error


# -- both -----------------------------------------------------------------------------------------------------


def _file(lengths: dict[str, int], read: Callable[[str, slice], NDArray[np.generic]]) -> ImportedTable:
    names = list(lengths)

    def load(places: Sequence[int], rows: Rows) -> tuple[list[NDArray[np.float64]], range]:
        chosen = [names[place] for place in places]
        if len({lengths[name] for name in chosen}) > 1:
            sizes = ", ".join(f"{name} {lengths[name]}" for name in chosen)
            raise UnusableInputError(
                Message("import.lengths", "its variables have different lengths: {variables}", variables=sizes)
            )
        taken = rows.within(lengths[chosen[0]])
        part = slice(taken.start, taken.stop)
        with np.errstate(invalid="ignore"):  # damaged files can contain any float, also signalling NaN
            return [np.ascontiguousarray(read(name, part), dtype=np.float64) for name in chosen], taken

    return ImportedTable("mat", tuple(Column.headed(name) for name in names), load)
