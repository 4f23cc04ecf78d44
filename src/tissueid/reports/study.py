"""Report of a study: one self-contained page with figures and tables by site and parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import pandas as pd
from matplotlib.figure import FigureBase

from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.curves.samples import (
    DAMPING,
    KERNEL1,
    KERNEL2,
    MAGNITUDE,
    MASS,
    NONLINEARITY,
    PARTITIONS,
    PHASE,
    STIFFNESS,
)
from tissueid.device import SIMULATED_LINE
from tissueid.formatting import label_and_unit
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import MISSING, Verbatim, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, template
from tissueid.reports.plot_axes import turn_names
from tissueid.reports.plot_renderer import draw_plot, key_over
from tissueid.reports.study_tables import HEADINGS, left_out_table, study_tables
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH
from tissueid.reports.tables import Table
from tissueid.studies.curve_groups import By, GroupCurve, chosen, directions
from tissueid.studies.curve_plots import (
    component_curves,
    component_panels,
    curve_plot,
    kernel_panel,
    name_of,
    scores_plot,
    shared_limit,
    title_of,
)
from tissueid.studies.study_plots import (
    conditions_plot,
    first_test_plot,
    groups_plot,
    materials_plot,
    nonlinearity_plot,
    regression_plot,
    sites_plot,
    subjects_plot,
    variation_plot,
)
from tissueid.studies.study_statistics import StudyStatistics
from tissueid.version import SOFTWARE

Plots = Mapping[str, Callable[[], Plot]]
"""Functions that compute plots, by the name of the parameter; a ``Verbatim`` is the label of a plot of a group."""
MOST_PANELS = 24
"""Largest number of groups whose kernels are drawn."""
_LINES = marked(
    "Lines: mean of the subjects, each the mean of its tests, or mean of the tests of a material. Bands: 95 % interval "
    "of the mean. A line ends where fewer than nine tenths of the subjects or tests have a value."
)
CURVE_CAPTIONS: Mapping[str, str] = {
    "response": _LINES,
    "depth": marked(
        "Lines: mean of the subjects, each the mean of its tests, or mean of the tests of a material. Bands: 95 % "
        "interval of the mean. Thin lines: subjects, or tests of a material. A mean ends where fewer than nine "
        "tenths of them have a value."
    ),
    "static": _LINES,
    "kernel": _LINES,
    "change": marked(
        "Change against the reference at the same depth, paired by subject. Lines: mean of the subjects. Bands: 95 % "
        "interval of the mean. Thin lines: subjects. A mean ends where fewer than nine tenths of them have a "
        "value."
    ),
    "second": marked(
        "Mean of the subjects, each the mean of its tests, or mean of the tests of a material; mean VAF of the tests. "
        "All groups have the same scale of colours."
    ),
    "partition": marked(
        "Kernels of the partitions of depth, mean of the subjects or of the tests of a material, where at least half "
        "have a value; mean VAF of the tests in a run that is scheduled by the measured depth. All groups have the "
        "same scale of colours."
    ),
    "components1": marked("Mean kernel of all tests, and its change by one standard deviation of each component."),
    "components2": marked(
        "Mean kernel of all tests, and its change by one standard deviation of each component, which share a scale of "
        "colours. Percent: share of the variance."
    ),
    "scores": marked("One point per test."),
}
"""What the signs of a figure of curves are, by the first word of the key of its group."""
_HEADINGS: Mapping[str, str] = {
    "response": marked("Frequency response"),
    "depth": marked("Mass, damping and stiffness against depth"),
    "static": marked("Fitted static nonlinearity"),
    "kernel": marked("First-order kernels"),
    "second": marked("Second-order kernels"),
    "partition": marked("Kernels by depth"),
}
_CURVES: Mapping[str, tuple[str, ...]] = {
    "response": (MAGNITUDE, PHASE),
    "depth": (MASS, DAMPING, STIFFNESS),
    "static": (NONLINEARITY,),
    "kernel": (KERNEL1,),
}
"""Curves of each kind of figure with lines."""
_PANELS = {"second": KERNEL2, "partition": PARTITIONS}
"""Kernel of each kind of figure with a panel for each group."""
_GROUPS: Mapping[By, str] = {
    "site": marked("{figure}: sites"),
    "condition": marked("{figure}: conditions"),
    "material": marked("{figure}: materials"),
}
_ORDERS = {KERNEL1: marked("first-order kernel"), KERNEL2: marked("second-order kernel")}


def curve_figures(found: StudyStatistics) -> Iterator[tuple[str, str, Plots]]:
    """Yield key, heading and plots of each group of figures of curves, of kernels and of principal components."""
    for kind, heading in _HEADINGS.items():
        for by, words in _GROUPS.items():
            if kind in _CURVES:
                plots = _lines(found.curves, by, _CURVES[kind])
            else:
                plots = _panels(chosen(found.curves, by, _PANELS[kind]))
            if plots:
                yield f"{kind}-{by}", _(words).format(figure=_(heading)), plots
    if plots := _lines(found.curves, "change", _CURVES["depth"]):
        yield "change-depth", _("Change against depth: conditions"), plots
    for one in found.components:
        order = _(_ORDERS[one.curve])
        if one.curve == KERNEL1:
            shown: Plots = {_label(component_curves(one)): partial(component_curves, one)}
        else:
            shown = {_label(plot): partial(_same, plot) for plot in component_panels(one)}
        number = "1" if one.curve == KERNEL1 else "2"
        yield f"components{number}-all", _("Principal components, {kernel}").format(kernel=order), shown
        if len(one.names) > 1:
            plots = {_label(scores_plot(one)): partial(scores_plot, one)}
            yield f"scores-{number}", _("Scores of the components, {kernel}").format(kernel=order), plots


def _lines(curves: Sequence[GroupCurve], by: By, names: Sequence[str]) -> Plots:
    own = [chosen(curves, by, name) for name in names]
    groups = list(dict.fromkeys(one.group for some in own for one in some))
    plots: dict[str, Callable[[], Plot]] = {}
    for some in own:
        for way in directions(some):
            shown = [one for one in some if one.direction == way]
            plots[Verbatim(translated(title_of(shown[0], groups)))] = partial(curve_plot, shown, groups)
    return plots


def _panels(curves: Sequence[GroupCurve]) -> Plots:
    if not curves:
        return {}
    limit = shared_limit(curves)
    return {Verbatim(translated(name_of(one))): partial(kernel_panel, one, limit) for one in curves[:MOST_PANELS]}


def _label(plot: Plot) -> Verbatim:
    return Verbatim(translated(plot.title))


def _same(plot: Plot) -> Plot:
    return plot


MOST_DRAWN = 6
"""Largest number of parameters that are drawn."""
CAPTIONS: Mapping[str, str] = {
    "subjects": marked("Points and bars: mean and standard deviation of the tests of each subject."),
    "sites": marked(
        "Circles: means of the subjects. Points and bars: mean and standard deviation of the subjects at each site."
    ),
    "variation": marked(
        "Standard deviation over mean: of the tests of a subject, and of the means of the subjects; mean of the sites."
    ),
    "first": marked(
        "Mean of the later tests less the first test. Circles: subjects. Points and bars: their mean and standard "
        "deviation."
    ),
    "by": marked("Points and bars: mean of the subjects of each group and its 95 % interval."),
    "on": marked("Points: means of the subjects. Lines: regression at each site."),
    "materials": marked(
        "Circles: tests of a material, or means of the subjects at a site. Points and bars: their mean and standard "
        "deviation."
    ),
    "curve": marked("From the mean constants C₁ and C₂; lines of sites are solid, those of materials are dashed."),
    "conditions": marked(
        "Change in percent of the reference. Circles: subjects. Points and bars: their mean and standard deviation."
    ),
    **CURVE_CAPTIONS,
}
"""What the signs of a figure are, by the first word of the key of its group."""
OF_SEVERAL = ("cv", "c")
"""Names of plots that show several parameters."""
_MOST_HALF, _LETTERS_HALF = 5, 44
"""Largest number of groups along the abscissa of a figure of half the width, and of letters of their names."""
_MOST_NAMES = 6
"""Largest number of names in the key of a figure of half the width."""
_HEIGHT, _ROW_OF_KEY = 3.0, 0.2
"""Height of a figure, and of a row of a long key, in inches."""
_AROUND = 0.9
"""Width of labels left of the axes of a figure, in inches."""
MOST_COMPARED = 10
"""Largest number of parameters that are drawn of conditions."""


def study_html(name: str, engine: str, found: StudyStatistics, failures: Mapping[str, str]) -> str:
    """Return the page as HTML text."""
    return template("study.html.j2").render(
        title=_("Study {name}").format(name=name),
        research_line=_(RESEARCH_LINE),
        simulated_line=simulated_line(found),
        software=SOFTWARE,
        facts=study_facts(found, engine),
        remarks=[translated(remark) for remark in found.remarks],
        failures=[(file, translated(reason)) for file, reason in failures.items()],
        groups=[_group(*item) for item in study_plots(found)],
        tables=tables_of(found),
        left_out=_("Left out"),
    )


def study_facts(found: StudyStatistics, engine: str) -> tuple[tuple[str, str], ...]:
    """Return names and values for the head of a report."""
    samples = sorted(map(str, found.samples["material"].unique())) if len(found.samples) else []
    return (
        (_("Subjects"), str(found.used["subject"].nunique())),
        (_("Sites"), "; ".join(sorted(map(str, found.used["site"].unique()))) or MISSING),
        *([(_("Materials"), "; ".join(samples))] if samples else []),
        (_("Tests that count"), str(len(found.used) + len(found.samples))),
        *([(_("Recorded"), dates)] if (dates := _dates(found)) else []),
        (_("Engine"), _(engine_label(engine))),
    )


def _dates(found: StudyStatistics) -> str:
    days = sorted(str(one)[:10] for table in (found.used, found.samples) if len(table) for one in table["created"])
    if not days or days[0] == days[-1]:
        return "".join(days[:1])
    return _("{first} to {last}").format(first=days[0], last=days[-1])


def simulated_line(found: StudyStatistics) -> str:
    """Return the remark that tests are simulated, with their number if others are not; "" if none is."""
    count, total = found.simulated_tests, len(found.used) + len(found.samples)
    if not count or count == total:
        return _(SIMULATED_LINE) if count else ""
    some = _("{count} of {total} tests are simulated.").format(count=count, total=total)
    return f"{_(SIMULATED_LINE)} {some}"


def tables_of(found: StudyStatistics) -> list[Table]:
    """Return all tables of a report: what does not count, the thesis and the study side by side, the statistics."""
    tables = [left_out_table(found.left_out)] if len(found.left_out) else []
    return tables + [one for key, rows in {**found.thesis, **found.tables}.items() for one in study_tables(key, rows)]


def study_plots(found: StudyStatistics) -> list[tuple[str, str, Plots]]:
    """Return key, heading and plots by parameter of each group of figures that has plots."""
    return [group for group in _figure_groups(found) if group[2]]


def _figure_groups(found: StudyStatistics) -> Iterator[tuple[str, str, Plots]]:
    names = found.parameters[:MOST_DRAWN]
    tables = found.tables
    if len(found.used):
        plain = found.used[found.used["condition"] == _reference(found)]
        means = found.means[found.means["condition"] == _reference(found)]
        yield "subjects", _("Subjects"), {name: partial(subjects_plot, plain, name) for name in names}
        yield "sites", _("Sites"), {name: partial(sites_plot, means, name) for name in names}
        if "variation" in tables:
            yield "variation", _("Variation"), {"cv": partial(variation_plot, tables["variation"])}
        if "first_test" in tables:
            plots: Plots = {name: partial(first_test_plot, plain, name) for name in names}
            yield "first", _(HEADINGS["first_test"]), plots
        for factor in _factors(tables.get("groups")):
            title = _("Groups: {factor}").format(factor=_(label_and_unit(factor)[0]))
            yield f"by-{factor}", title, {name: partial(groups_plot, means, factor, name) for name in names}
        rows = tables.get("regressions", pd.DataFrame())
        for regressor in _factors(rows):
            title = _("Regression: {quantity}").format(quantity=_(label_and_unit(regressor)[0]))
            plots = {name: partial(regression_plot, means, regressor, name, rows) for name in names}
            yield f"on-{regressor}", title, plots
    else:
        means = found.means
    if "materials" in tables:
        shown = dict.fromkeys(tables["materials"]["parameter"])
        plots = {name: partial(materials_plot, found.samples, means, name) for name in list(shown)[:MOST_DRAWN]}
        yield "materials", _(HEADINGS["materials"]), plots
    if {"c1_m", "c2_per_n"} <= set(found.parameters):
        yield "curve", _("Static nonlinearity"), {"c": partial(nonlinearity_plot, means, found.samples)}
    if "efficacy" in tables:
        before = str(tables["efficacy"]["before"].iloc[0])
        shown = dict.fromkeys(tables["efficacy"]["parameter"])
        plots = {name: partial(conditions_plot, found.means, before, name) for name in list(shown)[:MOST_COMPARED]}
        yield "conditions", _(HEADINGS["efficacy"]), plots
    yield from curve_figures(found)


def _reference(found: StudyStatistics) -> str:
    conditions = list(found.used["condition"].unique())
    return "" if "" in conditions else str(conditions[0])


def _factors(rows: pd.DataFrame | None) -> list[str]:
    return [] if rows is None or rows.empty else list(dict.fromkeys(rows["factor"]))


def _group(key: str, heading: str, plots: Plots) -> FigureGroup:
    made = {name: make() for name, make in plots.items()}
    wide = is_wide(made)
    panels = [
        _panel(f"{key}-{place if isinstance(name, Verbatim) else name}", name, plot, caption_of(key), wide=wide)
        for place, (name, plot) in enumerate(made.items())
    ]
    return FigureGroup(f"g-{key}", heading, tuple(panel.picture().block for panel in panels))


def caption_of(key: str) -> str:
    """Return what the signs of the figures of a group are."""
    return _(CAPTIONS[key.partition("-")[0]])


def is_wide(plots: Mapping[str, Plot]) -> bool:
    """Whether figures need the full width: they show several parameters, or have many groups or names."""
    names = [
        [translated(text) for _place, text in plot.x.ticks] for plot in plots.values() if plot.x.limits is not None
    ]
    many = any(
        len(one) > _MOST_HALF
        or len(one) * max((len(line) + 1 for text in one for line in text.split("\n")), default=0) > _LETTERS_HALF
        for one in names
    )
    many |= any(sum(bool(curve.name) for curve in plot.curves) > _MOST_NAMES for plot in plots.values())
    return many or bool(set(OF_SEVERAL) & set(plots))


def _panel(key: str, name: str, plot: Plot, caption: str, *, wide: bool) -> Panel:
    def draw(figure: FigureBase) -> None:
        axes = figure.subplots(1, 1)
        draw_plot(axes, plot, title=False, key=False)
        if plot.x.ticks:  # names, not the numbers of an axis
            turn_names(axes, (FULL_WIDTH if wide else HALF_WIDTH) - _AROUND)
        key_over(figure, axes)

    label, title = plot_label(name, plot), translated(plot.title)
    names = sum(bool(curve.name) for curve in plot.curves)
    height = _HEIGHT + _ROW_OF_KEY * max(0, names - _MOST_NAMES) / 2
    return Panel(key, label, title, f"{title}. {caption}", draw, wide=wide, height=height)


def plot_label(name: str, plot: Plot) -> str:
    """Return the heading of a figure: the parameter, or the title of a plot of several parameters or of a group."""
    return translated(plot.title) if name in OF_SEVERAL or isinstance(name, Verbatim) else _(label_and_unit(name)[0])
