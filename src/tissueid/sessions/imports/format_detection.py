"""Detection of the format of a file by its content."""

from __future__ import annotations

from pathlib import Path

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.sessions.imports.csv import open_csv
from tissueid.sessions.imports.imported_table import ImportedTable, checked_size
from tissueid.sessions.imports.lvm import FIRST_LINE, open_lvm
from tissueid.sessions.imports.mat import HDF5_MARK, MARK, open_mat

_SESSIONS = (".h5", ".hdf5", ".hdf")


def is_record(path: Path) -> bool:
    """Return whether a file, by its name, must be imported instead of opened as a session."""
    return path.suffix.lower() not in (*_SESSIONS, "")


def open_foreign(path: Path) -> ImportedTable:
    """Open a file of another program: CSV, MAT or LVM.

    Raises:
        UnusableInputError: it is missing, or in none of these formats; the message does not name the file.
        OSError: the disk failed, or the file may not be read.
    """
    checked_size(path)
    with path.open("rb") as file:
        head = file.read(520)
    if path.suffix.lower() == ".mat" or head.startswith((MARK, HDF5_MARK)) or head[512:].startswith(HDF5_MARK):
        return open_mat(path)
    if path.suffix.lower() == ".lvm" or head.removeprefix(b"\xef\xbb\xbf").startswith(FIRST_LINE.encode()):
        return open_lvm(path)
    if path.suffix.lower() in (".pkl", ".pickle", ".npy", ".npz", ".joblib"):
        raise UnusableInputError(
            Message("import.program", "can contain programs, and is not read: save it as CSV or MAT")
        )
    return open_csv(path)
