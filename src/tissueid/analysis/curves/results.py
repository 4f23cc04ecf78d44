"""The plots of the result of one engine, in a form in which results can be laid over each other.

Curves of the result itself have the colour role "model"; "measured" is the measurement that they are compared with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.correlations import signal_correlations
from tissueid.analysis.curves.depth import QUANTITIES, depth_plots
from tissueid.analysis.curves.linear import (
    coherence_curve,
    excited,
    impulse_curve,
    response_axes,
    response_curves,
    spectra_of,
)
from tissueid.analysis.curves.nonlinearity import nonlinearity_plot
from tissueid.analysis.curves.plot import Axis, Curve, Plot
from tissueid.analysis.curves.prediction import output_plots
from tissueid.analysis.curves.units import FREQUENCY, LAG, kernel_unit, ratio_unit
from tissueid.errors import UnusableInputError
from tissueid.identification.engines.spectral import Spectra
from tissueid.identification.validation.residual_tests import ResidualTest, residual_tests
from tissueid.language import marked
from tissueid.records import Record
from tissueid.units import display_unit

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
    attempt(("impulse",), lambda: (_impulse(analysis),))
    spectra = cache(lambda: spectra_of(analysis))
    attempt(("magnitude", "phase"), lambda: _response(analysis, spectra()))
    attempt(("coherence",), lambda: (_coherence(spectra()),))
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


def _impulse(analysis: Analysis) -> Plot:
    curve = impulse_curve(analysis.model, analysis.record, analysis)
    return Plot(TITLES["impulse"], LAG, Axis("", kernel_unit(analysis.record)[0]), (curve,))


def _response(analysis: Analysis, spectra: Spectra) -> tuple[Plot, Plot]:
    curves, axes = response_curves(analysis, spectra), response_axes(analysis.record)
    upper, lower = (Plot(y.label, FREQUENCY, y, (curve,)) for curve, y in zip(curves, axes, strict=True))
    return upper, lower


def _coherence(spectra: Spectra) -> Plot:
    title = TITLES["coherence"]
    curve = coherence_curve(spectra, excited(spectra))
    return Plot(title, FREQUENCY, Axis(title, limits=(0.0, 1.05)), (curve,))


def _correlations(analysis: Analysis) -> tuple[Plot, Plot]:
    """Return the correlations of the fitted record (Chen 2010, Fig. 3.4)."""
    own, _output, cross = signal_correlations({"": analysis.record[analysis.fit_part]})

    def drawn(panel: Panel, plot: Plot) -> Plot:
        return replace(plot, title=TITLES[panel], parts=tuple(replace(c, colour="model") for c in plot.curves))

    return drawn("input_correlation", own), drawn("input_to_output", cross)


def _test(panel: Panel, test: ResidualTest) -> Plot:
    known = np.isfinite(test.correlation)
    if not known.any():
        raise UnusableInputError("research.held_out_short", "too few samples are held out to test the residual")
    band = test.band[known]
    curve = Curve(1e3 * test.lag_s[known], test.correlation[known], colour="model", low=-band, high=band)
    return Plot(TITLES[panel], LAG, Axis(), (curve,))


__all__ = ["TITLES", "Panel", "missing_plot", "panel_units", "result_plots"]
