"""Live view of a running test: the linear response, its static curve, and the parameters so far.

An identifier holds the response (:mod:`~tissueid.identification.online`). A view does not change it and takes a few
milliseconds, so that it can be computed several times per second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array
from tissueid.identification.engines.als import Als, AlsIdentifier
from tissueid.identification.engines.lms import Lms
from tissueid.identification.engines.rls import Rls, RlsIdentifier
from tissueid.identification.engines.spectral import Spectral
from tissueid.identification.impulse_response import convolve_at_rest, kernel_std
from tissueid.identification.live.sliding import SlidingLms
from tissueid.identification.live.stopping import PARAMETERS, Parameter, Precision
from tissueid.identification.online_identifier import RECENT_S
from tissueid.identification.preparation import PreparedRecord, prepare
from tissueid.identification.second_order import without_spring
from tissueid.identification.second_order_fit import SecondOrderFit
from tissueid.identification.static_nonlinearity import fit_exponential
from tissueid.identification.validation import vaf_percent
from tissueid.identification.validation.scores import above_noise
from tissueid.messages import Listing
from tissueid.records import Estimate, Record

Method = Literal["sliding", "rls", "als"]
METHODS: tuple[Method, ...] = get_args(Method)
LiveIdentifier = SlidingLms | RlsIdentifier | AlsIdentifier
_METHOD_OF: dict[type, Method] = {SlidingLms: "sliding", RlsIdentifier: "rls", AlsIdentifier: "als"}

_LONGEST_SEGMENT_S = 0.5
_SEGMENTS = 3.0
"""Minimum length of a record, in segments; with an overlap of one half these are five segments."""

_EXCITED = 0.03
"""Input power density below which a frequency counts as not excited, relative to the greatest density."""

_LEVELS = 16
_SAMPLES_PER_LEVEL = 40
_CURVE_POINTS = 64
_DEPTHS = 24


@dataclass(frozen=True, eq=False)
class LiveBode:
    """Frequency response (bins,) of the present impulse response, and the coherence of input and output (Eq. 3.1).

    ``magnitude`` is in output units per input unit, ``phase_rad`` is unwrapped from the lowest frequency. ``coherence``
    is insignificant (5 %) below ``coherence_floor``. Frequencies that the input does not excite are left out.
    """

    frequency_hz: Array
    magnitude: Array
    phase_rad: Array
    coherence: Array
    coherence_floor: float


@dataclass(frozen=True, eq=False)
class LiveSpectra:
    """One-sided power densities (bins,) of input and output about their means, in squared units per hertz.

    They belong to all frequencies above zero, also those that the input does not excite: there the output shows noise.
    """

    frequency_hz: Array
    input_psd: Array
    output_psd: Array


@dataclass(frozen=True, eq=False)
class LiveCurve:
    """Measured output against the linear prediction, both in output units.

    ``predicted`` (levels,) and ``measured`` are means over bins of the prediction with equal counts, ``measured_std``
    the standard deviation of the outputs in each bin. ``curve_x`` (m,) and ``curve_y`` are the exponential of Eq. 3.26
    fitted to all samples. For a linear tissue, all points are on the diagonal.
    """

    predicted: Array
    measured: Array
    measured_std: Array
    curve_x: Array
    curve_y: Array


@dataclass(frozen=True, eq=False)
class LiveDepths:
    """Histogram of the output: ``share`` (k,) of the samples between the ``edges`` (k + 1,), in output units."""

    edges: Array
    share: Array


@dataclass(frozen=True, eq=False)
class LiveCourse:
    """Mass, damping and stiffness as estimated during the test.

    ``seconds`` has shape (estimates,), ``values`` and ``std`` (estimates, 3) in kg, N s/m and N/m; an unknown standard
    deviation is infinite.
    """

    seconds: Array
    values: Array
    std: Array


@dataclass(frozen=True, eq=False)
class LiveView:
    """View of a running test after ``seconds`` of record.

    ``impulse_response`` (lags,) is in output units per input unit and second at ``lag_s`` (lags,), empty before it is
    known; ``impulse_response_std`` holds its standard deviations, None for an adaptive response. ``second_order`` is
    the fit that gives ``parameters``. ``vaf_percent`` scores the free run of the response: over the window of the
    sliding method, over the latest ten seconds otherwise. ``missing`` is one line on what is not available yet and why,
    else empty.
    """

    method: Method
    seconds: float
    lag_s: Array
    impulse_response: Array
    impulse_response_std: Array | None
    second_order: SecondOrderFit | None
    parameters: dict[Parameter, Estimate]
    vaf_percent: float | None
    bode: LiveBode | None
    curve: LiveCurve | None
    depths: LiveDepths | None
    course: LiveCourse
    missing: str = ""
    spectra: LiveSpectra | None = None

    def without_spring(self, spring_n_per_m: float) -> LiveView:
        """Return a copy with a parallel spring subtracted from the stiffness; responses still include it."""
        values = self.course.values.copy()
        if values.size:
            values[:, PARAMETERS.index("stiffness")] -= spring_n_per_m
        return replace(
            self,
            parameters=without_spring(self.parameters, spring_n_per_m),
            course=replace(self.course, values=values),
        )


def start_identifier(
    method: Method, sample_rate_hz: float, memory: float = 0.125, window_s: float | None = RECENT_S
) -> LiveIdentifier:
    """Return an identifier from force to position without any data.

    Args:
        method: sliding least squares, recursive least squares, or adaptive least squares.
        sample_rate_hz: of the samples.
        memory: length of the impulse response, s.
        window_s: length of the window of the sliding method; None for all samples.

    Raises:
        UnusableInputError: there is no such method, or the sample rate is not positive.
    """
    if method == "sliding":
        return SlidingLms(Lms(memory=memory), sample_rate_hz, window_s)
    if method in ("rls", "als"):
        started: RlsIdentifier | AlsIdentifier = (Rls if method == "rls" else Als)(memory=memory).start(sample_rate_hz)
        return started
    raise UnusableInputError(
        "online.unknown_method",
        "there is no live method '{method}': choose one of {methods}",
        method=method,
        methods=Listing(METHODS),
    )


def view(identifier: LiveIdentifier, looks: Sequence[Precision] = ()) -> LiveView:
    """Return the live view of an identifier; ``looks`` are the parameter estimates so far, oldest first.

    Results that are not available yet are left out, and ``missing`` gives the reason.
    """
    newest = looks[-1] if looks else None
    response: _Response | None = None
    bode: LiveBode | None = None
    spectra: LiveSpectra | None = None
    missing = ""
    try:
        response = _present_response(identifier)
        bode, spectra = _by_frequency(response)
    except UnusableInputError as error:
        missing = error.message
    return LiveView(
        method=_METHOD_OF[type(identifier)],
        seconds=identifier.samples / identifier.sample_rate_hz,
        lag_s=identifier.lag_s if response else np.zeros(0),
        impulse_response=response.kernel * identifier.sample_rate_hz if response else np.zeros(0),
        impulse_response_std=response.std * identifier.sample_rate_hz
        if response and response.std is not None
        else None,
        second_order=newest.second_order if newest else None,
        parameters=newest.estimates if newest else {},
        vaf_percent=response.vaf_percent if response else None,
        bode=bode,
        curve=_curve(response) if response else None,
        depths=_depths(response.prepared.record) if response else None,
        course=_course(looks),
        missing=missing,
        spectra=spectra,
    )


@dataclass(frozen=True, eq=False)
class _Response:
    """A response per sample (lags,) with its standard deviations, and its simulation of the latest samples (n,)."""

    kernel: Array
    std: Array | None
    modelled: Array
    prepared: PreparedRecord

    @property
    def pairs(self) -> tuple[Array, Array]:
        """Linear prediction and measured output at samples that have both."""
        used = self.prepared.used & np.isfinite(self.modelled)
        return self.modelled[used], self.prepared.record.output[used]

    @property
    def vaf_percent(self) -> float | None:
        """Variance accounted for; None if the output does not vary above its noise."""
        predicted, measured = self.pairs
        return vaf_percent(measured, predicted) if above_noise(measured) else None


def _present_response(identifier: LiveIdentifier) -> _Response:
    """Return the response as the engine of the identifier would report it.

    Raises:
        UnusableInputError: there are too few samples, or nothing varies.
    """
    if isinstance(identifier, SlidingLms):
        solved = identifier.solve()
        prepared = solved.prepared
        x, modelled, residuals = _run(solved.kernel, prepared, prepared.input_mean, prepared.output_mean)
        std = kernel_std(solved.inverse, x, residuals)[: solved.kernel.size]
        return _Response(solved.kernel, std, modelled, prepared)
    prepared = prepare(identifier.recent(), None, identifier.options.memory_s)
    if isinstance(identifier, AlsIdentifier):
        kernel = identifier.average_response / identifier.sample_rate_hz
        _, modelled, residuals = _run(kernel, prepared, identifier.centre, 0.0)
        return _Response(kernel, None, modelled + float(np.nanmean(residuals)), prepared)
    kernel = identifier.impulse_response / identifier.sample_rate_hz
    x, modelled, residuals = _run(kernel, prepared, identifier.input_mean, identifier.offset)
    std = identifier.options.response_std(identifier, identifier.covariance, x, residuals, prepared.part)
    return _Response(kernel, std, modelled, prepared)


def _run(kernel: Array, prepared: PreparedRecord, centre: float, offset: float) -> tuple[Array, Array, Array]:
    """Return the input minus its centre, the free run, and the residuals (NaN for samples that are not scored); each
    (n,).
    """
    record = prepared.record
    x = record.input - centre
    modelled = offset + convolve_at_rest(kernel, x)
    return x, modelled, np.where(prepared.used, record.output - modelled, np.nan)


def _by_frequency(response: _Response) -> tuple[LiveBode, LiveSpectra]:
    """Return the transform of the response with the coherence, and the power densities.

    Segments are as long as the record allows.

    Raises:
        UnusableInputError: the record is too short, or has too many gaps, for two segments as long as the memory.
    """
    record, lags = response.prepared.record, response.kernel.size
    rate = record.sample_rate_hz
    segment = min(_LONGEST_SEGMENT_S, len(record) / rate / _SEGMENTS)
    if round(segment * rate) < lags:
        raise UnusableInputError(
            "online.short_for_coherence",
            "coherence needs {segments:g} memories of {memory:g} s: wait for more data",
            segments=_SEGMENTS,
            memory=lags / rate,
        )
    spectra = Spectral(window=segment).spectra(response.prepared)
    shown = (spectra.frequency_hz > 0.0) & (spectra.input_psd > _EXCITED * np.max(spectra.input_psd[1:]))
    transform = fft.rfft(response.kernel, round(segment * rate))
    bode = LiveBode(
        frequency_hz=spectra.frequency_hz[shown],
        magnitude=np.abs(transform)[shown],
        phase_rad=np.unwrap(np.angle(transform))[shown],
        coherence=spectra.coherence[shown],
        coherence_floor=spectra.coherence_floor,
    )
    return bode, LiveSpectra(spectra.frequency_hz[1:], spectra.input_psd[1:], spectra.output_psd[1:])


def _curve(response: _Response) -> LiveCurve | None:
    """Return binned means and the exponential fitted to all samples; None if there are too few."""
    predicted, measured = response.pairs
    levels = min(_LEVELS, predicted.size // _SAMPLES_PER_LEVEL)
    if levels < 4 or not float(np.ptp(predicted)) > 0.0:
        return None
    order = np.argsort(predicted)
    parts = np.array_split(order, levels)
    fitted = fit_exponential(predicted, measured)
    x = np.linspace(fitted.low, fitted.high, _CURVE_POINTS)
    return LiveCurve(
        predicted=np.array([predicted[part].mean() for part in parts]),
        measured=np.array([measured[part].mean() for part in parts]),
        measured_std=np.array([measured[part].std() for part in parts]),
        curve_x=x,
        curve_y=fitted(x),
    )


def _depths(record: Record) -> LiveDepths:
    received = record.output[np.isfinite(record.output)]
    counts, edges = np.histogram(received, bins=_DEPTHS)
    return LiveDepths(edges=edges, share=counts / max(1, received.size))


def _course(looks: Sequence[Precision]) -> LiveCourse:
    values = np.full((len(looks), len(PARAMETERS)), np.nan)
    std = np.full((len(looks), len(PARAMETERS)), np.inf)
    for row, look in enumerate(looks):
        for column, estimate in enumerate(look.estimates.values()):
            values[row, column] = estimate.value
            std[row, column] = np.inf if estimate.std is None else estimate.std
    return LiveCourse(np.array([look.seconds for look in looks]), values, std)
