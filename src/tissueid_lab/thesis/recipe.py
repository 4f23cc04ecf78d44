"""Form of a recipe: tests on simulated tissues, fits, pictures, and what the thesis found; its page and text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar

from tissueid.analysis.curves.plot import Plot
from tissueid.analysis.overlay import Overlay, OverlayEntry
from tissueid.configuration import CouplingName
from tissueid.formatting import fixed
from tissueid.identification.base import Model
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.records import Record
from tissueid.reports.overlay_page import DrawnFigures, OverlayReport, grid_figure, overlay_scores
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, picture, template, write_text_atomically
from tissueid.reports.tables import Table
from tissueid.sessions import Session
from tissueid.version import SOFTWARE

_QUICK_SECONDS = 2.0
"""Longest test of a quick run, s."""
_QUICK_STEP_M = 0.005
"""Distance of the positions of the sweep of a quick run, m."""

FittedModel = TypeVar("FittedModel", bound=Model)


class NumberRow(NamedTuple):
    """A quantity, the value of the thesis and the value here."""

    what: str
    thesis: str
    here: str


Outcome = tuple[DrawnFigures, Sequence[NumberRow]]
"""Pictures and comparison of a figure."""


@dataclass(frozen=True)
class Recording:
    """A test on a simulated tissue: noise over a range of force, N, after its preload.

    ``options`` are further options of the stimulus. ``name`` is that of its file. With ``stimulus`` "rtig" the depth is
    distributed by feedback; "sweep" is a dynamic sweep, whose ``options`` are those of the sweep. ``coil`` is that
    of the instrument: ideal, or finite; ``rate_hz`` is its sample rate. ``coupling`` is what attaches the probe, which
    can then pull. A ``quick`` recording is shorter, and played on an instrument that is not restarted for each test.
    """

    name: str
    preset: str
    force_n: tuple[float, float] = (-3.5, 10.5)
    seconds: float = 4.0
    seed: int = 1
    distribution: str = "uniform"
    options: tuple[tuple[str, Any], ...] = ()
    stimulus: Literal["noise", "rtig", "sweep"] = "noise"
    coil: str = "ideal"
    rate_hz: float = 2000.0
    coupling: CouplingName = "none"
    quick: bool = False

    def shortened(self) -> Recording:
        """Return the recording of a quick run, with a file of its own."""
        options = dict(self.options) | ({"step_m": _QUICK_STEP_M} if self.stimulus == "sweep" else {})
        seconds = min(self.seconds, _QUICK_SECONDS)
        return replace(self, name=f"{self.name}-quick", seconds=seconds, options=tuple(options.items()), quick=True)


@dataclass(frozen=True)
class RecipeSource:
    """A recording in a figure: its label, and the labels of the fits that are run on it; empty for all."""

    label: str
    recording: Recording
    fits: tuple[str, ...] = ()


@dataclass(frozen=True)
class Published:
    """A published figure, table or benchmark; ``remark`` says what differs by construction."""

    against: ClassVar[str] = marked("Thesis")
    """Heading of the published numbers."""
    number: str
    title: str
    remark: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class ThesisFigure(Published):
    """A figure or table: tests, fits ([LABEL=]ENGINE,OPTION=VALUE), pictures, and the comparison.

    ``pictures`` are keys of ``reports.overlay_page``. One function compares: ``rows`` or ``drawn``, which makes further
    pictures, from the fits; ``recorded`` from the sessions by label; or ``study`` without tests, whose argument is
    whether the run is quick. ``vafs`` are rows of a VAF, before the others: quantity, value of the thesis, source
    and fit, "" for the first. The other arguments are those of ``analysis.overlay.overlay``.
    """

    sources: tuple[RecipeSource, ...] = ()
    fits: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()
    rows: Callable[[Overlay], Sequence[NumberRow]] | None = None
    vafs: tuple[tuple[str, str, str, str], ...] = ()
    whole: bool = True
    downsample: int = 1
    sweep: tuple[str, tuple[float, ...]] = ("", ())
    calibration: bool = False
    drawn: Callable[[Overlay], Outcome] | None = None
    recorded: Callable[[Mapping[str, Session]], Outcome] | None = None
    study: Callable[[bool], Outcome] | None = None


@dataclass(frozen=True, eq=False)
class ReproducedFigure:
    """A figure with its comparison and its pictures; ``why`` says why it could not be made.

    ``warnings`` are those of its fits in this run. ``seconds`` is the time of fits and pictures.
    """

    figure: Published
    rows: tuple[NumberRow, ...] = ()
    why: str = ""
    report: DrawnFigures | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0


def drawn_grid(
    key: str,
    heading: str,
    alt: str,
    rows: Sequence[Sequence[Plot]],
    *,
    caption: str = "",
    row_height: float = 3.0,
    over: bool = False,
) -> DrawnFigures:
    """Return rows of plots as one picture, with its texts in English; ``over`` puts one key over the whole picture."""
    made = picture(key, _(heading), _(alt), lambda: (grid_figure(rows, row_height, over=over), _(caption)))
    return DrawnFigures((made,), tuple(plot for row in rows for plot in row))


def entry_of(overlay: Overlay, source: str = "", fit: str = "") -> OverlayEntry:
    """Return the first entry of a source and a fit; "" for any."""
    return next(entry for entry in overlay.entries if source in ("", entry.source) and fit in ("", entry.fit.label))


def fitted(
    overlay: Overlay, kind: type[FittedModel], fit: str = "", source: str = ""
) -> tuple[FittedModel, Record, slice]:
    """Return the model of a kind, its record and the part that it was fitted to, of a source and a fit."""
    analysis = entry_of(overlay, source, fit).analysis
    assert isinstance(analysis.model, kind)
    return analysis.model, analysis.record, analysis.fit_part


def shown_vaf(overlay: Overlay, source: str = "", fit: str = "") -> str:
    """Return the VAF of the fitted samples, scheduled where the model has a schedule."""
    return percent(entry_of(overlay, source, fit).shown_percent)


def percent(value: float) -> str:
    """Return a percentage with one decimal."""
    return f"{fixed(value, 1)} %"


def write_reproduction(path: Path, made: Sequence[ReproducedFigure]) -> None:
    """Write the page of all figures atomically.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable.
    """
    missing = tuple(
        f"{reproduced.figure.number}: {translated(reproduced.why)}" for reproduced in made if reproduced.why
    )
    blocks, scores = [], []
    for reproduced in made:
        number = reproduced.figure.number
        for drawn in () if reproduced.report is None else reproduced.report.pictures:
            key = f"{number.replace(' ', '-').replace('.', '-').lower()}-{drawn.key}"
            blocks.append(replace(drawn, key=key, heading=f"{number}. {drawn.heading}").block)
        if isinstance(reproduced.report, OverlayReport) and not reproduced.report.overlay.swept:
            table = overlay_scores(reproduced.report.overlay)
            scores.append(replace(table, caption=f"{number}. {table.caption}"))
    write_text_atomically(
        path,
        template("stimulus.html.j2").render(
            title=_("Figures and tables of the thesis"),
            facts=((_("Figures"), ", ".join(reproduced.figure.number for reproduced in made)),),
            research_line=_(RESEARCH_LINE),
            software=SOFTWARE,
            headline=_("{count} of {total} made").format(count=len(made) - len(missing), total=len(made)),
            level="check" if missing else "good",
            concerns=missing,
            summary=(_("Tests on the simulated instrument. The thesis is Chen, MIT, 2010."),),
            tables=(*(_comparison(reproduced) for reproduced in made if reproduced.rows), *scores),
            group=FigureGroup("figures", _("Figures"), tuple(blocks)),
        ),
    )


def _comparison(reproduced: ReproducedFigure) -> Table:
    figure = reproduced.figure
    return Table(
        f"{figure.number}. {translated(figure.title)}",
        (_("Quantity"), translated(figure.against), _("Here")),
        tuple((translated(row.what), translated(row.thesis), translated(row.here)) for row in reproduced.rows),
        " ".join(filter(None, (figure.remark, *map(_as_sentence, map(translated, reproduced.warnings))))),
    )


def as_markdown(results: Mapping[str, Any]) -> str:
    """Return the numbers of a results file as Markdown: a section for each figure, in English.

    Args:
        results: content of ``results.json``.
    """
    parts = []
    for figure in results["figures"]:
        name = f"Fig. {figure['number']}" if figure["number"][0].isdigit() else figure["number"]
        lines = [f"### {name}: {figure['title']}", ""]
        if figure["rows"]:
            columns = ("quantity", figure["against"].lower(), "TissueID")
            rows = [
                columns,
                ("---", "---", "---"),
                *((row["what"], row["thesis"], row["here"]) for row in figure["rows"]),
            ]
            lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows] + [""]
        if figure["why_missing"]:
            lines += [f"Not made: {figure['why_missing']}.", ""]
        for text in filter(None, (figure["remark"], *map(_as_sentence, figure.get("warnings", ())))):
            lines += [text, ""]
        parts.append("\n".join(lines))
    minutes = fixed(float(results["seconds"]) / 60.0, 1)
    quick = "quick run, " if results["quick"] else ""
    head = f"{len(results['figures'])} figures and tables, {results['software']}, {quick}{minutes} minutes.\n\n"
    return head + "\n".join(parts)


def _as_sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
