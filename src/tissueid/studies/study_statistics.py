"""Remarks about statistics that are not computed, with the least number of subjects that each needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

from tissueid.messages import Listing, Message, Verbatim, stored
from tissueid.studies.curve_groups import GroupCurve, group_curves
from tissueid.studies.group_comparison import (
    LEAST_MIXED,
    LEAST_PAIRS,
    LEAST_PER_GROUP,
    LEAST_POOLED,
    LEAST_REGRESSION,
    efficacy,
    general_linear,
    least_adjusted,
    materials,
    mixed_model,
    one_way,
    regressions,
    site_means,
    subject_means,
)
from tissueid.studies.multivariate import (
    LEAST_SUBJECTS,
    KernelComponents,
    component_table,
    kernel_components,
    partial_least_squares,
    score_table,
)
from tissueid.studies.repeatability import LEAST_COMPLETE, LEAST_FIRST, first_test, reliability, sample_sizes, variation
from tissueid.studies.study_table import MATERIAL, SIMULATED, as_json_rows, label_of, labels_of
from tissueid.studies.thesis_tables import thesis_tables
from tissueid.studies.usable_tests import has_groups, has_values, parameters_used, usable_tests

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
    present = set() if rows.empty else set(rows["site"])
    lacking = tuple(Verbatim(site) for site in sites if site not in present)
    return Listing(lacking, between="; ", last="; ") if lacking else None


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
    answer: dict[str, dict[str, Any]] = {name: dict.fromkeys(_MEANS) for name in parameters}
    for key, (table, column) in _MEANS.items():
        if table in tables:
            for name, value in tables[table].groupby("parameter")[column].mean().items():
                answer.setdefault(str(name), dict.fromkeys(_MEANS))[key] = None if pd.isna(value) else float(value)
    return answer


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


FACTORS = ("gender", "ethnicity", "age_group", "handedness")
REGRESSORS = ("age_years", "height_m", "weight_kg", "weight_per_height_kg_per_m", "bmi_kg_per_m2")
LINEAR = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m", "natural_frequency_rad_per_s", "damping_ratio")
"""Linear parameters of Fig. 7.10, of materials and products."""
_OF_ALL = ("variation", "reliability", "site_means", "first_test", "groups", "regressions", "efficacy")
"""Tables with a row for each parameter at each site."""


@dataclass(frozen=True)
class StudyStatistics:
    """Statistics of a study. ``tables`` are results by key, ``remarks`` say what was left out.

    ``used`` holds the tests of subjects that count, ``means`` one row per subject, site and condition, ``samples`` the
    tests of materials. ``left_out`` has one row per test that does not count, with the reason. ``thesis`` are the
    tables of the thesis next to those of the study, by their number. ``curves`` are the mean curves of the groups,
    ``components`` the principal components of Volterra kernels.
    """

    used: pd.DataFrame
    means: pd.DataFrame
    parameters: tuple[str, ...]
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    remarks: tuple[Message, ...] = ()
    left_out: pd.DataFrame = field(default_factory=pd.DataFrame)
    samples: pd.DataFrame = field(default_factory=pd.DataFrame)
    thesis: dict[str, pd.DataFrame] = field(default_factory=dict)
    curves: tuple[GroupCurve, ...] = ()
    components: tuple[KernelComponents, ...] = ()

    @property
    def simulated_tests(self) -> int:
        """Number of tests that count and that a simulation recorded."""
        tables = (self.used, self.samples)
        return sum(int(table[SIMULATED].eq(True).sum()) for table in tables if SIMULATED in table)

    def as_answer(self) -> dict[str, Any]:
        """Return the statistics for JSON."""
        return {
            "tests": len(self.used),
            "simulated_tests": self.simulated_tests,
            "subjects": int(self.used["subject"].nunique()),
            "sites": sorted(map(str, self.used["site"].unique())),
            "parameters": parameters_answer(self.parameters, self.tables),
            "comparisons": comparisons_answer(self.tables),
            "warnings": [str(remark) for remark in self.remarks],
            "warning_messages": [stored(remark) for remark in self.remarks],
            "left_out": as_json_rows(self.left_out.assign(reason=self.left_out["reason"].map(str)))
            if len(self.left_out)
            else [],
            "thesis": {key: as_json_rows(table) for key, table in self.thesis.items()},
            "statistics": {key: as_json_rows(table) for key, table in self.tables.items()},
            "curves": [curve.as_answer() for curve in self.curves],
        }


def study_statistics(
    table: pd.DataFrame,
    curves: pd.DataFrame | None = None,
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
        curves: sampled curves of its tests (``sampled_curves.curves_table``); None for statistics without curves.
        factors: columns with groups of subjects; those of ``FACTORS`` that the table has by default.
        regressors: columns with values of subjects; those of ``REGRESSORS`` that the table has by default.
        before: condition of the reference, "" for tests without one; tests under other conditions are compared only.
        after: condition that is compared with it; all others if not given.
        margin: relative margin of equivalence.
    """
    usable = usable_tests(table)
    remarks = list(usable.remarks)
    sample = usable.used[MATERIAL].notna() if MATERIAL in usable.used else pd.Series(False, usable.used.index)
    used, samples = usable.used[~sample].copy(), usable.used[sample].copy()
    parameters = parameters_used(used if len(used) else samples, remarks)
    keys = ("subject", "site", "condition")
    linear = [name for name in LINEAR if name in used and used[name].notna().any()]
    measured = list(dict.fromkeys([*parameters, *linear]))
    means = subject_means(used, measured, keys) if parameters and len(used) else used.head(0)
    plain = used[used["condition"] == before]
    if plain.empty and len(used):
        plain = used
        remarks.append(
            Message("study.all_conditions", "repeatability and groups use the tests of all conditions: none is without")
        )
    own = means[means["condition"].isin(plain["condition"].unique())].copy() if len(means) else means
    tables: dict[str, pd.DataFrame] = {}
    if len(used):
        remarks += too_few_repeats(plain)
        tables |= {
            "variation": variation(plain, parameters),
            "reliability": reliability(plain, parameters),
            "site_means": site_means(own, parameters),
            "first_test": first_test(plain, parameters),
            "sites": mixed_model(plain, "site", parameters),
        }
        remarks += not_repeated(tables, sorted(map(str, plain["site"].unique())) if parameters else ())
    if len(own) and parameters:
        tables |= _between_subjects(own, parameters, factors, regressors, remarks)
        tables |= _conditions(means, measured, before, after, margin, remarks)
    if len(samples):
        tables["materials"] = materials(samples, list(dict.fromkeys([*linear, *parameters])) or measured)
        if tables["materials"].empty:
            remarks.append(
                Message(
                    "study.few_materials",
                    "materials are not compared: that needs two materials of {least} tests",
                    least=LEAST_PER_GROUP,
                )
            )
    components: tuple[KernelComponents, ...] = ()
    groups: tuple[GroupCurve, ...] = ()
    if curves is not None and len(usable.used):
        groups = group_curves(used, samples, curves, str(plain["condition"].iloc[0]) if len(plain) else before)
        components = kernel_components(used, samples, curves, remarks)
        tables |= {"kernel_components": component_table(components), "kernel_scores": score_table(components)}
    remarks += parameters_missing({key: rows for key, rows in tables.items() if key in _OF_ALL}, parameters)
    tables = {key: rows for key, rows in tables.items() if not rows.empty}
    thesis = thesis_tables(own, tables, parameters)
    return StudyStatistics(
        used, means, tuple(parameters), tables, tuple(remarks), usable.left_out, samples, thesis, groups, components
    )


