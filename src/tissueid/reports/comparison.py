"""The comparison of engines as one self-contained page, and as files of its figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure

from tissueid.analysis import EngineComparison, Entry
from tissueid.analysis.distortion import distortion_of, is_multisine, levels_in_words
from tissueid.device import SIMULATED_LINE
from tissueid.identification.base import Model
from tissueid.reports.blocks import FigureGroup, Picture, absent, picture
from tissueid.reports.comparison_figures import (
    depth_profiles,
    distortion_figure,
    impulse_responses_figure,
    scores_figure,
    sweep_figure,
)
from tissueid.reports.comparison_tables import compared_parameters, compared_scores, notes_of
from tissueid.reports.configured import in_words_of, surface_of
from tissueid.reports.depth_panels import depth_panels
from tissueid.reports.figures.registry import Group, Subject, figures_of
from tissueid.reports.html import RESEARCH_LINE, template, write_whole
from tissueid.reports.material import Material
from tissueid.reports.record_pictures import distributions_picture, power_picture, signals_picture
from tissueid.reports.style import plain_image
from tissueid.reports.tables import readable_date, settings_tables
from tissueid.sessions import Session
from tissueid.sessions.quality import quality_of
from tissueid.whole_file import private_folder, whole_file
from tissueid.wording import engine_label, fixed

Progress = Callable[[str, float], None]
_ORDER: tuple[Group, ...] = ("record", "linear", "nonlinear", "validation")
_DISTORTION = "Distortion by a multisine"


@dataclass(frozen=True, eq=False)
class Section:
    """Figures under one heading, with what an engine found and what it warns of."""

    key: str
    heading: str
    findings: tuple[str, ...]
    warnings: tuple[str, ...]
    pictures: tuple[Picture, ...]


@dataclass(frozen=True, eq=False)
class ComparisonReport:
    """A comparison with all of its figures drawn."""

    session: Session
    found: EngineComparison
    sections: tuple[Section, ...]

    def html(self, title: str | None = None) -> str:
        """The page: recommendation, table, figures engine by engine, and settings."""
        found, test = self.found, self.session.test(self.found.split.tests[0])
        return template("compare.html.j2").render(
            title=title or f"Engines compared on test {test.number}",
            research_line=RESEARCH_LINE,
            simulated_line=SIMULATED_LINE,
            session=self.session,
            date=readable_date(self.session.created),
            tests=", ".join(map(str, found.split.tests)),
            test=test,
            recommendation=found.recommendation,
            quality=quality_of(test),
            ceiling=_ceiling(found),
            scores=compared_scores(found),
            notes=notes_of(found),
            sections=[(s, FigureGroup(s.key, s.heading, tuple(p.block for p in s.pictures))) for s in self.sections],
            parameters=compared_parameters(found),
            settings=settings_tables(self.session, test, found.analyses),
        )

    def write(self, path: Path) -> None:
        """Write the page, whole or not at all.

        Raises:
            OSError: the folder is missing, or the disk is full or not writable.
        """
        write_whole(path, self.html())

    def write_figures(self, folder: Path) -> tuple[Path, ...]:
        """Write every figure as SVG and PNG into a folder, which is made when missing, and return the files.

        Raises:
            OSError: the folder cannot be made or written to.
        """
        private_folder(folder)
        written = []
        for section in self.sections:
            for drawn in section.pictures:
                if drawn.figure is not None:
                    for form in ("svg", "png"):
                        target = folder / f"{drawn.key}.{form}"
                        with whole_file(target) as partial:
                            plain_image(drawn.figure, partial, "svg" if form == "svg" else "png")
                        written.append(target)
        return tuple(written)


def comparison_report(
    session: Session, found: EngineComparison, progress: Progress = lambda _what, _share: None
) -> ComparisonReport:
    """Draw everything about a comparison; ``progress`` is told which engine's figures are being drawn."""
    test = session.test(found.split.tests[0])
    material = Material(session, test, found.analyses, ())
    sections = [_overview(found, surface_of(test)), _recorded(material, found)]
    for number, subject in enumerate(material.subjects):
        progress("figures", number / max(1, len(material.subjects)))
        sections.append(_of_engine(subject))
    progress("figures", 1.0)
    worded = [replace(section, pictures=in_words_of(test, section.pictures)) for section in sections]
    return ComparisonReport(session, found, tuple(worded))


