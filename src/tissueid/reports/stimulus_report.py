"""Report of a designed stimulus or a calibration: a page, or one sheet of figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tissueid.analysis.curves.feedback import FeedbackRun
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.formatting import fixed, grouped
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports.feedback_panels import feedback_panels
from tissueid.reports.page import RESEARCH_LINE, FigureGroup, Panel, draw_sheet, template, write_text_atomically
from tissueid.reports.stimulus_panels import stimulus_panels
from tissueid.reports.style import plain_image
from tissueid.reports.tables import Table, named_text
from tissueid.stimuli import FeedbackKind
from tissueid.stimuli.stimulus_check import StimulusCheck
from tissueid.version import SOFTWARE

FAR = 0.08
"""Kolmogorov distance from the desired distribution of depth above which the report shows a caution."""

FORMS: dict[str, tuple[str | bytes, ...]] = {
    ".html": ("<!DOCTYPE html",),
    ".pdf": ("%PDF",),
    ".png": (b"\x89PNG",),
    ".svg": ("<?xml", "<svg"),
}
"""File name suffixes of reports, and the first bytes of such files."""


@dataclass(frozen=True, eq=False)
class StimulusReport:
    """A report of verdict, tables and figures in the active language; ``facts`` are label and value."""

    title: str
    facts: tuple[tuple[str, str], ...]
    headline: str
    level: Literal["good", "check", "poor"]
    concerns: tuple[str, ...]
    summary: tuple[str, ...]
    tables: tuple[Table, ...]
    panels: tuple[Panel, ...]

    def html(self) -> str:
        """Return the page: verdict, figures, tables."""
        blocks = tuple(panel.picture().block for panel in self.panels)
        return template("stimulus.html.j2").render(
            title=self.title,
            facts=self.facts,
            research_line=_(RESEARCH_LINE),
            software=SOFTWARE,
            headline=self.headline,
            level=self.level,
            concerns=self.concerns,
            summary=self.summary,
            tables=self.tables,
            group=FigureGroup("figures", _("Figures"), blocks),
        )

    def write(self, path: Path) -> None:
        """Write a page or a sheet of all figures atomically; the suffix of the name chooses the form (``FORMS``).

        Raises:
            UnusableInputError: the suffix is not one of them, or there is nothing to draw.
            OSError: the folder is missing, or the disk is full or not writable.
        """
        form = output_suffix(path)
        if form == ".html":
            write_text_atomically(path, self.html())
            return
        figure = draw_sheet(self.title, self.panels)
        with atomic_file(path) as partial:
            plain_image(figure, partial, "pdf" if form == ".pdf" else "svg" if form == ".svg" else "png")


def output_suffix(path: Path) -> str:
    """Return the suffix of a file name, one of ``FORMS``.

    Raises:
        UnusableInputError: the suffix is not one of ``FORMS``.
    """
    form = path.suffix.lower()
    if form not in FORMS:
        raise UnusableInputError(
            "report.unknown_form",
            "the file name of a plot must end in {forms}, got {name}",
            forms=", ".join(FORMS),
            name=path.name,
        )
    return form


def judged(found: StimulusCheck) -> tuple[str, Literal["good", "check", "poor"]]:
    """Return the headline of a stimulus check and its level."""
    if not found.playable:
        return marked("The stimulus cannot be played"), "poor"
    if any(concern.severity == "caution" for concern in found.concerns):
        return marked("The stimulus can be played: read the cautions first"), "check"
    return marked("The stimulus can be played"), "good"


def stimulus_report(design: StimulusDesign) -> StimulusReport:
    """Return the report of a stimulus that is designed before its test."""
    stimulus, found, kind = design.stimulus, design.appraisal, design.specification
    headline, level = judged(found)
    length = fixed(stimulus.seconds, 2)
    low, high = (
        (found.force_min_n, found.force_max_n)
        if stimulus.unit == "N"
        else (
            found.voltage_min_v,
            found.voltage_max_v,
        )
    )
    return StimulusReport(
        title=_("Stimulus {kind}, {low} to {high} {unit}, {seconds} s").format(
            kind=kind.name, low=fixed(low, 1), high=fixed(high, 1), unit=stimulus.unit, seconds=length
        ),
        facts=(
            (_("Instrument"), f"{design.device.model}, {design.device.serial_number}"),
            (
                _("Samples"),
                _("{count} at {rate} Hz").format(count=grouped(len(stimulus)), rate=fixed(stimulus.sample_rate_hz, 0)),
            ),
            (_("Seed"), str(stimulus.seed)),
        ),
        headline=_(headline),
        level=level,
        concerns=tuple(translated(concern.words) for concern in found.concerns),
        summary=tuple(translated(line) for line in found.summary()),
        tables=(
            Table(_("Properties"), (), translated_rows(design.rows())),
            Table(_("Options"), (), option_rows(kind.describe())),
        ),
        panels=tuple(stimulus_panels(design)),
    )


def feedback_report(
    kind: FeedbackKind, runs: Sequence[FeedbackRun], rows: tuple[tuple[str, str], ...]
) -> StimulusReport:
    """Return the report of tests with a feedback stimulus; ``rows`` are their results as label and value."""
    worst = max(run.distance for run in runs)
    return StimulusReport(
        title=_("Stimulus {kind}, {low} to {high} N").format(
            kind=kind.name, low=fixed(kind.force_min_n, 1), high=fixed(kind.force_max_n, 1)
        ),
        facts=((_("Played on"), ", ".join(run.label for run in runs)), (_("Seed"), str(kind.seed))),
        headline=_("The depths follow the desired distribution within {distance}").format(distance=fixed(worst, 3)),
        level="good" if worst <= FAR else "check",
        concerns=(),
        summary=(
            _(
                "The number is Kolmogorov's distance: the largest difference between the share of samples above a "
                "depth and the desired share."
            ),
        ),
        tables=(
            Table(_("Results"), (), translated_rows(rows)),
            Table(_("Options"), (), option_rows(kind.describe())),
        ),
        panels=tuple(feedback_panels(runs)),
    )


def option_rows(options: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return options as label and value."""
    return tuple(named_text(name, value) for name, value in options.items() if name != "type")


def translated_rows(rows: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    """Return rows of label and value in the active language."""
    return tuple((translated(label), translated(value)) for label, value in rows)
