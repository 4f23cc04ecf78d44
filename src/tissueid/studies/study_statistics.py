"""All statistics of a study that its table allows, with a statement of what is left out and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from tissueid.messages import Listing, Message, Verbatim
from tissueid.studies.group_comparison import (
    efficacy,
    general_linear,
    mixed_model,
    one_way,
    regressions,
    subject_means,
)
from tissueid.studies.multivariate import partial_least_squares
from tissueid.studies.repeatability import first_test, reliability, variation
from tissueid.studies.sample_size import sample_sizes
from tissueid.studies.study_table import as_json_rows, parameters_of

THESIS_SIX = (
    "damping_ratio",
    "natural_frequency_rad_per_s",
    "scaled_mass_s2",
    "scaled_damping_s",
    "c1_m",
    "c2_per_n",
)
"""Parameters of the Wiener fit that the thesis studies (7.1.1)."""
FACTORS = ("gender", "ethnicity", "handedness")
REGRESSORS = ("age_years", "height_m", "weight_kg", "bmi_kg_per_m2")
_MOST_PARAMETERS = 12


@dataclass(frozen=True)
class StudyStatistics:
    """Statistics of a study. ``tables`` are results by key, ``remarks`` say what was left out.

    ``used`` holds the tests that count, ``means`` one row per subject, site and condition.
    """

    used: pd.DataFrame
    means: pd.DataFrame
    parameters: tuple[str, ...]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    remarks: tuple[Message, ...] = ()

    def as_answer(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        return {
            "tests": len(self.used),
            "subjects": int(self.used["subject"].nunique()),
            "sites": sorted(map(str, self.used["site"].unique())),
            "parameters": list(self.parameters),
            "remarks": [str(remark) for remark in self.remarks],
            "statistics": {key: as_json_rows(table) for key, table in self.tables.items()},
        }


def study_statistics(
    table: pd.DataFrame,
    *,
    factors: Sequence[str] = (),
    regressors: Sequence[str] = (),
    before: str = "",
    after: str | None = None,
    margin: float | None = None,
) -> StudyStatistics:
    """Compute what the table allows.

    Args:
        table: of the study.
        factors: columns with groups of subjects; those of ``FACTORS`` that the table has by default.
        regressors: columns with values of subjects; those of ``REGRESSORS`` that the table has by default.
        before: condition of the reference, "" for tests without one; tests under other conditions are compared only.
        after: condition that is compared with it.
        margin: relative margin of equivalence.
    """
    used, parameters, remarks = usable_tests(table)
    keys = ("subject", "site", "condition")
    means = subject_means(used, parameters, keys) if parameters else used.head(0)
    plain = used[used["condition"] == before]
    if plain.empty:
        plain = used
        remarks.append(
            Message("study.all_conditions", "repeatability and groups use the tests of all conditions: none is without")
        )
    own = means[means["condition"].isin(plain["condition"].unique())] if parameters else means
    tables = {
        "variation": variation(plain, parameters),
        "reliability": reliability(plain, parameters),
        "first_test": first_test(plain, parameters),
        "sites": mixed_model(plain, "site", parameters),
    }
    remarks += [_left_out(key) for key in ("variation", "reliability") if tables[key].empty]
    chosen = [name for name in factors or FACTORS if _has_groups(own, name, remarks, stated=bool(factors))]
    if chosen and parameters:
        tables["groups"] = _joined([one_way(own, name, parameters) for name in chosen])
        if len(chosen) > 1:
            tables["general_linear"] = general_linear(own, chosen, parameters)
        if not tables["groups"].empty:
            tables["sample_sizes"] = sample_sizes(tables["groups"])
    values = [name for name in regressors or REGRESSORS if _has_values(own, name, remarks, stated=bool(regressors))]
    if values and parameters:
        tables["regressions"] = _joined([regressions(own, name, parameters) for name in values])
    responses = [*values, *(name for name in chosen if own[name].nunique() == 2)]
    if responses and parameters:
        tables["partial_least_squares"] = partial_least_squares(own, responses, parameters)
    if after is not None and parameters:
        tables["efficacy"] = efficacy(means, before, after, parameters, margin)
        if tables["efficacy"].empty:
            remarks.append(
                Message(
                    "study.no_pairs",
                    "no three subjects were tested at one site under both conditions, {before} and {after}",
                    before=Verbatim(before or "''"),
                    after=Verbatim(after),
                )
            )
    tables = {key: found for key, found in tables.items() if not found.empty}
    return StudyStatistics(used, means, tuple(parameters), tables, tuple(remarks))


def usable_tests(table: pd.DataFrame) -> tuple[pd.DataFrame, list[str], list[Message]]:
    """Return the tests that count, the parameters that are compared, and a statement of what is left out."""
    remarks: list[Message] = []
    used = _usable(table, remarks)
    return used, _parameters(used, remarks), remarks


def _usable(table: pd.DataFrame, remarks: list[Message]) -> pd.DataFrame:
    usable = table[(table["status"] == "completed") & (table["quality"] != "repeat")]
    if (dropped := len(table) - len(usable)) > 0:
        remarks.append(
            Message(
                "study.tests_dropped",
                "{count} of {total} tests do not count: not completed, not analysed, or their quality is 'repeat'",
                count=dropped,
                total=len(table),
            )
        )
    kinds = usable["configuration"].nunique()
    if kinds > 1:
        most = usable["configuration"].mode().iloc[0]
        remarks.append(
            Message(
                "study.configurations",
                "the tests have {count} configurations; only those with '{kept}' count",
                count=kinds,
                kept=Verbatim(str(most)),
            )
        )
        usable = usable[usable["configuration"] == most]
    return usable.assign(condition=usable["condition"].fillna(""))


def _parameters(used: pd.DataFrame, remarks: list[Message]) -> list[str]:
    found = parameters_of(used)
    if all(name in found for name in THESIS_SIX):
        return list(THESIS_SIX)
    constant = [name for name in found if used[name].dropna().nunique() < 2]
    if constant:
        remarks.append(
            Message(
                "study.constant",
                "constant in all tests, and therefore left out: {names}",
                names=Listing(tuple(constant)),
            )
        )
    return [name for name in found if name not in constant][:_MOST_PARAMETERS]


def _has_groups(means: pd.DataFrame, name: str, remarks: list[Message], *, stated: bool) -> bool:
    if name not in means or means[name].dropna().empty:
        if stated:
            remarks.append(Message("study.no_column", "no subject has a value of '{name}'", name=Verbatim(name)))
        return False
    if means[name].nunique() < 2:
        remarks.append(Message("study.one_group", "all subjects have the same '{name}'", name=Verbatim(name)))
        return False
    _count_missing(means, name, remarks)
    return True


def _has_values(means: pd.DataFrame, name: str, remarks: list[Message], *, stated: bool) -> bool:
    numbers = pd.to_numeric(means[name], errors="coerce") if name in means else pd.Series(dtype=float)
    if numbers.dropna().empty:
        if stated:
            remarks.append(Message("study.no_number", "no subject has a number for '{name}'", name=Verbatim(name)))
        return False
    if numbers.dropna().nunique() < 3:
        remarks.append(
            Message("study.too_few_values", "'{name}' has too few values for a regression", name=Verbatim(name))
        )
        return False
    means[name] = numbers
    _count_missing(means, name, remarks)
    return True


def _count_missing(means: pd.DataFrame, name: str, remarks: list[Message]) -> None:
    missing = means.loc[means[name].isna(), "subject"].nunique()
    if missing:
        remarks.append(
            Message(
                "study.missing",
                "{count} subjects have no value of '{name}' and do not count in its comparisons",
                count=int(missing),
                name=Verbatim(name),
            )
        )


def _left_out(key: str) -> Message:
    if key == "variation":
        return Message("study.no_variation", "no subject has two tests at one site: no coefficients of variation")
    return Message(
        "study.no_reliability", "no three subjects have the same two repeats at one site: no intraclass correlation"
    )


def _joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    filled = [table for table in tables if not table.empty]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()