def _between_subjects(
    own: pd.DataFrame,
    parameters: Sequence[str],
    factors: Sequence[str],
    regressors: Sequence[str],
    remarks: list[Message],
) -> dict[str, pd.DataFrame]:
    tables = {}
    sites = sorted(map(str, own["site"].unique()))
    chosen = [name for name in factors or FACTORS if has_groups(own, name, remarks, stated=bool(factors))]
    if chosen:
        tables["groups"] = _joined([one_way(own, name, parameters) for name in chosen])
        remarks += no_groups(tables["groups"], chosen, sites)
        if len(chosen) > 1:
            tables["general_linear"] = general_linear(own, chosen, parameters)
            if missing := _missing(sites, tables["general_linear"]):
                remarks.append(
                    Message(
                        "study.few_for_linear",
                        "the groups are not adjusted for each other at {sites}: that needs {least} subjects",
                        sites=missing,
                        least=least_adjusted(own, chosen),
                    )
                )
        if not tables["groups"].empty:
            tables["sample_sizes"] = sample_sizes(tables["groups"])
    values = [name for name in regressors or REGRESSORS if has_values(own, name, remarks, stated=bool(regressors))]
    if values:
        tables["regressions"] = _joined([regressions(own, name, parameters) for name in values])
        remarks += no_regressions(tables["regressions"], values, sites)
    responses = [*values, *(name for name in chosen if own[name].nunique() == 2 and name != "age_group")]
    if responses:
        tables["partial_least_squares"] = least_squares = partial_least_squares(own, responses, parameters)
        if lacking := [name for name in responses if _missing(sites, _of(least_squares, "response", name))]:
            remarks.append(
                Message(
                    "study.few_for_least_squares",
                    "no partial least squares at some or all sites, which need {least} subjects with a value: {labels}",
                    least=LEAST_SUBJECTS,
                    names=Listing(tuple(map(Verbatim, lacking))),
                    labels=labels_of(lacking),
                )
            )
    return tables


def _conditions(
    means: pd.DataFrame,
    parameters: Sequence[str],
    before: str,
    after: str | None,
    margin: float | None,
    remarks: list[Message],
) -> dict[str, pd.DataFrame]:
    others = [after] if after is not None else sorted(set(means["condition"]) - {before})
    if not others:
        return {}
    rows = _joined([efficacy(means, before, other, parameters, margin) for other in others])
    remarks += no_pairs(rows, means, before, others)
    return {"efficacy": rows}


def too_few_repeats(plain: pd.DataFrame) -> list[Message]:
    """State the series of a single test, which have no variation within a subject."""
    counts = plain.groupby(["subject", "site"]).size()
    single = int((counts < 2).sum())
    if not single or single == len(counts):  # the latter is stated where the tables are missing
        return []
    return [
        Message(
            "study.single_tests",
            "{count} of {total} series have one test that counts: they enter means and groups, not the variation "
            "within a subject",
            count=single,
            total=len(counts),
        )
    ]


def _joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    filled = [table for table in tables if not table.empty]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()
