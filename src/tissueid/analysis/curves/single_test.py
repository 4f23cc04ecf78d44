"""The plots that stand behind the result of a test, in the window and on its printed page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from tissueid.analysis import Analysis
from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.levels import level_impulse_plots, level_response_plots
from tissueid.analysis.curves.linear import coherence_plot, frequency_response, impulse_response
from tissueid.analysis.curves.nonlinearity import wiener_nonlinearity
from tissueid.analysis.curves.plot import Axis, Bars, Curve, Plot, Surface, plot_or_reason, thin
from tissueid.analysis.curves.prediction import unseen_motion
from tissueid.analysis.curves.signals import has_samples, recording_plots, recording_spectra
from tissueid.analysis.curves.units import FREQUENCY, LAG, TIME
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.identification.localized import LocalizedModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions import Test

Analyses = Mapping[str, Analysis]
M = TypeVar("M", bound=Model)
_NO_RESPONSE = Message("report.no_transfer_function", "no transfer function could be estimated")


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
        plot_or_reason(coherence, FREQUENCY, Axis(), lambda: replace(_coherence(analyses), title=coherence)),
    )


def plots_of_test(analyses: Analyses, linear: str | None) -> ResultPlots:
    """Return the plots of a test; those of a localized test have a curve for each level.

    Args:
        analyses: results by engine.
        linear: the linear engine that leads the report; its simulation is shown where there is no Wiener cascade.
    """
    levels = _first(analyses, LocalizedModel)
    if levels is not None:
        return _localized_plots(levels[0], levels[1], analyses)
    spectral = _first(analyses, SpectralModel)
    magnitude, phase = marked("Bode magnitude"), marked("Bode phase")
    upper, lower = Plot(magnitude, FREQUENCY, Axis()), Plot(phase, FREQUENCY, Axis())
    try:
        if spectral is None:
            raise UnusableInputError(_NO_RESPONSE)
        upper, lower = frequency_response(spectral[0], spectral[1].record)
        upper, lower = replace(upper, title=magnitude), replace(lower, title=phase)
    except UnusableInputError as error:
        upper, lower = replace(upper, missing=error.message), replace(lower, missing=error.message)
    impulse, nonlinearity = marked("Impulse response"), marked("Static nonlinearity")
    return ResultPlots(
        plot_or_reason(impulse, LAG, Axis(), lambda: _impulse(analyses)),
        upper,
        lower,
        plot_or_reason(nonlinearity, Axis(), Axis(), lambda: _nonlinearity(analyses)),
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
        found = analysis.depth_profile(model)
        assert found is not None
        return profile_plots({"": found})[2]

    name = next(name for name, other in analyses.items() if other is analysis)
    return ResultPlots(
        replace(impulse, title=marked("Impulse response at each level")),
        replace(upper, title=marked("Bode magnitude")),
        replace(lower, title=marked("Bode phase")),
        replace(plot_or_reason(stiffness, Axis(), Axis(), profile), title=stiffness),
        plot_or_reason(marked("Unseen motion"), Axis(), Axis(), lambda: unseen_motion(analyses, (name,))),
    )


def _first(analyses: Analyses, kind: type[M]) -> tuple[M, Analysis] | None:
    return next(((a.model, a) for a in analyses.values() if isinstance(a.model, kind)), None)


def _voltage(test: Test) -> Plot:
    if not has_samples(test, "voltage"):
        raise UnusableInputError("report.no_voltage", "no voltage was recorded")
    plot = recording_plots(test)[0]
    return replace(plot, title=marked("Voltage"), parts=tuple(_thinned(part) for part in plot.parts))


def _thinned(part: Curve | Surface | Bars) -> Curve | Surface | Bars:
    """Return a long line reduced to its extremes by column, so that it is drawn fast."""
    if not isinstance(part, Curve) or part.kind != "line":
        return part
    x, y = thin(part.x, part.y)
    return replace(part, x=x, y=y)


def _coherence(analyses: Analyses) -> Plot:
    spectral = _first(analyses, SpectralModel)
    if spectral is None:
        raise UnusableInputError(_NO_RESPONSE)
    return coherence_plot(spectral[0].spectra)


def _impulse(analyses: Analyses) -> Plot:
    found = _first(analyses, LmsModel)
    if found is None:
        raise UnusableInputError("report.no_impulse_response", "no impulse response could be estimated")
    return impulse_response(found[0], found[1].record)


def _nonlinearity(analyses: Analyses) -> Plot:
    found = _first(analyses, WienerModel)
    if found is None:
        raise UnusableInputError("report.no_nonlinearity", "no static nonlinearity could be estimated")
    model, analysis = found
    plot = wiener_nonlinearity(model, analysis.record, analysis.fit_part)
    return replace(plot, x=replace(plot.x, label=marked("Force after the linear stage")))
