"""Report of a study on paper: the same facts, figures and tables as the HTML page, on A4."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes

from tissueid.analysis.curves.plot import Plot
from tissueid.atomic_write import atomic_file
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.pdf import PageWriter
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.study import OF_SEVERAL, WIDE_GROUPS, plot_label, study_facts, study_plots, tables_of
from tissueid.reports.style import MUTED, drawing
from tissueid.reports.tables import Table
from tissueid.studies.study_statistics import StudyStatistics

_ACROSS = 105
"""Letters that fit across at 9 points."""
_PER_ROW = 2
"""Figures side by side."""
_TABLE_SIZE = 7.0
_MOST_LETTERS = 128
"""Letters of a row of a table; further columns follow in a second table."""


def write_study_pdf(path: Path, name: str, engine: str, found: StudyStatistics, failures: Mapping[str, str]) -> None:
    """Write the report of a study so that ``path`` is whole or untouched.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    written = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)  # letters that the font lacks
        _write(written, name, engine, found, failures)
    with atomic_file(path) as partial_file:
        partial_file.write_bytes(written.getvalue())


@drawing
def _write(target: io.BytesIO, name: str, engine: str, found: StudyStatistics, failures: Mapping[str, str]) -> None:
    paper = PageWriter()
    title = _("Study {name}").format(name=name)
    paper.line(title, size=17.0, bold=True)
    for label, value in study_facts(found, engine):
        for place, words in enumerate(textwrap.wrap(clean(value), _ACROSS - 20)):
            paper.line(label if not place else "", colour=MUTED)
            paper.text(2.0, words)
    paper.draw_rule()
    notes = [translated(remark) for remark in found.remarks]
    notes += [f"{file}: {translated(reason)}" for file, reason in failures.items()]
    if notes:
        paper.line(_("Left out"), size=11.0, bold=True)
        for note in notes:
            _wrapped(paper, note, size=9.0)
    for key, heading, plots in study_plots(found):
        _figures(paper, key, heading, plots)
    for table in tables_of(found):
        for part in _parts(table):
            paper.table(part.caption, part.head, part.rows, size=_TABLE_SIZE)
            if part.note:
                _wrapped(paper, part.note, size=8.0)
    paper.write(target, title)


def _wrapped(paper: PageWriter, text: str, *, size: float) -> None:
    for words in textwrap.wrap(clean(text), _ACROSS if size > 8.0 else round(_ACROSS * 9.0 / 8.0)):
        paper.line(words, size=size, colour=MUTED)


def _figures(paper: PageWriter, key: str, heading: str, plots: Mapping[str, Callable[[], Plot]]) -> None:
    made = [(name, make()) for name, make in plots.items()]
    wide = key in WIDE_GROUPS or bool(set(OF_SEVERAL) & set(plots))
    inches = 3.2 if wide else 2.9
    paper.ensure_room(inches + 0.8)
    paper.y -= 0.08
    paper.line(heading, size=11.0, bold=True)
    count = 1 if wide else _PER_ROW
    for first in range(0, len(made), count):
        row = made[first : first + count]
        paper.drawings([(plot_label(name, plot), partial(_draw, plot)) for name, plot in row], inches)


def _draw(plot: Plot, axes: Axes) -> None:
    draw_plot(axes, plot, title=False, key=False)
    names = axes.get_legend_handles_labels()[1]
    columns = 2 if len(names) < 5 else 5
    if len(names) > 1:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=columns, frameon=False, fontsize=6.0)


def _parts(table: Table) -> list[Table]:
    """Return a table in parts that fit across: each has the columns that say what the row is about."""
    widths = [
        max(round(8 * len(head) / 9), *(len(row[place]) for row in table.rows), 1) + 3
        for place, head in enumerate(table.head)
    ]
    if sum(widths) <= _MOST_LETTERS or len(widths) < 4:
        return [table]
    names = next((place for place, head in enumerate(table.head) if head == _("Parameter")), 0) + 1
    rest = list(range(names, len(widths)))
    parts = []
    while rest:
        room = _MOST_LETTERS - sum(widths[:names])
        taken = [rest.pop(0)]
        while rest and sum(widths[place] for place in taken) + widths[rest[0]] <= room:
            taken.append(rest.pop(0))
        places = [*range(names), *taken]
        rows = tuple(tuple(row[place] for place in places) for row in table.rows)
        parts.append(
            Table(table.caption, tuple(table.head[place] for place in places), rows, "" if rest else table.note)
        )
    return parts
