"""Report of a study: one self-contained page with figures and tables by site and parameter."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import pandas as pd
from matplotlib.figure import FigureBase

from tissueid import __version__
from tissueid.analysis.curves.plot import Plot
from tissueid.formatting import axis_label, label_and_unit, number
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import MISSING, translated
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.html import RESEARCH_LINE, template
from tissueid.reports.panel_sheet import Panel
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.tables import Table
from tissueid.studies.study_plots import (
    first_test_plot,
    groups_plot,
    regression_plot,
    sites_plot,
    subjects_plot,
    variation_plot,
)
from tissueid.studies.study_statistics import StudyStatistics
from tissueid.units import display_unit

_HEADINGS = {
    "variation": marked("Variation within and between subjects"),
    "reliability": marked("Reliability of a single test"),
    "first_test": marked("First test against the later ones"),
    "sites": marked("Differences between sites"),
    "groups": marked("Differences between groups"),
    "general_linear": marked("Groups adjusted for each other"),
    "sample_sizes": marked("Participants per group for 80 and 90 % power"),
    "regressions": marked("Regressions on values of the subjects"),
    "partial_least_squares": marked("Partial least squares of all parameters"),
    "efficacy": marked("Conditions compared within subjects"),
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
    "first_test": marked("Mean of the later tests of a subject less the first test; paired t test."),
    "sites": marked("Mixed model with the subject as random effect; the first site is the reference."),
    "groups": marked(
        "One-way analysis of variance of the subjects' means, Welch's form where the variances differ (Levene). "
        "Effect size: partial eta squared. Corrected by Holm's method over the parameters and sites of a factor."
    ),
    "general_linear": marked("Type II sums of squares; each factor is adjusted for the others."),
    "sample_sizes": marked("From the smallest difference of two means and the largest standard deviation; size 0.05."),
    "regressions": marked(
        "Slope in SI units of the parameter per unit of the value. Weighted by the uncertainty of each subject's mean."
    ),
    "partial_least_squares": marked(
        "Components by cross-validation, p-value by permutation. Q²: share of the variance of held-out subjects that "
        "is predicted."
    ),
    "efficacy": marked("Difference after less before, paired by subject. Equivalence: two one-sided tests."),
}
_COLUMNS: Mapping[str, str] = {
    "site": marked("Site"),
    "factor": marked("Quantity or group"),
    "response": marked("Quantity or group"),
    "parameter": marked("Parameter"),
    "level": marked("Level"),
    "reference": marked("Reference"),
    "before": marked("Reference"),
    "after": marked("Condition"),
    "subjects": marked("Subjects"),
    "left_out": marked("Left out"),
    "tests": marked("Tests"),
    "groups": marked("Groups"),
    "mean": marked("Mean"),
    "std": marked("Standard deviation"),
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
    "equivalence_p_value": marked("p of equivalence"),
    "method": marked("Method"),
    "normal": marked("Normal residuals"),
    "equal_variances": marked("Equal variances"),
    "participants_80": marked("80 %"),
    "participants_90": marked("90 %"),
    "converged": marked("Converged"),
}
_IN_UNITS = ("mean", "std", "difference", "minimal_detectable_change")
_INTERVALS = {
    "individual_cv": ("individual_cv_low", "individual_cv_high"),
    "population_cv": ("population_cv_low", "population_cv_high"),
    "icc": ("icc_low", "icc_high"),
    "difference": ("low", "high"),
    "slope": ("slope_low", "slope_high"),
}
_MOST_DRAWN = 6
"""Largest number of parameters that are drawn."""
_METHODS = {"anova": marked("analysis of variance"), "welch": marked("Welch")}


def study_html(name: str, engine: str, found: StudyStatistics, failures: Mapping[str, str]) -> str:
    """Return the page as HTML text."""
    facts = (
        (_("Subjects"), str(found.used["subject"].nunique())),
        (_("Sites"), ", ".join(sorted(map(str, found.used["site"].unique())))),
        (_("Tests that count"), str(len(found.used))),
        (_("Engine"), _(engine_label(engine))),
    )
    return template("study.html.j2").render(
        title=_("Study {name}").format(name=name),
        research_line=_(RESEARCH_LINE),
        software=f"tissueid {__version__}",
        facts=facts,
        remarks=[translated(remark) for remark in found.remarks],
        failures=[(file, translated(reason)) for file, reason in failures.items()],
        groups=[group for group in _figures(found) if group.figures],
        tables=[_table(key, rows) for key, rows in found.tables.items()],
        left_out=_("Left out"),
    )


def _figures(found: StudyStatistics) -> list[FigureGroup]:
    names = found.parameters[:_MOST_DRAWN]
    tables = found.tables
    groups = [
        _group("subjects", _("Subjects"), {name: partial(subjects_plot, found.used, name) for name in names}),
        _group("sites", _("Sites"), {name: partial(sites_plot, found.means, name) for name in names}),
    ]
    if "variation" in tables:
        groups.append(_group("variation", _("Variation"), {"cv": partial(variation_plot, tables["variation"])}))
    if "first_test" in tables:
        plots = {name: partial(first_test_plot, found.used, name) for name in names}
        groups.append(_group("first", _(_HEADINGS["first_test"]), plots))
    for factor in dict.fromkeys(tables.get("groups", pd.DataFrame(columns=["factor"]))["factor"]):
        title = _("By {factor}").format(factor=_(label_and_unit(factor)[0]))
        plots = {name: partial(groups_plot, found.means, factor, name) for name in names}
        groups.append(_group(f"by-{factor}", title, plots))
    rows = tables.get("regressions", pd.DataFrame(columns=["factor"]))
    for regressor in dict.fromkeys(rows["factor"]):
        title = _("Against {quantity}").format(quantity=_(label_and_unit(regressor)[0]))
        plots = {name: partial(regression_plot, found.means, regressor, name, rows) for name in names}
        groups.append(_group(f"on-{regressor}", title, plots))
    return groups


def _group(key: str, heading: str, plots: Mapping[str, Callable[[], Plot]]) -> FigureGroup:
    panels = [_panel(f"{key}-{name}", name, make, wide=len(plots) == 1) for name, make in plots.items()]
    return FigureGroup(f"g-{key}", heading, tuple(panel.picture().block for panel in panels))


def _panel(key: str, name: str, make: Callable[[], Plot], *, wide: bool) -> Panel:
    plot = make()

    def draw(figure: FigureBase) -> None:
        draw_plot(figure.subplots(1, 1), plot, title=False)

    label = translated(plot.title) if name == "cv" else _(label_and_unit(name)[0])
    return Panel(key, label, translated(plot.title), translated(plot.title) + ".", draw, wide=wide, height=3.0)


def _table(key: str, rows: pd.DataFrame) -> Table:
    columns = [name for name in _COLUMNS if name in rows]
    head = tuple(_(_COLUMNS[name]) for name in columns)
    cells = tuple(tuple(_cell(row, name) for name in columns) for row in rows.to_dict("records"))
    return Table(_(_HEADINGS[key]), head, cells, _(_NOTES[key]))


def _cell(row: Mapping[str, Any], name: str) -> str:
    value = row[name]
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return MISSING
    if isinstance(value, bool):
        return _("yes") if value else _("no")
    if name == "parameter":
        return axis_label(str(value), display_unit(label_and_unit(str(value))[1])[0])
    if name in ("factor", "response"):
        return _(label_and_unit(str(value))[0])
    if name == "method":
        return _(_METHODS[str(value)])
    if isinstance(value, str):
        return value
    scale = display_unit(label_and_unit(str(row["parameter"]))[1])[1] if name in _IN_UNITS else 1.0
    if name in ("p_value", "p_corrected", "equivalence_p_value"):
        return "< 0.0005" if value < 0.0005 else f"{value:.3f}"
    text = "∞" if math.isinf(value) else number(float(value) * scale, 3)
    low, high = (row.get(edge) for edge in _INTERVALS.get(name, ("", "")))
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high):
        text += f" [{number(low * scale, 3)}, {number(high * scale, 3)}]"
    return text
