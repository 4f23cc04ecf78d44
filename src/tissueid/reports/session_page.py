"""Report of a session: one self-contained HTML page without scripts or external files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from matplotlib.figure import Figure

from tissueid.analysis import Analysis
from tissueid.analysis.curves.overlay_plots import signal_correlations
from tissueid.analysis.curves.signals import distribution_plots, recording_plots, recording_spectra
from tissueid.analysis.curves.validation import (
    Prediction,
    correlation_plots,
    held_out_prediction,
    prediction_plots,
    scatter_plots,
)
from tissueid.analysis.device_readings import STEP_KIND, recorded_readings
from tissueid.device import SIMULATED_LINE
from tissueid.errors import UnusableInputError
from tissueid.identification import engine_label, report_engines
from tissueid.identification.base import Model
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import _
from tissueid.messages import Message, Verbatim, translated
from tissueid.records import Record
from tissueid.reports import captions
from tissueid.reports.figures.registry import FigureSubject, Group, all_figures, figures_of
from tissueid.reports.page import (
    RESEARCH_LINE,
    FigureGroup,
    Picture,
    absent,
    captions_for_configuration,
    picture,
    spring_line,
    surface_of,
    template,
    write_text_atomically,
)
from tissueid.reports.plot_renderer import column_figure, row_figure
from tissueid.reports.tables import (
    ComparisonTable,
    Table,
    comparison_table,
    parameter_table,
    readable_date,
    score_table,
    settings_tables,
)
from tissueid.reports.verdict import KeyNumber, Verdict, judge, key_numbers, linear_engine, visited
from tissueid.sessions import Session, Test
from tissueid.sessions.quality import Quality, quality_of


@dataclass(frozen=True)
class TestPage:
    """All that the page shows of one test."""

    __test__ = False  # not a test case, whatever pytest thinks of the name

    number: int
    key: str
    site: str
    kind: str
    configuration: str
    verdict: Verdict
    key_numbers: tuple[KeyNumber, ...]
    visited: str
    quality: Quality | None
    groups: tuple[FigureGroup, ...]
    parameters: Table | None
    scores: Table
    warnings: tuple[str, ...]
    readings: Table | None = None


def test_page(
    session: Session, number: int, analyses: Mapping[str, Analysis], *, full: bool, refused: Mapping[str, str]
) -> TestPage:
    """Draw and word everything about one test; a short page leaves the finer figures out.

    ``refused`` are engines that could not use the test, and why: what they would have drawn says so.
    """
    test = session.test(number)
    material = Material(session, test, analyses, tuple(_predictions(test, analyses)), refused)
    key = f"test{number}"
    groups = _full_groups(material, key) if full else _short_groups(material, key)
    readings, read_group = _readings(material, key)
    verdict = judge(test, analyses)
    return TestPage(
        number=number,
        key=key,
        site=test.site,
        kind=_(test.kind.replace("_", " ")),
        configuration=_(test.configuration),
        verdict=replace(verdict, headline=_(verdict.headline), reasons=tuple(map(translated, verdict.reasons))),
        key_numbers=key_numbers(analyses),
        visited=" ".join(
            filter(None, [translated(visited(analyses, surface_of(test))), spring_line(analyses.values())])
        ),
        quality=quality_of(test),
        groups=(*groups, *read_group),
        readings=readings,
        parameters=parameter_table(analyses),
        scores=score_table(analyses),
        warnings=(
            *_warnings(analyses),
            *(
                translated(
                    Message(
                        "report.could_not_use",
                        "{engine} could not use it: {why}",
                        engine=Verbatim(engine_label(name)),
                        why=why,
                    )
                )
                for name, why in refused.items()
            ),
        ),
    )


def _warnings(analyses: Mapping[str, Analysis]) -> Iterator[str]:
    """What the engines warn of; what several say alike stands once, after all their names."""
    said: dict[str, list[str]] = {}
    for name, analysis in analyses.items():
        for text in dict.fromkeys(analysis.model.report.warnings):
            said.setdefault(text, []).append(engine_label(name))
    for text, names in said.items():
        yield f"{', '.join(names)}: {translated(text)}"


def _predictions(test: Test, analyses: Mapping[str, Analysis]) -> list[Prediction]:
    """The linear engine that leads the report, and after it the Wiener cascade."""
    linear = linear_engine(analyses)
    chosen = [name for name, a in analyses.items() if name == linear or isinstance(a.model, WienerModel)]
    own = {name: a.held_out_record.input is a.record.input for name, a in analyses.items()}
    return [
        held_out_prediction(engine_label(name), analyses[name], test.preload_s if own[name] else 0.0)
        for name in chosen[:4]
    ]


def _full_groups(material: Material, key: str) -> tuple[FigureGroup, ...]:
    predictions = material.predictions
    return (
        _group(
            material,
            f"{key}-recorded",
            _("What was recorded"),
            signals_picture(material.test, material.held_out_s, key),
            power_picture(material.test, material.spectra, key),
            *_of_engines(material, key, "record"),
            distributions_picture(material.any.record, key),
        ),
        _group(material, f"{key}-linear", _("Linear description"), *_of_engines(material, key, "linear")),
        _group(material, f"{key}-nonlinear", _("Nonlinear description"), *_of_engines(material, key, "nonlinear")),
        _group(
            material,
            f"{key}-unseen",
            _("Against unseen data"),
            _prediction(material, key),
            picture(
                f"{key}-scatter",
                _("Measured against predicted"),
                _(
                    "Clouds of measured against predicted output for each model, with the diagonal of perfect "
                    "agreement."
                ),
                lambda: (row_figure(scatter_plots(predictions), 3.3), captions.scatter(predictions)),
            ),
            picture(
                f"{key}-residuals",
                _("What the models leave over"),
                _(
                    "Left: autocorrelation of the residuals. Right: their correlation with the input. Both with 95 % "
                    "bands."
                ),
                lambda: (row_figure(correlation_plots(predictions), 3.0), _(captions.RESIDUALS)),
            ),
        ),
    )


def _readings(material: Material, key: str) -> tuple[Table | None, tuple[FigureGroup, ...]]:
    """Return the readings of a step test for comparison with other probes, and their figures; nothing for others."""
    if material.test.kind != STEP_KIND:
        return None, ()
    from tissueid.reports.readings_page import recorded_group

    try:
        recorded = recorded_readings(material.test)
    except UnusableInputError:
        return None, ()
    table, pictures = recorded_group(recorded, f"{key}-readings")
    return table, (_group(material, f"{key}-readings", table.caption, *pictures),)


def _short_groups(material: Material, key: str) -> tuple[FigureGroup, ...]:
    groups: tuple[Group, ...] = ("record", "linear", "nonlinear")
    drawn = [picture for group in groups for picture in _of_engines(material, key, group, short=True)]
    recorded = signals_picture(material.test, material.held_out_s, key)
    return (_group(material, f"{key}-figures", "Figures", recorded, *drawn, _prediction(material, key)),)


def _group(material: Material, key: str, heading: str, *pictures: Picture) -> FigureGroup:
    return FigureGroup(
        key, heading, tuple(picture.block for picture in captions_for_configuration(material.test, pictures))
    )


def _of_engines(material: Material, key: str, group: Group, *, short: bool = False) -> Iterator[Picture]:
    """The figures of a group that the models have, and the standard ones for which an engine is lacking."""
    standard = report_engines()
    places: list[tuple[int, Picture]] = []
    for subject in material.subjects:
        suffix = "" if subject.name in standard else f" ({subject.label})"
        places += [
            (figure.order, figure.picture(subject, key, suffix=suffix))
            for figure in figures_of(subject)
            if figure.group == group
            and (figure.short or not short)
            and (figure.standard or subject.name not in standard)
        ]
    for figure in all_figures():
        there = any(isinstance(a.model, figure.model) for a in material.analyses.values())
        if figure.group == group and figure.standard and not there and (figure.short or not short):
            why = material.refused.get(figure.standard)
            engine = Verbatim(engine_label(figure.standard))
            reason = Message("report.engine_not_run", "the {engine} engine was not run on this test", engine=engine)
            if why:
                reason = Message(
                    "report.engine_failed", "the {engine} engine could not use it: {why}", engine=engine, why=why
                )
            places.append(
                (figure.order, absent(f"{key}-{figure.key}", _(figure.heading), translated(reason), wide=figure.wide))
            )
    for _order, drawn in sorted(places, key=lambda item: item[0]):
        yield drawn


# -- recorded -------------------------------------------------------------------------------------------------


# -- validated ------------------------------------------------------------------------------------------------


def _prediction(material: Material, key: str) -> Picture:
    return picture(
        f"{key}-prediction",
        _("Measured and predicted"),
        _("Measured output as dots with the simulations of the models as lines, and the residuals below."),
        lambda: (
            column_figure(prediction_plots(material.predictions), 4.2, wide=True, heights=(2.2, 1.0), over=True),
            captions.prediction(material.analyses),
        ),
    )


NOTHING_ANALYSED = Message("report.nothing_analysed", "there is nothing to report: no test was analysed")


def report_html(
    session: Session,
    analyses: Mapping[int, Mapping[str, Analysis]],
    *,
    comparison: ComparisonTable | None = None,
    title: str | None = None,
    refused: Mapping[str, str] | None = None,
) -> str:
    """Return the report as HTML text.

    Args:
        session: the session.
        analyses: analyses by test number and engine name. The first test is the main one; the others get a shorter
            section.
        comparison: estimates of a small-amplitude test and the known values of a simulated plant.
        title: heading of the page; the site of the main test by default.
        refused: engines that could not use the main test, and why.

    Raises:
        UnusableInputError: nothing was analysed, or the session lacks one of the tests.
    """
    tests = [(number, engines) for number, engines in analyses.items() if engines]
    if not tests:
        raise UnusableInputError(NOTHING_ANALYSED)
    pages = [
        test_page(session, number, engines, full=index == 0, refused=refused or {})
        for index, (number, engines) in enumerate(tests)
    ]
    number, engines = tests[0]
    main = session.test(number)
    return template("report.html.j2").render(
        title=title or (main.site[:1].upper() + main.site[1:]) or _("Tissue measurement"),
        research_line=_(RESEARCH_LINE),
        simulated_line=_(SIMULATED_LINE),
        session=session,
        date=readable_date(session.created),
        main=pages[0],
        others=pages[1:],
        comparison=None if comparison is None else comparison_table(comparison),
        settings=settings_tables(session, main, engines),
    )


def write_report(
    path: Path,
    session: Session,
    analyses: Mapping[int, Mapping[str, Analysis]],
    *,
    comparison: ComparisonTable | None = None,
    title: str | None = None,
    refused: Mapping[str, str] | None = None,
) -> None:
    """Write the report atomically; arguments and errors as :func:`report_html`.

    Raises:
        OSError: the folder is missing, or the disk is full or not writable; nothing is left behind.
    """
    write_text_atomically(path, report_html(session, analyses, comparison=comparison, title=title, refused=refused))


def signals_figure(test: Test, held_out_s: tuple[float, float] | None = None) -> Figure:
    """Voltage, force and position over time; arguments as :func:`recording_plots`.

    Raises:
        UnusableInputError: none of the signals to be drawn was received.
    """
    plots = recording_plots(test, held_out_s)
    return column_figure(plots, 0.7 + 1.45 * len(plots), wide=True, over=True)


def signals_picture(test: Test, held_out_s: tuple[float, float] | None, key: str) -> Picture:
    """The signals over time."""
    return picture(
        f"{key}-signals",
        _("Signals"),
        _("Line plots over time of coil voltage, coil force and probe position, with the preload shaded."),
        lambda: (signals_figure(test, held_out_s), captions.signals(test)),
    )


def power_picture(test: Test, spectra: SpectralModel | None, key: str) -> Picture:
    """The power spectra."""
    return picture(
        f"{key}-power",
        _("Power spectra"),
        _("Power spectral densities of voltage, force and position against frequency, both axes logarithmic."),
        lambda: (column_figure([recording_spectra(test)], 3.3), captions.power(spectra)),
        wide=False,
    )


def correlations_picture(record: Record, key: str) -> Picture:
    """The correlations of input and output."""
    return picture(
        f"{key}-correlations",
        _("Correlations of input and output"),
        _("Autocorrelations of input and output and their cross-correlation over both signs of the lag."),
        lambda: (row_figure(signal_correlations({"": record}), 2.7), _(captions.CORRELATIONS)),
    )


def distributions_picture(record: Record, key: str) -> Picture:
    """The distributions of input and output."""
    return picture(
        f"{key}-distributions",
        _("Distributions of input and output"),
        _("Histograms of {input} and {output}, each with a Gaussian curve.").format(
            input=_(record.input_name), output=_(record.output_name)
        ),
        lambda: (row_figure(distribution_plots(record), 2.5), captions.distributions(record)),
    )


@dataclass(frozen=True)
class Material:
    """A test, its analyses, and what several figures share."""

    session: Session
    test: Test
    analyses: Mapping[str, Analysis]
    predictions: tuple[Prediction, ...]
    refused: Mapping[str, str] = field(default_factory=dict)
    """Engines that could not use the test, and why."""

    @property
    def spectra(self) -> SpectralModel | None:
        """The spectra, when that engine was run."""
        return next((a.model for a in self.analyses.values() if isinstance(a.model, SpectralModel)), None)

    @property
    def subjects(self) -> list[FigureSubject[Model]]:
        """The models, to be drawn."""
        surface = surface_of(self.test)
        return [FigureSubject(name, a.model, a, surface) for name, a in self.analyses.items()]

    @property
    def any(self) -> Analysis:
        """Any analysis, for what all of them share."""
        return next(iter(self.analyses.values()))

    @property
    def held_out_s(self) -> tuple[float, float] | None:
        """When the held-out part begins and ends, if it is a part of this test."""
        analysis = self.any
        if analysis.held_out_record is not analysis.record:
            return None
        start = round(self.test.preload_s * self.test.sample_rate_hz)
        first, end, _ = analysis.held_out.indices(len(analysis.record))
        return (start + first) / self.test.sample_rate_hz, (start + end) / self.test.sample_rate_hz
