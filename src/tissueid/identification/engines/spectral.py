"""Spectra by Welch's method: power, coherence and transfer function of the best linear approximation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Family, Model, option
from tissueid.identification.impulse_response import convolve_at_rest
from tissueid.identification.memory import MemoryEngine
from tissueid.identification.preparation import (
    PreparedRecord,
    finite_runs,
    memory_in_samples,
    part_length,
    prepare,
    typical_samples,
)
from tissueid.identification.registry import engine
from tissueid.identification.second_order import Complex
from tissueid.identification.second_order_fit import SecondOrderFit, fit_second_order
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.records import Record

_WINDOW_S = 0.5
"""Length of a segment of a record of tissue, s (``typical_samples``)."""
_SEGMENTS = 4
"""Least number of segments, without overlap, of another record."""

_NO_COHERENCE = Message("spectral.no_coherence", "input and output have no significant coherence at any frequency")


@dataclass(frozen=True)
class Spectra:
    """Averaged spectra; every array has shape (bins,), at ``frequency_hz``.

    ``input_psd`` and ``output_psd`` are one-sided densities, input and output units squared per hertz.
    ``coherence`` is the mean squared coherence of Eq. 3.1, insignificant (5 %) below ``coherence_floor``.
    ``averages`` is the equivalent number of independent segments. ``magnitude_std`` and ``phase_std_rad`` are standard
    deviations of the transfer function, infinite where the coherence is zero.
    """

    frequency_hz: Array
    input_psd: Array
    output_psd: Array
    coherence: Array
    response: Complex
    magnitude_std: Array
    phase_std_rad: Array
    averages: float

    @property
    def magnitude(self) -> Array:
        """Magnitude of the transfer function, output units per input unit."""
        return np.abs(self.response)

    @property
    def phase_rad(self) -> Array:
        """Phase, unwrapped from the lowest frequency."""
        return np.unwrap(np.angle(self.response))

    @property
    def coherence_floor(self) -> float:
        """Coherence that unrelated signals exceed with a probability of 5 % (Goodman 1957)."""
        return 1.0 - math.pow(0.05, 1.0 / max(self.averages - 1.0, 1e-9))


@dataclass(frozen=True, eq=False)
class SpectralModel(Model):
    """A linear system given by its transfer function H1 about an operating point.

    It is simulated by the impulse response of H1, ``kernel`` (lags,) per sample, from the bins with significant
    coherence and input power; at other bins H1 is a ratio of noise. ``second_order`` is the parametric fit to the same
    samples in the time domain.
    """

    spectra: Spectra
    kernel: Array
    input_mean: float
    output_mean: float
    second_order: SecondOrderFit

    def simulate(self, u: Array) -> Array:
        """Return the free-run output (n,) for an input (n,), at rest at the mean input before the first sample."""
        return self.output_mean + convolve_at_rest(self.kernel, np.asarray(u, dtype=np.float64) - self.input_mean)


@engine
class Spectral(MemoryEngine):
    """Spectral engine.

    Assumes a linear system and a window several times longer than its memory. A coherence below 1 is caused by output
    noise, by nonlinearity, or by leakage of a window that is too short.
    """

    name: ClassVar[str] = "spectral"
    label: ClassVar[str] = marked("Spectral")
    title: ClassVar[str] = marked(
        "Welch spectra, coherence and Bode diagram (Chen 2010, 3.1.2), with mass, damping and stiffness."
    )
    family: ClassVar[Family] = Family.LINEAR
    in_report: ClassVar[bool] = True

    window: float | None = option(
        None, marked("Window"), marked("Length of a segment, s; from the record if not given"), gt=0.0, le=1e7
    )
    overlap: float = option(0.5, marked("Overlap"), marked("Share of a segment that overlaps the next"), ge=0.0, le=0.9)
    taper: Literal["hann", "hamming", "blackman", "boxcar"] = option("hann", marked("Taper"), marked("Window function"))
    range_db: float = option(
        30.0,
        marked("Range"),
        marked("Simulation uses frequencies whose input power is within this range below its peak, dB"),
        gt=0.0,
        le=300.0,
    )

    def for_record(self, record: Record, fit_part: slice | None) -> Self:
        """Return the specification with memory and window for this record.

        Raises:
            UnusableInputError: the memory has too many samples.
        """
        specification = super().for_record(record, fit_part)
        if specification.window is not None:
            return specification
        rate = record.sample_rate_hz
        typical = typical_samples(_WINDOW_S, rate)
        if typical == round(_WINDOW_S * rate):
            return specification.model_copy(update={"window": max(_WINDOW_S, specification.memory_s)})
        length = part_length(record, fit_part)
        samples = max(memory_in_samples(specification.memory_s, rate), min(typical, length // _SEGMENTS))
        return specification.model_copy(update={"window": samples / rate})

    def fit(self, record: Record, fit_part: slice | None = None) -> SpectralModel:
        """Estimate the spectra of a record, or of a contiguous part of it.

        Raises:
            UnusableInputError: nothing varies, too few samples, the window shorter than the memory, or fewer than
                two segments without a gap.
        """
        prepared = prepare(record, fit_part, self.memory_s)
        lags = prepared.memory_samples
        length = memory_in_samples(self.window or _WINDOW_S, record.sample_rate_hz)
        if length < lags:
            raise UnusableInputError(
                "spectral.window_shorter_than_memory",
                "the window, {window:g} s, is shorter than the memory, {memory:g} s",
                window=self.window,
                memory=self.memory_s,
            )
        spectra = self.spectra(prepared)
        trusted = (spectra.coherence > spectra.coherence_floor) & (
            spectra.input_psd > np.max(spectra.input_psd) * 10.0 ** (-self.range_db / 10.0)
        )
        kernel = fft.irfft(np.where(trusted, spectra.response, 0.0), length)[:lags]
        modelled = prepared.output_mean + convolve_at_rest(kernel, record.input - prepared.input_mean)
        second_order = fit_second_order(record, prepared.used, self.hold)
        doubts = () if trusted.any() else (_NO_COHERENCE,)
        return SpectralModel(
            report=self.report(
                record,
                prepared.used,
                modelled,
                lags + 1,
                parameters=second_order.parameters,
                warnings=(*prepared.warnings, *doubts, *second_order.warnings),
                details={
                    "averages": spectra.averages,
                    "mean_coherence": float(np.average(spectra.coherence, weights=spectra.input_psd)),
                    "vaf_parametric_percent": second_order.vaf_percent,
                },
            ),
            sample_rate_hz=record.sample_rate_hz,
            memory_samples=lags,
            spectra=spectra,
            kernel=kernel,
            input_mean=prepared.input_mean,
            output_mean=prepared.output_mean,
            second_order=second_order,
        )

    def spectra(self, prepared: PreparedRecord) -> Spectra:
        """Average the periodograms of all segments (segments, length) of the fitted part without a gap.

        Raises:
            UnusableInputError: there are fewer than two segments without a gap.
        """
        record = prepared.record
        length = memory_in_samples(self.window or _WINDOW_S, record.sample_rate_hz)
        stride = max(1, round(length * (1.0 - self.overlap)))
        runs = finite_runs(record.valid[prepared.part])  # the grid of segments restarts after each gap
        each = [np.arange(first, end - length + 1, stride) for first, end in runs]
        starts = prepared.part.start + np.concatenate(each).astype(np.intp)
        if starts.size < 2:
            raise UnusableInputError(
                "spectral.too_few_segments",
                "{count} segments of {window:g} s without a gap are too few: coherence needs at least two. Shorten "
                "the window",
                count=starts.size,
                window=self.window,
            )
        taper = signal.get_window(self.taper, length)
        index = starts[:, None] + np.arange(length)
        x = fft.rfft((record.input - prepared.input_mean)[index] * taper, axis=1)  # (segments, bins)
        y = fft.rfft((record.output - prepared.output_mean)[index] * taper, axis=1)
        xx = np.mean(np.abs(x) ** 2, axis=0)
        yy = np.mean(np.abs(y) ** 2, axis=0)
        xy = np.mean(np.conj(x) * y, axis=0)
        nonzero = np.abs(xy) > 0.0
        coherence = np.zeros(xx.size)
        coherence[nonzero] = np.minimum(1.0, np.abs(xy[nonzero]) ** 2 / (xx[nonzero] * yy[nonzero]))
        response = np.zeros(xx.size, dtype=np.complex128)
        response[nonzero] = xy[nonzero] / xx[nonzero]
        averages = independent_averages(starts, taper)
        relative = np.full(xx.size, np.inf)
        relative[nonzero] = np.sqrt((1.0 - coherence[nonzero]) / (2.0 * averages * coherence[nonzero]))
        density = np.full(xx.size, 2.0 / (record.sample_rate_hz * float(taper @ taper)))
        density[0] *= 0.5
        if length % 2 == 0:
            density[-1] *= 0.5
        return Spectra(
            frequency_hz=fft.rfftfreq(length, 1.0 / record.sample_rate_hz),
            input_psd=xx * density,
            output_psd=yy * density,
            coherence=coherence,
            response=response,
            magnitude_std=np.where(nonzero, np.abs(response), 1.0) * relative,
            phase_std_rad=relative,
            averages=averages,
        )


def independent_averages(starts: NDArray[np.intp], taper: Array) -> float:
    """Return the equivalent number of independent segments of overlapping ones, for white data (Welch 1967)."""
    distance = np.abs(starts[:, None] - starts[None, :])  # (segments, segments)
    correlation = signal.correlate(taper, taper)[taper.size - 1 :] / float(taper @ taper)
    shared = np.where(distance < taper.size, correlation[np.minimum(distance, taper.size - 1)], 0.0)
    return float(starts.size**2 / np.sum(shared**2))
