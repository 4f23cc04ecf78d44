"""Spectra of stimuli, each as a power density and as an autocorrelation.

Both are normalised: the autocorrelation at lag 0 is 1, and so is the mean of the power density from 0 to half the
sample rate. Both are exact for the sampled signal (Wiener-Khinchin theorem), whichever of the two is given. The forms
are those of Chen 2010, C.4.1, and tables.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.base import MAX_SAMPLES

Array = NDArray[np.float64]

SpectrumName = Literal["butterworth", "white", "band", "exponential", "second_order", "power", "autocorrelation"]

ROUNDING_ERROR = 1e-5
"""Largest negative power of a tabulated spectrum, as a sum of squares over all lags, attributed to three-digit
rounding.
"""

_MIN_GRID, _MAX_GRID = 1 << 16, 1 << 24
"""Minimum and maximum grid, samples, for summing the power of a filter; its impulse response must decay within it."""

_GRID_CYCLES = 100
"""Periods of the cutoff frequency per filter order after which the impulse response has decayed."""

_CHUNK = 1 << 16
"""Frequencies evaluated at a time, which limits memory."""

_SETTLING_CYCLES = 40
"""Periods of the cutoff frequency after which the initial transient of a low-pass has decayed."""

_TINY = float(np.finfo(np.float64).tiny)


class Spectrum(ABC):
    """Distribution of the power of a stimulus over frequency."""

    @abstractmethod
    def check(self, sample_rate_hz: float) -> None:
        """Raise if no signal at this sample rate has this spectrum.

        Raises:
            UnusableInputError: the message gives the reason.
        """

    @abstractmethod
    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the autocorrelation (lags + 1,) at 0 to ``lags`` samples, 1 at lag 0."""

    @abstractmethod
    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the power density (n // 2 + 1,) at the frequencies of a real transform of n samples, relative to its
        mean.
        """


def _below_nyquist(what: str, frequency_hz: float, sample_rate_hz: float) -> None:
    if frequency_hz >= 0.5 * sample_rate_hz:
        raise UnusableInputError(
            "spectrum.nyquist",
            "{what} of {frequency_hz:g} Hz needs a sample rate above {needed:g} Hz, not {sample_rate_hz:g} Hz",
            what=what,
            frequency_hz=frequency_hz,
            needed=2 * frequency_hz,
            sample_rate_hz=sample_rate_hz,
        )


def settling_samples(cutoff_hz: float, sample_rate_hz: float) -> int:
    """Return the number of samples after which the initial transient of a low-pass has decayed."""
    return int(np.ceil(_SETTLING_CYCLES * sample_rate_hz / cutoff_hz))


def check_settling(cutoff_hz: float, sample_rate_hz: float, grid_cycles: float = 0.0) -> None:
    """Raise for a low-pass that takes longer to settle than the longest stimulus.

    Args:
        cutoff_hz: of the low-pass, Hz.
        sample_rate_hz: of the stimulus, Hz.
        grid_cycles: periods of the cutoff frequency over which its power is summed, 0 if it is not.

    Raises:
        UnusableInputError: the cutoff is too low; the message gives the minimum.
    """
    settled, summed = (sample_rate_hz * share for share in (_SETTLING_CYCLES / MAX_SAMPLES, grid_cycles / _MAX_GRID))
    least = max(settled, summed)
    if cutoff_hz < least:
        reason = (
            Message(
                "spectrum.settling",
                "the filter would take more than {limit:.3g} samples to settle",
                limit=MAX_SAMPLES,
            )
            if cutoff_hz < settled
            else Message(
                "spectrum.grid",
                "its power would have to be summed over more than {limit:.3g} samples",
                limit=_MAX_GRID,
            )
        )
        raise UnusableInputError(
            "spectrum.low_cutoff",
            "a cutoff of {cutoff_hz:g} Hz is too low at a sample rate of {sample_rate_hz:g} Hz: {reason}; "
            "the minimum is about {least:.3g} Hz",
            cutoff_hz=cutoff_hz,
            sample_rate_hz=sample_rate_hz,
            reason=reason,
            least=1.005 * least,
        )


def _frequencies(n: int, sample_rate_hz: float) -> Array:
    return np.asarray(scipy.fft.rfftfreq(n, 1.0 / sample_rate_hz), dtype=np.float64)


@dataclass(frozen=True)
class White(Spectrum):
    """White spectrum: constant power density."""

    def check(self, sample_rate_hz: float) -> None:
        """Accept every sample rate."""

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return 1 at lag 0 and 0 at all others, shape (lags + 1,)."""
        return np.concatenate([[1.0], np.zeros(lags)])

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return ones (n // 2 + 1,)."""
        return np.ones(n // 2 + 1)


@dataclass(frozen=True)
class Butterworth(Spectrum):
    """White noise through a digital Butterworth low-pass (bilinear transform)."""

    cutoff_hz: float
    order: int = 8

    def check(self, sample_rate_hz: float) -> None:
        """Raise unless the cutoff is below half the sample rate and the filter settles within a stimulus."""
        _below_nyquist(marked("a cutoff"), self.cutoff_hz, sample_rate_hz)
        check_settling(self.cutoff_hz, sample_rate_hz, _GRID_CYCLES * self.order)

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the transform of the filter's power, on a grid fine enough for the response to decay."""
        correlation = scipy.fft.irfft(*self._resolved_gain(lags, sample_rate_hz))[: lags + 1]
        return np.asarray(correlation / correlation[0], dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the normalised power gain of the filter."""
        return self._gain(n, sample_rate_hz) / _mean_power(self._resolved_gain(0, sample_rate_hz)[0])

    def _resolved_gain(self, lags: int, sample_rate_hz: float) -> tuple[Array, int]:
        """Return the power gain on a sufficiently fine grid and the number of samples of the grid."""
        samples = _GRID_CYCLES * self.order * sample_rate_hz / self.cutoff_hz
        n = max(_MIN_GRID, 1 << int(np.ceil(np.log2(max(samples, 4.0 * lags + 4.0)))))
        return self._gain(n, sample_rate_hz), n

    def _gain(self, n: int, sample_rate_hz: float) -> Array:
        low_pass = scipy.signal.butter(self.order, self.cutoff_hz, fs=sample_rate_hz, output="sos")
        gain = _frequencies(n, sample_rate_hz)
        for first in range(0, gain.size, _CHUNK):
            piece = gain[first : first + _CHUNK]
            piece[:] = np.abs(scipy.signal.sosfreqz(low_pass, piece, fs=sample_rate_hz)[1]) ** 2
        return gain


@dataclass(frozen=True)
class Band(Spectrum):
    """Constant power up to the cutoff and none above: "power" of C.4.1, without its tail."""

    cutoff_hz: float

    def check(self, sample_rate_hz: float) -> None:
        """Raise unless the cutoff is below half the sample rate."""
        _below_nyquist(marked("a cutoff"), self.cutoff_hz, sample_rate_hz)

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return sin(x) / x, x = 2 pi cutoff lag, shape (lags + 1,)."""
        return np.asarray(np.sinc(2.0 * self.cutoff_hz * np.arange(lags + 1) / sample_rate_hz), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return a constant up to the cutoff and 0 above."""
        inside = _frequencies(n, sample_rate_hz) <= self.cutoff_hz
        return np.where(inside, 0.5 * sample_rate_hz / self.cutoff_hz, 0.0)


@dataclass(frozen=True)
class ExponentialDecay(Spectrum):
    """Autocorrelation exp(-t / T): white noise through a first-order low-pass."""

    time_constant_s: float

    def check(self, sample_rate_hz: float) -> None:
        """Raise unless the time constant lies between 0.001 samples and the length of the longest stimulus."""
        samples = self.time_constant_s * sample_rate_hz
        if not 1e-3 <= samples <= MAX_SAMPLES:
            raise UnusableInputError(
                "spectrum.time_constant",
                "the time constant must be between 0.001 and {limit:.3g} samples, not {samples:.3g} "
                "({time_constant_s:g} s); below that use the white spectrum",
                time_constant_s=self.time_constant_s,
                samples=samples,
                limit=MAX_SAMPLES,
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the exponential autocorrelation at lags 0 to ``lags``, shape (lags + 1,)."""
        return np.asarray(np.exp(-np.arange(lags + 1) / (self.time_constant_s * sample_rate_hz)), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the power of a geometric autocorrelation at ``n`` frequencies."""
        return _geometric_power(-1.0 / (self.time_constant_s * sample_rate_hz), n)


@dataclass(frozen=True)
class SecondOrderSpectrum(Spectrum):
    """Autocorrelation exp(-z w t) cos(w sqrt(1 - z^2) t) of a damped oscillator: "order2" of C.4.1."""

    natural_hz: float
    damping: float

    def check(self, sample_rate_hz: float) -> None:
        """Raise unless the natural frequency is below half the sample rate and the oscillation decays within a
        stimulus.
        """
        _below_nyquist(marked("a natural frequency"), self.natural_hz, sample_rate_hz)
        least = sample_rate_hz / (2.0 * np.pi * self.damping * MAX_SAMPLES)
        if self.natural_hz < least:
            raise UnusableInputError(
                "spectrum.slow",
                "an oscillation of {natural_hz:g} Hz with a damping of {damping:g} decays more slowly than "
                "the longest stimulus; at this damping the minimum is about {least:.3g} Hz",
                natural_hz=self.natural_hz,
                damping=self.damping,
                least=1.005 * least,
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the real part of a complex geometric sequence, shape (lags + 1,)."""
        return np.asarray(np.exp(np.arange(lags + 1) * self._exponent(sample_rate_hz)).real, dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the power of a geometric autocorrelation with a complex factor."""
        return _geometric_power(self._exponent(sample_rate_hz), n)

    def _exponent(self, sample_rate_hz: float) -> complex:
        pole = complex(-self.damping, np.sqrt(1.0 - self.damping**2))
        return 2.0 * np.pi * self.natural_hz / sample_rate_hz * pole


@dataclass(frozen=True)
class PowerTable(Spectrum):
    """Power ``densities`` (m,) at ``frequencies_hz`` (m,), interpolated linearly, 0 outside.

    Raises:
        UnusableInputError: the tables are not a power density.
    """

    frequencies_hz: tuple[float, ...]
    densities: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.frequencies_hz) != len(self.densities) or len(self.densities) < 2:
            raise UnusableInputError(
                "spectrum.table_lengths",
                "a power spectrum needs at least 2 frequencies and a density for each: {frequencies_hz} "
                "frequencies, {densities} densities",
                frequencies_hz=len(self.frequencies_hz),
                densities=len(self.densities),
            )
        if self.frequencies_hz[0] < 0.0 or any(b <= a for a, b in pairwise(self.frequencies_hz)):
            raise UnusableInputError(
                "spectrum.table_rise", "the frequencies of a power spectrum must be nonnegative and strictly rising"
            )
        if min(self.densities) < 0.0:
            at = self.frequencies_hz[int(np.argmin(self.densities))]
            raise UnusableInputError(
                "spectrum.negative",
                "the power density at {at:g} Hz is {densities:g}: it cannot be negative",
                at=at,
                densities=min(self.densities),
            )
        if max(self.densities) == 0.0:
            raise UnusableInputError("spectrum.zero", "the power spectrum has no power at any frequency")
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        with np.errstate(all="ignore"):
            total, slopes = float(np.trapezoid(s, f)), np.diff(s) / np.diff(f)
        if not (_TINY <= total < np.inf and np.all(np.isfinite(slopes))):
            raise UnusableInputError(
                "spectrum.scale",
                "the power spectrum has a total power of {total:g} or is too steep: give densities closer "
                "to 1 and frequencies further apart",
                total=total,
            )

    def check(self, sample_rate_hz: float) -> None:
        """Raise for power at or above half the sample rate."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        highest = float(f[min(int(np.flatnonzero(s)[-1]) + 1, f.size - 1)])
        if highest > 0.5 * sample_rate_hz:
            raise UnusableInputError(
                "spectrum.table_rate",
                "a power spectrum up to {highest:g} Hz needs a sample rate of at least {needed:g} Hz, not "
                "{sample_rate_hz:g} Hz",
                highest=highest,
                needed=2 * highest,
                sample_rate_hz=sample_rate_hz,
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the exact Fourier integral of the piecewise linear density."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        slope = np.diff(s) / np.diff(f)
        w = 2.0 * np.pi * np.arange(1, lags + 1)[:, None] / sample_rate_hz
        ends = (s[-1] * np.sin(w[:, 0] * f[-1]) - s[0] * np.sin(w[:, 0] * f[0])) / w[:, 0]
        bends = np.diff(np.cos(w * f), axis=1) @ slope / w[:, 0] ** 2
        return np.concatenate([[1.0], (ends + bends) / np.trapezoid(s, f)])

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the interpolated density, normalised."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        density = np.interp(_frequencies(n, sample_rate_hz), f, s, left=0.0, right=0.0)
        return np.asarray(density * 0.5 * sample_rate_hz / np.trapezoid(s, f), dtype=np.float64)


@dataclass(frozen=True)
class AutocorrelationTable(Spectrum):
    """Autocorrelation ``correlations`` (m,) at ``lags_s`` (m,), s, interpolated linearly, 0 beyond the last lag.

    Raises:
        UnusableInputError: the tables are not the autocorrelation of any process.
    """

    lags_s: tuple[float, ...]
    correlations: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.lags_s) != len(self.correlations) or len(self.lags_s) < 2:
            raise UnusableInputError(
                "autocorrelation.lengths",
                "an autocorrelation needs at least 2 lags and a value for each: {lags_s} lags, {correlations} values",
                lags_s=len(self.lags_s),
                correlations=len(self.correlations),
            )
        if self.lags_s[0] != 0.0 or any(b <= a for a, b in pairwise(self.lags_s)):
            raise UnusableInputError(
                "autocorrelation.rise", "the lags of an autocorrelation must begin at 0 and be strictly rising"
            )
        if abs(self.correlations[0] - 1.0) > 1e-9:
            raise UnusableInputError(
                "autocorrelation.lag_zero",
                "an autocorrelation is 1 at lag 0, not {correlations:g}: divide the values by it",
                correlations=self.correlations[0],
            )
        largest = int(np.argmax(np.abs(self.correlations[1:]))) + 1
        if abs(self.correlations[largest]) > 1.0:
            raise UnusableInputError(
                "autocorrelation.range",
                "an autocorrelation must lie between -1 and 1, but is {value:g} at {largest:g} s",
                largest=self.lags_s[largest],
                value=self.correlations[largest],
            )

    def check(self, sample_rate_hz: float) -> None:
        """Raise unless the spectrum is nonnegative: an autocorrelation is positive semidefinite."""
        samples = self.lags_s[-1] * sample_rate_hz
        if samples > MAX_SAMPLES:
            raise UnusableInputError(
                "autocorrelation.long",
                "the autocorrelation table extends to {samples:.3g} samples; the maximum is {limit:.3g}: "
                "give its lags in seconds",
                samples=samples,
                limit=MAX_SAMPLES,
            )
        reach = self._reach(sample_rate_hz)
        n = max(8192, 1 << int(np.ceil(np.log2(4.0 * reach + 4.0))))
        density = self._density(n, sample_rate_hz)
        # By Parseval, half the mean square of the negative power is a lower bound of the one-sided sum of squared
        # differences between this table and the autocorrelation of any signal.
        error = 0.5 * _mean_power(np.minimum(density, 0.0) ** 2)
        if error > ROUNDING_ERROR:
            lowest = int(np.argmin(density))
            raise UnusableInputError(
                "autocorrelation.impossible",
                "no signal has this autocorrelation: its spectrum would be negative, at {frequency:.4g} Hz by "
                "{power:.2g} times the mean power",
                frequency=lowest * sample_rate_hz / n,
                power=-density[lowest],
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the interpolated table at these lags."""
        times = np.arange(lags + 1) / sample_rate_hz * (1.0 - 1e-12)  # the last lag must not fall beyond the table
        return np.asarray(np.interp(times, self.lags_s, self.correlations, right=0.0), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the transform of the table, with small negative values from rounding set to 0."""
        return np.maximum(self._density(n, sample_rate_hz), 0.0)

    def _reach(self, sample_rate_hz: float) -> int:
        return int(self.lags_s[-1] * sample_rate_hz * (1.0 + 1e-12))

    def _density(self, n: int, sample_rate_hz: float) -> Array:
        """Return the power density (n // 2 + 1,) of the two-sided autocorrelation, aliased to n samples."""
        one_sided = self.autocorrelation(self._reach(sample_rate_hz), sample_rate_hz)
        folded = np.zeros(n)
        np.add.at(folded, np.arange(one_sided.size) % n, one_sided)
        np.add.at(folded, -np.arange(1, one_sided.size) % n, one_sided[1:])
        return np.asarray(scipy.fft.rfft(folded).real, dtype=np.float64)


def _geometric_power(exponent: complex, n: int) -> Array:
    """Return the power density (n // 2 + 1,) of the autocorrelation Re exp(exponent |lag|)."""
    w = 2.0 * np.pi * np.arange(n // 2 + 1) / n
    # Closed form of Re 1 / (1 - z) - 1/2, |z| < 1, for both sides; avoids cancellation near |z| = 1
    kept = -np.expm1(2.0 * exponent.real)
    density = np.zeros(w.size)
    for turned in (w, -w):
        density += 0.5 * kept / np.abs(-np.expm1(exponent + 1j * turned)) ** 2
    return density


def _mean_power(density: Array) -> float:
    """Return the mean of a density (n // 2 + 1,), n even, over 0 to half the sample rate."""
    return float((0.5 * (density[0] + density[-1]) + density[1:-1].sum()) / (density.size - 1))
