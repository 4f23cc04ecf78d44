"""Remarks about statistics that are not computed, with the least number of subjects that each needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import pandas as pd

from tissueid.messages import Listing, Message, Verbatim
from tissueid.studies.group_comparison import (
    LEAST_MIXED,
    LEAST_PAIRS,
    LEAST_PER_GROUP,
    LEAST_POOLED,
    LEAST_REGRESSION,
)
from tissueid.studies.multivariate import LEAST_SUBJECTS
from tissueid.studies.repeatability import LEAST_COMPLETE, LEAST_FIRST
from tissueid.studies.study_table import label_of, labels_of

Tables = Mapping[str, pd.DataFrame]


def not_repeated(tables: Tables, sites: Sequence[str]) -> list[Message]:
    """Return remarks about the statistics of repeated tests, by the sites where they are missing.

    Args:
        tables: statistics by key, also empty ones.
        sites: all sites of the study.
    """
    remarks = []
    if tables["variation"].empty:
        remarks.append(
            Message("study.no_variation", "no subject has two tests at one site: no coefficients of variation")
        )
    if tables["reliability"].empty:
        remarks.append(
            Message(
                "study.no_reliability",
                "no three subjects have the same two repeats at one site: no intraclass correlation",
            )
        )
    elif missing := _missing(sites, tables["reliability"]):
        remarks.append(
            Message(
                "study.few_for_reliability",
                "no intraclass correlation at {sites}: it needs {least} subjects with the same repeats",
                sites=missing,
                least=LEAST_COMPLETE,
            )
        )
    if not tables["variation"].empty and (missing := _missing(sites, tables["first_test"])):
        remarks.append(
            Message(
                "study.few_for_first_test",
                "the first test is not compared with the later ones at {sites}: that needs {least} subjects with two "
                "tests",
                sites=missing,
                least=LEAST_FIRST,
            )
        )
    if missing := _missing(sites, tables["site_means"]):
        remarks.append(
            Message(
                "study.few_for_means",
                "no weighted mean at {sites}: it needs {least} subjects whose means have an uncertainty",
                sites=missing,
                least=LEAST_POOLED,
            )
        )
    return remarks + _mixed(tables["sites"], sites)


def no_groups(rows: pd.DataFrame, factors: Iterable[str], sites: Sequence[str]) -> list[Message]:
    """Return remarks about groups that are not compared at some sites; ``rows`` are of ``one_way``."""
    return [
        Message(
            "study.few_for_groups",
            "groups of '{label}' are not compared at {sites}: that needs two groups of {least} subjects",
            name=Verbatim(name),
            label=label_of(name),
            sites=missing,
            least=LEAST_PER_GROUP,
        )
        for name in factors
        if (missing := _missing(sites, _of(rows, "factor", name)))
    ]


def no_adjusted_groups(rows: pd.DataFrame, sites: Sequence[str], least: int) -> list[Message]:
    """Return a remark about groups that are not adjusted for each other; ``least`` is the number of subjects needed."""
    if missing := _missing(sites, rows):
        return [
            Message(
                "study.few_for_linear",
                "the groups are not adjusted for each other at {sites}: that needs {least} subjects",
                sites=missing,
                least=least,
            )
        ]
    return []


def no_regressions(rows: pd.DataFrame, regressors: Iterable[str], sites: Sequence[str]) -> list[Message]:
    """Return remarks about regressions that are not computed at some sites; ``rows`` are of ``regressions``."""
    return [
        Message(
            "study.few_for_regression",
            "no regression on '{label}' at {sites}: it needs {least} subjects with a value",
            name=Verbatim(name),
            label=label_of(name),
            sites=missing,
            least=LEAST_REGRESSION,
        )
        for name in regressors
        if (missing := _missing(sites, _of(rows, "factor", name)))
    ]


def no_least_squares(rows: pd.DataFrame, responses: Iterable[str], sites: Sequence[str]) -> list[Message]:
    """Return a remark about partial least squares; ``rows`` are of ``partial_least_squares``."""
    lacking = [name for name in responses if _missing(sites, _of(rows, "response", name))]
    if not lacking:
        return []
    return [
        Message(
            "study.few_for_least_squares",
            "no partial least squares at some or all sites, which need {least} subjects with a value: {labels}",
            least=LEAST_SUBJECTS,
            names=Listing(tuple(map(Verbatim, lacking))),
            labels=labels_of(lacking),
        )
    ]


def no_pairs(rows: pd.DataFrame, means: pd.DataFrame, before: str, others: Iterable[str]) -> list[Message]:
    """Return remarks about conditions that are not compared; ``rows`` are of ``efficacy``."""
    remarks = []
    for other in others:
        own = _of(rows, "after", other)
        tested = sorted(map(str, means.loc[means["condition"] == other, "site"].unique()))
        if own.empty:
            remarks.append(
                Message(
                    "study.no_pairs",
                    "no three subjects were tested at one site under both conditions, {before} and {after}",
                    before=Verbatim(before or "''"),
                    after=Verbatim(other),
                )
            )
        elif missing := _missing(tested, own):
            remarks.append(
                Message(
                    "study.few_pairs",
                    "the condition '{after}' is not compared at {sites}: that needs {least} subjects with tests under "
                    "both conditions",
                    after=Verbatim(other),
                    sites=missing,
                    least=LEAST_PAIRS,
                )
            )
    return remarks


def no_materials(rows: pd.DataFrame) -> list[Message]:
    """Return a remark where materials are not compared; ``rows`` are of ``materials``."""
    if not rows.empty:
        return []
    return [
        Message(
            "study.few_materials",
            "materials are not compared: that needs two materials of {least} tests",
            least=LEAST_PER_GROUP,
        )
    ]


def parameters_missing(tables: Tables, parameters: Sequence[str]) -> list[Message]:
    """Return a remark about the parameters that some tables do not have at a site where they have others."""
    lacking = {
        name
        for rows in tables.values()
        if {"site", "parameter"} <= set(rows)
        for _site, own in rows.groupby("site")
        for name in set(rows["parameter"]) | set(parameters)
        if name not in set(own["parameter"])
    }
    if not lacking:
        return []
    return [
        Message(
            "study.parameters_missing",
            "left out of some comparisons, because values are missing or constant at a site: {labels}",
            names=Listing(tuple(sorted(lacking))),
            labels=labels_of(sorted(lacking)),
        )
    ]


def _mixed(rows: pd.DataFrame, sites: Sequence[str]) -> list[Message]:
    if rows.empty:
        if len(sites) < 2:
            return []
        return [
            Message("study.few_for_sites", "the sites are not compared: that needs {least} subjects", least=LEAST_MIXED)
        ]
    remarks = []
    if singular := tuple(dict.fromkeys(rows.loc[rows["singular"], "parameter"])):
        remarks.append(
            Message(
                "study.singular",
                "the mixed model of sites finds no variance between subjects, perhaps because there are few: {labels}",
                names=Listing(singular),
                labels=labels_of(singular),
            )
        )
    if unsettled := tuple(dict.fromkeys(rows.loc[~rows["converged"], "parameter"])):
        remarks.append(
            Message(
                "study.not_converged",
                "the mixed model of sites did not converge: {labels}",
                names=Listing(unsettled),
                labels=labels_of(unsettled),
            )
        )
    return remarks


def _of(rows: pd.DataFrame, column: str, value: str) -> pd.DataFrame:
    return rows if rows.empty else rows[rows[column] == value]


def _missing(sites: Sequence[str], rows: pd.DataFrame) -> Listing | None:
    """Return the sites without a row; None where there is none."""
    known = set() if rows.empty else set(rows["site"])
    lacking = tuple(Verbatim(site) for site in sites if site not in known)
    return Listing(lacking, between="; ", last="; ") if lacking else None
