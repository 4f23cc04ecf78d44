"""Plots of linear dynamics: impulse and frequency response, coherence; of the levels of a stepped record too."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tissueid.analysis import Analysis
from tissueid.analysis.curves.plot import (
    CONFIDENCE,
    FREQUENCY,
    LAG,
    TIME,
    Array,
    Axis,
    Curve,
    Kind,
    Plot,
    banded,
    depth_roles,
    kernel_unit,
    ratio_unit,
    signal_axis,
)
from tissueid.analysis.curves.validation import power_edge
from tissueid.errors import UnusableInputError
from tissueid.identification.base import Model
from tissueid.identification.engines.lms import LmsModel
from tissueid.identification.engines.localized import LevelFit, LocalizedModel
from tissueid.identification.engines.rls import RlsModel
from tissueid.identification.engines.spectral import Spectra, Spectral, SpectralModel
from tissueid.identification.online_identifier import OnlineModel
from tissueid.identification.partitions.model import PartitionedModel
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.volterra.structure import VolterraModel
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record
from tissueid.units import display_unit

_EXCITED = 0.03
"""Share of the input's greatest power density below which a frequency counts as not excited."""
_FINE = 200
_FINE_FIT = 400
_PULSE = 1e-3
"""Height of the pulse that a model is probed with, in standard deviations of the input."""
FEW_FREQUENCIES = Message(
    "report.few_frequencies", "the input has power at fewer than three frequencies: use noise or a multisine"
)
_SECOND_ORDER = marked("second order")


def impulse_response(model: LmsModel, record: Record) -> Plot:
    """Return the impulse response, its deviation at every lag, and the second-order fit (Chen 2010, Fig. 3.5)."""
    estimate = replace(
        impulse_curve(model, record),
        name=marked("each lag by itself"),
        colour="measured",
        kind="points",
        band=marked("± 1 standard deviation"),
    )
    fit = second_order_curve(model.second_order, float(model.lag_s[-1]), record)
    return _response_plot(marked("Impulse response"), model.lag_s, (estimate, fit), record)


def online_response(model: OnlineModel, record: Record) -> Plot:
    """Return the impulse response used in simulation, its 95 % band where known, and the second-order fit."""
    std = model.impulse_response_std if isinstance(model, RlsModel) else None
    band = CONFIDENCE * std if std is not None else None
    points = _banded(model.lag_s, model.impulse_response, band, record, marked("each lag by itself"), "points")
    fit = second_order_curve(model.second_order, float(model.lag_s[-1]), record)
    return _response_plot(marked("Impulse response"), model.lag_s, (points, fit), record)


def first_kernel_plot(model: VolterraModel, record: Record) -> Plot:
    """Return the first-order kernel with its 95 % band, and the linear system (Chen 2010, Figs. 4.6a and 4.12)."""
    assert model.kernel1 is not None
    title, band = marked("First-order kernel"), None if model.kernel1_std is None else CONFIDENCE * model.kernel1_std
    parts = [
        replace(_banded(model.lag_s, model.kernel1, band, record, marked("first-order kernel"), "line"), marker=".")
    ]
    if model.second_order is not None:
        fit = second_order_curve(model.second_order, float(model.lag_s[-1]), record)
        parts.append(replace(fit, name=marked("linear system")))
    return _response_plot(title, model.lag_s, tuple(parts), record)


def _banded(lag_s: Array, response: Array, half: Array | None, record: Record, name: str, kind: Kind) -> Curve:
    """Return a response (lags,), in SI units, with a band of half a width ``half``."""
    scale = kernel_unit(record)[1]
    reach = None if half is None else scale * half
    return banded(1e3 * lag_s, scale * response, reach, name, "measured", kind, band=marked("95 % band"))


def _response_plot(title: str, lag_s: Array, parts: tuple[Curve, ...], record: Record) -> Plot:
    lag = replace(LAG, limits=(0.0, 1e3 * float(lag_s[-1]) or 1.0))
    return Plot(title, lag, Axis(title, kernel_unit(record)[0], zero=True), parts)


