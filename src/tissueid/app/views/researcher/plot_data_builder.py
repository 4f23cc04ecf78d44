"""Build the plot data of a fitted model; the panels are the same for every engine."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tissueid.analysis import Analysis
from tissueid.analysis.curves.kernels import kernel_plots
from tissueid.app.views.researcher.model_output_curves import model_output
from tissueid.app.views.researcher.plot_data import Array, Line, Panel, PlotData
from tissueid.app.words import sentence
from tissueid.errors import UnusableInputError
from tissueid.identification.cascades.curves import curve_slopes
from tissueid.identification.engines.cascade import CascadeModel
from tissueid.identification.engines.hammerstein import HammersteinModel
from tissueid.identification.engines.spectral import Spectra, Spectral, SpectralModel
from tissueid.identification.engines.wiener import WienerModel
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.static_nonlinearity import StaticNonlinearity
from tissueid.identification.validation.residual_tests import ResidualTests, residual_tests
from tissueid.identification.volterra.model import VolterraModel
from tissueid.messages import Message, translated
from tissueid.records import Record
from tissueid.units import display_unit

MS = 1e3
CONFIDENCE = 1.96
_EXCITED = 0.03
"""Share of the input's greatest power density below which a frequency counts as not excited."""
_FINE = 200
_PULSE = 1e-3
"""Height of the pulse that a model is probed with, in standard deviations of the input."""
_STRETCHES = 40
_FEWEST = 8


def plot_data_of(analysis: Analysis) -> tuple[PlotData, tuple[str, ...]]:
    """Return the plot data of an analysis, and the findings of its residual tests."""
    record = analysis.record
    lines: dict[Panel, Line] = {}
    missing: dict[Panel, str] = {}

    def attempt(panels: tuple[Panel, ...], make: Callable[[], tuple[Line, ...]]) -> None:
        try:
            lines.update(zip(panels, make(), strict=True))
        except UnusableInputError as error:
            missing.update(dict.fromkeys(panels, sentence(translated(error.message))))

    spectra = _spectra(analysis)
    measured: dict[Panel, Line] = {}
    try:
        measured["output"], lines["output"], lines["residual"] = model_output(analysis)
    except UnusableInputError as error:
        missing |= dict.fromkeys(("output", "residual"), sentence(translated(error.message)))
    attempt(("impulse",), lambda: (_impulse(analysis),))
    attempt(("magnitude", "phase"), lambda: _response(analysis, spectra))
    attempt(("coherence",), lambda: (_coherence(spectra),))
    attempt(("nonlinearity",), lambda: (_nonlinearity(analysis),))
    attempt(("mass", "damping", "stiffness"), lambda: _against_depth(analysis))
    findings: tuple[str, ...] = ()
    try:
        tests = residual_tests(analysis.model, analysis.held_out_record, analysis.held_out)
        findings = tests.findings
        attempt(("autocorrelation", "cross"), lambda: _residuals(tests))
    except UnusableInputError as error:
        missing |= dict.fromkeys(("autocorrelation", "cross"), sentence(translated(error.message)))
    return PlotData(lines, _units(record), kernel_plots(analysis.model, record), missing, measured), findings


def _units(record: Record) -> dict[Panel, str]:
    out, _ = display_unit(record.output_unit)
    into, _ = display_unit(record.input_unit)
    ratio = f"{out or '1'}/{into or '1'}"
    return {
        "output": out,
        "residual": out,
        "impulse": f"{out or '1'}/({into or '1'}·s)",
        "magnitude": ratio,
        "phase": "°",
        "nonlinearity": out,
        "mass": "g",
        "damping": "N·s/m",
        "stiffness": "N/m",
    }


def _scale(record: Record) -> float:
    return display_unit(record.output_unit)[1] / display_unit(record.input_unit)[1]


def _impulse(analysis: Analysis) -> Line:
    """Return the impulse response about the mean input against lag (ms), with its standard deviation if known."""
    model, scale = analysis.model, _scale(analysis.record)
    std = None
    if isinstance(model, VolterraModel) and model.kernel1 is not None:
        lag_s, response, std = model.lag_s, model.kernel1, model.kernel1_std
    elif isinstance(model, PartitionedModel):
        edges, middle = model.breakpoints_m, float(np.nanmean(analysis.record[analysis.fit_part].output))
        row = int(np.clip(np.searchsorted(edges, middle, "right") - 1, 0, len(model.operating_kernels) - 1))
        lag_s, response = model.lag_s, model.operating_kernels[row]
    else:
        own = getattr(model, "impulse_response", None)
        if isinstance(own, np.ndarray):
            lag_s, response = np.asarray(getattr(model, "lag_s")), own  # noqa: B009 - engines of others have it too
            std = getattr(model, "impulse_response_std", None)
        elif isinstance(model, SpectralModel):
            lag_s = np.arange(model.kernel.size) / model.sample_rate_hz
            response = model.kernel * model.sample_rate_hz
        else:
            lag_s, response = _probed(analysis)
    y = scale * response
    if std is None:
        return Line(MS * lag_s, y)
    half = np.where(np.isfinite(std), scale * std, 0.0)
    return Line(MS * lag_s, y, y - half, y + half)


