"""Page of the figures and tables of the thesis and those made here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tissueid.formatting import fixed
from tissueid.language import _
from tissueid.messages import translated
from tissueid.reports.overlay_page import OverlayReport, overlay_scores
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, template, write_text_atomically
from tissueid.reports.tables import Table
from tissueid.version import SOFTWARE
from tissueid_lab.thesis.recipe import ReproducedFigure


def write_reproduction(path: Path, made: Sequence[ReproducedFigure]) -> None:
    """Write the page of all figures atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    missing = tuple(f"{one.figure.number}: {translated(one.why)}" for one in made if one.why)
    blocks, scores = [], []
    for one in made:
        number = one.figure.number
        for drawn in () if one.report is None else one.report.pictures:
            key = f"{number.replace(' ', '-').replace('.', '-').lower()}-{drawn.key}"
            blocks.append(replace(drawn, key=key, heading=f"{number}. {drawn.heading}").block)
        if isinstance(one.report, OverlayReport) and not one.report.found.swept:
            table = overlay_scores(one.report.found)
            scores.append(replace(table, caption=f"{number}. {table.caption}"))
    write_text_atomically(
        path,
        template("stimulus.html.j2").render(
            title=_("Figures and tables of the thesis"),
            facts=((_("Figures"), ", ".join(one.figure.number for one in made)),),
            research_line=_(RESEARCH_LINE),
            software=SOFTWARE,
            headline=_("{count} of {total} made").format(count=len(made) - len(missing), total=len(made)),
            level="check" if missing else "good",
            concerns=missing,
            summary=(_("Tests on the simulated instrument. The thesis is Chen, MIT, 2010."),),
            tables=(*(_comparison(one) for one in made if one.rows), *scores),
            group=FigureGroup("figures", _("Figures"), tuple(blocks)),
        ),
    )


def _comparison(one: ReproducedFigure) -> Table:
    figure = one.figure
    return Table(
        f"{figure.number}. {translated(figure.title)}",
        (_("Quantity"), translated(figure.against), _("Here")),
        tuple((translated(row.what), translated(row.thesis), translated(row.here)) for row in one.rows),
        " ".join(filter(None, (figure.remark, *map(_as_sentence, map(translated, one.warnings))))),
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
            columns = ("quantity", one["against"].lower(), "TissueID")
            rows = [columns, ("---", "---", "---"), *((row["what"], row["thesis"], row["here"]) for row in one["rows"])]
            lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows] + [""]
        if one["why_missing"]:
            lines += [f"Not made: {one['why_missing']}.", ""]
        for text in filter(None, (one["remark"], *map(_as_sentence, one.get("warnings", ())))):
            lines += [text, ""]
        parts.append("\n".join(lines))
    minutes = fixed(float(results["seconds"]) / 60.0, 1)
    quick = "quick run, " if results["quick"] else ""
    head = f"{len(results['figures'])} figures and tables, {results['software']}, {quick}{minutes} minutes.\n\n"
    return head + "\n".join(parts)


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
