"""Report of a comparison of engines: one self-contained page, and the figures as files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure

from tissueid.analysis import ComparisonEntry, EngineComparison
from tissueid.analysis.comparison import described_levels, distortion_of, is_multisine
from tissueid.analysis.curves.comparison_plots import distortion_plot, memory_plots, response_plots, score_plots
from tissueid.device import SIMULATED_LINE
from tissueid.formatting import fixed, grouped
from tissueid.identification import engine_label
from tissueid.identification.base import Model
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.reports import captions
from tissueid.reports.figures.registry import FigureSubject, Group, figures_of
from tissueid.reports.page import (
    RESEARCH_LINE,
    FigureGroup,
    Picture,
    absent,
    captions_for_configuration,
    picture,
    surface_of,
    template,
    write_figures,
    write_text_atomically,
)
from tissueid.reports.plot_renderer import column_figure, depth_panels, row_figure
from tissueid.reports.session_page import (
    Material,
    correlations_picture,
    distributions_picture,
    power_picture,
    signals_picture,
)
from tissueid.reports.tables import Table, held_out_cell, parameter_table, readable_date, settings_tables
from tissueid.sessions import Session
from tissueid.sessions.quality import quality_of

OWN_SAMPLES = Message(
    "report.own_samples",
    "scored on its own samples, because it needs more of the record than the others: not comparable",
)


def compared_scores(comparison: EngineComparison) -> Table:
    """Return scores, parameters and seconds of every engine (Chen 2010, Table 8.1); notes are given by number."""
    scheduled = any(a.model.report.vaf_scheduled_percent is not None for a in comparison.analyses.values())
    ceiling = comparison.ceiling
    head = [_("Engine"), _("VAF, fitted (%)"), _("VAF, held out (%)")]
    head += [_("VAF, held out, scheduled (%)")] if scheduled else []
    head += [_("Of the limit set by repeats (%)")] if ceiling is not None else []
    head += ["AICc", _("Parameters"), _("Seconds"), _("Interpretable"), _("Notes")]
    numbers = {note: str(number) for number, note in enumerate(notes_of(comparison), start=1)}
    rows = []
    for entry in comparison.entries:
        marks = ", ".join(numbers[note] for note in _notes(entry))
        label = engine_label(entry.engine)
        if entry.scored is None:
            rows.append((label, *[MISSING] * (len(head) - 2), marks))
            continue
        report = entry.scored.analysis.model.report
        cells = [label, fixed(report.vaf_percent, 2), held_out_cell(report)]
        cells += [fixed(report.vaf_scheduled_percent, 2)] if scheduled else []
        if ceiling is not None:
            cells.append(fixed(ceiling.explained_percent(report.vaf_validation_percent or 0.0), 1))
        cells += [grouped(report.aicc), grouped(entry.scored.parameters), fixed(report.seconds, 2)]
        rows.append((*cells, translated(entry.family.interpretability), marks))
    return Table(
        _("Scores"),
        tuple(head),
        tuple(rows),
        _(
            "Held out: {part}. VAF is the variance accounted for by a free run, which uses the input alone. The lowest "
            "AICc is the best among engines scored on the same samples."
        ).format(part=translated(comparison.split.validated_on)),
    )


def notes_of(comparison: EngineComparison) -> tuple[str, ...]:
    """Return the notes on engines below their table, each once; the first is number 1."""
    return tuple(dict.fromkeys(note for entry in comparison.entries for note in _notes(entry)))


def _notes(entry: ComparisonEntry) -> Iterator[str]:
    if entry.refused is not None:
        yield Message("report.refused", "refused: {why}", why=entry.refused)
    if entry.scored is not None:
        if entry.scored.own_samples:
            yield OWN_SAMPLES
        yield from dict.fromkeys(entry.scored.analysis.model.report.warnings)


Progress = Callable[[str, float], None]
_ORDER: tuple[Group, ...] = ("record", "linear", "nonlinear", "validation")
_DISTORTION = marked("Distortion by a multisine")


@dataclass(frozen=True, eq=False)
class Section:
    """Figures under one heading, with the findings and warnings of an engine."""

    key: str
    heading: str
    findings: tuple[str, ...]
    warnings: tuple[str, ...]
    pictures: tuple[Picture, ...]


@dataclass(frozen=True, eq=False)
class ComparisonReport:
    """A comparison with all of its figures drawn."""

    session: Session
    comparison: EngineComparison
    sections: tuple[Section, ...]

    def html(self, title: str | None = None) -> str:
        """Return the page: recommendation, table, figures of each engine, and settings."""
        comparison, test = self.comparison, self.session.test(self.comparison.split.tests[0])
        return template("compare.html.j2").render(
            title=title or _("Engines compared on test {number}").format(number=test.number),
            research_line=_(RESEARCH_LINE),
            simulated_line=_(SIMULATED_LINE),
            session=self.session,
            date=readable_date(self.session.created),
            tests=", ".join(map(str, comparison.split.tests)),
            test=test,
            recommendation=comparison.recommendation,
            quality=quality_of(test),
            ceiling=_ceiling(comparison),
            scores=compared_scores(comparison),
            notes=tuple(translated(note) for note in notes_of(comparison)),
            sections=[(s, FigureGroup(s.key, s.heading, tuple(p.block for p in s.pictures))) for s in self.sections],
            parameters=parameter_table(comparison.analyses),
            settings=settings_tables(self.session, test, comparison.analyses),
        )

    def write(self, path: Path) -> None:
        """Write the page atomically.

        Raises:
            OSError: the folder is missing, or the disk is full or not writable.
        """
        write_text_atomically(path, self.html())

    def write_figures(self, folder: Path) -> tuple[Path, ...]:
        """Write every figure as SVG and PNG into a folder, which is made when missing, and return the files.

        Raises:
            OSError: the folder cannot be made or written to.
        """
        return write_figures((drawn for section in self.sections for drawn in section.pictures), folder)


def comparison_report(
    session: Session, comparison: EngineComparison, progress: Progress = lambda _what, _share: None
) -> ComparisonReport:
    """Draw all figures of a comparison; ``progress`` gets "figures" and the share that is done."""
    test = session.test(comparison.split.tests[0])
    material = Material(session, test, comparison.analyses, ())
    sections = [_overview(comparison, surface_of(test)), _recorded(material, comparison)]
    for number, subject in enumerate(material.subjects):
        progress("figures", number / max(1, len(material.subjects)))
        sections.append(_of_engine(subject))
    progress("figures", 1.0)
    worded = [replace(section, pictures=captions_for_configuration(test, section.pictures)) for section in sections]
    return ComparisonReport(session, comparison, tuple(worded))


def _overview(comparison: EngineComparison, surface_position_m: float) -> Section:
    profiles = {engine_label(name): analysis.depth_profile() for name, analysis in comparison.analyses.items()}
    estimated = {name: profile for name, profile in profiles.items() if profile is not None}
    scores = score_plots(comparison)
    height = 1.4 + 0.3 * len(scores[0].y.ticks)
    pictures = (
        picture(
            "scores",
            _("Scores"),
            _("Dots for each engine: variance accounted for on fitted and on held-out samples. Right: bars of AICc."),
            lambda: (row_figure(scores, height, widths=(2.2, 1.0), over=True), _scores_caption(comparison)),
        ),
        picture(
            "memory",
            _("Scores against memory"),
            _("Lines for each engine against memory: variance accounted for, fitted and held out, and AICc."),
            lambda: (row_figure(memory_plots(comparison.memory_sweep), 3.9, over=True), _(_SWEEP)),
        ),
        picture(
            "depth",
            _("Mass, damping and stiffness against depth"),
            _("Three panels against depth: mass, damping and stiffness of every engine with a depth profile."),
            lambda: (
                depth_panels(estimated, surface_position_m, comparison.split.record.output[comparison.split.fit_part]),
                _(_DEPTH),
            ),
        )
        if estimated
        else absent("depth", _("Mass, damping and stiffness against depth"), NO_DEPTH_ENGINE),
        picture(
            "impulse-responses",
            _("Impulse responses side by side"),
            _("Left: impulse responses of the linear engines against lag. Right: measured against predicted output."),
            lambda: (row_figure(response_plots(comparison), 3.9, widths=(1.5, 1.0)), _(_IMPULSES)),
        ),
    )
    return Section("overview", _("Side by side"), (), (), pictures)


def _recorded(material: Material, comparison: EngineComparison) -> Section:
    test, record = material.test, comparison.split.record
    pictures = (
        signals_picture(test, material.held_out_s, "recorded"),
        power_picture(test, material.spectra, "recorded"),
        distributions_picture(record, "recorded"),
        correlations_picture(record, "recorded"),
        _distortion(material),
    )
    return Section("recorded", _("Recorded signals"), (), (), pictures)


def _distortion(material: Material) -> Picture:
    """Return noise, even and odd distortion if the stimulus was a multisine."""
    test, analysis = material.test, material.any
    if not is_multisine(test.stimulus):
        return absent("distortion", _(_DISTORTION), NO_MULTISINE)
    names = analysis.record.input_name, analysis.record.output_name

    def make() -> tuple[Figure, str]:
        record = test.record(*names)
        levels = distortion_of(record, test.stimulus)
        relative = described_levels(levels)
        said = _("Relative to the output: {levels}.").format(levels=translated(relative)) if relative else ""
        caption = _(
            "In a linear system, lines that were not driven contain only noise. Power at even lines is even "
            "nonlinearity, such as stiffness that increases with depth; power at odd lines that were not driven is "
            "odd nonlinearity."
        )
        drawn = column_figure([distortion_plot(levels, record)], 3.9, wide=True, over=True)
        return drawn, captions.joined(caption, said, captions.findings(levels.findings))

    alt = _("Levels of the output against frequency: at driven lines, at odd and even lines between, and the noise.")
    return picture("distortion", _(_DISTORTION), alt, make)


def _of_engine(subject: FigureSubject[Model]) -> Section:
    """Return the figures of an engine, group by group."""
    declared = sorted(figures_of(subject), key=lambda figure: (_ORDER.index(figure.group), figure.order))
    report = subject.model.report
    return Section(
        key=f"engine-{subject.name}",
        heading=subject.label,
        findings=tuple(translated(text) for text in report.findings),
        warnings=tuple(translated(text) for text in report.warnings),
        pictures=tuple(figure.picture(subject) for figure in declared),
    )


def _ceiling(comparison: EngineComparison) -> str:
    if comparison.ceiling is None:
        return ""
    best, std = comparison.ceiling.vaf_percent.value, comparison.ceiling.vaf_percent.std
    limit = fixed(best, 2) if std is None else f"{fixed(best, 2)} ± {fixed(std, 2)}"
    text = _("No model can exceed {limit} % on held-out samples: this is the agreement of {count} repeats.").format(
        limit=limit, count=comparison.ceiling.repeats
    )
    return captions.joined(text, captions.findings(comparison.ceiling.left_out))


def _scores_caption(comparison: EngineComparison) -> str:
    parts = [
        _(
            "Sorted by score on held-out samples. A dot far left of its circle indicates overfitting. Held out: {part}."
        ).format(part=translated(comparison.split.validated_on))
    ]
    if any(a.model.report.vaf_scheduled_percent is not None for a in comparison.analyses.values()):
        parts.append(
            _("Diamonds: scheduled by measured depth; these scores cannot be compared with those of simulations.")
        )
    parts.append(_ceiling(comparison) or _("Without repeats in the session the highest possible score is not known."))
    refused = [engine_label(entry.engine) for entry in comparison.entries if entry.refused is not None]
    if refused:
        parts.append(_("Refused: {engines}.").format(engines=", ".join(refused)))
    parts.append(
        _("Right: the star marks the lowest AICc. AICc assumes independent residuals: small differences mean little.")
    )
    return captions.joined(*parts)


NO_DEPTH_ENGINE = Message("report.no_depth_engine", "no engine with a depth profile was run")
NO_MULTISINE = Message("report.no_multisine", "the stimulus was not an odd random-phase multisine")
_SWEEP = marked(
    "All scores are of the same samples. The lines should level off where the memory contains the whole response; if "
    "the held-out score falls again or AICc rises, further lags fit noise."
)
_DEPTH = marked(
    "Every engine with a depth profile, on the same axes, with 95 % bars or bands; below, the number of samples at "
    "each depth. Values on which engines agree within their bars are reliable. Each direction has its own colour and "
    "marker."
)
_IMPULSES = marked(
    "Left: the linear response of each engine; recursive and correlation estimates should coincide, an adaptive one "
    "is the mean over time. Right: the mean of measured against predicted samples; a bend away from the dashed "
    "diagonal is a nonlinearity that a linear response does not describe."
)