def _probed(analysis: Analysis) -> tuple[Array, Array]:
    """Return lags (s) and the response to a small pulse at the mean input, per unit of its area.

    Raises:
        UnusableInputError: the model does not answer the pulse.
    """
    model, record = analysis.model, analysis.record[analysis.fit_part]
    known = record.input[np.isfinite(record.input)]
    if known.size < 2:
        raise UnusableInputError(Message("research.no_input", "no input was received"))
    lags = min(model.memory_samples, known.size)
    rest = np.full(3 * lags, float(np.mean(known)))
    pulse, height = rest.copy(), _PULSE * float(np.std(known))
    pulse[lags] += height
    answer = (model.simulate(pulse) - model.simulate(rest))[lags - 1 : 2 * lags]
    if not np.isfinite(answer).all() or height == 0.0 or not np.any(answer):
        raise UnusableInputError(
            Message("research.no_pulse_response", "the model does not answer a small pulse about the mean input")
        )
    return np.arange(-1, lags) / model.sample_rate_hz, answer * model.sample_rate_hz / height


def _spectra(analysis: Analysis) -> Spectra | None:
    """Return the spectra of the fitted record; None if it is too short."""
    if isinstance(analysis.model, SpectralModel):
        return analysis.model.spectra
    try:
        model = Spectral().fit(analysis.record, analysis.fit_part)
    except UnusableInputError:
        return None
    return model.spectra if isinstance(model, SpectralModel) else None


def _excited(spectra: Spectra | None) -> np.ndarray:
    if spectra is None:
        raise UnusableInputError(Message("research.short_record", "the record is too short for spectra"))
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * spectra.input_psd[1:].max())
    if shown.sum() < 3:
        raise UnusableInputError(
            Message(
                "research.narrow_input", "the input has power at fewer than three frequencies: use noise or a multisine"
            )
        )
    return np.asarray(shown, dtype=np.bool_)


def _response(analysis: Analysis, spectra: Spectra | None) -> tuple[Line, Line]:
    """Return log10 magnitude and phase (degrees) against log10 frequency (Hz).

    The spectral engine shows what it measured with 95 % bands, any other the transform of its impulse response.
    """
    scale, shown = _scale(analysis.record), _excited(spectra)
    assert spectra is not None
    if isinstance(analysis.model, SpectralModel):
        shown &= (spectra.magnitude > 0.0) & np.isfinite(spectra.magnitude_std)
        x, magnitude = np.log10(spectra.frequency_hz[shown]), np.log10(scale * spectra.magnitude[shown])
        spread = np.log10(1.0 + CONFIDENCE * spectra.magnitude_std[shown] / spectra.magnitude[shown])
        phase = np.degrees(spectra.phase_rad[shown])
        half = np.degrees(CONFIDENCE * spectra.phase_std_rad[shown])
        return (
            Line(x, magnitude, magnitude - spread, magnitude + spread),
            Line(x, phase, phase - half, phase + half),
        )
    line = _impulse(analysis)
    low, high = np.log10(spectra.frequency_hz[shown][[0, -1]])
    log_f = np.linspace(float(low), float(high), _FINE)
    lag_s = line.x / MS
    turning = np.exp(-2j * np.pi * np.outer(10.0**log_f, lag_s))  # (frequencies, lags)
    answer = turning @ line.y * float(lag_s[1] - lag_s[0] if lag_s.size > 1 else 1.0)
    phase = np.degrees(np.unwrap(np.angle(answer)))
    return Line(log_f, np.log10(np.maximum(np.abs(answer), 1e-12))), Line(log_f, phase)


def _coherence(spectra: Spectra | None) -> Line:
    shown = _excited(spectra)
    assert spectra is not None
    return Line(np.log10(spectra.frequency_hz[shown]), spectra.coherence[shown])


