"""A session as files for other programs: one a test, with its attributes in JSON beside it. Whole or not at all."""

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

from tissueid.errors import UnusableInputError
from tissueid.sessions.imports.attributes import ColumnPart, attributes_text
from tissueid.sessions.model import Session, Test
from tissueid.whole_file import whole_folder

_BLOCK = 65_536
_LONGEST_VARIABLE = 63
"""Characters that MATLAB allows in the name of a variable."""

_FORMULA = ("=", "+", "-", "@")
"""What formulas of spreadsheets begin with."""

_Columns = dict[str, NDArray[np.float64]]


def export_session(
    session: Session, folder: Path, kind: str, told: Callable[[float], None] = lambda _: None
) -> list[str]:
    """Write every test of a session into a new folder, and its attributes beside it; returns the names of the files.

    ``kind`` is one of ``FORMATS``; ``told`` hears how much is done, 0 to 1. The folder is there when all is written, or
    it is not there; an empty one may be there before.

    Raises:
        UnusableInputError: no such format, the folder is there and holds something, or there is nothing to export.
        OSError: the disk is full or not writable; nothing is left behind.
    """
    if kind not in FORMATS:
        raise UnusableInputError(f"there is no format {kind!r}; there are {', '.join(FORMATS)}")
    if kind == "parquet":
        _pyarrow()
    if not session.tests:
        raise UnusableInputError("the session holds no tests")
    written = []
    with whole_folder(_new_folder(folder)) as partial:
        for done, test in enumerate(session.tests):
            columns, parts = _columns(test, _variable if kind == "mat" else _header)
            name = f"test-{test.number:04d}"
            FORMATS[kind](partial / f"{name}.{kind}", columns)
            (partial / f"{name}.json").write_text(attributes_text(session, test, parts), encoding="utf-8")
            written += [f"{name}.{kind}", f"{name}.json"]
            told((done + 1) / len(session.tests))
    return written


def _new_folder(folder: Path) -> Path:
    """The folder by its whole name, once it is known that there is nothing in it.

    Raises:
        UnusableInputError: there is, or its own folder is missing.
    """
    folder = Path(os.path.abspath(folder))  # noqa: PTH100 - resolve() would follow a link, and replace what it leads to
    if folder.is_symlink() or (folder.exists() and (not folder.is_dir() or any(folder.iterdir()))):
        raise UnusableInputError(f"{folder} is there already; exports go into a new folder, or an empty one")
    if not folder.parent.is_dir():
        raise UnusableInputError(f"there is no folder {folder.parent}")
    return folder


def _columns(test: Test, named: Callable[[str, str], str]) -> tuple[_Columns, dict[str, ColumnPart]]:
    """Columns by their names in the file, time first, and what each is."""
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
    """A column's header: "force (N)". An apostrophe before it keeps a spreadsheet from taking it for a formula."""
    plain = "".join(mark if mark.isprintable() else "_" for mark in signal).strip() or "_"
    plain = f"'{plain}" if plain.startswith(_FORMULA) else plain
    return plain if unit == "1" else f"{plain} ({unit})"


def _variable(signal: str, unit: str) -> str:
    """A column's name as a variable of MATLAB: "force_N"."""
    suffix = {"1": "", "m s-2": "_m_per_s2", "m/s": "_m_per_s"}.get(unit, "_" + re.sub(r"[^A-Za-z0-9]+", "_", unit))
    plain = re.sub(r"[^A-Za-z0-9]+", "_", signal).strip("_") or "signal"
    return ("" if plain[0].isalpha() else "x") + plain[: _LONGEST_VARIABLE - 1 - len(suffix)] + suffix


# -- formats --------------------------------------------------------------------------------------------------


def _write_csv(path: Path, columns: _Columns) -> None:
    """Numbers with as many digits as give every one back exactly; an empty cell where a sample is missing."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        rows = next(iter(columns.values())).size
        for first in range(0, rows, _BLOCK):
            block = [values[first : first + _BLOCK].tolist() for values in columns.values()]
            texts = [["" if value != value else repr(value) for value in values] for values in block]
            writer.writerows(zip(*texts, strict=True))


def _write_mat(path: Path, columns: _Columns) -> None:
    """Version 5, every signal a column vector."""
    scipy.io.savemat(path, columns, oned_as="column", do_compression=True, long_field_names=True)


def _write_parquet(path: Path, columns: _Columns) -> None:
    """One table; NaN where a sample is missing."""
    _pyarrow()
    arrow = importlib.import_module("pyarrow")
    importlib.import_module("pyarrow.parquet").write_table(arrow.table(columns), path)


def _pyarrow() -> ModuleType:
    """The library behind Parquet, which comes with an extra of this program.

    Raises:
        UnusableInputError: it is not installed; says how to get it.
    """
    try:
        return importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise UnusableInputError(
            f"Parquet needs pyarrow, which is not installed: "
            f"{Path(sys.executable).name} -m pip install 'tissueid[parquet]'"
        ) from error


FORMATS: dict[str, Callable[[Path, _Columns], None]] = {
    "csv": _write_csv,
    "mat": _write_mat,
    "parquet": _write_parquet,
}
