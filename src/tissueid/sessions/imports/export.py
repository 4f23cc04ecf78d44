"""Export a session to files for other programs: for each test a data file and a JSON file with its attributes."""

from __future__ import annotations

import csv
import importlib
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import scipy.io
from numpy.typing import NDArray

from tissueid.atomic_write import atomic_folder
from tissueid.errors import UnusableInputError
from tissueid.formatting import cell_text
from tissueid.sessions.imports.export_attributes import ColumnPart, attributes_text
from tissueid.sessions.model import Session, Test

_BLOCK = 65_536
_LONGEST_VARIABLE = 63
"""Longest name of a MATLAB variable, characters."""

_Columns = dict[str, NDArray[np.float64]]


def export_session(
    session: Session, folder: Path, kind: str, progress: Callable[[float], None] = lambda _: None
) -> list[str]:
    """Write every test of a session and its attributes into a new or empty folder; return the names of the files.

    ``kind`` is one of ``FORMATS``; ``progress`` is called with the completed share, 0 to 1. The folder is written
    completely or not at all.

    Raises:
        UnusableInputError: there is no such format, the folder exists and is not empty, or the session has no tests.
        OSError: the disk is full or not writable; no file remains.
    """
    if kind not in FORMATS:
        raise UnusableInputError(
            "export.format", "there is no format '{kind}'; there are {formats}", kind=kind, formats=", ".join(FORMATS)
        )
    if kind == "parquet":
        _pyarrow()
    if not session.tests:
        raise UnusableInputError("session.empty", "the session holds no tests")
    written = []
    with atomic_folder(_new_folder(folder)) as partial:
        for done, test in enumerate(session.tests):
            columns, parts = _columns(test, _variable if kind == "mat" else _header)
            name = f"test-{test.number:04d}"
            FORMATS[kind](partial / f"{name}.{kind}", columns)
            (partial / f"{name}.json").write_text(attributes_text(session, test, parts), encoding="utf-8")
            written += [f"{name}.{kind}", f"{name}.json"]
            progress((done + 1) / len(session.tests))
    return written


def _new_folder(folder: Path) -> Path:
    """Return the absolute path of a folder that does not exist or is empty.

    Raises:
        UnusableInputError: it holds files, or its parent is missing.
    """
    folder = Path(os.path.abspath(folder))  # noqa: PTH100 - resolve() would follow a link and replace its target
    if folder.is_symlink() or (folder.exists() and (not folder.is_dir() or any(folder.iterdir()))):
        raise UnusableInputError(
            "export.folder_exists",
            "{folder} exists already; exports go into a new or an empty folder",
            folder=str(folder),
        )
    if not folder.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(folder.parent))
    return folder


def _columns(test: Test, named: Callable[[str, str], str]) -> tuple[_Columns, dict[str, ColumnPart]]:
    """Return the columns by their names in the file, time first, and the column and unit of each signal."""
    columns: _Columns = {}
    parts = {}
    signals = {"time": np.arange(test.samples) / test.sample_rate_hz} | test.signals
    for signal, values in signals.items():
        unit = test.unit(signal) or "1"
        name = first = named(signal, unit)
        count = 1
        while name.casefold() in {other.casefold() for other in columns}:
            count += 1
            name = f"{first[: _LONGEST_VARIABLE - 4]}_{count}"
        columns[name] = values
        parts[signal] = ColumnPart(column=name, unit=unit)
    return columns, parts


def _header(signal: str, unit: str) -> str:
    """Return a header such as "force (N)"; an apostrophe prevents that a spreadsheet reads a formula."""
    plain = "".join(mark if mark.isprintable() else "_" for mark in signal).strip() or "_"
    plain = cell_text(plain)
    return plain if unit == "1" else f"{plain} ({unit})"


def _variable(signal: str, unit: str) -> str:
    """Return the name of a MATLAB variable such as "force_N"."""
    suffix = {"1": "", "m s-2": "_m_per_s2", "m/s": "_m_per_s"}.get(unit, "_" + re.sub(r"[^A-Za-z0-9]+", "_", unit))
    plain = re.sub(r"[^A-Za-z0-9]+", "_", signal).strip("_") or "signal"
    return ("" if plain[0].isalpha() else "x") + plain[: _LONGEST_VARIABLE - 1 - len(suffix)] + suffix


# -- formats --------------------------------------------------------------------------------------------------


def _write_csv(path: Path, columns: _Columns) -> None:
    """Write numbers with all their digits; missing samples are empty cells."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        rows = next(iter(columns.values())).size
        for first in range(0, rows, _BLOCK):
            block = [values[first : first + _BLOCK].tolist() for values in columns.values()]
            texts = [["" if value != value else repr(value) for value in values] for values in block]
            writer.writerows(zip(*texts, strict=True))


def _write_mat(path: Path, columns: _Columns) -> None:
    """Write MAT version 5, each signal as a column vector."""
    scipy.io.savemat(path, columns, oned_as="column", do_compression=True, long_field_names=True)


def _write_parquet(path: Path, columns: _Columns) -> None:
    """Write one table; missing samples are NaN."""
    _pyarrow()
    arrow = importlib.import_module("pyarrow")
    importlib.import_module("pyarrow.parquet").write_table(arrow.table(columns), path)


def _pyarrow() -> ModuleType:
    """Return the Parquet library, which an extra of this package installs.

    Raises:
        UnusableInputError: it is not installed.
    """
    try:
        return importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise UnusableInputError(
            "export.no_pyarrow",
            "Parquet needs pyarrow, which is not installed: {python} -m pip install 'tissueid[parquet]'",
            python=Path(sys.executable).name,
        ) from error


FORMATS: dict[str, Callable[[Path, _Columns], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}
