"""The sampled curves of all tests of a study as a table, one row per curve, and its file."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from scipy import stats

from tissueid.analysis.curves.plot import Array
from tissueid.analysis.curves.samples import DAMPING, GRIDS, KERNEL1, KERNEL2, MASS, PARTITIONS, STIFFNESS, SampledCurve
from tissueid.atomic_write import atomic_file
from tissueid.stored_values import finite
from tissueid.studies.repeatability import CONFIDENCE
from tissueid.studies.study_table import MATERIAL, NO_CONDITION
from tissueid.test_settings import COMPARED_CIRCUMSTANCES, setting_of

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
    rows = [(session, test, curve.name, curve.direction, curve.first, curve.values) for session, test, curve in curves]
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


By = Literal["site", "condition", "material", "change"]
ALL_SITES = ""
"""Group of the curves of all subjects at all sites, next to those of the materials."""
_LEAST_SHARE, _LEAST_SHARE_BY_DEPTH = 0.9, 0.5
"""Share of the subjects, or of the tests of a material, that must have a value at a point of the grid: of curves, which
have a step where the subjects change, and of kernels by depth."""
_ROUNDING = 1e-9
_LEAST_OF_INTERVAL = 3
"""Least number of subjects, or of tests of a material, of an interval: that of two is meaninglessly wide."""
MOST_MEMBERS = 30
"""Largest number of subjects, or of tests of a material, whose own curves are kept."""
_OF_DEPTH = (MASS, DAMPING, STIFFNESS)
_SURFACES = (KERNEL1, KERNEL2, PARTITIONS)


@dataclass(frozen=True, eq=False)
class GroupCurve:
    """Mean curve of a group on the grid of ``curve``, (n,), with its 95 % interval; NaN where too few have a value.

    ``by`` says what the groups are; those of "change" are changes in percent of the reference, paired by subject.
    ``count`` is the number of subjects, or of tests of a material. ``vaf_percent`` is the mean VAF of their tests:
    of the run that is scheduled by the measured depth for kernels by depth.
    ``members`` (m, n) are the curves of the first ``MOST_MEMBERS`` of them, for curves over depth: their depths differ.
    """

    by: By
    group: str
    curve: str
    direction: int
    mean: Array
    low: Array
    high: Array
    count: int
    vaf_percent: float = float("nan")
    members: Array | None = None

    @property
    def has_values(self) -> bool:
        """Whether a mean or a member has a value."""
        return bool(np.isfinite(self.mean).any() or (self.members is not None and np.isfinite(self.members).any()))

    def as_answer(self) -> dict[str, Any]:
        """Return the known points for JSON; the abscissas are named with their units."""
        finite_points = np.isfinite(self.mean)
        grid = GRIDS[self.curve]
        columns = {grid.x_name: grid.x} | ({} if grid.y is None else {grid.y_name: grid.y})
        columns |= {"mean": self.mean, "low": self.low, "high": self.high}
        return {
            "by": self.by,
            "group": self.group,
            "curve": self.curve,
            "direction": self.direction,
            "count": self.count,
            "vaf_percent": finite(self.vaf_percent),
        } | {name: finite(values[finite_points].tolist()) for name, values in columns.items()}


def group_labels(tests: pd.DataFrame, by: By) -> pd.Series:
    """Return the group of each test: site, condition at a site, or material, and circumstances where there are several.

    Args:
        tests: tests that count, with the columns of a study table.
        by: what the groups are.
    """
    labels = tests[MATERIAL if by == "material" else "site"].astype(str)
    if by == "condition":
        named = tests["condition"].astype(str).replace("", NO_CONDITION)
        labels = named if labels.nunique() == 1 else labels + "; " + named
    for name in COMPARED_CIRCUMSTANCES:
        if name in tests and tests[name].nunique() > 1:
            shown = f", {setting_of(name).shown or '{value}'}"
            labels = labels + [shown.format(value=value) if pd.notna(value) else "" for value in tests[name]]
    return labels


def group_curves(
    persons: pd.DataFrame, samples: pd.DataFrame, curves: pd.DataFrame, reference: str = ""
) -> tuple[GroupCurve, ...]:
    """Return the mean curves of all groups.

    Args:
        persons: tests of subjects that count.
        samples: tests of materials that count.
        curves: sampled curves (``sampled_curves.curves_table``); those of other tests do not count.
        reference: condition whose tests are compared by site; conditions are compared with it.
    """
    if curves.empty:
        return ()
    plain = persons[persons["condition"] == reference]
    several = persons.groupby("site")["condition"].transform("nunique") > 1 if len(persons) else pd.Series(dtype=bool)
    treated = persons[several.astype(bool)] if len(persons) else persons
    means: list[GroupCurve] = []
    for by, tests in (("site", plain), ("condition", treated), ("material", samples)):
        if len(tests):
            means += _means(by, _with_curves(tests, by, curves))  # type: ignore[arg-type]
    if len(samples) and len(plain):
        whole = _with_curves(plain, "site", curves).assign(group=ALL_SITES)
        means += _means("material", whole[~whole["curve"].isin(_SURFACES)], person=True)
    if len(treated):
        means += _changes(treated, curves, reference)
    return tuple(means)


def mean_and_interval(rows: Array, share: float = _LEAST_SHARE) -> tuple[Array, Array, Array]:
    """Return mean and 95 % interval of the mean over rows (k, n) at each point, each (n,).

    A mean is NaN where fewer than the ``share`` of the rows have a value, an interval also where fewer than three have.
    """
    count = np.isfinite(rows).sum(axis=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns without a value
        mean = np.nanmean(rows, axis=0)
        mean[count < max(1.0, share * len(rows) - _ROUNDING)] = np.nan
        error = np.nanstd(rows, axis=0, ddof=1) / np.sqrt(count)
        half = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, np.maximum(count - 1, 1)) * error
    half = np.where(count >= _LEAST_OF_INTERVAL, half, np.nan)
    return mean, mean - half, mean + half


def _with_curves(tests: pd.DataFrame, by: By, curves: pd.DataFrame) -> pd.DataFrame:
    columns = ["session", "test", "subject", "site", "condition", "vaf_percent", "vaf_scheduled_percent"]
    keys = tests[[name for name in columns if name in tests]].assign(group=group_labels(tests, by))
    return keys.merge(curves, on=["session", "test"])


def _means(by: By, rows: pd.DataFrame, *, person: bool = False) -> Iterator[GroupCurve]:
    # A material is averaged over its tests, subjects over their means.
    units = ["session", "test"] if by == "material" and not person else ["subject"]
    for (name, direction), own in rows.groupby(["curve", "direction"], sort=False):
        for group, tests in own.groupby("group", sort=True):
            values = np.stack([_mean_of(part) for _unit, part in tests.groupby(units, sort=True)])
            score = "vaf_scheduled_percent" if name == PARTITIONS else "vaf_percent"
            vaf = float(tests[score].mean()) if score in tests else float("nan")
            members = values[:MOST_MEMBERS] if name in _OF_DEPTH else None
            share = _LEAST_SHARE_BY_DEPTH if name == PARTITIONS else _LEAST_SHARE
            limits = mean_and_interval(values, share)
            yield GroupCurve(by, str(group), str(name), int(direction), *limits, len(values), vaf, members)


def _changes(treated: pd.DataFrame, curves: pd.DataFrame, reference: str) -> Iterator[GroupCurve]:
    """Yield the relative change of each parameter against depth under each condition, paired by subject (Fig. 7.21)."""
    rows = _with_curves(treated, "condition", curves[curves["curve"].isin(_OF_DEPTH)])
    if rows.empty:
        return
    names = rows.groupby(["site", "condition"], sort=True)["group"].first()
    for (name, direction), own in rows.groupby(["curve", "direction"], sort=False):
        means = {key: _mean_of(part) for key, part in own.groupby(["site", "condition", "subject"], sort=True)}
        for (site, condition), group in names.items():
            if condition == reference:
                continue
            pairs = [
                100.0 * (values / means[site, reference, subject] - 1.0)
                for (where, what, subject), values in means.items()
                if (where, what) == (site, condition) and (site, reference, subject) in means
            ]
            if pairs:
                own_changes = np.stack(pairs)
                limits = mean_and_interval(own_changes)
                yield GroupCurve(
                    "change",
                    str(group),
                    str(name),
                    int(direction),
                    *limits,
                    len(pairs),
                    members=own_changes[:MOST_MEMBERS],
                )


def _mean_of(rows: pd.DataFrame) -> Array:
    """Return the mean of curves of the same name at each point of the grid where one has a value, (n,)."""
    total = np.zeros(GRIDS[str(rows["curve"].iloc[0])].x.size)
    count = np.zeros(total.size)
    for curve in curves_of(rows):
        values = curve.on_grid
        given = np.isfinite(values)
        total[given] += values[given]
        count += given
    mean: Array = np.divide(total, count, out=np.full(total.size, np.nan), where=count > 0)
    return mean


def chosen(curves: Iterable[GroupCurve], by: By, name: str) -> list[GroupCurve]:
    """Return the curves of a kind of groups and a name that have a value; all sites and no product come first."""
    matching = [curve for curve in curves if (curve.by, curve.curve) == (by, name) and curve.has_values]
    return sorted(matching, key=lambda curve: curve.group != ALL_SITES and not curve.group.endswith(NO_CONDITION))


def directions(curves: Sequence[GroupCurve]) -> list[int]:
    """Return the directions of curves as far as there are any: both, into the tissue, out of it."""
    return [way for way in (0, 1, -1) if any(curve.direction == way for curve in curves)]
