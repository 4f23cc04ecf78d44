"""The table of a study: one row per test and engine, with subject, site, condition, repeat, parameters and quality."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.formatting import cell_text, clean, label_and_unit
from tissueid.language import marked
from tissueid.messages import Listing, Verbatim, joined
from tissueid.test_settings import COMPARED_CIRCUMSTANCES, NUMBERS, PROPERTIES, Circumstances

KEYS = (
    "session",
    "session_id",
    "created",
    "test",
    "subject",
    "site",
    "condition",
    *(name for name in Circumstances.model_fields if name not in COMPARED_CIRCUMSTANCES),
    "repeat",
)
DESCRIPTION = (
    "configuration",
    *(name for name in PROPERTIES if name not in KEYS),
    "simulated",
    "kind",
    "status",
    "quality",
    "findings",
    "engine",
    "model",
    "signals",
    "vaf_percent",
    "vaf_validation_percent",
    "vaf_scheduled_percent",
    "problem",
)
STD_SUFFIX = "_sd"
"""Suffix of the column with the standard deviation of a parameter, after its name."""
DEMOGRAPHICS = (
    "age_years",
    "weight_kg",
    "height_m",
    "bmi_kg_per_m2",
    "weight_per_height_kg_per_m",
    "age_group",
    "gender",
    "handedness",
    "ethnicity",
    "skin_conditions",
    "material",
)
SIMULATED = "simulated"
"""Column that says whether a simulation recorded the test."""
MATERIAL = "material"
"""Column of a sample's material; a row with one is of a sample, not of a person."""
NO_CONDITION = marked("without")
"""Name of the condition of tests without a product."""
AGE_LIMIT_YEARS = 25.0
"""Limit of the two groups of age in thesis 7.1.2."""
_NUMBERS = (*NUMBERS, *DEMOGRAPHICS[:5])
_TEXTS = (*(name for name in PROPERTIES if name not in NUMBERS), *DEMOGRAPHICS[5:])
"""Columns whose values a session or a file of subjects may give as text or as number, and which they are."""
_LARGEST = 1e60
"""Numbers from here on count as missing, so that their fourth powers are finite."""
_LARGEST_SUBJECTS = 10_000_000
_MOST_COLUMNS = 100
_SHOWN = 60
"""Characters of a condition, and number of values, that a message repeats."""


