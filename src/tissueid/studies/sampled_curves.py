"""The sampled curves of all tests of a study as a table, one row per curve, and its file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from tissueid.analysis.curves.samples import GRIDS, SampledCurve
from tissueid.atomic_write import atomic_file

COLUMNS = ("session", "test", "curve", "direction", "first", "value")
"""Columns of the table: ``curve`` is the name, ``first`` the first point on the grid, ``value`` an array (k,)."""
_ROWS_AT_ONCE = 5000
"""Number of curves that are written in one group of rows, so that their abscissas need little memory."""
_SCHEMA = pa.schema(
    [
        ("session", pa.string()),
        ("test", pa.int64()),
        ("curve", pa.string()),
        ("direction", pa.int64()),
        ("first", pa.int64()),
        ("x", pa.list_(pa.float32())),
        ("y", pa.list_(pa.float32())),
        ("value", pa.list_(pa.float32())),
    ]
)


def curves_table(curves: Iterable[tuple[str, int, SampledCurve]]) -> pd.DataFrame:
    """Return the table of curves from session, number of the test and curve."""
    rows = [(session, test, one.name, one.direction, one.first, one.values) for session, test, one in curves]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def curves_of(table: pd.DataFrame) -> list[SampledCurve]:
    """Return the curves of the rows of a table."""
    return [
        SampledCurve(str(name), int(first), np.asarray(values), int(direction))
        for name, direction, first, values in zip(
            table["curve"], table["direction"], table["first"], table["value"], strict=True
        )
    ]


def write_curves(table: pd.DataFrame, path: Path) -> None:
    """Write the table as Parquet, with the abscissas ``x`` and ``y`` of the values as lists, atomically.

    Raises:
        OSError: it cannot be written.
    """
    with atomic_file(path) as partial, pq.ParquetWriter(partial, _SCHEMA) as writer:
        for begin in range(0, len(table), _ROWS_AT_ONCE):
            rows = table.iloc[begin : begin + _ROWS_AT_ONCE]
            columns: dict[str, list[object]] = {name: rows[name].tolist() for name in COLUMNS}
            ends = list(zip(rows["curve"], rows["first"], rows["value"].map(len), strict=True))
            columns["x"] = [GRIDS[name].x[first : first + size] for name, first, size in ends]
            ordinates = [(GRIDS[name].y, first, size) for name, first, size in ends]
            columns["y"] = [None if y is None else y[first : first + size] for y, first, size in ordinates]
            writer.write_table(pa.table({name: columns[name] for name in _SCHEMA.names}, _SCHEMA))


def read_curves(path: Path) -> pd.DataFrame:
    """Return the table of a file that ``write_curves`` wrote; an empty one if there is none or it cannot be used."""
    try:
        table = pd.read_parquet(path, columns=list(COLUMNS))
    except (OSError, ValueError):
        return curves_table(())
    return table[table["curve"].isin(list(GRIDS))].reset_index(drop=True)