def impulse_curve(model: Model, record: Record, analysis: Analysis | None = None) -> Curve:
    """Return the impulse response of a model about the mean input, with one deviation where the engine estimates it.

    Without an impulse response of its own a model is probed by a small pulse, which takes the ``analysis``.

    Raises:
        UnusableInputError: the model does not answer the pulse.
    """
    std: Array | None = None
    if isinstance(model, VolterraModel) and model.kernel1 is not None:
        lag_s, response, std = model.lag_s, model.kernel1, model.kernel1_std
    elif isinstance(model, PartitionedModel) and analysis is not None:
        edges, middle = model.breakpoints_m, float(np.nanmean(record[analysis.fit_part].output))
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
            lag_s, response = _probed(model, record if analysis is None else record[analysis.fit_part])
    scale = kernel_unit(record)[1]
    return banded(1e3 * lag_s, scale * response, None if std is None else scale * std, colour="model")


def second_order_curve(fit: SecondOrderFit, seconds: float, record: Record) -> Curve:
    """Return the impulse response of a second-order system up to a lag in seconds."""
    fine_s = np.linspace(0.0, seconds, _FINE_FIT)
    response = kernel_unit(record)[1] * fit.sign * fit.system.impulse_response(fine_s)
    return Curve(1e3 * fine_s, response, _SECOND_ORDER, "model", "dashed", width=1.2)


def _probed(model: Model, record: Record) -> tuple[Array, Array]:
    """Return lags (s) and the response to a small pulse at the mean input, per unit of its area.

    Raises:
        UnusableInputError: the model does not answer the pulse.
    """
    received = record.input[np.isfinite(record.input)]
    if received.size < 2:
        raise UnusableInputError("research.no_input", "no input was received")
    lags = min(model.memory_samples, received.size)
    rest = np.full(3 * lags, float(np.mean(received)))
    pulse, height = rest.copy(), _PULSE * float(np.std(received))
    pulse[lags] += height
    answer = (model.simulate(pulse) - model.simulate(rest))[lags - 1 : 2 * lags]
    if not np.isfinite(answer).all() or height == 0.0 or not np.any(answer):
        raise UnusableInputError(
            "research.no_pulse_response", "the model does not answer a small pulse about the mean input"
        )
    return np.arange(-1, lags) / model.sample_rate_hz, answer * model.sample_rate_hz / height


# -- frequency --------------------------------------------------------------------------------------------------------


def spectra_of(analysis: Analysis) -> Spectra:
    """Return the spectra of the fitted record.

    Raises:
        UnusableInputError: the record is too short.
    """
    if isinstance(analysis.model, SpectralModel):
        return analysis.model.spectra
    try:
        model = Spectral().fit(analysis.record, analysis.fit_part)
    except UnusableInputError:
        model = None
    if not isinstance(model, SpectralModel):
        raise UnusableInputError("research.short_record", "the record is too short for spectra")
    return model.spectra


def excited(spectra: Spectra) -> NDArray[np.bool_]:
    """Return a mask (bins,) of the frequencies at which the input has power.

    Raises:
        UnusableInputError: there are fewer than three.
    """
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * spectra.input_psd[1:].max())
    if shown.sum() < 3:
        raise UnusableInputError(FEW_FREQUENCIES)
    return np.asarray(shown, dtype=np.bool_)


def frequency_response(model: SpectralModel, record: Record) -> tuple[Plot, Plot]:
    """Return magnitude and phase where the input has power, 95 % bands, and the second-order fit (Chen 2010, Fig. 3.3).

    Raises:
        UnusableInputError: the input has power at fewer than three frequencies.
    """
    magnitude, phase = _measured_response(model.spectra, record)
    fine_hz = np.geomspace(magnitude.x[0], magnitude.x[-1], _FINE_FIT)
    fitted = ratio_unit(record)[1] * model.second_order.sign * model.second_order.system.frequency_response(fine_hz)
    angle = np.degrees(np.unwrap(np.angle(fitted)))
    by = 360.0 * float(np.round((np.median(angle) - np.median(phase.y)) / 360.0))
    phase = replace(phase, y=phase.y + by, low=cast(Array, phase.low) + by, high=cast(Array, phase.high) + by)
    upper, lower = (
        Plot(
            axis.label,
            FREQUENCY,
            axis,
            (
                replace(curve, name=marked("measured"), colour="measured", kind="points", band=marked("95 % band")),
                Curve(fine_hz, fit, _SECOND_ORDER, "model", "dashed", width=1.2),
            ),
        )
        for curve, fit, axis in zip((magnitude, phase), (np.abs(fitted), angle), response_axes(record), strict=True)
    )
    return upper, lower


