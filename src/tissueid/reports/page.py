"""What stands on the page about one test: figures with captions and alternative texts, verdict, tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from matplotlib.figure import Figure

from tissueid.analysis import Analysis
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.reports import captions
from tissueid.reports.diagnostics import Prediction, held_out_prediction
from tissueid.reports.model_figures import (
    bode_figure,
    coherence_figure,
    impulse_response_figure,
    iterations_figure,
    nonlinearity_figure,
)
from tissueid.reports.signal_figures import distributions_figure, power_figure, signals_figure
from tissueid.reports.style import to_svg
from tissueid.reports.tables import Table, parameter_table, score_table
from tissueid.reports.validation_figures import prediction_figure, residuals_figure, scatter_figure
from tissueid.reports.verdict import KeyNumber, Verdict, judge, key_numbers, linear_engine, visited
from tissueid.sessions import Session, Test
from tissueid.wording import engine_label


@dataclass(frozen=True)
class FigureBlock:
    """A figure on the page, or in its place the reason why there is none: one of ``svg`` and ``missing`` is ""."""

    key: str
    heading: str
    caption: str
    svg: str
    missing: str
    wide: bool


@dataclass(frozen=True)
class FigureGroup:
    """Figures under one heading."""

    key: str
    heading: str
    figures: tuple[FigureBlock, ...]


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
    groups: tuple[FigureGroup, ...]
    parameters: Table | None
    scores: Table
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Material:
    """A test, its analyses, and what several figures share."""

    session: Session
    test: Test
    analyses: Mapping[str, Analysis]
    predictions: tuple[Prediction, ...]

    def first(self, kind: type[Model]) -> Analysis | None:
        return next((a for a in self.analyses.values() if isinstance(a.model, kind)), None)

    @property
    def any(self) -> Analysis | None:
        return next(iter(self.analyses.values()), None)

    @property
    def held_out_s(self) -> tuple[float, float] | None:
        """When the held-out part begins and ends, if it is a part of this test."""
        analysis = self.any
        if analysis is None or analysis.held_out_record is not analysis.record:
            return None
        start = round(self.test.preload_s * self.test.sample_rate_hz)
        first, end, _ = analysis.held_out.indices(len(analysis.record))
        return (start + first) / self.test.sample_rate_hz, (start + end) / self.test.sample_rate_hz


def test_page(session: Session, number: int, analyses: Mapping[str, Analysis], *, full: bool) -> TestPage:
    """Draw and word everything about one test; a short page leaves the finer figures out."""
    test = session.test(number)
    material = _Material(session, test, analyses, tuple(_predictions(session, test, analyses)))
    key = f"test{number}"
    groups = _full_groups(material, key) if full else _short_groups(material, key)
    return TestPage(
        number=number,
        key=key,
        site=test.site,
        kind=test.kind.replace("_", " "),
        configuration=test.configuration,
        verdict=judge(test, analyses),
        key_numbers=key_numbers(analyses),
        visited=visited(analyses, test.surface_position_m),
        groups=groups,
        parameters=parameter_table(analyses),
        scores=score_table(analyses),
        warnings=tuple(_warnings(analyses)),
    )


def _warnings(analyses: Mapping[str, Analysis]) -> Iterator[str]:
    """What the engines warn of; what several say alike stands once, after all their names."""
    said: dict[str, list[str]] = {}
    for name, analysis in analyses.items():
        for text in dict.fromkeys(analysis.model.report.warnings):
            said.setdefault(text, []).append(engine_label(name))
    for text, names in said.items():
        yield f"{', '.join(names)}: {text}"


def _predictions(session: Session, test: Test, analyses: Mapping[str, Analysis]) -> list[Prediction]:
    """The linear engine that leads the report, and after it the Wiener cascade."""
    linear = linear_engine(analyses)
    chosen = [name for name, a in analyses.items() if name == linear or isinstance(a.model, WienerModel)]
    found = []
    for name in chosen[:4]:
        analysis = analyses[name]
        own = analysis.held_out_record is analysis.record
        found.append(held_out_prediction(engine_label(name), analysis, test.preload_s if own else 0.0))
    return found


def _full_groups(material: _Material, key: str) -> tuple[FigureGroup, ...]:
    return (
        FigureGroup(
            f"{key}-recorded",
            "What was recorded",
            (_signals(material, key), _power(material, key), _coherence(material, key), _distributions(material, key)),
        ),
        FigureGroup(f"{key}-linear", "Linear description", (_bode(material, key), _impulse_response(material, key))),
        FigureGroup(
            f"{key}-nonlinear", "Nonlinear description", (_nonlinearity(material, key), _iterations(material, key))
        ),
        FigureGroup(
            f"{key}-unseen",
            "Against unseen data",
            (_prediction(material, key), _scatter(material, key), _residuals(material, key)),
        ),
    )


def _short_groups(material: _Material, key: str) -> tuple[FigureGroup, ...]:
    figures = _signals, _coherence, _bode, _nonlinearity, _prediction
    return (FigureGroup(f"{key}-figures", "Figures", tuple(make(material, key) for make in figures)),)


def _block(
    key: str, heading: str, make: Callable[[], Figure], alt: str, caption: Callable[[], str], *, wide: bool = True
) -> FigureBlock:
    """Draw, or say why not."""
    try:
        svg = to_svg(make(), key, alt)
        return FigureBlock(key, heading, caption(), svg, "", wide)
    except UnusableInputError as error:
        return FigureBlock(key, heading, "", "", f"Left out: {error}.", wide)


def _absent(key: str, heading: str, engine: str, *, wide: bool = True) -> FigureBlock:
    return FigureBlock(key, heading, "", "", f"Left out: the {engine} engine was not run on this test.", wide)


# -- recorded -------------------------------------------------------------------------------------------------


def _signals(material: _Material, key: str) -> FigureBlock:
    test = material.test
    return _block(
        f"{key}-signals",
        "Signals",
        lambda: signals_figure(test, material.held_out_s),
        "Line plots over time of coil voltage, coil force and probe position, with the preload shaded.",
        lambda: captions.signals(test),
    )


def _power(material: _Material, key: str) -> FigureBlock:
    spectral = material.first(SpectralModel)
    model = spectral.model if spectral is not None and isinstance(spectral.model, SpectralModel) else None
    return _block(
        f"{key}-power",
        "Power spectra",
        lambda: power_figure(material.test),
        "Power spectral densities of voltage, force and position against frequency, both axes logarithmic.",
        lambda: captions.power(model),
        wide=False,
    )


def _distributions(material: _Material, key: str) -> FigureBlock:
    heading = "Distributions of input and output"
    analysis = material.any
    if analysis is None:
        return _absent(f"{key}-distributions", heading, "linear")
    return _block(
        f"{key}-distributions",
        heading,
        lambda: distributions_figure(analysis.record),
        f"Histograms of {analysis.record.input_name} and {analysis.record.output_name}, each with a Gaussian curve.",
        lambda: captions.distributions(analysis.record),
    )


def _coherence(material: _Material, key: str) -> FigureBlock:
    heading = "Mean squared coherence"
    analysis = material.first(SpectralModel)
    if analysis is None or not isinstance(model := analysis.model, SpectralModel):
        return _absent(f"{key}-coherence", heading, "spectral", wide=False)
    return _block(
        f"{key}-coherence",
        heading,
        lambda: coherence_figure(model),
        "Coherence between 0 and 1 against frequency, with its significance level as a dashed line.",
        lambda: captions.coherence(model),
        wide=False,
    )


# -- identified -----------------------------------------------------------------------------------------------


def _bode(material: _Material, key: str) -> FigureBlock:
    heading = "Bode diagram"
    analysis = material.first(SpectralModel)
    if analysis is None or not isinstance(model := analysis.model, SpectralModel):
        return _absent(f"{key}-bode", heading, "spectral", wide=False)
    return _block(
        f"{key}-bode",
        heading,
        lambda: bode_figure(model, analysis.record),
        "Magnitude and phase of output over input against frequency, measured and as a second-order system.",
        lambda: captions.bode(model),
        wide=False,
    )


def _impulse_response(material: _Material, key: str) -> FigureBlock:
    heading = "Impulse response"
    analysis = material.first(LmsModel)
    if analysis is None or not isinstance(model := analysis.model, LmsModel):
        return _absent(f"{key}-impulse", heading, "LMS", wide=False)
    return _block(
        f"{key}-impulse",
        heading,
        lambda: impulse_response_figure(model, analysis.record),
        "Impulse response against lag: points with a band of one deviation, and the second-order curve.",
        lambda: captions.impulse_response(model),
        wide=False,
    )


def _nonlinearity(material: _Material, key: str) -> FigureBlock:
    heading = "Static nonlinearity and stiffness"
    analysis = material.first(WienerModel)
    if analysis is None or not isinstance(model := analysis.model, WienerModel):
        return _absent(f"{key}-nonlinearity", heading, "Wiener")
    surface = material.test.surface_position_m
    return _block(
        f"{key}-nonlinearity",
        heading,
        lambda: nonlinearity_figure(model, analysis.record, analysis.fit_part, surface),
        "Left: measured output against predicted linear output with a fitted curve. Right: stiffness by depth.",
        lambda: captions.nonlinearity(model, analysis.record, surface),
    )


def _iterations(material: _Material, key: str) -> FigureBlock:
    heading = "How the Wiener iteration settled"
    analysis = material.first(WienerModel)
    if analysis is None or not isinstance(model := analysis.model, WienerModel):
        return _absent(f"{key}-iterations", heading, "Wiener")
    return _block(
        f"{key}-iterations",
        heading,
        lambda: iterations_figure(model),
        "Left: variance accounted for by pass. Right: each parameter relative to its last value by pass.",
        lambda: captions.iterations(model),
    )


# -- validated ------------------------------------------------------------------------------------------------


def _prediction(material: _Material, key: str) -> FigureBlock:
    return _block(
        f"{key}-prediction",
        "Measured and predicted",
        lambda: prediction_figure(material.predictions),
        "Measured output as dots with the simulations of the models as lines, and the residuals below.",
        lambda: captions.prediction(material.analyses),
    )


def _scatter(material: _Material, key: str) -> FigureBlock:
    return _block(
        f"{key}-scatter",
        "Measured against predicted",
        lambda: scatter_figure(material.predictions),
        "Clouds of measured against predicted output for each model, with the diagonal of perfect agreement.",
        lambda: captions.scatter(material.predictions),
    )


def _residuals(material: _Material, key: str) -> FigureBlock:
    return _block(
        f"{key}-residuals",
        "What the models leave over",
        lambda: residuals_figure(material.predictions),
        "Left: autocorrelation of the residuals. Right: their correlation with the input. Both with 95 % bands.",
        lambda: captions.RESIDUALS,
    )
