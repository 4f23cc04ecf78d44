"""Report of a study as one self-contained page, and on paper (A4) with the same facts, figures and tables."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib.artist import Artist
from matplotlib.figure import Figure, FigureBase

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
from tissueid.formatting import clean, label_and_unit
from tissueid.identification import engine_label
from tissueid.language import _, marked
from tissueid.messages import MISSING, Verbatim, translated
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, template
from tissueid.reports.pdf import TEXT_WIDTH, PageWriter, key_size, text_width, write_pages
from tissueid.reports.plot_axes import turn_names
from tissueid.reports.plot_renderer import draw_plot, key_over
from tissueid.reports.study_tables import ABOUT, COLUMNS, HEADINGS, left_out_table, study_tables
from tissueid.reports.style import FULL_WIDTH, HALF_WIDTH, MUTED
from tissueid.reports.tables import Table
from tissueid.studies.curve_groups import By, GroupCurve, chosen, directions
from tissueid.studies.study_plots import (
    component_curves,
    component_panels,
    conditions_plot,
    curve_plot,
    first_test_plot,
    groups_plot,
    kernel_panel,
    materials_plot,
    name_of,
    nonlinearity_plot,
    regression_plot,
    scores_plot,
    shared_limit,
    sites_plot,
    subjects_plot,
    title_of,
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


def curve_figures(statistics: StudyStatistics) -> Iterator[tuple[str, str, Plots]]:
    """Yield key, heading and plots of each group of figures of curves, of kernels and of principal components."""
    for kind, heading in _HEADINGS.items():
        for by, heading_template in _GROUPS.items():
            if kind in _CURVES:
                plots = _lines(statistics.curves, by, _CURVES[kind])
            else:
                plots = _panels(chosen(statistics.curves, by, _PANELS[kind]))
            if plots:
                yield f"{kind}-{by}", _(heading_template).format(figure=_(heading)), plots
    if plots := _lines(statistics.curves, "change", _CURVES["depth"]):
        yield "change-depth", _("Change against depth: conditions"), plots
    for components in statistics.components:
        order = _(_ORDERS[components.curve])
        number, shown = (
            ("1", [component_curves(components)])
            if components.curve == KERNEL1
            else ("2", component_panels(components))
        )
        yield f"components{number}-all", _("Principal components, {kernel}").format(kernel=order), _drawn(shown)
        if len(components.names) > 1:
            plots = _drawn([scores_plot(components)])
            yield f"scores-{number}", _("Scores of the components, {kernel}").format(kernel=order), plots


def _lines(curves: Sequence[GroupCurve], by: By, names: Sequence[str]) -> Plots:
    own = [chosen(curves, by, name) for name in names]
    groups = list(dict.fromkeys(curve.group for some in own for curve in some))
    plots: dict[str, Callable[[], Plot]] = {}
    for some in own:
        for way in directions(some):
            shown = [curve for curve in some if curve.direction == way]
            plots[Verbatim(translated(title_of(shown[0], groups)))] = partial(curve_plot, shown, groups)
    return plots


def _panels(curves: Sequence[GroupCurve]) -> Plots:
    if not curves:
        return {}
    limit = shared_limit(curves)
    return {Verbatim(translated(name_of(curve))): partial(kernel_panel, curve, limit) for curve in curves[:MOST_PANELS]}


def _drawn(plots: Iterable[Plot]) -> Plots:
    """Return plots that are computed already by their titles."""
    return {Verbatim(translated(plot.title)): partial(replace, plot) for plot in plots}


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


def study_html(name: str, engine: str, statistics: StudyStatistics, failures: Mapping[str, str]) -> str:
    """Return the page as HTML text."""
    return template("study.html.j2").render(
        title=_("Study {name}").format(name=name),
        research_line=_(RESEARCH_LINE),
        simulated_line=simulated_line(statistics),
        software=SOFTWARE,
        facts=study_facts(statistics, engine),
        remarks=[translated(remark) for remark in statistics.remarks],
        failures=[(file, translated(reason)) for file, reason in failures.items()],
        groups=[_group(*item) for item in study_plots(statistics)],
        tables=tables_of(statistics),
        left_out=_("Left out"),
    )


def study_facts(statistics: StudyStatistics, engine: str) -> tuple[tuple[str, str], ...]:
    """Return names and values for the head of a report."""
    samples = sorted(map(str, statistics.samples["material"].unique())) if len(statistics.samples) else []
    return (
        (_("Subjects"), str(statistics.used["subject"].nunique())),
        (_("Sites"), "; ".join(sorted(map(str, statistics.used["site"].unique()))) or MISSING),
        *([(_("Materials"), "; ".join(samples))] if samples else []),
        (_("Tests that count"), str(len(statistics.used) + len(statistics.samples))),
        *([(_("Recorded"), dates)] if (dates := _dates(statistics)) else []),
        (_("Engine"), _(engine_label(engine))),
    )


def _dates(statistics: StudyStatistics) -> str:
    days = sorted(
        str(date)[:10] for table in (statistics.used, statistics.samples) if len(table) for date in table["created"]
    )
    if not days or days[0] == days[-1]:
        return "".join(days[:1])
    return _("{first} to {last}").format(first=days[0], last=days[-1])


def simulated_line(statistics: StudyStatistics) -> str:
    """Return the remark that tests are simulated, with their number if others are not; "" if none is."""
    count, total = statistics.simulated_tests, len(statistics.used) + len(statistics.samples)
    if not count or count == total:
        return _(SIMULATED_LINE) if count else ""
    some = _("{count} of {total} tests are simulated.").format(count=count, total=total)
    return f"{_(SIMULATED_LINE)} {some}"


def tables_of(statistics: StudyStatistics) -> list[Table]:
    """Return all tables of a report: what does not count, the thesis and the study side by side, the statistics."""
    tables = [left_out_table(statistics.left_out)] if len(statistics.left_out) else []
    return tables + [
        table for key, rows in {**statistics.thesis, **statistics.tables}.items() for table in study_tables(key, rows)
    ]


def study_plots(statistics: StudyStatistics) -> list[tuple[str, str, Plots]]:
    """Return key, heading and plots by parameter of each group of figures that has plots."""
    return [group for group in _figure_groups(statistics) if group[2]]


def _figure_groups(statistics: StudyStatistics) -> Iterator[tuple[str, str, Plots]]:
    names = statistics.parameters[:MOST_DRAWN]
    tables = statistics.tables
    if len(statistics.used):
        plain = statistics.used[statistics.used["condition"] == _reference(statistics)]
        means = statistics.means[statistics.means["condition"] == _reference(statistics)]
        yield "subjects", _("Subjects"), {name: partial(subjects_plot, plain, name) for name in names}
        yield "sites", _("Sites"), {name: partial(sites_plot, means, name) for name in names}
        if "variation" in tables:
            yield "variation", _("Variation"), {"cv": partial(variation_plot, tables["variation"])}
        if "first_test" in tables:
            plots: Plots = {name: partial(first_test_plot, plain, name) for name in names}
            yield "first", _(HEADINGS["first_test"]), plots
        for factor in _factors(tables.get("groups", pd.DataFrame())):
            title = _("Groups: {factor}").format(factor=_(label_and_unit(factor)[0]))
            yield f"by-{factor}", title, {name: partial(groups_plot, means, factor, name) for name in names}
        rows = tables.get("regressions", pd.DataFrame())
        for regressor in _factors(rows):
            title = _("Regression: {quantity}").format(quantity=_(label_and_unit(regressor)[0]))
            plots = {name: partial(regression_plot, means, regressor, name, rows) for name in names}
            yield f"on-{regressor}", title, plots
    else:
        means = statistics.means
    if "materials" in tables:
        shown = dict.fromkeys(tables["materials"]["parameter"])
        plots = {name: partial(materials_plot, statistics.samples, means, name) for name in list(shown)[:MOST_DRAWN]}
        yield "materials", _(HEADINGS["materials"]), plots
    if {"c1_m", "c2_per_n"} <= set(statistics.parameters):
        yield "curve", _("Static nonlinearity"), {"c": partial(nonlinearity_plot, means, statistics.samples)}
    if "efficacy" in tables:
        before = str(tables["efficacy"]["before"].iloc[0])
        shown = dict.fromkeys(tables["efficacy"]["parameter"])
        plots = {name: partial(conditions_plot, statistics.means, before, name) for name in list(shown)[:MOST_COMPARED]}
        yield "conditions", _(HEADINGS["efficacy"]), plots
    yield from curve_figures(statistics)


def _reference(statistics: StudyStatistics) -> str:
    conditions = list(statistics.used["condition"].unique())
    return "" if "" in conditions else str(conditions[0])


def _factors(rows: pd.DataFrame) -> list[str]:
    return [] if rows.empty else list(dict.fromkeys(rows["factor"]))


def _group(key: str, heading: str, plots: Plots) -> FigureGroup:
    made = {name: make() for name, make in plots.items()}
    wide = is_wide(made)
    panels = [
        _panel(f"{key}-{index if isinstance(name, Verbatim) else name}", name, plot, caption_of(key), wide=wide)
        for index, (name, plot) in enumerate(made.items())
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
        len(texts) > _MOST_HALF
        or len(texts) * max((len(line) + 1 for text in texts for line in text.split("\n")), default=0) > _LETTERS_HALF
        for texts in names
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


_ACROSS, _ACROSS_SMALL = 105, 118
"""Letters that fit across at 9 points, and at 8."""
_PER_ROW = 2
"""Figures side by side."""
_ROW_INCHES, _HEAD_INCHES = 2.15, 0.5
"""Height of a row of figures, and of the heading and explanation above the first."""
_SHORTEST_HEAD = 6
"""Smallest number of letters in a line of the head of a column."""
_TABLE_SIZES = (7.5, 7.0, 6.6)
"""Sizes of letters in tables, in points: the first at which a table fits across, or the last."""
_COLUMN_GAP = 0.1
"""Inches between columns of a table; columns that do not fit follow in a second table."""
_LETTERS_PER_INCH = 17
"""Letters of text of 7 points that fit in an inch."""
_MEASURED = 8
"""Number of the longest cells of a column that are measured."""


def write_study_pdf(
    path: Path, name: str, engine: str, statistics: StudyStatistics, failures: Mapping[str, str]
) -> None:
    """Write the report of a study so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    title = _("Study {name}").format(name=name)
    write_pages(path, title, partial(_draw_pages, title=title, engine=engine, statistics=statistics, failures=failures))