def response_axes(record: Record) -> tuple[Axis, Axis]:
    """Return the axes of magnitude and phase."""
    return Axis(marked("Magnitude"), ratio_unit(record)[0], log=True), Axis(marked("Phase"), "°")


def response_curves(analysis: Analysis, spectra: Spectra) -> tuple[Curve, Curve]:
    """Return magnitude and phase of a model: measured for spectra, else the transform of its impulse response.

    Raises:
        UnusableInputError: the input has power at fewer than three frequencies, or there is no impulse response.
    """
    if isinstance(analysis.model, SpectralModel):
        return _measured_response(spectra, analysis.record)
    ends = spectra.frequency_hz[excited(spectra)][[0, -1]]
    curve = impulse_curve(analysis.model, analysis.record, analysis)
    frequency_hz = np.geomspace(ends[0], ends[1], _FINE)
    lag_s = 1e-3 * curve.x
    turning = np.exp(-2j * np.pi * np.outer(frequency_hz, lag_s))  # (frequencies, lags)
    answer = turning @ curve.y * float(lag_s[1] - lag_s[0] if lag_s.size > 1 else 1.0)
    phase = np.degrees(np.unwrap(np.angle(answer)))
    magnitude = np.maximum(np.abs(answer), 1e-12)
    return Curve(frequency_hz, magnitude, colour="model"), Curve(frequency_hz, phase, colour="model")


def coherence_curve(spectra: Spectra, shown: NDArray[np.bool_] | slice) -> Curve:
    """Return the mean squared coherence at some frequencies."""
    return Curve(spectra.frequency_hz[shown], spectra.coherence[shown], colour="model")


def power_band(spectra: Spectra) -> NDArray[np.bool_]:
    """Return a mask (bins,) of the frequencies that contain 99 % of the input power, without zero."""
    edge = power_edge(spectra.frequency_hz, spectra.input_psd)
    return (spectra.frequency_hz > 0.0) & (spectra.frequency_hz <= edge)


def coherence_plot(spectra: Spectra) -> Plot:
    """Return the mean squared coherence, the level that unrelated signals seldom exceed, and where there is no input.

    Chen 2010, Fig. 3.2b, Eq. 3.1.
    """
    frequency_hz = spectra.frequency_hz[1:]
    ends = float(frequency_hz[0]), float(frequency_hz[-1])
    edge = float(spectra.frequency_hz[power_band(spectra)].max(initial=ends[0]))
    floor = np.array([spectra.coherence_floor])
    parts = [
        replace(coherence_curve(spectra, slice(1, None)), colour="measured"),
        Curve(floor, floor, marked("5 % significance level"), "model", "level"),
    ]
    if edge < ends[1]:
        parts.insert(0, Curve(np.array([edge, ends[1]]), np.zeros(0), "", "muted", "spans", opacity=0.1))
    title = marked("Mean squared coherence")
    return Plot(title, replace(FREQUENCY, limits=ends), Axis(title, limits=(0.0, 1.06)), tuple(parts))


def _measured_response(spectra: Spectra, record: Record) -> tuple[Curve, Curve]:
    """Return measured magnitude and phase with 95 % bands."""
    shown = excited(spectra) & (spectra.magnitude > 0.0) & np.isfinite(spectra.magnitude_std)
    frequency_hz, scale = spectra.frequency_hz[shown], ratio_unit(record)[1]
    magnitude = scale * spectra.magnitude[shown]
    spread = 1.0 + CONFIDENCE * spectra.magnitude_std[shown] / spectra.magnitude[shown]
    phase = np.degrees(spectra.phase_rad[shown])
    half = np.minimum(np.degrees(CONFIDENCE * spectra.phase_std_rad[shown]), 180.0)
    return (
        Curve(frequency_hz, magnitude, colour="model", low=magnitude / spread, high=magnitude * spread),
        Curve(frequency_hz, phase, colour="model", low=phase - half, high=phase + half),
    )


_BELOW = 0.3
"""Lower end of a Bode diagram as a multiple of the lowest natural frequency."""
_ABOVE = 6.0
"""Upper end of a Bode diagram as a multiple of the highest natural frequency."""


