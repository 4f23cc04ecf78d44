"""The plots that stand behind the result of a test, in the window and on its printed page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from tissueid.analysis import Analysis
from tissueid.analysis.curves.depth import profile_plots
from tissueid.analysis.curves.levels import level_impulse_plots, level_response_plots
from tissueid.analysis.curves.linear import frequency_response, impulse_response
from tissueid.analysis.curves.nonlinearity import wiener_nonlinearity
from tissueid.analysis.curves.plot import Axis, Plot, plot_or_reason
from tissueid.analysis.curves.prediction import unseen_motion
from tissueid.analysis.curves.units import FREQUENCY, LAG
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import SpectralModel
from tissueid.identification.engines.wiener import Wiener, WienerModel
from tissueid.identification.localized import LocalizedModel
from tissueid.language import marked
from tissueid.messages import Message

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


def _impulse(analyses: Analyses) -> Plot:
    found = _first(analyses, LmsModel)
    if found is None:
        raise UnusableInputError(Message("report.no_impulse_response", "no impulse response could be estimated"))
    return impulse_response(found[0], found[1].record)


def _nonlinearity(analyses: Analyses) -> Plot:
    found = _first(analyses, WienerModel)
    if found is None:
        raise UnusableInputError(Message("report.no_nonlinearity", "no static nonlinearity could be estimated"))
    model, analysis = found
    plot = wiener_nonlinearity(model, analysis.record, analysis.fit_part)
    return replace(plot, x=replace(plot.x, label=marked("Force after the linear stage")))