def _draw_pages(
    paper: PageWriter, title: str, engine: str, statistics: StudyStatistics, failures: Mapping[str, str]
) -> None:
    paper.line(title, size=17.0, bold=True)
    for label, value in study_facts(statistics, engine):
        for index, line in enumerate(textwrap.wrap(clean(value), _ACROSS - 20)):
            paper.line(label if not index else "", colour=MUTED)
            paper.text(2.0, line)
    if simulated := simulated_line(statistics):
        paper.line(simulated, bold=True)
    paper.draw_rule()
    notes = [translated(remark) for remark in statistics.remarks]
    notes += [f"{file}: {translated(reason)}" for file, reason in failures.items()]
    if notes:
        paper.line(_("Left out"), size=11.0, bold=True)
        for note in notes:
            paper.wrapped(note, size=9.0, across=_ACROSS)
    for key, heading, plots in study_plots(statistics):
        _figures(paper, key, heading, plots)
    for table in tables_of(statistics):
        broken = _with_broken_heads(table)
        size = next((candidate for candidate in _TABLE_SIZES if len(_parts(broken, candidate)) == 1), _TABLE_SIZES[-1])
        for part, widths in _parts(broken, size):
            paper.table(part.caption, part.head, part.rows, size=size, widths=widths)
            paper.wrapped(part.note, across=_ACROSS_SMALL)


