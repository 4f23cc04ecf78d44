"""The plots behind the result of a test, and those of one engine, made so that several results can be overlaid.

Curves of an engine's result have the colour role "model"; "measured" is the measurement that they are compared with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal, TypeVar

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.depth import QUANTITIES, depth_plots, profile_plots
from tissueid.analysis.curves.linear import (
    coherence_curve,
    coherence_plot,
    excited,
    frequency_response,
    impulse_curve,
    impulse_response,
    level_impulse_plots,
    level_response_plots,
    response_axes,
    response_curves,
    spectra_of,
)
from tissueid.analysis.curves.nonlinearity import nonlinearity_plot, wiener_nonlinearity
from tissueid.analysis.curves.overlay_plots import signal_correlations
from tissueid.analysis.curves.plot import (
    FREQUENCY,
    LAG,
    TIME,
    Axis,
    Curve,
    Plot,
    kernel_unit,
    plot_or_reason,
    ratio_unit,
    thin,
)
from tissueid.analysis.curves.signals import has_samples, recording_plots, recording_spectra
from tissueid.analysis.curves.validation import output_plots, unseen_motion
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.localized import LocalizedModel
from tissueid.identification.engines.spectral import Spectra, SpectralModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.identification.validation.residual_tests import ResidualTest, residual_tests
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.sessions import Test
from tissueid.units import display_unit

Analyses = Mapping[str, Analysis]
M = TypeVar("M", bound=Model)
_NO_RESPONSE = Message("report.no_transfer_function", "no transfer function could be estimated")
_NO_IMPULSE = Message("report.no_impulse_response", "no impulse response could be estimated")
_NO_NONLINEARITY = Message("report.no_nonlinearity", "no static nonlinearity could be estimated")


@dataclass(frozen=True, eq=False)
class ResultPlots:
    """Plots of a test; ``missing`` of a plot says why it cannot be drawn."""

    impulse: Plot
    magnitude: Plot
    phase: Plot
    nonlinearity: Plot
    prediction: Plot


@dataclass(frozen=True, eq=False)
class RecordPlots:
    """Plots of the recorded signals of a test (Chen 2010, Fig. 2.13); ``missing`` says why one cannot be drawn."""

    voltage: Plot
    spectra: Plot
    coherence: Plot


def record_plots(test: Test, analyses: Analyses) -> RecordPlots:
    """Return voltage over time, power spectra of voltage, force and position, and coherence of force and position."""
    voltage, spectra, coherence = marked("Voltage"), marked("Power spectra"), marked("Coherence")
    return RecordPlots(
        plot_or_reason(voltage, TIME, Axis(), lambda: _voltage(test)),
        plot_or_reason(spectra, FREQUENCY, Axis(), lambda: replace(recording_spectra(test), title=spectra)),
        plot_or_reason(
            coherence,
            FREQUENCY,
            Axis(),
            lambda: replace(coherence_plot(_first(analyses, SpectralModel, _NO_RESPONSE)[0].spectra), title=coherence),
        ),
    )


def plots_of_test(analyses: Analyses, linear: str | None) -> ResultPlots:
    """Return the plots of a test; those of a localized test have a curve for each level.

    Args:
        analyses: results by engine.
        linear: the linear engine that leads the report; its simulation is shown where there is no Wiener cascade.
    """
    for analysis in analyses.values():
        if isinstance(analysis.model, LocalizedModel):
            return _localized_plots(analysis.model, analysis, analyses)

    def impulse() -> Plot:
        model, analysis = _first(analyses, LmsModel, _NO_IMPULSE)
        return impulse_response(model, analysis.record)

    @cache
    def response() -> tuple[Plot, Plot]:
        model, analysis = _first(analyses, SpectralModel, _NO_RESPONSE)
        return frequency_response(model, analysis.record)

    def nonlinearity() -> Plot:
        model, analysis = _first(analyses, WienerModel, _NO_NONLINEARITY)
        plot = wiener_nonlinearity(model, analysis.record, analysis.fit_part)
        return replace(plot, x=replace(plot.x, label=marked("Force after the linear stage")))

    magnitude, phase = marked("Bode magnitude"), marked("Bode phase")
    return ResultPlots(
        plot_or_reason(marked("Impulse response"), LAG, Axis(), impulse),
        plot_or_reason(magnitude, FREQUENCY, Axis(), lambda: replace(response()[0], title=magnitude)),
        plot_or_reason(phase, FREQUENCY, Axis(), lambda: replace(response()[1], title=phase)),
        plot_or_reason(marked("Static nonlinearity"), Axis(), Axis(), nonlinearity),
        plot_or_reason(
            marked("Unseen motion"),
            Axis(),
            Axis(),
            lambda: unseen_motion(analyses, tuple(filter(None, (Wiener.name, linear)))),
        ),
    )


def _localized_plots(model: LocalizedModel, analysis: Analysis, analyses: Analyses) -> ResultPlots:
    """Return the responses at each level, and the stiffness against depth in place of a static nonlinearity."""
    impulse, _scaled = level_impulse_plots(model, analysis.record)
    upper, lower = level_response_plots(model, analysis.record)
    stiffness = marked("Stiffness at each level")

    def profile() -> Plot:
        depth_profile = analysis.depth_profile(model)
        assert depth_profile is not None
        return profile_plots({"": depth_profile})[2]

    name = next(name for name, other in analyses.items() if other is analysis)
    return ResultPlots(
        replace(impulse, title=marked("Impulse response at each level")),
        replace(upper, title=marked("Bode magnitude")),
        replace(lower, title=marked("Bode phase")),
        replace(plot_or_reason(stiffness, Axis(), Axis(), profile), title=stiffness),
        plot_or_reason(marked("Unseen motion"), Axis(), Axis(), lambda: unseen_motion(analyses, (name,))),
    )


def _first(analyses: Analyses, kind: type[M], missing: Message) -> tuple[M, Analysis]:
    """Return the first model of a kind and its analysis.

    Raises:
        UnusableInputError: there is none, for the reason ``missing``.
    """
    for analysis in analyses.values():
        if isinstance(analysis.model, kind):
            return analysis.model, analysis
    raise UnusableInputError(missing)


def _voltage(test: Test) -> Plot:
    if not has_samples(test, "voltage"):
        raise UnusableInputError("report.no_voltage", "no voltage was recorded")
    plot = recording_plots(test)[0]
    # Long lines are reduced to their extremes by column, so that they are drawn fast.
    parts = []
    for curve in plot.curves:
        x, y = thin(curve.x, curve.y) if curve.kind == "line" else (curve.x, curve.y)
        parts.append(replace(curve, x=x, y=y))
    return replace(plot, title=marked("Voltage"), parts=tuple(parts))


Panel = Literal[
    "output",
    "residual",
    "impulse",
    "magnitude",
    "phase",
    "coherence",
    "nonlinearity",
    "mass",
    "damping",
    "stiffness",
    "autocorrelation",
    "cross",
    "input_correlation",
    "input_to_output",
]
"""A plot, whatever is laid over another in it."""

_DEVIATION = marked("Band: ± one standard deviation")
_MEASURED = marked("Band: 95 % confidence, where it was measured")
_NOTES: Mapping[str, str] = {
    "impulse": marked("Band: ± one standard deviation, if the engine estimates it"),
    "magnitude": _MEASURED,
    "phase": _MEASURED,
    "nonlinearity": marked(
        "Band: Wiener, the standard deviation of what was measured about the curve; Hammerstein, 95 % confidence"
    ),
    **dict.fromkeys(QUANTITIES, _DEVIATION),
    "autocorrelation": marked(
        "Band: what one lag exceeds one time in twenty, 1.96 over the root of the samples for a white residual"
    ),
    "cross": marked("Band: what one lag exceeds one time in twenty if the residual is unrelated to the input"),
}
"""What the bands mean."""


def result_plots(analysis: Analysis) -> tuple[dict[Panel, Plot], tuple[str, ...]]:
    """Return the plots of an analysis, and the findings of its residual tests."""
    made: dict[Panel, Plot] = {}

    def attempt(panels: tuple[Panel, ...], make: Callable[[], tuple[Plot, ...]]) -> None:
        try:
            made.update(zip(panels, make(), strict=True))
        except UnusableInputError as error:
            made.update({panel: missing_plot(panel, error.message) for panel in panels})

    attempt(("output", "residual"), lambda: output_plots(analysis))
    impulse = Axis("", kernel_unit(analysis.record)[0])
    attempt(
        ("impulse",),
        lambda: (Plot(TITLES["impulse"], LAG, impulse, (impulse_curve(analysis.model, analysis.record, analysis),)),),
    )
    spectra = cache(lambda: spectra_of(analysis))
    attempt(("magnitude", "phase"), lambda: _response(analysis, spectra()))
    coherence = Axis(TITLES["coherence"], limits=(0.0, 1.05))
    attempt(
        ("coherence",),
        lambda: (Plot(coherence.label, FREQUENCY, coherence, (coherence_curve(spectra(), excited(spectra())),)),),
    )
    attempt(("nonlinearity",), lambda: (nonlinearity_plot(analysis),))
    attempt(("mass", "damping", "stiffness"), lambda: depth_plots(analysis))
    findings: list[str] = []

    def residuals() -> tuple[Plot, ...]:
        tests = residual_tests(analysis.model, analysis.held_out_record, analysis.held_out)
        findings.extend(tests.findings)
        return _test("autocorrelation", tests["autocorrelation"]), _test("cross", tests["input"])

    attempt(("autocorrelation", "cross"), residuals)
    attempt(("input_correlation", "input_to_output"), lambda: _correlations(analysis))
    return {panel: replace(plot, note=_NOTES.get(panel, "")) for panel, plot in made.items()}, tuple(findings)


def missing_plot(panel: Panel, reason: str) -> Plot:
    """Return a plot without curves."""
    return Plot(TITLES[panel], Axis(), Axis(), missing=reason)


def panel_units(record: Record) -> dict[str, str]:
    """Return the display units of the panels that have one."""
    out, ratio = display_unit(record.output_unit)[0], ratio_unit(record)[0]
    units = {"output": out, "residual": out, "impulse": kernel_unit(record)[0], "magnitude": ratio, "phase": "°"}
    return units | {"nonlinearity": out} | {name: axis.unit for name, (axis, _name, _scale) in QUANTITIES.items()}


TITLES: Mapping[Panel, str] = {
    "output": marked("Measured and simulated output, held out"),
    "residual": marked("Measured less simulated"),
    "impulse": marked("Impulse response about the mean input"),
    "magnitude": marked("Magnitude"),
    "phase": marked("Phase"),
    "coherence": marked("Coherence of the record"),
    "nonlinearity": marked("Static nonlinearity"),
    "mass": marked("Mass"),
    "damping": marked("Damping"),
    "stiffness": marked("Stiffness"),
    "autocorrelation": marked("Autocorrelation of the held-out residual"),
    "cross": marked("Input against the held-out residual"),
    "input_correlation": marked("Autocorrelation of the input"),
    "input_to_output": marked("Correlation of the output with the input"),
}


def _response(analysis: Analysis, spectra: Spectra) -> tuple[Plot, Plot]:
    curves, axes = response_curves(analysis, spectra), response_axes(analysis.record)
    upper, lower = (Plot(y.label, FREQUENCY, y, (curve,)) for curve, y in zip(curves, axes, strict=True))
    return upper, lower


def _correlations(analysis: Analysis) -> tuple[Plot, Plot]:
    """Return the correlations of the fitted record (Chen 2010, Fig. 3.4)."""
    own, _output, cross = signal_correlations({"": analysis.record[analysis.fit_part]})

    def drawn(panel: Panel, plot: Plot) -> Plot:
        return replace(plot, title=TITLES[panel], parts=tuple(replace(c, colour="model") for c in plot.curves))

    return drawn("input_correlation", own), drawn("input_to_output", cross)


def _test(panel: Panel, test: ResidualTest) -> Plot:
    finite = np.isfinite(test.correlation)
    if not finite.any():
        raise UnusableInputError("research.held_out_short", "too few samples are held out to test the residual")
    band = test.band[finite]
    curve = Curve(1e3 * test.lag_s[finite], test.correlation[finite], colour="model", low=-band, high=band)
    return Plot(TITLES[panel], LAG, Axis(), (curve,))