def by_depth(model: LocalizedModel) -> list[LevelFit]:
    """Return the levels from the lowest position to the highest."""
    return sorted(model.levels, key=lambda level: level.position)


def level_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return input and output against time, with the mean of each level coloured by depth (Chen 2010, Fig. 3.12)."""
    levels = by_depth(model)
    time = replace(TIME, limits=(float(record.time[0]), float(record.time[-1])))
    made = []
    for name, si_unit, values, colour, of in (
        (record.input_name, record.input_unit, record.input, "model", "force"),
        (record.output_name, record.output_unit, record.output, "good", "position"),
    ):
        scale = display_unit(si_unit)[1]
        parts = [Curve(record.time, scale * values, "", colour, width=0.4, opacity=0.5)]
        for fitted, role in zip(levels, depth_roles(len(levels)), strict=True):
            span = record.time[[fitted.level.first, fitted.level.end - 1]]
            parts.append(Curve(span, np.full(2, scale * float(getattr(fitted, of))), "", role, width=2.3))
        made.append(Plot("", time, signal_axis(name, si_unit), tuple(parts)))
    return made[0], made[1]


def level_impulse_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return impulse responses, and each divided by its area; a curve for each level (Chen 2010, Fig. 3.12a).

    Curves are coloured by depth; those of levels reached by moving out of the tissue are dashed.
    """
    levels = by_depth(model)
    unit, scale = kernel_unit(record)
    slowest = min(level.fit.system.natural_frequency_rad_per_s for level in levels)
    time_s = np.linspace(0.0, 4.0 * np.pi / slowest, 400)
    impulses, normalised = [], []
    for level, role in zip(levels, depth_roles(len(levels)), strict=True):
        response = level.fit.system.impulse_response(time_s)
        impulses.append(Curve(1e3 * time_s, scale * level.fit.sign * response, "", role, _kind(level)))
        normalised.append(Curve(1e3 * time_s, response * level.fit.system.stiffness, "", role, _kind(level)))
    lag = replace(LAG, limits=(0.0, 1e3 * float(time_s[-1])))
    return (
        Plot("", lag, Axis(marked("Impulse response"), unit, zero=True), tuple(impulses)),
        Plot(
            "",
            lag,
            Axis(marked("Divided by its area"), "1/s", zero=True),
            tuple(normalised),
            depths=_depths(model, record),
        ),
    )


def level_response_plots(model: LocalizedModel, record: Record) -> tuple[Plot, Plot]:
    """Return magnitude and phase of the compliance; a curve for each level, as above (Chen 2010, Fig. 3.13)."""
    levels = by_depth(model)
    natural = np.array([level.fit.system.natural_frequency_rad_per_s for level in levels]) / (2.0 * np.pi)
    highest = min(_ABOVE * float(natural.max()), 0.5 * record.sample_rate_hz)
    frequency_hz = np.geomspace(_BELOW * float(natural.min()), highest, 300)
    scale = ratio_unit(record)[1]
    magnitudes, phases = [], []
    for level, role in zip(levels, depth_roles(len(levels)), strict=True):
        response = scale * level.fit.sign * level.fit.system.frequency_response(frequency_hz)
        magnitudes.append(Curve(frequency_hz, np.abs(response), "", role, _kind(level)))
        phases.append(Curve(frequency_hz, np.degrees(np.unwrap(np.angle(response))), "", role, _kind(level)))
    frequency = replace(FREQUENCY, limits=(float(frequency_hz[0]), float(frequency_hz[-1])))
    magnitude, phase = response_axes(record)
    return (
        Plot("", frequency, magnitude, tuple(magnitudes)),
        Plot("", frequency, phase, tuple(phases), depths=_depths(model, record)),
    )


def _depths(model: LocalizedModel, record: Record) -> Axis:
    """Return the axis of the colours: the output, from the lowest level to the highest."""
    places = display_unit(record.output_unit)[1] * np.array([level.position for level in model.levels])
    axis = signal_axis(record.output_name, record.output_unit)
    return replace(axis, limits=(float(places.min()), float(places.max())))


def _kind(level: LevelFit) -> Kind:
    return "dashed" if level.level.direction < 0 else "line"
