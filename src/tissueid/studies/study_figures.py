"""The figures that the statistics of a study allow, by heading and parameter; none is computed before it is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import pandas as pd

from tissueid.analysis.curves.plot import Plot
from tissueid.formatting import label_and_unit
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.studies.study_plots import (
    first_test_plot,
    groups_plot,
    regression_plot,
    sites_plot,
    subjects_plot,
    variation_plot,
)
from tissueid.studies.study_statistics import StudyStatistics


@dataclass(frozen=True)
class StudyFigure:
    """Figures of one kind: ``plots`` return the plot by parameter, or by "" where it shows all parameters."""

    title: str
    plots: Mapping[str, Callable[[], Plot]]


def study_figures(found: StudyStatistics) -> list[StudyFigure]:
    """Return the figures of a study (Figs. 7.2 to 7.6), those that need a table only where it is not empty."""
    names, tables = found.parameters, found.tables
    figures = [
        StudyFigure(marked("Subjects"), {name: partial(subjects_plot, found.used, name) for name in names}),
        StudyFigure(marked("Sites"), {name: partial(sites_plot, found.means, name) for name in names}),
    ]
    if "variation" in tables:
        figures.append(StudyFigure(marked("Variation"), {"": partial(variation_plot, tables["variation"])}))
    if "first_test" in tables:
        plots = {name: partial(first_test_plot, found.used, name) for name in names}
        figures.append(StudyFigure(marked("First test against the later ones"), plots))
    for factor in _columns(tables, "groups"):
        plots = {name: partial(groups_plot, found.means, factor, name) for name in names}
        title = Message("study.by", "By {factor}", factor=_label(factor))
        figures.append(StudyFigure(title, plots))
    for regressor in _columns(tables, "regressions"):
        rows = tables["regressions"]
        plots = {name: partial(regression_plot, found.means, regressor, name, rows) for name in names}
        title = Message("study.against", "Against {quantity}", quantity=_label(regressor))
        figures.append(StudyFigure(title, plots))
    return [figure for figure in figures if figure.plots]


def _columns(tables: Mapping[str, pd.DataFrame], key: str) -> list[str]:
    """Return the factors of a table in their order."""
    return list(dict.fromkeys(tables[key]["factor"])) if key in tables else []


def _label(name: str) -> str:
    return label_and_unit(name)[0]
