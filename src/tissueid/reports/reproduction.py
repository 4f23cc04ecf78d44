"""Page of the figures and tables of the thesis and those made here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tissueid import __version__
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.html import RESEARCH_LINE, template, write_text_atomically
from tissueid.reports.overlay import DrawnFigures, OverlayReport, overlay_scores
from tissueid.reports.tables import Table


@dataclass(frozen=True)
class Row:
    """A quantity, the value of the thesis and the value here."""

    what: str
    thesis: str
    here: str


@dataclass(frozen=True, eq=False)
class ReproducedFigure:
    """A figure of the thesis with its comparison and its pictures; ``why`` says why it could not be made."""

    number: str
    title: str
    rows: tuple[Row, ...] = ()
    why: str = ""
    report: DrawnFigures | None = None


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
        (_("Quantity"), _("Thesis"), _("Here")),
        tuple((translated(row.what), translated(row.thesis), translated(row.here)) for row in figure.rows),
    )


def _scores(made: Sequence[ReproducedFigure]) -> list[Table]:
    tables = []
    for one in made:
        if isinstance(one.report, OverlayReport) and not one.report.found.swept:
            table = overlay_scores(one.report.found)
            tables.append(replace(table, caption=f"{one.number}. {table.caption}"))
    return tables


__all__ = ["ReproducedFigure", "Row", "comparison", "write_reproduction"]
