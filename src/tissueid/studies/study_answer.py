"""Statistics of a study in the form of the JSON contract: parameters by name, and one list of comparisons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from tissueid.studies.study_table import as_json_rows

_MEANS = {
    "cv_individual": ("variation", "individual_cv"),
    "cv_population": ("variation", "population_cv"),
    "icc": ("reliability", "icc"),
    "minimal_detectable_change": ("reliability", "minimal_detectable_change"),
}
"""Key of a parameter, and the table and column whose values at the sites it is the mean of."""
_KINDS: Mapping[str, tuple[str, tuple[str, ...], str, str, str]] = {
    "first_test": ("first_test", (), "difference", "subjects", "paired_t"),
    "sites": ("site", ("reference", "level"), "difference", "subjects", "mixed_model"),
    "groups": ("group", ("levels",), "difference", "subjects", ""),
    "general_linear": ("group_adjusted", (), "", "subjects", "general_linear"),
    "regressions": ("regression", (), "slope", "subjects", ""),
    "partial_least_squares": ("partial_least_squares", (), "", "subjects", "permutations"),
    "efficacy": ("condition", ("before", "after"), "difference", "subjects", "paired_t"),
    "materials": ("material", ("levels",), "", "tests", ""),
}
"""Kind of the comparisons of a table, columns with its groups, estimate and number, and the test; "" where each row
has its own or none."""


def parameters_answer(parameters: tuple[str, ...], tables: Mapping[str, pd.DataFrame]) -> dict[str, dict[str, Any]]:
    """Return coefficients of variation, ICC and minimal detectable change by parameter: means of the sites, SI."""
    found: dict[str, dict[str, Any]] = {name: dict.fromkeys(_MEANS) for name in parameters}
    for key, (table, column) in _MEANS.items():
        if table in tables:
            for name, value in tables[table].groupby("parameter")[column].mean().items():
                found.setdefault(str(name), dict.fromkeys(_MEANS))[key] = None if pd.isna(value) else float(value)
    return found


def comparisons_answer(tables: Mapping[str, pd.DataFrame]) -> list[dict[str, Any]]:
    """Return all comparisons with their raw and corrected p-values; None where a table has no such value.

    ``estimate`` is the second group less the first, or the slope of a regression. ``parameter`` is None where all
    parameters are taken together.
    """
    return [_comparison(key, row) for key in _KINDS if key in tables for row in _rows(key, tables[key])]


def _rows(key: str, table: pd.DataFrame) -> list[dict[str, Any]]:
    if key != "materials":
        return as_json_rows(table)
    # One comparison of all materials by parameter, not one row for each material.
    groups = [(rows.iloc[:1], rows) for _name, rows in table.groupby("parameter", sort=False)]
    return [
        as_json_rows(first)[0] | {"levels": rows["level"].tolist(), "tests": int(rows["tests"].sum())}
        for first, rows in groups
    ]


def _comparison(key: str, row: Mapping[str, Any]) -> dict[str, Any]:
    kind, columns, estimate, number, test = _KINDS[key]
    groups: list[str] = []
    for column in columns:
        groups += row[column] if isinstance(row[column], list) else [row[column]]
    edge = "slope_" if key == "regressions" else ""
    interval = [row.get(f"{edge}low"), row.get(f"{edge}high")]
    if key == "regressions":
        test = "weighted_least_squares" if row["weighted"] else "least_squares"
    return {
        "kind": kind,
        "site": row.get("site"),
        "factor": row.get("factor", row.get("response")),
        "parameter": row.get("parameter"),
        "groups": ["first", "later"] if key == "first_test" else groups,
        "estimate": row.get(estimate),
        "ci": None if None in interval or not estimate else interval,
        "effect_size": row.get("r_squared" if key == "regressions" else "effect_size"),
        "p": row["p_value"],
        "p_corrected": row.get("p_corrected"),
        "test": test or row.get("method", "anova"),
        "n": row[number],
    }