def _figures(paper: PageWriter, key: str, heading: str, plots: Mapping[str, Callable[[], Plot]]) -> None:
    made = {name: make() for name, make in plots.items()}
    count = 1 if is_wide(made) else _PER_ROW
    names = list(made)
    handles = _key_of(made[names[0]])
    key_height = key_size(handles[1])[1]
    paper.ensure_room(_ROW_INCHES + key_height + _HEAD_INCHES)
    paper.y -= 0.08
    paper.line(heading, size=11.0, bold=True)
    paper.wrapped(caption_of(key), across=_ACROSS_SMALL)
    page = None
    for first in range(0, len(names), count):
        row = [
            (plot_label(name, made[name]), partial(draw_plot, plot=made[name], title=False, key=False))
            for name in names[first : first + count]
        ]
        paper.ensure_room(_ROW_INCHES + (0.0 if page else key_height))
        if paper.pages[-1] is not page:  # the key stands once on each page
            if page is not None:
                paper.line(_("{heading}, continued").format(heading=heading), colour=MUTED)
            page = paper.pages[-1]
            paper.key(*handles)
        paper.drawings(row, _ROW_INCHES, count)


def _key_of(plot: Plot) -> tuple[list[Artist], list[str]]:
    """Return signs and names of the curves of a plot, drawn on invisible axes."""
    axes = Figure().subplots()
    draw_plot(axes, plot, title=False, key=False)
    handles, names = axes.get_legend_handles_labels()
    return (list(handles), names) if len(names) > 1 else ([], [])