def _nonlinearity(analysis: Analysis) -> Line:
    """Return the static nonlinearity: after the linear stage for a Wiener cascade, before it otherwise."""
    model, record = analysis.model, analysis.record[analysis.fit_part]
    into, out = display_unit(record.input_unit)[1], display_unit(record.output_unit)[1]
    if isinstance(model, WienerModel):
        z = model.linear_output(record.input)
        x = _span(z)
        y = model.nonlinearity(x)
        half = _scatter(x, z, record.output - model.nonlinearity(z))
        return Line(into * x, out * y, out * (y - half), out * (y + half))
    if isinstance(model, HammersteinModel):
        x = _span(record.input)
        y, std = model.nonlinearity(x) + model.offset, _curve_std(model.nonlinearity, x, model.nonlinearity_covariance)
        if std is None or not model.steady_gain:
            return Line(into * x, out * y)
        return Line(into * x, out * y, out * (y - CONFIDENCE * std), out * (y + CONFIDENCE * std))
    if isinstance(model, CascadeModel) and model.structure == "hammerstein" and model.inner is not None:
        x = _span(record.input)
        return Line(into * x, out * (model.inner(x) + model.offset))
    raise UnusableInputError(
        Message(
            "research.no_nonlinearity",
            "only engines with a static nonlinearity have this curve: Wiener, Hammerstein",
        )
    )


def _span(values: Array) -> Array:
    known = values[np.isfinite(values)]
    if known.size < 2:
        raise UnusableInputError(Message("research.no_cascade_sample", "no sample lies in the range of the cascade"))
    low, high = np.quantile(known, (0.005, 0.995))
    return np.linspace(float(low), float(high), _FINE)


def _scatter(x: Array, z: Array, error: Array) -> Array:
    """Return the standard deviation of the error near each of x (k,), from samples z (n,)."""
    known = np.isfinite(z) & np.isfinite(error)
    edges = np.linspace(x[0], x[-1], _STRETCHES + 1)
    place = np.clip(np.digitize(z[known], edges) - 1, 0, _STRETCHES - 1)
    count = np.bincount(place, minlength=_STRETCHES)
    squares = np.bincount(place, error[known] ** 2, _STRETCHES)
    held = count >= _FEWEST
    if not held.any():
        return np.full(x.size, float(np.std(error[known])))
    middle = 0.5 * (edges[1:] + edges[:-1])
    return np.interp(x, middle[held], np.sqrt(squares[held] / count[held]))


def _curve_std(curve: StaticNonlinearity, x: Array, covariance: Array) -> Array | None:
    if not np.isfinite(covariance).all():
        return None
    slopes = curve_slopes(curve, x)  # (p, k)
    return np.asarray(np.sqrt(np.maximum(np.einsum("pk,pq,qk->k", slopes, covariance, slopes), 0.0)))


def _against_depth(analysis: Analysis) -> tuple[Line, Line, Line]:
    """Return mass (g), damping (N s/m) and stiffness (N/m) against position (mm), with one standard deviation."""
    profile = analysis.depth_profile()
    if profile is None:
        return _at_one_depth(analysis)
    into, out = profile.direction >= 0, profile.direction < 0
    found = []
    for values, std, scale in (
        (profile.mass, profile.mass_std, 1e3),
        (profile.damping, profile.damping_std, 1.0),
        (profile.stiffness, profile.stiffness_std, 1.0),
    ):
        x, y = 1e3 * profile.position, scale * values
        half = np.where(np.isfinite(std), scale * std, 0.0)
        found.append(
            Line(
                x[into],
                y[into],
                (y - half)[into],
                (y + half)[into],
                x[out] if out.any() else None,
                y[out] if out.any() else None,
            )
        )
    return found[0], found[1], found[2]


def _at_one_depth(analysis: Analysis) -> tuple[Line, Line, Line]:
    """Return one point per parameter at the mean position of the test."""
    record, found = analysis.record[analysis.fit_part], analysis.model.report.reportable_parameters
    names = (("mass_kg", 1e3), ("damping_n_s_per_m", 1.0), ("stiffness_n_per_m", 1.0))
    if (record.output_unit, record.input_unit) != ("m", "N") or any(name not in found for name, _ in names):
        raise UnusableInputError(
            Message("research.no_second_order", "this engine estimates no mass, damping and stiffness from this record")
        )
    where = np.array([1e3 * float(np.nanmean(record.output))])
    mass, damping, stiffness = (Line(where, np.array([scale * found[n].value]), dots=True) for n, scale in names)
    return mass, damping, stiffness


def _residuals(tests: ResidualTests) -> tuple[Line, Line]:
    lines = []
    for name in ("autocorrelation", "input"):
        test = tests[name]
        known = np.isfinite(test.correlation)
        if not known.any():
            raise UnusableInputError(
                Message("research.held_out_short", "too few samples are held out to test the residual")
            )
        band = test.band[known]
        lines.append(Line(MS * test.lag_s[known], test.correlation[known], -band, band))
    return lines[0], lines[1]
