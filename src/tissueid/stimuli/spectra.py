"""Spectra that a stimulus can be asked for, each as a power density and as an autocorrelation.

Both are normalised: the autocorrelation at lag 0 is 1, and so is the mean of the power density from 0 to half the
sample rate. They belong to one another exactly, as functions of the sampled signal (Wiener and Khinchin), whichever
of the two is given. The forms are those of Chen 2010, C.4.1, and tables.
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
from tissueid.stimuli.base import MOST_SAMPLES

Array = NDArray[np.float64]

SpectrumName = Literal["butterworth", "white", "band", "exponential", "second_order", "power", "autocorrelation"]

UNREACHABLE = 1e-5
"""Least error, a sum of squares over all lags, that still passes for the rounding of a table to three digits."""

_GRID, _MOST_GRID = 1 << 16, 1 << 24
"""Samples whose frequencies a filter's power is summed on, least and most: its response must have died away by then."""

_GRID_CYCLES = 100
"""Periods of the cut-off frequency, for each order of the filter, after which its response counts as gone."""

_PIECE = 1 << 16
"""Frequencies at which a filter's gain is worked out at a time: what lies between takes many times its room."""

_SETTLING_CYCLES = 40
"""Periods of the cut-off frequency after which the start of a low-pass has died away."""

_TINY = float(np.finfo(np.float64).tiny)


class Spectrum(ABC):
    """How the power of a stimulus is spread over frequency."""

    @abstractmethod
    def check(self, sample_rate_hz: float) -> None:
        """Refuse what no sampled signal has.

        Raises:
            UnusableInputError: says what cannot be, and why.
        """

    @abstractmethod
    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Autocorrelation (lags + 1,) at 0 to ``lags`` samples, 1 at lag 0."""

    @abstractmethod
    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Power density (n // 2 + 1,) at the frequencies of a real transform of n samples, in units of its mean."""


def _below_nyquist(what: str, frequency_hz: float, sample_rate_hz: float) -> None:
    if frequency_hz >= 0.5 * sample_rate_hz:
        raise UnusableInputError(
            Message(
                "spectrum.nyquist",
                "{what} of {frequency_hz:g} Hz needs more than {needed:g} samples a second, not {sample_rate_hz:g}",
                what=what,
                frequency_hz=frequency_hz,
                needed=2 * frequency_hz,
                sample_rate_hz=sample_rate_hz,
            )
        )


def settling(cutoff_hz: float, sample_rate_hz: float) -> int:
    """Samples after which the start of a low-pass has died away."""
    return int(np.ceil(_SETTLING_CYCLES * sample_rate_hz / cutoff_hz))


def check_settling(cutoff_hz: float, sample_rate_hz: float, grid_cycles: float = 0.0) -> None:
    """Refuse a low-pass that takes longer to settle than any stimulus lasts.

    Args:
        cutoff_hz: of the low-pass.
        sample_rate_hz: of the stimulus.
        grid_cycles: periods of the cut-off frequency that its power is summed over, 0 where it is not.

    Raises:
        UnusableInputError: it does, or its sum would have too many terms; the line says the least cut-off.
    """
    settled, summed = (sample_rate_hz * share for share in (_SETTLING_CYCLES / MOST_SAMPLES, grid_cycles / _MOST_GRID))
    least = max(settled, summed)
    if cutoff_hz < least:
        reason = (
            Message(
                "spectrum.settling",
                "the filter would take more than {limit:.3g} samples to settle",
                limit=MOST_SAMPLES,
            )
            if cutoff_hz < settled
            else Message(
                "spectrum.grid",
                "its power would have to be summed over more than {limit:.3g} samples",
                limit=_MOST_GRID,
            )
        )
        raise UnusableInputError(
            Message(
                "spectrum.low_cutoff",
                "a cut-off of {cutoff_hz:g} Hz is too low at {sample_rate_hz:g} samples a second: "
                "{reason}; {least:.3g} Hz is about the least",
                cutoff_hz=cutoff_hz,
                sample_rate_hz=sample_rate_hz,
                reason=reason,
                least=1.005 * least,
            )
        )


def _frequencies(n: int, sample_rate_hz: float) -> Array:
    return np.asarray(scipy.fft.rfftfreq(n, 1.0 / sample_rate_hz), dtype=np.float64)


