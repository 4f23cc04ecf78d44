"""A designed stimulus as a page, as one sheet of figures, or as single figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tissueid import __version__
from tissueid.analysis.design import Design
from tissueid.errors import UnusableInputError
from tissueid.reports.blocks import FigureGroup
from tissueid.reports.feedback_figures import FeedbackRun
from tissueid.reports.feedback_panels import feedback_panels
from tissueid.reports.html import RESEARCH_LINE, template, write_whole
from tissueid.reports.panel_sheet import Panel, sheet
from tissueid.reports.stimulus_panels import stimulus_panels
from tissueid.reports.style import plain_image
from tissueid.reports.tables import Table
from tissueid.stimuli import FeedbackKind
from tissueid.stimuli.appraisal import Appraisal
from tissueid.whole_file import whole_file
from tissueid.wording import fixed, grouped, named_value

FAR = 0.08
"""Distance from the desired distribution of depth from which on a page asks to look closer."""

FORMS: dict[str, tuple[str | bytes, ...]] = {
    ".html": ("<!DOCTYPE html",),
    ".pdf": ("%PDF",),
    ".png": (b"\x89PNG",),
    ".svg": ("<?xml", "<svg"),
}
"""Ends of the names of the files that a report can be written to, and what such files begin with."""


@dataclass(frozen=True, eq=False)
class StimulusReport:
    """A stimulus with its figures; ``facts`` are label and value."""

    title: str
    facts: tuple[tuple[str, str], ...]
    headline: str
    level: Literal["good", "check", "poor"]
    concerns: tuple[str, ...]
    summary: tuple[str, ...]
    tables: tuple[Table, ...]
    panels: tuple[Panel, ...]

    def html(self) -> str:
        """The page: what to know before it is played, figures, options."""
        blocks = tuple(panel.picture().block for panel in self.panels)
        return template("stimulus.html.j2").render(
            title=self.title,
            facts=self.facts,
            research_line=RESEARCH_LINE,
            software=f"tissueid {__version__}",
            headline=self.headline,
            level=self.level,
            concerns=self.concerns,
            summary=self.summary,
            tables=self.tables,
            group=FigureGroup("figures", "Figures", blocks),
        )

    def write(self, path: Path) -> None:
        """Write a page or a sheet of all figures, whole or not at all, by the end of the name (``FORMS``).

        Raises:
            UnusableInputError: the name ends in none of them, or there is nothing to draw.
            OSError: the folder is missing, or the disk is full or not writable.
        """
        form = form_of(path)
        if form == ".html":
            write_whole(path, self.html())
            return
        figure = sheet(self.title, self.panels)
        with whole_file(path) as partial:
            plain_image(figure, partial, "pdf" if form == ".pdf" else "svg" if form == ".svg" else "png")


def form_of(path: Path) -> str:
    """The form in which a file is written, one of ``FORMS``, by the end of its name.

    Raises:
        UnusableInputError: it ends in none of ``FORMS``.
    """
    form = path.suffix.lower()
    if form not in FORMS:
        raise UnusableInputError(f"a plot ends in {', '.join(FORMS)}, and {path.name} does not")
    return form


def judged(found: Appraisal) -> tuple[str, Literal["good", "check", "poor"]]:
    """What is said over an appraisal, and in which colour."""
    if not found.playable:
        return "It cannot be played", "poor"
    if any(concern.severity == "caution" for concern in found.concerns):
        return "It can be played: read this first", "check"
    return "It can be played", "good"


def stimulus_report(design: Design) -> StimulusReport:
    """The report of a stimulus that is known before its test."""
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
        title=f"Stimulus {kind.name}, {fixed(low, 1)} to {fixed(high, 1)} {stimulus.unit}, {length} s",
        facts=(
            ("Instrument", f"{design.device.model}, {design.device.serial_number}"),
            ("Samples", f"{grouped(len(stimulus))} at {fixed(stimulus.sample_rate_hz, 0)} Hz"),
            ("Seed", str(stimulus.seed)),
        ),
        headline=headline,
        level=level,
        concerns=tuple(concern.words for concern in found.concerns),
        summary=found.summary(),
        tables=(
            Table("What it is", (), design.rows()),
            Table("Options", (), option_rows(kind.describe())),
        ),
        panels=tuple(stimulus_panels(design)),
    )


def feedback_report(
    kind: FeedbackKind, runs: Sequence[FeedbackRun], rows: tuple[tuple[str, str], ...]
) -> StimulusReport:
    """The report of tests whose stimulus was generated while they ran; ``rows`` are what was found of them."""
    worst = max(run.distance for run in runs)
    return StimulusReport(
        title=f"Stimulus {kind.name}, {fixed(kind.force_min_n, 1)} to {fixed(kind.force_max_n, 1)} N",
        facts=(("Played on", ", ".join(run.label for run in runs)), ("Seed", str(kind.seed))),
        headline=f"The depths keep to the desired distribution within {fixed(worst, 3)}",
        level="good" if worst <= FAR else "check",
        concerns=(),
        summary=(
            "The number is Kolmogorov's distance: the largest difference between the share of samples above a depth "
            "and the share that was wanted there.",
        ),
        tables=(
            Table("What came of it", (), rows),
            Table("Options", (), option_rows(kind.describe())),
        ),
        panels=tuple(feedback_panels(runs)),
    )


def option_rows(options: dict[str, Any]) -> tuple[tuple[str, str], ...]:
    """Options as label and value."""
    return tuple(named_value(name, value) for name, value in options.items() if name != "type")