def _with_broken_heads(table: Table) -> Table:
    """Return a table whose heads are broken into lines that are no longer than the cells below them."""
    heads = []
    for column, head in enumerate(table.head):
        most = max(_SHORTEST_HEAD, *(len(row[column]) for row in table.rows), *map(len, head.split()))
        heads.append("\n".join(textwrap.wrap(head, most)))
    return replace(table, head=tuple(heads))


def _parts(table: Table, size: float) -> list[tuple[Table, list[float]]]:
    """Return a table in parts that fit across, with the widths of their columns in inches.

    Each part has the columns that say what the row is about.
    """
    widths = [_width(head, [row[column] for row in table.rows], size) for column, head in enumerate(table.head)]
    about = {_(COLUMNS[name]) for name in ABOUT}
    names = sum(1 for head in table.head if head.replace("\n", " ") in about)
    rest = list(range(names, len(widths)))
    parts = []
    while rest:
        room = TEXT_WIDTH + _COLUMN_GAP - sum(widths[:names])
        taken = [rest.pop(0)]
        while rest and sum(widths[column] for column in taken) + widths[rest[0]] <= room:
            taken.append(rest.pop(0))
        places = [*range(names), *taken]
        rows = tuple(tuple(row[column] for column in places) for row in table.rows)
        before = sum(widths[column] for column in places[:-1])
        if before + widths[places[-1]] > TEXT_WIDTH + _COLUMN_GAP:
            rows = _wrapped_rows(rows, int(max(TEXT_WIDTH - before, 1.0) * _LETTERS_PER_INCH * 7.0 / size))
        head = tuple(table.head[column] for column in places)
        part = Table(table.caption, head, rows, "" if rest else table.note)
        parts.append((part, [widths[column] for column in places]))
    return parts


def _wrapped_rows(rows: Sequence[Sequence[str]], most: int) -> tuple[tuple[str, ...], ...]:
    """Return rows whose last cells are continued in further rows after ``most`` letters."""
    wrapped: list[tuple[str, ...]] = []
    for *first, last in rows:
        for index, line in enumerate(textwrap.wrap(last, most) or [""]):
            wrapped.append((*(first if not index else [""] * len(first)), line))
    return tuple(wrapped)


def _width(head: str, cells: Sequence[str], size: float) -> float:
    longest = sorted(set(cells), key=len)[-_MEASURED:]
    widths = [text_width(clean(cell), size) for cell in longest]
    heads = [text_width(line, 8.0 * size / 9.0) for line in head.split("\n")]
    return max(*widths, *heads, 0.0) + _COLUMN_GAP