@dataclass(frozen=True)
class White(Spectrum):
    """The same power at all frequencies."""

    def check(self, sample_rate_hz: float) -> None:
        """Every sample rate will do."""

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """1 at lag 0, and 0 at all others."""
        return np.concatenate([[1.0], np.zeros(lags)])

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """1 everywhere."""
        return np.ones(n // 2 + 1)


@dataclass(frozen=True)
class Butterworth(Spectrum):
    """White noise through a Butterworth low-pass, as a digital filter has it (bilinear transform)."""

    cutoff_hz: float
    order: int = 8

    def check(self, sample_rate_hz: float) -> None:
        """The cut-off lies below half the sample rate, and the filter settles within a stimulus."""
        _below_nyquist(marked("a cut-off"), self.cutoff_hz, sample_rate_hz)
        check_settling(self.cutoff_hz, sample_rate_hz, _GRID_CYCLES * self.order)

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Sum of the filter's power over enough frequencies for its response to decay between repeats."""
        correlation = scipy.fft.irfft(*self._fine(lags, sample_rate_hz))[: lags + 1]
        return np.asarray(correlation / correlation[0], dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """The filter's power."""
        return self._gain(n, sample_rate_hz) / _mean_power(self._fine(0, sample_rate_hz)[0])

    def _fine(self, lags: int, sample_rate_hz: float) -> tuple[Array, int]:
        """Gain of power on a grid that resolves it, and the number of samples that the grid belongs to."""
        samples = _GRID_CYCLES * self.order * sample_rate_hz / self.cutoff_hz
        n = max(_GRID, 1 << int(np.ceil(np.log2(max(samples, 4.0 * lags + 4.0)))))
        return self._gain(n, sample_rate_hz), n

    def _gain(self, n: int, sample_rate_hz: float) -> Array:
        low_pass = scipy.signal.butter(self.order, self.cutoff_hz, fs=sample_rate_hz, output="sos")
        gain = _frequencies(n, sample_rate_hz)
        for first in range(0, gain.size, _PIECE):
            piece = gain[first : first + _PIECE]
            piece[:] = np.abs(scipy.signal.sosfreqz(low_pass, piece, fs=sample_rate_hz)[1]) ** 2
        return gain


@dataclass(frozen=True)
class Band(Spectrum):
    """The same power up to the cut-off and none above: "power" of C.4.1, without its tail."""

    cutoff_hz: float

    def check(self, sample_rate_hz: float) -> None:
        """The cut-off lies below half the sample rate."""
        _below_nyquist(marked("a cut-off"), self.cutoff_hz, sample_rate_hz)

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """sin(x) / x, x = 2 pi cutoff lag."""
        return np.asarray(np.sinc(2.0 * self.cutoff_hz * np.arange(lags + 1) / sample_rate_hz), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Flat, then nothing."""
        inside = _frequencies(n, sample_rate_hz) <= self.cutoff_hz
        return np.where(inside, 0.5 * sample_rate_hz / self.cutoff_hz, 0.0)


@dataclass(frozen=True)
class ExponentialDecay(Spectrum):
    """Autocorrelation exp(-t / T): what white noise through a first-order low-pass has."""

    time_constant_s: float

    def check(self, sample_rate_hz: float) -> None:
        """The correlation is lost within a stimulus, and reaches over some small part of a sample at least."""
        samples = self.time_constant_s * sample_rate_hz
        if not 1e-3 <= samples <= MOST_SAMPLES:
            raise UnusableInputError(
                Message(
                    "spectrum.time_constant",
                    "a time constant of {time_constant_s:g} s is {samples:.3g} samples: it must be 0.001 to "
                    "{limit:.3g}; at its short end the spectrum is white",
                    time_constant_s=self.time_constant_s,
                    samples=samples,
                    limit=MOST_SAMPLES,
                )
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Return the exponential autocorrelation at lags 0 to ``lags``, shape (lags + 1,)."""
        return np.asarray(np.exp(-np.arange(lags + 1) / (self.time_constant_s * sample_rate_hz)), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Return the power of a geometric autocorrelation at ``n`` frequencies."""
        return _geometric_power(-1.0 / (self.time_constant_s * sample_rate_hz), n)


@dataclass(frozen=True)
class SecondOrder(Spectrum):
    """Autocorrelation exp(-z w t) cos(w sqrt(1 - z^2) t) of a damped oscillation: "order2" of C.4.1."""

    natural_hz: float
    damping: float

    def check(self, sample_rate_hz: float) -> None:
        """The natural frequency lies below half the sample rate, and the oscillation dies away within a stimulus."""
        _below_nyquist(marked("a natural frequency"), self.natural_hz, sample_rate_hz)
        least = sample_rate_hz / (2.0 * np.pi * self.damping * MOST_SAMPLES)
        if self.natural_hz < least:
            raise UnusableInputError(
                Message(
                    "spectrum.slow",
                    "an oscillation of {natural_hz:g} Hz with a damping of {damping:g} takes longer to die "
                    "away than any stimulus lasts; at that damping {least:.3g} Hz is about the least",
                    natural_hz=self.natural_hz,
                    damping=self.damping,
                    least=1.005 * least,
                )
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Real part of a complex factor for every lag."""
        return np.asarray(np.exp(np.arange(lags + 1) * self._exponent(sample_rate_hz)).real, dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """That of a geometric autocorrelation with a complex factor."""
        return _geometric_power(self._exponent(sample_rate_hz), n)

    def _exponent(self, sample_rate_hz: float) -> complex:
        pole = complex(-self.damping, np.sqrt(1.0 - self.damping**2))
        return 2.0 * np.pi * self.natural_hz / sample_rate_hz * pole


@dataclass(frozen=True)
class PowerTable(Spectrum):
    """Power ``densities`` (m,) at ``frequencies_hz`` (m,), straight lines between, nothing outside.

    Raises:
        UnusableInputError: the tables are no power density.
    """

    frequencies_hz: tuple[float, ...]
    densities: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.frequencies_hz) != len(self.densities) or len(self.densities) < 2:
            raise UnusableInputError(
                Message(
                    "spectrum.table_lengths",
                    "a power spectrum needs at least 2 frequencies and a density for each: {frequencies_hz} "
                    "frequencies, {densities} densities",
                    frequencies_hz=len(self.frequencies_hz),
                    densities=len(self.densities),
                )
            )
        if self.frequencies_hz[0] < 0.0 or any(b <= a for a, b in pairwise(self.frequencies_hz)):
            raise UnusableInputError(
                Message(
                    "spectrum.table_rise",
                    "the frequencies of a power spectrum must rise from one to the next, from 0 or above",
                )
            )
        if min(self.densities) < 0.0:
            at = self.frequencies_hz[int(np.argmin(self.densities))]
            raise UnusableInputError(
                Message(
                    "spectrum.negative",
                    "the power density at {at:g} Hz is {densities:g}: it cannot be negative",
                    at=at,
                    densities=min(self.densities),
                )
            )
        if max(self.densities) == 0.0:
            raise UnusableInputError(Message("spectrum.zero", "the power spectrum has no power at any frequency"))
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        with np.errstate(all="ignore"):
            total, slopes = float(np.trapezoid(s, f)), np.diff(s) / np.diff(f)
        if not (_TINY <= total < np.inf and np.all(np.isfinite(slopes))):
            raise UnusableInputError(
                Message(
                    "spectrum.scale",
                    "the power spectrum adds up to {total:g}, or is steeper than a number can say: give "
                    "densities nearer 1, and frequencies further apart",
                    total=total,
                )
            )

    def check(self, sample_rate_hz: float) -> None:
        """No power at or above half the sample rate."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        highest = float(f[min(int(np.flatnonzero(s)[-1]) + 1, f.size - 1)])
        if highest > 0.5 * sample_rate_hz:
            raise UnusableInputError(
                Message(
                    "spectrum.table_rate",
                    "a power spectrum up to {highest:g} Hz needs at least {needed:g} samples a second, "
                    "not {sample_rate_hz:g}",
                    highest=highest,
                    needed=2 * highest,
                    sample_rate_hz=sample_rate_hz,
                )
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """Fourier integral of the straight lines, exactly."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        slope = np.diff(s) / np.diff(f)
        w = 2.0 * np.pi * np.arange(1, lags + 1)[:, None] / sample_rate_hz
        ends = (s[-1] * np.sin(w[:, 0] * f[-1]) - s[0] * np.sin(w[:, 0] * f[0])) / w[:, 0]
        bends = np.diff(np.cos(w * f), axis=1) @ slope / w[:, 0] ** 2
        return np.concatenate([[1.0], (ends + bends) / np.trapezoid(s, f)])

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """The straight lines."""
        f, s = np.array(self.frequencies_hz), np.array(self.densities)
        density = np.interp(_frequencies(n, sample_rate_hz), f, s, left=0.0, right=0.0)
        return np.asarray(density * 0.5 * sample_rate_hz / np.trapezoid(s, f), dtype=np.float64)


@dataclass(frozen=True)
class AutocorrelationTable(Spectrum):
    """Autocorrelation ``correlations`` (m,) at ``lags_s`` (m,), s, straight lines between, 0 beyond the last.

    Raises:
        UnusableInputError: the tables are no autocorrelation of any process.
    """

    lags_s: tuple[float, ...]
    correlations: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.lags_s) != len(self.correlations) or len(self.lags_s) < 2:
            raise UnusableInputError(
                Message(
                    "autocorrelation.lengths",
                    "an autocorrelation needs at least 2 lags and a value for each: {lags_s} lags, "
                    "{correlations} values",
                    lags_s=len(self.lags_s),
                    correlations=len(self.correlations),
                )
            )
        if self.lags_s[0] != 0.0 or any(b <= a for a, b in pairwise(self.lags_s)):
            raise UnusableInputError(
                Message(
                    "autocorrelation.rise",
                    "the lags of an autocorrelation must begin at 0 and rise from one to the next",
                )
            )
        if abs(self.correlations[0] - 1.0) > 1e-9:
            raise UnusableInputError(
                Message(
                    "autocorrelation.lag_zero",
                    "an autocorrelation is 1 at lag 0, not {correlations:g}: divide the values by it",
                    correlations=self.correlations[0],
                )
            )
        largest = int(np.argmax(np.abs(self.correlations[1:]))) + 1
        if abs(self.correlations[largest]) > 1.0:
            raise UnusableInputError(
                Message(
                    "autocorrelation.range",
                    "an autocorrelation lies between -1 and 1, and at {largest:g} s this one is {value:g}",
                    largest=self.lags_s[largest],
                    value=self.correlations[largest],
                )
            )

    def check(self, sample_rate_hz: float) -> None:
        """Its spectrum is negative nowhere: an autocorrelation is positive semidefinite."""
        samples = self.lags_s[-1] * sample_rate_hz
        if samples > MOST_SAMPLES:
            raise UnusableInputError(
                Message(
                    "autocorrelation.long",
                    "the table of the autocorrelation reaches {samples:.3g} samples, and {limit:.3g} "
                    "is the most: give its lags in seconds",
                    samples=samples,
                    limit=MOST_SAMPLES,
                )
            )
        reach = self._reach(sample_rate_hz)
        n = max(8192, 1 << int(np.ceil(np.log2(4.0 * reach + 4.0))))
        density = self._density(n, sample_rate_hz)
        # A signal's power is nowhere negative, so by Parseval half the mean square of what lies below 0 is the least
        # sum of squares, over all lags to one side, that is left between its autocorrelation and this one.
        error = 0.5 * _mean_power(np.minimum(density, 0.0) ** 2)
        if error > UNREACHABLE:
            lowest = int(np.argmin(density))
            raise UnusableInputError(
                Message(
                    "autocorrelation.impossible",
                    "no signal has this autocorrelation: its spectrum would be negative, at {frequency:.4g} Hz by "
                    "{power:.2g} times the mean power",
                    frequency=lowest * sample_rate_hz / n,
                    power=-density[lowest],
                )
            )

    def autocorrelation(self, lags: int, sample_rate_hz: float) -> Array:
        """The table at these lags."""
        times = np.arange(lags + 1) / sample_rate_hz * (1.0 - 1e-12)  # the last lag must not fall beyond the table
        return np.asarray(np.interp(times, self.lags_s, self.correlations, right=0.0), dtype=np.float64)

    def power(self, n: int, sample_rate_hz: float) -> Array:
        """Transform of the table, without the little below zero that its rounding can leave."""
        return np.maximum(self._density(n, sample_rate_hz), 0.0)

    def _reach(self, sample_rate_hz: float) -> int:
        return int(self.lags_s[-1] * sample_rate_hz * (1.0 + 1e-12))

    def _density(self, n: int, sample_rate_hz: float) -> Array:
        """Power density (n // 2 + 1,): the two-sided autocorrelation, folded to n samples, and transformed."""
        one_sided = self.autocorrelation(self._reach(sample_rate_hz), sample_rate_hz)
        folded = np.zeros(n)
        np.add.at(folded, np.arange(one_sided.size) % n, one_sided)
        np.add.at(folded, -np.arange(1, one_sided.size) % n, one_sided[1:])
        return np.asarray(scipy.fft.rfft(folded).real, dtype=np.float64)


def _geometric_power(exponent: complex, n: int) -> Array:
    """Power density (n // 2 + 1,) of the autocorrelation Re exp(exponent |lag|)."""
    w = 2.0 * np.pi * np.arange(n // 2 + 1) / n
    # Re 1 / (1 - z) - 1/2, |z| < 1, on either side; by its closed form, since it is a small difference near |z| = 1
    kept = -np.expm1(2.0 * exponent.real)
    density = np.zeros(w.size)
    for turned in (w, -w):
        density += 0.5 * kept / np.abs(-np.expm1(exponent + 1j * turned)) ** 2
    return density


def _mean_power(density: Array) -> float:
    """Mean over 0 to half the sample rate of a density (n // 2 + 1,), n even."""
    return float((0.5 * (density[0] + density[-1]) + density[1:-1].sum()) / (density.size - 1))
