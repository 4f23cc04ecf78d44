"""Tables of a study for people: statistics, the tables of the thesis next to them, and the tests that do not count."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from tissueid.formatting import axis_label, label_and_unit, number
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
from tissueid.reports.tables import Table
from tissueid.studies.multivariate import ALL_GROUPS, SUBJECTS
from tissueid.studies.study_plots import parameter_axis
from tissueid.studies.study_table import NO_CONDITION
from tissueid.studies.thesis_tables import MEAN_SITE

MOST_LEFT_OUT = 200
"""Largest number of tests that are listed one by one."""
HEADINGS: Mapping[str, str] = {
    "variation": marked("Variation within and between subjects"),
    "reliability": marked("Reliability of a single test"),
    "site_means": marked("Means by site"),
    "first_test": marked("First test against the later ones"),
    "sites": marked("Differences between sites"),
    "groups": marked("Differences between groups"),
    "general_linear": marked("Groups adjusted for each other"),
    "sample_sizes": marked("Participants per group for 80 and 90 % power"),
    "regressions": marked("Regressions on values of the subjects"),
    "partial_least_squares": marked("Partial least squares of all parameters"),
    "efficacy": marked("Conditions compared within subjects"),
    "materials": marked("Materials"),
    "kernel_components": marked("Principal components of the Volterra kernels"),
    "kernel_scores": marked("Scores of the principal components"),
    "7.1": marked("Table 7.1 of the thesis: variation within a subject"),
    "7.2": marked("Table 7.2 of the thesis: variation between subjects"),
    "7.3a": marked("Table 7.3a of the thesis: groups"),
    "7.3b": marked("Table 7.3b of the thesis: regressions"),
    "7.3c": marked("Table 7.3c of the thesis: participants per group"),
    "7.4": marked("Table 7.4 of the thesis: partial least squares"),
    "7.5": marked("Table 7.5 of the thesis: right-handed males of 18 to 28 years, left arm"),
}
_NOTES = {
    "variation": marked(
        "Individual: standard deviation over the tests of a subject divided by their mean, averaged over the subjects. "
        "Population: the same over the means of the subjects. In brackets: 95 % interval, bootstrap over subjects."
    ),
    "reliability": marked(
        "ICC(A,1): share of the variance that is between subjects (McGraw and Wong 1996). A change of a single test "
        "that is smaller than the minimal detectable change can be chance."
    ),
    "site_means": marked(
        "Weighted by the uncertainty of each subject's mean: random-effects model of Paule and Mandel. The standard "
        "deviation is that of the subjects; between subjects it is without the uncertainty of their means."
    ),
    "first_test": marked("Mean of the later tests of a subject less the first test; paired t test."),
    "sites": marked(
        "Mixed model with the subject as random effect; the first site is the reference. Effect size: difference over "
        "the total standard deviation."
    ),
    "groups": marked(
        "One-way analysis of variance of the subjects' means, Welch's form where the variances differ (Levene). "
        "Effect size: partial eta squared. Corrected by Holm's method over the parameters and sites of a factor. "
        "Weighted: by the uncertainty of each subject's mean. Detectable: Cohen's f that these groups show with a "
        "power of 80 % (half of Cohen's d for two groups)."
    ),
    "general_linear": marked("Type II sums of squares; each factor is adjusted for the others."),
    "sample_sizes": marked("From the smallest difference of two means and the largest standard deviation; size 0.05."),
    "regressions": marked(
        "Slope in the unit of the parameter per unit of the value. Weighted by the uncertainty of each subject's mean. "
        "Equal variances: Breusch and Pagan."
    ),
    "partial_least_squares": marked(
        "Components by cross-validation, p-value by permutations, each with its own components. "
        "Q²: share of the variance of held-out subjects that is predicted."
    ),
    "efficacy": marked("Difference to the reference, paired by subject; effect size: Cohen's d."),
    "materials": marked(
        "Analysis of variance over the tests, Welch's form where the variances differ. The last column is the number "
        "of other materials from which this one differs (Tukey, 5 % for all pairs together)."
    ),
    "kernel_components": marked(
        "Components of the kernels of all tests that count. Analysis of variance of their scores over sites, "
        "orientations, conditions and materials, Welch's form where the variances differ (Levene); the tests of a "
        "subject are averaged first. Corrected by Holm's method over the components of a kernel. Effect size: partial "
        "eta squared. The sites of a subject count as independent."
    ),
    "kernel_scores": marked(
        "Mean and standard deviation over the tests of each group, in standard deviations of all tests."
    ),
    "7.1": marked("Individual coefficient of variation; in brackets its 95 % interval. The last column is the ratio."),
    "7.2": marked("Population coefficient of variation; in brackets its 95 % interval. The last column is the ratio."),
    "7.3a": marked(
        "Smallest p-value over the six parameters. The thesis' cells are not legible; its text is given instead."
    ),
    "7.3b": marked("The thesis' cells are not legible; its text is given instead."),
    "7.3c": marked("Parameter with the fewest participants. The thesis' text gives ranges over its parameters."),
    "7.4": marked("P-values; the number of components is not printed in the thesis."),
    "7.5": marked(
        "Mean and standard deviation; one-way analysis of variance. The heads of the printed columns contradict the "
        "text and are interchanged here. Seven subjects reproduce the four printed p-values."
    ),
}
COLUMNS: Mapping[str, str] = {
    "kernel": marked("Kernel"),
    "component": marked("Component"),
    "among": marked("Compared"),
    "site": marked("Site"),
    "factor": marked("Quantity or group"),
    "response": marked("Quantity or group"),
    "parameter": marked("Parameter"),
    "level": marked("Level"),
    "reference": marked("Reference"),
    "before": marked("Reference"),
    "after": marked("Condition"),
    "share": marked("Share of the variance"),
    "score_1": marked("Component 1"),
    "score_2": marked("Component 2"),
    "score_3": marked("Component 3"),
    "mean": marked("Mean"),
    "individual_cv": marked("Individual CV"),
    "population_cv": marked("Population CV"),
    "icc": marked("ICC(A,1)"),
    "minimal_detectable_change": marked("Minimal detectable change"),
    "difference": marked("Difference"),
    "slope": marked("Slope"),
    "statistic": marked("F"),
    "effect_size": marked("Effect size"),
    "r_squared": marked("R²"),
    "q_squared": marked("Q²"),
    "components": marked("Components"),
    "p_value": marked("p"),
    "p_corrected": marked("p corrected"),
    "p_weighted": marked("p weighted"),
    "equivalence_p_value": marked("p of equivalence"),
    "std": marked("Standard deviation"),
    "between_std": marked("Between subjects"),
    "within_std": marked("Within a subject"),
    "subjects": marked("Subjects"),
    "left_out": marked("Left out"),
    "tests": marked("Tests"),
    "means": marked("Means"),
    "groups": marked("Groups"),
    "method": marked("Method"),
    "participants_80": marked("80 %"),
    "participants_90": marked("90 %"),
    "detectable": marked("Detectable"),
    "unlike": marked("Differs from"),
    "study": marked("Study"),
    "anterior": marked("Anterior"),
    "posterior": marked("Posterior"),
    "thesis_anterior": marked("Thesis, anterior"),
    "thesis_posterior": marked("Thesis, posterior"),
    "thesis": marked("Thesis"),
    "thesis_p": marked("Thesis, p"),
    "thesis_participants": marked("Thesis, participants"),
    "ratio": marked("Study over thesis"),
    "converged": marked("Converged"),
}
_IN_UNITS = (
    "mean",
    "std",
    "between_std",
    "within_std",
    "difference",
    "slope",
    "minimal_detectable_change",
    "anterior",
    "posterior",
    "thesis_anterior",
    "thesis_posterior",
)
ABOUT = (
    "kernel",
    "component",
    "among",
    "site",
    "factor",
    "response",
    "parameter",
    "level",
    "reference",
    "before",
    "after",
)
"""Columns that say what a row is about; they come first."""
_ONCE = (
    "reference",
    "before",
    "after",
    "subjects",
    "left_out",
    "tests",
    "groups",
    "means",
    "among",
    "components",
    "detectable",
    "method",
    "converged",
)
"""Columns that stand in the note of a table if all rows have the same value."""
_BY_FACTOR = ("groups", "sample_sizes", "regressions")
"""Statistics that have a table for each factor."""
_MARKS: Mapping[str, tuple[str, str, str]] = {
    "normal": (
        "*",
        marked("the residuals are not normal (Shapiro and Wilk, 5 %)."),
        marked("Where there are fewer than four values, it is not tested whether the residuals are normal."),
    ),
    "equal_variances": ("†", marked("the variances differ."), ""),
}
"""Marks of a p-value whose assumption does not hold, what they mean, and what it means if it was not tested."""
_P_VALUES = ("p_value", "p_corrected", "p_weighted", "equivalence_p_value")
_INTERVALS = {
    "individual_cv": ("individual_cv_low", "individual_cv_high"),
    "population_cv": ("population_cv_low", "population_cv_high"),
    "icc": ("icc_low", "icc_high"),
    "mean": ("low", "high"),
    "difference": ("low", "high"),
    "study": ("study_low", "study_high"),
    "slope": ("slope_low", "slope_high"),
}
_AMONG = {ALL_GROUPS: marked("all groups"), SUBJECTS: marked("subjects alone")}
_METHODS = {"anova": marked("analysis of variance"), "welch": marked("Welch")}


def study_tables(key: str, rows: pd.DataFrame) -> list[Table]:
    """Return the tables of one kind of statistics, or of the thesis next to them, for people: one for each factor."""
    factors = list(rows["factor"].unique()) if key in _BY_FACTOR else []
    if len(factors) < 2:
        return [study_table(key, rows)]
    return [
        study_table(key, rows[rows["factor"] == factor], f"{_(HEADINGS[key])}: {_(label_and_unit(str(factor))[0])}")
        for factor in factors
    ]


def study_table(key: str, rows: pd.DataFrame, caption: str = "") -> Table:
    """Return one table; ``key`` is its kind, ``caption`` another heading, which names the factor."""
    left_out = {"materials": "p_weighted", "sites": "factor"}.get(key)  # which says nothing there
    columns = [name for name in COLUMNS if name in rows and name != left_out]
    if caption and "factor" in columns:
        columns.remove("factor")
    lines = [{name: _cell(row, name) for name in columns} for row in rows.to_dict("records")]
    same = [name for name in _ONCE if name in columns and len({line[name] for line in lines}) == 1 < len(lines)]
    columns = [name for name in columns if name not in same]
    head = tuple(_(COLUMNS[name]) for name in columns)
    cells = tuple(tuple(line[name] for name in columns) for line in lines)
    note = " ".join([_(_NOTES[key]), *_assumptions(rows)])
    if same:
        values = "; ".join(f"{_(COLUMNS[name])}: {lines[0][name]}" for name in same)
        note += " " + _("The same in all rows: {values}.").format(values=values)
    if "margin" in rows:
        margin = _("Equivalence: two one-sided tests with a margin of {percent} % of the mean under the reference.")
        note += " " + margin.format(percent=number(100.0 * float(rows["margin"].iloc[0]), 3))
    return Table(caption or _(HEADINGS[key]), head, cells, note)


def _assumptions(rows: pd.DataFrame) -> list[str]:
    """Return what the marks of p-values mean, and whether the normality of residuals could be tested."""
    notes = []
    for name, (mark, text, untested) in _MARKS.items():
        if name not in rows:
            continue
        if rows[name].eq(False).any():
            notes.append(f"{mark}: {_(text)}")
        if untested and rows[name].isna().any():
            notes.append(_(untested))
    return notes


def _cell(row: Mapping[str, Any], name: str) -> str:
    value = row[name]
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return MISSING
    if isinstance(value, bool):
        return _("yes") if value else _("no")
    if name == "parameter":
        return axis_label(str(value), parameter_axis(str(value))[0].unit)
    if name in ("before", "after") and not value:
        return _(NO_CONDITION)
    if name in ("factor", "response", "kernel"):
        return _(label_and_unit(str(value))[0])
    if name == "among":
        return _(_AMONG[str(value)])
    if name == "method":
        return _(_METHODS[str(value)])
    if isinstance(value, str):
        return _("mean") if name == "site" and value == MEAN_SITE else value
    scale = parameter_axis(str(row["parameter"]))[1] if name in _IN_UNITS else 1.0
    if name in _P_VALUES or (name == "thesis" and "response" in row):
        marks = "".join(mark for key, (mark, *_rest) in _MARKS.items() if name == "p_value" and _is_false(row.get(key)))
        return ("< 0.0005" if value < 0.0005 else f"{value:.3f}") + marks
    text = "∞" if math.isinf(value) else number(float(value) * scale, 3)
    if f"{name}_std" in row:
        return f"{text} ± {number(float(row[name + '_std']) * scale, 2)}"
    low, high = (row.get(edge) for edge in _INTERVALS.get(name, ("", "")))
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high):
        text += f" [{number(low * scale, 3)}, {number(high * scale, 3)}]"
    return text


def _is_false(value: Any) -> bool:
    return value is not None and value == False  # noqa: E712 # numpy's too, and not that of a missing value


def left_out_table(rows: pd.DataFrame) -> Table:
    """Return the tests that do not count, with the reasons; the first ``MOST_LEFT_OUT`` one by one."""
    head = (_("Session"), _("Test"), _("Subject"), _("Site"), _("Reason"))
    shown = rows.head(MOST_LEFT_OUT)
    cells = tuple(
        (str(row["session"]), str(row["test"]), str(row["subject"]), str(row["site"]), translated(row["reason"]))
        for row in shown.to_dict("records")
    )
    more = len(rows) - len(shown)
    note = _("{count} further tests are in the JSON of the report.").format(count=more) if more else ""
    return Table(_("Tests that do not count"), head, cells, note)
