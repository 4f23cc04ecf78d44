"""Selection of the tests, parameters and demographic values that count; states what is left out and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from tissueid.formatting import ANONYMOUS
from tissueid.language import marked
from tissueid.messages import Listing, Message, Verbatim
from tissueid.studies.study_table import STD_SUFFIX, label_of, labels_of, parameters_of

THESIS_SIX = (
    "damping_ratio",
    "natural_frequency_rad_per_s",
    "scaled_mass_s2",
    "scaled_damping_s",
    "c1_m",
    "c2_per_n",
)
"""Parameters of the Wiener fit that the thesis studies (7.1.1)."""
PLAUSIBLE = {
    "age_years": (0.0, 120.0),
    "height_m": (0.3, 2.6),
    "weight_kg": (1.0, 400.0),
    "bmi_kg_per_m2": (5.0, 120.0),
    "weight_per_height_kg_per_m": (2.0, 250.0),
}
"""Range of each demographic value; others have another unit, such as cm, and do not count."""
_COMPARABLE = ("configuration", "engine", "model", "signals")
"""Columns that decide what the parameters of a test mean."""
_MOST_PARAMETERS = 12
_LEAST_VALUES = 3
"""Least number of different values of a regression."""
_REPEAT = marked("quality 'repeat': {findings}")
_WHERE = ("session", "test", "subject", "site", "condition")


@dataclass(frozen=True, eq=False)
class UsableTests:
    """Tests that count, and those that do not (columns ``session``, ``test``, ``subject``, ``site``, ``condition``,
    ``reason``), with remarks about the latter.
    """

    used: pd.DataFrame
    left_out: pd.DataFrame
    remarks: tuple[Message, ...]


class _Reason(NamedTuple):
    rows: pd.Series
    text: Message


def usable_tests(table: pd.DataFrame) -> UsableTests:
    """Return the tests that count: completed, analysed, quality not "repeat", and with comparable parameters.

    These are those of the most frequent configuration, engine, model of the engine, and signals with their units.
    """
    remarks: list[Message] = []
    reasons = _unusable(table)
    usable = pd.Series(True, table.index)
    for reason in reasons:
        usable &= ~reason.rows
    if (dropped := int((~usable).sum())) > 0:
        remarks.append(
            Message(
                "study.tests_dropped",
                "{count} of {total} tests do not count: not completed, not analysed, or their quality is 'repeat'",
                count=dropped,
                total=len(table),
            )
        )
    for column in _COMPARABLE:
        other = _others(table[usable], column, remarks) if column in table else []
        reasons += other
        for reason in other:
            usable &= ~reason.rows.reindex(table.index, fill_value=False)
    used = table[usable].copy()
    used = used.assign(condition=used["condition"].fillna(""))
    for name, (least, most) in PLAUSIBLE.items():
        _without_implausible(used, name, least, most, remarks)
    if (nameless := int((used["subject"] == ANONYMOUS).sum())) > 0:
        remarks.append(
            Message(
                "study.anonymous", "{count} tests are of anonymous subjects, who count as one subject", count=nameless
            )
        )
    return UsableTests(used, _left_out(table, reasons), tuple(remarks))


def parameters_used(used: pd.DataFrame, remarks: list[Message]) -> list[str]:
    """Return the parameters that are compared: the six of the thesis if the engine has them; adds remarks."""
    names = parameters_of(used)
    if all(name in names for name in THESIS_SIX):
        names = list(THESIS_SIX)
    constant = [name for name in names if used[name].dropna().nunique() < 2]
    if constant:
        remarks.append(
            Message(
                "study.constant",
                "constant in all tests, and therefore left out: {labels}",
                names=Listing(tuple(constant)),
                labels=labels_of(constant),
            )
        )
    stated = {name for name in names if f"{name}{STD_SUFFIX}" in used and used[f"{name}{STD_SUFFIX}"].notna().any()}
    unknown = [name for name in names if stated and name not in stated and name not in constant]
    if unknown:
        remarks.append(
            Message(
                "study.undetermined",
                "without a standard deviation in any test, and therefore left out: {labels}",
                names=Listing(tuple(unknown)),
                labels=labels_of(unknown),
            )
        )
    chosen = [name for name in names if name not in (*constant, *unknown)]
    remarks += [
        Message(
            "study.no_value",
            "{count} tests have no value of '{label}', such as tests of other signals or units",
            count=missing,
            name=Verbatim(name),
            label=label_of(name),
        )
        for name in chosen
        if (missing := int(used[name].isna().sum()))
    ]
    if len(chosen) > _MOST_PARAMETERS:
        remarks.append(
            Message(
                "study.most_parameters",
                "the first {count} of {total} parameters are compared",
                count=_MOST_PARAMETERS,
                total=len(chosen),
            )
        )
    return chosen[:_MOST_PARAMETERS]


def has_groups(means: pd.DataFrame, name: str, remarks: list[Message], *, stated: bool) -> bool:
    """Tell whether a column has two groups or more; otherwise add a remark.

    Args:
        means: one row per subject and site.
        name: column.
        remarks: is extended.
        stated: whether the column was asked for, so that its absence is a remark.
    """
    if name not in means or means[name].dropna().empty:
        if stated:
            remarks.append(
                Message(
                    "study.no_column", "no subject has a value of '{label}'", name=Verbatim(name), label=label_of(name)
                )
            )
        return False
    if means[name].nunique() < 2:
        remarks.append(
            Message(
                "study.one_group", "all subjects have the same '{label}'", name=Verbatim(name), label=label_of(name)
            )
        )
        return False
    sizes = means.drop_duplicates("subject")[name].value_counts()
    if len(small := sizes.index[sizes < 2]):
        remarks.append(
            Message(
                "study.small_group",
                "groups of '{label}' with one subject do not count: {groups}",
                name=Verbatim(name),
                label=label_of(name),
                groups=Listing(tuple(map(str, small))),
            )
        )
    _count_missing(means, name, remarks)
    return True


def has_values(means: pd.DataFrame, name: str, remarks: list[Message], *, stated: bool) -> bool:
    """Tell whether a column has numbers enough for a regression, and make them numbers; otherwise add a remark.

    Arguments as in ``has_groups``.
    """
    numbers = pd.to_numeric(means[name], errors="coerce") if name in means else pd.Series(dtype=float)
    if numbers.dropna().empty:
        if stated:
            remarks.append(
                Message(
                    "study.no_number",
                    "no subject has a number for '{label}'",
                    name=Verbatim(name),
                    label=label_of(name),
                )
            )
        return False
    if numbers.dropna().nunique() < _LEAST_VALUES:
        remarks.append(
            Message(
                "study.too_few_values",
                "no regression on '{label}': it has fewer than {least} different values",
                name=Verbatim(name),
                label=label_of(name),
                least=_LEAST_VALUES,
            )
        )
        return False
    means[name] = numbers
    _count_missing(means, name, remarks)
    return True


def _unusable(table: pd.DataFrame) -> list[_Reason]:
    problem = table["problem"].fillna("").astype(str) if "problem" in table else pd.Series("", table.index)
    reasons = []
    for status in table["status"].dropna().unique():
        if status == "completed":
            continue
        for text in problem[table["status"] == status].unique():
            reason = Message("study.reason.status", "status '{status}'", status=Verbatim(str(status)))
            if text:
                reason = Message(
                    "study.reason.problem", "status '{status}': {why}", status=Verbatim(str(status)), why=Verbatim(text)
                )
            reasons.append(_Reason((table["status"] == status) & (problem == text), reason))
    repeat = (table["quality"] == "repeat") & (table["status"] == "completed")
    if repeat.any():
        why = table["findings"].fillna("").astype(str) if "findings" in table else pd.Series("", table.index)
        reasons += [
            _Reason(
                repeat & (why == text),
                Message("study.reason.quality", _REPEAT, findings=Verbatim(text or "?")),
            )
            for text in why[repeat].unique()
        ]
    return reasons


def _others(usable: pd.DataFrame, column: str, remarks: list[Message]) -> list[_Reason]:
    """Return the reasons for the tests whose value of a column is not the most frequent one."""
    values = usable[column].fillna("")
    if values.nunique() < 2:
        return []
    most = values.mode().iloc[0]
    kept = Verbatim(str(most))
    remarks.append(
        Message(
            "study.not_comparable",
            "the tests differ in '{label}' ({count} values) and their parameters are not comparable; only those with "
            "'{kept}' count",
            label=label_of(column),
            count=values.nunique(),
            kept=kept,
        )
    )
    return [
        _Reason(
            values == name,
            Message(
                f"study.reason.{column}",
                "{label} '{name}', not '{kept}'",
                label=label_of(column),
                name=Verbatim(str(name)),
                kept=kept,
            ),
        )
        for name in values.unique()
        if name != most
    ]


def _left_out(table: pd.DataFrame, reasons: list[_Reason]) -> pd.DataFrame:
    columns = [name for name in _WHERE if name in table]
    parts = []
    for rows, text in reasons:
        part = table.loc[rows.index[rows], columns].copy()
        part["reason"] = pd.Series([text] * len(part), part.index, dtype=object)
        parts.append(part)
    parts = [part for part in parts if len(part)]
    return pd.concat(parts).sort_index() if parts else pd.DataFrame(columns=[*columns, "reason"])


def _without_implausible(used: pd.DataFrame, name: str, least: float, most: float, remarks: list[Message]) -> None:
    if name not in used:
        return
    numbers = pd.to_numeric(used[name], errors="coerce")
    wrong = (numbers < least) | (numbers > most) | (used[name].notna() & numbers.isna())
    if not wrong.any():
        return
    used[name] = numbers.where(~wrong, np.nan)
    if name in ("bmi_kg_per_m2", "weight_per_height_kg_per_m"):  # follows from height and weight, which are stated
        return
    remarks.append(
        Message(
            "study.implausible",
            "{count} subjects have a '{label}' outside {least:g} to {most:g}, perhaps in another unit; it is ignored",
            count=int(used.loc[wrong, "subject"].nunique()),
            name=Verbatim(name),
            label=label_of(name),
            least=least,
            most=most,
        )
    )


def _count_missing(means: pd.DataFrame, name: str, remarks: list[Message]) -> None:
    missing = means.loc[means[name].isna(), "subject"].nunique()
    if missing:
        remarks.append(
            Message(
                "study.missing",
                "{count} subjects have no value of '{label}' and do not count in its comparisons",
                count=int(missing),
                name=Verbatim(name),
                label=label_of(name),
            )
        )