def study_table(rows: Iterable[Mapping[str, Any]], subjects: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the table of a study from rows of single tests.

    The tests of a subject at a site under a condition with an engine that count are numbered by their time (column
    ``repeat``; missing for the others).

    Args:
        rows: values by column; demographic values of the session are included.
        subjects: demographic values by subject, which replace those of the sessions.
    """
    table = pd.DataFrame(list(rows))
    if table.empty:
        return pd.DataFrame(columns=[*KEYS, *DESCRIPTION])
    table = _uniform(table)
    table = table.sort_values(["created", "session", "test"], kind="stable").reset_index(drop=True)
    same = ["subject", "site", "condition", "configuration", *COMPARED_CIRCUMSTANCES, "engine"]
    order = table[counting(table)].groupby([name for name in same if name in table], dropna=False).cumcount() + 1
    table["repeat"] = order.reindex(table.index).astype("Int64")
    if subjects is not None:
        table = _with_subjects(table, subjects)
    if {"weight_kg", "height_m"} <= set(table.columns):
        weight, height = (pd.to_numeric(table[name], errors="coerce") for name in ("weight_kg", "height_m"))
        height = height.where(height > 0.0)
        table["bmi_kg_per_m2"] = weight / height**2
        table["weight_per_height_kg_per_m"] = weight / height
    if "age_years" in table:
        age = pd.to_numeric(table["age_years"], errors="coerce")
        groups = pd.Series(f"< {AGE_LIMIT_YEARS:g}", table.index).where(age < AGE_LIMIT_YEARS, f"≥ {AGE_LIMIT_YEARS:g}")
        table["age_group"] = groups.where(age.notna())
    first = [*KEYS, *DESCRIPTION, *DEMOGRAPHICS]
    return table[[name for name in first if name in table] + [name for name in table if name not in first]]


def counting(table: pd.DataFrame) -> pd.Series:
    """Return whether each test counts: it was completed and analysed, and its quality is not "repeat"."""
    return (table["status"] == "completed") & (table["quality"] != "repeat")


def label_of(name: str) -> str:
    """Return the readable label of a column, in English, for messages."""
    return label_and_unit(name)[0]


def labels_of(names: Iterable[str]) -> Listing:
    """Return the readable labels of columns as a list in messages."""
    return Listing(tuple(map(label_of, names)))


def parameters_of(table: pd.DataFrame) -> list[str]:
    """Return the columns of the engine's parameters, in the order of the table."""
    described = {*KEYS, *DESCRIPTION, *DEMOGRAPHICS}
    return [
        str(name)
        for name in table
        if name not in described
        and not str(name).endswith(STD_SUFFIX)
        and f"{name}{STD_SUFFIX}" in table
        and table[name].notna().any()
    ]


def subject_columns(table: pd.DataFrame) -> list[str]:
    """Return the columns with values of subjects: known demographic values and other columns of their file."""
    others = {*KEYS, *DESCRIPTION, *parameters_of(table), MATERIAL}
    return [
        str(name)
        for name in table
        if name not in others and not str(name).endswith(STD_SUFFIX) and table[name].notna().any()
    ]


def subgroup(table: pd.DataFrame, conditions: Sequence[str]) -> pd.DataFrame:
    """Return the tests of the subjects, or at the sites, that meet all conditions; those of samples stay.

    Args:
        table: of the study.
        conditions: ``NAME=VALUE`` or, for numbers, ``NAME=LOW:HIGH`` with both ends included.

    Raises:
        UnusableInputError: a condition is malformed, names no column with values of subjects, or leaves no subject.
    """
    for condition in conditions:
        name, equals, value = condition.partition("=")
        columns = [*subject_columns(table), "site"]
        if not equals or name not in columns:
            raise UnusableInputError(
                "study.subgroup",
                "{condition}: give NAME=VALUE or NAME=LOW:HIGH with one of {known}",
                condition=Verbatim(clean(condition)[:_SHOWN]),
                known=joined(map(Verbatim, columns)),
            )
        try:
            low, high = (float(edge) for edge in value.split(":")) if ":" in value else (float(value), float(value))
            kept = pd.to_numeric(table[name], errors="coerce").between(low, high)
        except ValueError:
            kept = table[name].astype(str) == value
        sample = table[MATERIAL].notna() if MATERIAL in table else kept & False
        if not (kept & ~sample).any():
            raise UnusableInputError(
                "study.empty_subgroup",
                "no subject has {condition}; values: {known}",
                condition=Verbatim(clean(condition)[:_SHOWN]),
                known=joined(
                    Verbatim(clean(str(item))[:_SHOWN]) for item in sorted(set(table[name].dropna()))[:_SHOWN]
                ),
            )
        table = table[kept | sample]
    return table


def read_subjects(path: Path) -> pd.DataFrame:
    """Read demographic values by subject from a CSV file with the column ``subject``.

    Raises:
        UnusableInputError: the file cannot be read, or a subject is missing or occurs twice.
    """
    try:
        if path.stat().st_size > _LARGEST_SUBJECTS:
            raise UnusableInputError("study.subjects_size", "{path} is too large", path=str(path))
        subjects = pd.read_csv(path, dtype={"subject": str}, nrows=1_000_000)
    except (OSError, ValueError, pd.errors.ParserError) as error:
        why = Verbatim(str(error).splitlines()[0])
        raise UnusableInputError(
            "study.subjects_unreadable", "{path} cannot be read: {reason}", path=str(path), reason=why
        ) from error
    if "subject" not in subjects or len(subjects.columns) > _MOST_COLUMNS:
        raise UnusableInputError("study.subjects_column", "{path} must have a column 'subject'", path=str(path))
    if subjects["subject"].isna().any() or subjects["subject"].duplicated().any():
        raise UnusableInputError("study.subjects_twice", "in {path} each row must name another subject", path=str(path))
    return subjects


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV or, if the name ends in ``.parquet``, as Parquet, atomically.

    Raises:
        OSError: it cannot be written.
    """
    with atomic_file(path) as partial:
        if path.suffix == ".parquet":
            table.to_parquet(partial, index=False)
        else:
            texts = table.select_dtypes(["object", "string"]).columns
            safe = table.assign(**{name: table[name].map(cell_text, na_action="ignore") for name in texts})
            safe.rename(columns=cell_text).to_csv(partial, index=False)


def as_json_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows for JSON; missing values are None."""
    return list(json.loads(table.to_json(orient="records", double_precision=15)))


def _uniform(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose columns are all texts or all numbers, whatever a session or a file of subjects holds.

    Numbers that are not finite, or too large to be squared, become missing.
    """
    for name in table:
        column = table[name]
        if name in _NUMBERS or str(name).endswith(STD_SUFFIX) or f"{name}{STD_SUFFIX}" in table:
            column = pd.to_numeric(column, errors="coerce")
        elif name in _TEXTS or column.map(lambda value: isinstance(value, str)).any():
            column = column.map(str, na_action="ignore").astype(object)
        if pd.api.types.is_float_dtype(column):
            column = column.where(column.abs() < _LARGEST)
        table[name] = column
    return table


def _with_subjects(table: pd.DataFrame, subjects: pd.DataFrame) -> pd.DataFrame:
    given: Sequence[str] = [str(name) for name in subjects if name != "subject"]
    taken = [name for name in given if name in (*KEYS, *DESCRIPTION) or name.endswith(STD_SUFFIX)]
    if taken := taken + [name for name in given if f"{name}{STD_SUFFIX}" in table]:
        raise UnusableInputError(
            "study.subjects_taken",
            "the file of subjects has a column '{name}', which is a column of the table of a study: rename it",
            name=Verbatim(clean(taken[0])[:60]),
        )
    subjects = _uniform(subjects.copy())
    return table.drop(columns=[name for name in given if name in table]).merge(subjects, on="subject", how="left")