def _overview(found: EngineComparison, surface_position_m: float) -> Section:
    profiles = depth_profiles(found)
    pictures = (
        picture(
            "scores",
            "Scores",
            "Dots for each engine: variance accounted for on fitted and on held-out samples; bars of AICc beside.",
            lambda: (scores_figure(found), _scores_caption(found)),
        ),
        picture(
            "memory",
            "Scores against memory",
            "Lines for each engine against memory: variance accounted for, fitted and held out, and AICc.",
            lambda: (sweep_figure(found.memory_sweep), _SWEEP),
        ),
        picture(
            "depth",
            "Mass, damping and stiffness against depth",
            "Three panels against depth: mass, damping and stiffness of every engine that sees depth, on shared axes.",
            lambda: (
                depth_panels(profiles, surface_position_m, found.split.record.output[found.split.fit_part]),
                _DEPTH,
            ),
        )
        if profiles
        else absent("depth", "Mass, damping and stiffness against depth", "no engine that sees depth was run"),
        picture(
            "impulse-responses",
            "Impulse responses side by side",
            "Left: impulse responses of the linear engines against lag. Right: measured against predicted output.",
            lambda: (impulse_responses_figure(found), _IMPULSES),
        ),
    )
    return Section("overview", "Side by side", (), (), pictures)


def _recorded(material: Material, found: EngineComparison) -> Section:
    test, record = material.test, found.split.record
    pictures = (
        signals_picture(test, material.held_out_s, "recorded"),
        power_picture(test, material.spectra, "recorded"),
        distributions_picture(record, "recorded"),
        _distortion(material),
    )
    return Section("recorded", "What was recorded", (), (), pictures)


def _distortion(material: Material) -> Picture:
    """Noise, even and odd distortion, where the stimulus was a multisine."""
    test, analysis = material.test, material.any
    if analysis is None or not is_multisine(test.stimulus):
        return absent("distortion", _DISTORTION, "the stimulus was not an odd random-phase multisine")
    names = analysis.record.input_name, analysis.record.output_name

    def make() -> tuple[Figure, str]:
        record = test.record(*names)
        levels = distortion_of(record, test.stimulus)
        said = levels_in_words(levels)
        told = f" Relative to the output: {said}." if said else ""
        found = "".join(f" {text[:1].upper()}{text[1:]}." for text in levels.findings)
        return distortion_figure(levels, record), (
            "Lines that were not driven should hold noise alone in a linear system. What stands on even lines is even "
            "nonlinearity, such as stiffness that grows with depth; on odd ones that were left out, odd nonlinearity."
            f"{told}{found}"
        )

    alt = "Levels of the output against frequency: at driven lines, at odd and even lines between, and the noise."
    return picture("distortion", _DISTORTION, alt, make)


def _of_engine(subject: Subject[Model]) -> Section:
    """An engine's figures, group by group."""
    declared = sorted(figures_of(subject), key=lambda one: (_ORDER.index(one.group), one.place))
    report = subject.model.report
    return Section(
        key=f"engine-{subject.name}",
        heading=subject.label,
        findings=report.findings,
        warnings=report.warnings,
        pictures=tuple(one.picture(subject) for one in declared),
    )


def _ceiling(found: EngineComparison) -> str:
    if found.ceiling is None:
        return ""
    best, std = found.ceiling.vaf_percent.value, found.ceiling.vaf_percent.std
    spread = "" if std is None else f" ± {fixed(std, 2)}"
    return (
        f"No model can do better than {fixed(best, 2)}{spread} % on unseen samples: so far {found.ceiling.repeats} "
        f"repeats agree.{''.join(f' {line[:1].upper()}{line[1:]}.' for line in found.ceiling.left_out)}"
    )


def _scores_caption(found: EngineComparison) -> str:
    text = (
        "The best on held-out samples first. A dot far left of its circle fitted what does not come back. Held out: "
        f"{found.split.validated_on}. "
    )
    if any(a.model.report.vaf_scheduled_percent is not None for a in found.analyses.values()):
        text += "Diamonds were told the measured depth as they ran, and cannot be held against simulations. "
    text += _ceiling(found) or "Without repeats in the session nobody knows how much there is to explain."
    refused = [engine_label(name) for name in _refused(found.entries)]
    if refused:
        text += f" Refused: {', '.join(refused)}."
    return (
        text
        + " Right: the star has the lowest AICc; it takes residuals for independent, so small differences mean little."
    )


def _refused(entries: tuple[Entry, ...]) -> Iterator[str]:
    return (entry.engine for entry in entries if entry.refused is not None)


_SWEEP = (
    "All at the same samples. The lines should level off where the memory holds the whole response; a held-out score "
    "that falls again, or an AICc that rises, says that further lags fit noise."
)
_DEPTH = (
    "Every engine that sees depth, on the same axes, with 95 % bars or bands; below, how often each depth was visited. "
    "Where engines agree within their bars the numbers can be relied on. Directions have a colour and a marker each."
)
_IMPULSES = (
    "Left: what each engine takes for the linear response; recursive and correlation estimates should lie on each "
    "other, an adaptive one is the average of its course. Right: the middle of the cloud of measured against predicted "
    "samples; a bend away from the dashed diagonal is the nonlinearity that no linear response has."
)
