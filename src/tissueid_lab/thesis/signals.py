"""Recipes of chapters 2 and 3 from a sweep and from one large test: signals, spectra, linear and Wiener fits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import stats

from tissueid.analysis.curves.calibration_plots import Region, bode_plots, parameter_plots
from tissueid.analysis.curves.linear import coherence_plot, frequency_response, impulse_response
from tissueid.analysis.curves.nonlinearity import iteration_plots, linear_output, stiffness_plot, wiener_nonlinearity
from tissueid.analysis.curves.signals import distribution_plots, recording_spectra
from tissueid.analysis.curves.validation import held_out_prediction, prediction_plots
from tissueid.analysis.overlay import Overlay
from tissueid.calibration.sweep import sweep_tests
from tissueid.calibration.sweep_analysis import SpringMass, SweepResult, analyse_sweep, as_calibration
from tissueid.formatting import fixed
from tissueid.identification.base import Array
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.spectral import Spectral, SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.language import marked
from tissueid.reports.calibration_page import sweep_panels
from tissueid.reports.overlay_page import DrawnFigures
from tissueid.sessions import Session
from tissueid_lab.thesis.comparisons import POSTERIOR
from tissueid_lab.thesis.recipe import (
    NumberRow,
    Outcome,
    RecipeSource,
    Recording,
    ThesisFigure,
    drawn_grid,
    entry_of,
    fitted,
    percent,
)

GAUSSIAN = Recording(
    f"{POSTERIOR}-gaussian", POSTERIOR, (-5.0, 11.8), distribution="gaussian", options=(("clipped", 0.0455),)
)
"""The test of chapter 3: Gaussian force with a cutoff of 200 Hz, into the skin and off it."""
_ONE = (RecipeSource("posterior", GAUSSIAN),)
_SPRING_N_PER_M = 1000.0
_SETTLED = 0.02
"""Largest relative change of every parameter in a pass after which the iteration counts as settled."""


# -- chapter 2 --------------------------------------------------------------------------------------------------------


def _analysed(session: Session) -> tuple[SweepResult, dict[str, dict[str, Array]]]:
    result = analyse_sweep(sweep_tests(session), session.instrument, SpringMass(_SPRING_N_PER_M))
    tables = as_calibration(result).tables.items()
    return result, {table: {name: np.asarray(values) for name, values in columns.items()} for table, columns in tables}


def sweep_of(session: Session) -> dict[str, Array]:
    """Return the parameters by position of a recorded sweep, which are drawn under depth profiles (thesis 2.4.1)."""
    return _analysed(session)[1]["sweep"]


def _swept(sessions: Mapping[str, Session]) -> Outcome:
    """Return parameters and Bode diagrams along the stroke, and the ranges of Table 2.1 (Fig. 2.12)."""
    (session,) = sessions.values()
    result, tables = _analysed(session)
    low, high = result.region.min_m.value, result.region.max_m.value
    region = Region(low, high, result.region.plateau_n_per_a.value)
    sweep = tables["sweep"]
    inside = (sweep["position_m"] >= low) & (sweep["position_m"] <= high)

    def ends(name: str, unit: str, scale: float = 1.0, decimals: int = 1) -> str:
        values = scale * sweep[name][inside]
        return f"{fixed(float(values.min()), decimals)} to {fixed(float(values.max()), decimals)} {unit}"

    shown = [panel.picture() for panel in sweep_panels(tables, region) if panel.key in ("parameters", "bode")]
    plots = (*parameter_plots(sweep, region), *bode_plots(tables["response"], sweep))
    return DrawnFigures(tuple(shown), plots), [
        NumberRow(marked("VAF on the spring, linear region"), marked("95 to 98 %"), ends("vaf_percent", "%")),
        NumberRow(marked("mass"), marked("60 to 80 g"), ends("mass_kg", "g", 1e3)),
        NumberRow(marked("damping"), marked("3 to 4 N·s/m"), ends("damping_n_s_per_m", "N·s/m", 1.0, 2)),
        NumberRow(marked("stiffness"), marked("1000 to 1200 N/m"), ends("stiffness_n_per_m", "N/m", 1.0, 0)),
        NumberRow(
            marked("length of the linear region"), marked("20 to 25 mm of 32 mm"), f"{fixed(1e3 * (high - low), 1)} mm"
        ),
    ]


# -- signals and spectra ----------------------------------------------------------------------------------------------


def _distributions(overlay: Overlay) -> Outcome:
    record = overlay.records["posterior"]

    def shape(values: np.ndarray) -> str:
        finite = values[np.isfinite(values)]
        return f"{fixed(float(stats.skew(finite)), 2)} and {fixed(float(stats.kurtosis(finite)), 2)}"

    force = record.input[np.isfinite(record.input)]
    crest = float(np.abs(force - force.mean()).max() / force.std())
    return drawn_grid(
        "distributions",
        marked("Distributions of force and position"),
        marked("Histograms of force and position, each with the Gaussian of its mean and deviation."),
        [distribution_plots(record)],
        row_height=3.2,
        over=True,
    ), [
        NumberRow(marked("force: skewness and excess kurtosis"), marked("Gaussian: 0 and 0"), shape(record.input)),
        NumberRow(marked("position: skewness and excess kurtosis"), marked("not Gaussian"), shape(record.output)),
        NumberRow(marked("crest factor of the force"), marked("best: 1"), fixed(crest, 2)),
    ]


def _spectra(sessions: Mapping[str, Session]) -> Outcome:
    """Return spectra of the signals and the coherence of force and position (Fig. 3.2)."""
    test = sessions["posterior"].test(1)
    model = Spectral().fit(test.record())
    assert isinstance(model, SpectralModel)
    spectra = model.spectra
    plots = recording_spectra(test), coherence_plot(spectra)

    def mean(low: float, high: float) -> str:
        inside = (spectra.frequency_hz >= low) & (spectra.frequency_hz < high)
        return fixed(float(spectra.coherence[inside].mean()), 2)

    rows = [
        NumberRow(marked("coherence to 100 Hz"), marked("about 0.8"), mean(1.0, 100.0)),
        NumberRow(marked("coherence from 100 to 200 Hz"), marked("almost 1"), mean(100.0, 200.0)),
        NumberRow(marked("coherence above 300 Hz"), marked("effectively 0"), mean(300.0, 1000.0)),
    ]
    for curve, said in zip(plots[0].curves, ("8", "4", "6"), strict=False):
        densities = curve.y[curve.y > 0.0]
        decades = float(np.log10(densities.max() / np.quantile(densities, 0.05)))
        rows.append(
            NumberRow(f"{str(curve.name).partition(' ')[0]}, decades to the noise floor", said, fixed(decades, 1))
        )
    alt = marked("Power spectral densities of voltage, force and position, and the coherence of force and position.")
    return drawn_grid("spectra", marked("Power spectra and coherence"), alt, [plots], row_height=3.4), rows


def _bode(overlay: Overlay) -> Outcome:
    model, record, _part = fitted(overlay, SpectralModel, "spectral")
    spectra, system = model.spectra, model.second_order.system
    high = (spectra.frequency_hz > 80.0) & (spectra.frequency_hz < 190.0)
    slope = np.polyfit(np.log10(spectra.frequency_hz[high]), np.log10(spectra.magnitude[high]), 1)[0]
    end = float(np.degrees(np.angle(system.frequency_response(np.array([190.0]))))[0])
    hz = system.natural_frequency_rad_per_s / (2.0 * np.pi)
    return drawn_grid(
        "bode",
        marked("Bode diagram of the compliance"),
        marked("Magnitude and phase against frequency."),
        [frequency_response(model, record)],
        over=True,
    ), [
        NumberRow(marked("natural frequency"), marked("36 Hz (226 rad/s)"), f"{fixed(hz, 1)} Hz"),
        NumberRow(marked("damping ratio"), marked("0.5 to 1"), fixed(system.damping_ratio, 2)),
        NumberRow(marked("slope of the magnitude, 80 to 190 Hz"), "-2", fixed(float(slope), 2)),
        NumberRow(marked("phase at 190 Hz"), marked("towards -180°"), f"{fixed(end, 0)}°"),
    ]


# -- linear and Wiener fits -------------------------------------------------------------------------------------------


def _impulse(overlay: Overlay) -> Outcome:
    model, record, _part = fitted(overlay, LmsModel, "lms")
    p, system = model.report.parameters, model.second_order.system
    return drawn_grid(
        "impulse",
        marked("Impulse response"),
        marked("Impulse response at each lag, and its second-order fit."),
        [[impulse_response(model, record)]],
        over=True,
    ), [
        NumberRow(marked("VAF, nonparametric"), "75.79 %", percent(model.report.vaf_percent)),
        NumberRow(marked("VAF, parametric"), "75.64 %", percent(model.report.details["vaf_parametric_percent"])),
        NumberRow(marked("mass"), "91.2 g", f"{fixed(1e3 * p['mass_kg'].value, 1)} g"),
        NumberRow(marked("damping"), "22.77 N·s/m", f"{fixed(p['damping_n_s_per_m'].value, 2)} N·s/m"),
        NumberRow(marked("stiffness"), "4670 N/m", f"{fixed(p['stiffness_n_per_m'].value, 0)} N/m"),
        NumberRow(marked("damping ratio"), "0.55", fixed(system.damping_ratio, 2)),
        NumberRow(marked("natural frequency"), "226 rad/s", f"{fixed(system.natural_frequency_rad_per_s, 0)} rad/s"),
    ]


def _nonlinearity(overlay: Overlay) -> Outcome:
    model, record, part = fitted(overlay, WienerModel, "wiener")
    surface, p = entry_of(overlay, fit="wiener").surface_position_m, model.report.parameters
    z, measured = linear_output(model, record, part)
    shallow, deep = 1.0 / model.nonlinearity.slope(np.quantile(z, (0.05, 0.95)))
    scatter = 1e3 * float(np.std(measured - model.nonlinearity(z)))
    plots = (wiener_nonlinearity(model, record, part, surface), stiffness_plot(model, record, part, surface))
    alt = marked("Measured position against the output of the linear stage with the fitted curve; stiffness by depth.")
    return drawn_grid(
        "nonlinearity", marked("Static nonlinearity and its inverse slope"), alt, [plots], row_height=3.4
    ), [
        NumberRow(
            marked("stiffness, 5 % and 95 % of the load"),
            marked("rises with depth"),
            f"{fixed(float(shallow), 0)} and {fixed(float(deep), 0)} N/m",
        ),
        NumberRow("C1", marked("9.77 mm (Table 3.1)"), f"{fixed(1e3 * p['c1_m'].value, 2)} mm"),
        NumberRow("C2", marked("0.154 1/N (Table 3.1)"), f"{fixed(p['c2_per_n'].value, 3)} 1/N"),
        NumberRow(
            marked("scatter about the curve, and travel"),
            marked("as much as 1 mm of 7 mm"),
            f"{fixed(scatter, 2)} mm (SD) of {fixed(1e3 * float(np.ptp(measured)), 1)} mm",
        ),
    ]


def _iterations(overlay: Overlay) -> Outcome:
    model, _record, _part = fitted(overlay, WienerModel, "wiener")
    history, last = model.history, model.history[-1].parameters
    settled = next(
        (
            step.iteration
            for step in history
            if all(abs(step.parameters[n] / v - 1.0) < _SETTLED for n, v in last.items() if v and n in step.parameters)
        ),
        history[-1].iteration,
    )
    first, end = history[0].nonlinear_vaf_percent, history[-1].nonlinear_vaf_percent
    alt = marked("Variance accounted for and parameters relative to their last value against the pass.")
    return drawn_grid(
        "iterations", marked("Scores and parameters by pass"), alt, [iteration_plots(model)], row_height=3.4
    ), [
        NumberRow(
            marked("passes until every parameter is within 2 %"),
            marked("about 6"),
            f"{settled} of {history[-1].iteration}",
        ),
        NumberRow(
            marked("VAF of the cascade, first and last pass"),
            marked("falls slightly after the first"),
            f"{percent(first)} and {percent(end)}",
        ),
    ]


def _prediction(overlay: Overlay) -> Outcome:
    runs = [held_out_prediction(name, entry_of(overlay, fit=name).analysis) for name in ("lms", "wiener")]
    gain = entry_of(overlay, fit="wiener").shown_percent - entry_of(overlay, fit="lms").shown_percent
    return drawn_grid(
        "prediction",
        marked("Measured and predicted position"),
        marked("Measured position, and that of a linear and a Wiener model, over a stretch of the test."),
        [[plot] for plot in prediction_plots(runs)],
        row_height=2.4,
        over=True,
    ), [
        NumberRow(marked("gain"), marked("5 to 10 points"), fixed(gain, 1)),
    ]


_STEPS = (("from_m", 0.002), ("to_m", 0.030), ("step_m", 0.002))
SWEEP = Recording("sweep", "calibration-spring", stimulus="sweep", options=_STEPS, coil="finite")
"""The dynamic sweep of a spring along a coil that leaves its field at both ends."""
SIGNAL_FIGURES: tuple[ThesisFigure, ...] = (
    ThesisFigure(
        "2.12",
        marked("Coil parameters along the stroke, and the ranges of Table 2.1"),
        (RecipeSource("sweep", SWEEP),),
        recorded=_swept,
    ),
    ThesisFigure("3.1", marked("Distributions of force and position"), _ONE, ("lms",), drawn=_distributions),
    ThesisFigure("3.2", marked("Power spectra, and coherence of force and position"), _ONE, recorded=_spectra),
    ThesisFigure("3.3", marked("Bode diagram of the compliance"), _ONE, ("spectral",), drawn=_bode),
    ThesisFigure("3.5", marked("Impulse response with its second-order fit"), _ONE, ("lms",), drawn=_impulse),
    ThesisFigure("3.8", marked("Static nonlinearity of a Wiener system"), _ONE, ("wiener",), drawn=_nonlinearity),
    ThesisFigure("3.9", marked("Scores and parameters over the iterations"), _ONE, ("wiener",), drawn=_iterations),
    ThesisFigure(
        "3.10",
        marked("Measured and predicted position"),
        _ONE,
        ("lms", "wiener"),
        drawn=_prediction,
        vafs=(
            (marked("VAF, linear model"), "75.8 %", "", "lms"),
            (marked("VAF, with the static nonlinearity"), "80.7 %", "", "wiener"),
        ),
    ),
)
"""Figures of chapters 2 and 3 from a sweep and from one large test."""
