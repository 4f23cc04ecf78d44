"""Page of the figures and tables of the thesis and those made here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tissueid import __version__
from tissueid.analysis.curves.plot import Plot
from tissueid.formatting import fixed
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports.overlay import DrawnFigures, OverlayReport, grid_figure, overlay_scores
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, picture, template, write_text_atomically
from tissueid.reports.tables import Table


@dataclass(frozen=True)
class Row:
    """A quantity, the value of the thesis and the value here."""

    what: str
    thesis: str
    here: str


@dataclass(frozen=True, eq=False)
class ReproducedFigure:
    """A figure of the thesis with its comparison and its pictures; ``why`` says why it could not be made.

    ``remark`` says what differs by construction, ``warnings`` are those of its fits in this run. ``seconds`` is the
    time of fits and pictures, and ``against`` the heading of what it is compared with.
    """

    number: str
    title: str
    rows: tuple[Row, ...] = ()
    why: str = ""
    report: DrawnFigures | None = None
    remark: str = ""
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    against: str = marked("Thesis")


@dataclass(frozen=True, eq=False)
class PlotGrid:
    """Rows of plots that are one picture, with its texts in English."""

    key: str
    heading: str
    alt: str
    rows: Sequence[Sequence[Plot]]
    caption: str = ""
    row_height: float = 3.0
    over: bool = True


def drawn_grids(grids: Sequence[PlotGrid]) -> DrawnFigures:
    """Return grids of plots as pictures."""
    pictures = tuple(
        picture(
            grid.key,
            _(grid.heading),
            _(grid.alt),
            lambda grid=grid: (grid_figure(grid.rows, grid.row_height, over=grid.over), _(grid.caption)),  # type: ignore[misc]
        )
        for grid in grids
    )
    return DrawnFigures(pictures, tuple(plot for grid in grids for row in grid.rows for plot in row))


def write_reproduction(path: Path, made: Sequence[ReproducedFigure]) -> None:
    """Write the page of all figures atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    missing = tuple(f"{one.number}: {translated(one.why)}" for one in made if one.why)
    blocks = []
    for one in made:
        for drawn in () if one.report is None else one.report.pictures:
            key = f"{one.number.replace(' ', '-').replace('.', '-').lower()}-{drawn.key}"
            blocks.append(replace(drawn, key=key, heading=f"{one.number}. {drawn.heading}").block)
    write_text_atomically(
        path,
        template("stimulus.html.j2").render(
            title=_("Figures and tables of the thesis"),
            facts=((_("Figures"), ", ".join(one.number for one in made)),),
            research_line=_(RESEARCH_LINE),
            software=f"tissueid {__version__}",
            headline=_("{count} of {total} made").format(count=len(made) - len(missing), total=len(made)),
            level="check" if missing else "good",
            concerns=missing,
            summary=(_("Tests on the simulated instrument. The thesis is Chen, MIT, 2010."),),
            tables=tuple(comparison(one) for one in made if one.rows) + tuple(_scores(made)),
            group=FigureGroup("figures", _("Figures"), tuple(blocks)),
        ),
    )


def comparison(figure: ReproducedFigure) -> Table:
    """Return the numbers of the thesis and those found here."""
    return Table(
        f"{figure.number}. {translated(figure.title)}",
        (_("Quantity"), translated(figure.against), _("Here")),
        tuple((translated(row.what), translated(row.thesis), translated(row.here)) for row in figure.rows),
        " ".join(filter(None, (translated(figure.remark), *map(_as_sentence, map(translated, figure.warnings))))),
    )


def as_markdown(results: Mapping[str, Any]) -> str:
    """Return the numbers of a results file as Markdown: a section for each figure, in English.

    Args:
        results: content of ``results.json``.
    """
    parts = []
    for one in results["figures"]:
        name = f"Fig. {one['number']}" if one["number"][0].isdigit() else one["number"]
        lines = [f"### {name}: {one['title']}", ""]
        if one["rows"]:
            lines += [f"| quantity | {one['against'].lower()} | TissueID |", "| --- | --- | --- |"]
            lines += [
                f"| {_cell(row['what'])} | {_cell(row['thesis'])} | {_cell(row['here'])} |" for row in one["rows"]
            ]
            lines.append("")
        if one["why_missing"]:
            lines += [f"Not made: {one['why_missing']}.", ""]
        for text in filter(None, (one["remark"], *map(_as_sentence, one.get("warnings", ())))):
            lines += [text, ""]
        parts.append("\n".join(lines))
    seconds = float(results["seconds"])
    head = (
        f"{len(results['figures'])} figures and tables, {results['software']}, "
        f"{'quick run, ' if results['quick'] else ''}{fixed(seconds / 60.0, 1)} minutes.\n\n"
    )
    return head + "\n".join(parts)


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _scores(made: Sequence[ReproducedFigure]) -> list[Table]:
    tables = []
    for one in made:
        if isinstance(one.report, OverlayReport) and not one.report.found.swept:
            table = overlay_scores(one.report.found)
            tables.append(replace(table, caption=f"{one.number}. {table.caption}"))
    return tables


__all__ = ["PlotGrid", "ReproducedFigure", "Row", "as_markdown", "comparison", "drawn_grids", "write_reproduction"]
