"""Report of a study on paper: the same facts, figures and tables as the HTML page, on A4."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tissueid.analysis.curves.plot import Plot
from tissueid.atomic_write import atomic_file
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.pdf import TEXT_WIDTH, PageWriter, key_size, text_width
from tissueid.reports.plot_renderer import draw_plot
from tissueid.reports.study import caption_of, is_wide, plot_label, simulated_line, study_facts, study_plots, tables_of
from tissueid.reports.study_tables import ABOUT, COLUMNS
from tissueid.reports.style import MUTED, drawing
from tissueid.reports.tables import Table
from tissueid.studies.study_statistics import StudyStatistics

_ACROSS = 105
"""Letters that fit across at 9 points."""
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
    if simulated := simulated_line(found):
        paper.line(simulated, bold=True)
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
        broken = _with_broken_heads(table)
        size = next((one for one in _TABLE_SIZES if len(_parts(broken, one)) == 1), _TABLE_SIZES[-1])
        for part, widths in _parts(broken, size):
            paper.table(part.caption, part.head, part.rows, size=size, widths=widths)
            if part.note:
                _wrapped(paper, part.note, size=8.0)
    paper.write(target, title)


def _wrapped(paper: PageWriter, text: str, *, size: float) -> None:
    for words in textwrap.wrap(clean(text), _ACROSS if size > 8.0 else round(_ACROSS * 9.0 / 8.0)):
        paper.line(words, size=size, colour=MUTED)


def _figures(paper: PageWriter, key: str, heading: str, plots: Mapping[str, Callable[[], Plot]]) -> None:
    made = {name: make() for name, make in plots.items()}
    count = 1 if is_wide(made) else _PER_ROW
    names = list(made)
    handles = _key_of(made[names[0]])
    key_height = key_size(handles[1])[1]
    caption = caption_of(key)
    paper.ensure_room(_ROW_INCHES + key_height + _HEAD_INCHES)
    paper.y -= 0.08
    paper.line(heading, size=11.0, bold=True)
    _wrapped(paper, caption, size=8.0)
    page = None
    for first in range(0, len(names), count):
        row = [(plot_label(name, made[name]), partial(_draw, made[name])) for name in names[first : first + count]]
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


def _draw(plot: Plot, axes: Axes) -> None:
    draw_plot(axes, plot, title=False, key=False)


def _with_broken_heads(table: Table) -> Table:
    """Return a table whose heads are broken into lines that are no longer than the cells below them."""
    heads = []
    for place, head in enumerate(table.head):
        most = max((len(row[place]) for row in table.rows), default=0)
        longest = max(map(len, head.split()), default=1)
        heads.append("\n".join(textwrap.wrap(head, max(most, longest, _SHORTEST_HEAD))))
    return Table(table.caption, tuple(heads), table.rows, table.note)


def _parts(table: Table, size: float) -> list[tuple[Table, list[float]]]:
    """Return a table in parts that fit across, with the widths of their columns in inches.

    Each part has the columns that say what the row is about.
    """
    widths = [_width(head, [row[place] for row in table.rows], size) for place, head in enumerate(table.head)]
    about = {_(COLUMNS[name]) for name in ABOUT}
    names = sum(1 for head in table.head if head.replace("\n", " ") in about)
    rest = list(range(names, len(widths)))
    parts = []
    while rest:
        room = TEXT_WIDTH + _COLUMN_GAP - sum(widths[:names])
        taken = [rest.pop(0)]
        while rest and sum(widths[place] for place in taken) + widths[rest[0]] <= room:
            taken.append(rest.pop(0))
        places = [*range(names), *taken]
        rows = tuple(tuple(row[place] for place in places) for row in table.rows)
        before = sum(widths[place] for place in places[:-1])
        if before + widths[places[-1]] > TEXT_WIDTH + _COLUMN_GAP:
            rows = _wrapped_rows(rows, int(max(TEXT_WIDTH - before, 1.0) * _LETTERS_PER_INCH * 7.0 / size))
        head = tuple(table.head[place] for place in places)
        part = Table(table.caption, head, rows, "" if rest else table.note)
        parts.append((part, [widths[place] for place in places]))
    return parts


def _wrapped_rows(rows: Sequence[Sequence[str]], most: int) -> tuple[tuple[str, ...], ...]:
    """Return rows whose last cells are continued in further rows after ``most`` letters."""
    wrapped: list[tuple[str, ...]] = []
    for *first, last in rows:
        for place, words in enumerate(textwrap.wrap(last, most) or [""]):
            wrapped.append((*(first if not place else [""] * len(first)), words))
    return tuple(wrapped)


def _width(head: str, cells: Sequence[str], size: float) -> float:
    longest = sorted(set(cells), key=len)[-_MEASURED:]
    widths = [text_width(clean(words), size) for words in longest]
    heads = [text_width(line, 8.0 * size / 9.0) for line in head.split("\n")]
    return max(*widths, *heads, 0.0) + _COLUMN_GAP
