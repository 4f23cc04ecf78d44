"""Phase optimisation of multisines for a low crest factor.

Clipping (Van der Ouderaa, Schoukens and Renneboog 1988) gives a starting point; then the L2p norms are minimised for
growing p (Guillaume, Schoukens, Pintelon and Kollar 1991), each by L-BFGS with the gradient from one Fourier transform.
The norm tends to the peak as p grows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.stimuli.base import GUIDED, Array, Ranged, Stimulus, crest_factor, stimulus

Lines = NDArray[np.int_]

_CLIPPINGS = 300
"""Maximum number of clipping iterations."""
_FIRST_CLIP_LEVEL = 0.75
"""Clipping level of the first iteration, as a share of the peak."""
_LAST_CLIP_LEVEL = 0.99
"""Clipping level of the last iteration, as a share of the peak."""

_NORMS = (4, 8, 16, 32, 64, 128, 256, 512)
"""Exponents of the norms that are minimised, in this order."""
_MAX_ITERATIONS = 200
"""Maximum number of L-BFGS iterations for each norm."""

_MAX_EVALUATIONS = 100_000_000
"""Maximum of grid points times iterations: a few seconds. Long periods get fewer iterations."""

_CORRECTIONS = 20
"""Number of L-BFGS correction pairs."""

_PER_CYCLE = 16
"""Minimum grid points per cycle of the highest line: the peak between points is underestimated by at most 2 %."""


def sum_of_sines(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """Return one period (period,) of the sum of amplitude * cos(2 pi line k / period + phase); lines
    below period / 2.
    """
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * period * amplitudes * np.exp(1j * phases)
    return np.asarray(scipy.fft.irfft(spectrum, period), dtype=np.float64)


def grid_size(lines: Lines, period: int) -> int:
    """Return the number of points of a grid over one period that resolves the peak: a multiple of ``period``."""
    return period * max(1, -(-_PER_CYCLE * int(lines[-1]) // period))


def multisine_crest_factor(lines: Lines, amplitudes: Array, phases: Array, period: int) -> float:
    """Return the crest factor of the multisine, with the peak evaluated between samples too."""
    values = sum_of_sines(lines, amplitudes, phases, grid_size(lines, period))
    return float(np.max(np.abs(values)) / np.sqrt(0.5 * np.sum(amplitudes**2)))


def schroeder_phases(amplitudes: Array) -> Array:
    """Return phases (lines,) whose group delay spreads the power evenly over the period (Schroeder 1970, Eq. 11)."""
    share = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(share)[:-1]])
    return np.asarray(-2.0 * np.pi * np.cumsum(below), dtype=np.float64)


def minimise_crest_factor(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """Return phases (lines,) of a low crest factor: a local minimum near the given phases.

    Args:
        lines: driven lines, rising, multiples of the frequency of one period.
        amplitudes: of the lines, positive; not changed.
        phases: starting point (lines,), rad.
        period: samples.
    """
    size = grid_size(lines, period)
    share = min(1.0, _MAX_EVALUATIONS / (size * (_CLIPPINGS + len(_NORMS) * _MAX_ITERATIONS)))
    best = _clip_iterations(lines, amplitudes, phases, size, round(share * _CLIPPINGS))
    lowest = multisine_crest_factor(lines, amplitudes, best, period)
    candidate = best
    for norm in _NORMS:
        candidate = scipy.optimize.minimize(
            _log_norm,
            candidate,
            args=(lines, amplitudes, size, norm),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": max(1, round(share * _MAX_ITERATIONS)), "maxcor": _CORRECTIONS},
        ).x
        reached = multisine_crest_factor(lines, amplitudes, candidate, period)
        if reached < lowest:
            best, lowest = candidate, reached
    return np.asarray(best, dtype=np.float64)


def _clip_iterations(lines: Lines, amplitudes: Array, phases: Array, size: int, count: int) -> Array:
    """Return the best phases of ``count`` iterations of clipping peaks and restoring amplitudes, with a rising clip
    level.
    """
    best, lowest = phases, np.inf
    for share in np.linspace(_FIRST_CLIP_LEVEL, _LAST_CLIP_LEVEL, max(2, count)):
        values = sum_of_sines(lines, amplitudes, phases, size)
        peak = float(np.max(np.abs(values)))
        if peak < lowest:
            best, lowest = phases, peak
        phases = np.angle(scipy.fft.rfft(np.clip(values, -share * peak, share * peak))[lines])
    return best


def _log_norm(phases: Array, lines: Lines, amplitudes: Array, size: int, norm: int) -> tuple[float, Array]:
    """Return the logarithm of the ``norm``-norm of x, (mean |x|^norm)^(1/norm), and its gradient (lines,) by the
    phases.
    """
    values = sum_of_sines(lines, amplitudes, phases, size)
    peak = float(np.max(np.abs(values)))
    ratio = values / peak
    high = ratio ** (norm - 1)
    mean = float(np.mean(high * ratio))
    # d log norm / d x is high / (size mean peak); d x / d phase is the real part of i amplitude exp(i (phase + w t)).
    weights = scipy.fft.rfft(high)[lines] / (size * mean * peak)
    gradient = -np.imag(amplitudes * np.exp(1j * phases) * np.conj(weights))
    return float(np.log(peak) + np.log(mean) / norm), np.asarray(gradient, dtype=np.float64)


def lines_in_band(period: int, sample_rate_hz: float, low_hz: float, high_hz: float) -> Lines:
    """Return the lines 1, 2, ... below half the ``period`` (samples) with frequencies from ``low_hz``
    to ``high_hz``.
    """
    lines = np.arange(1, (period + 1) // 2)
    frequency = np.asarray(lines * sample_rate_hz / period, dtype=np.float64)
    return lines[_inside(frequency, low_hz, high_hz)]


def outside_notches(frequency_hz: Array, notches: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return True (n,) where a frequency lies in none of the bands (low, high), Hz, ends included."""
    kept = np.ones(frequency_hz.size, dtype=bool)
    for low, high in notches:
        kept &= ~_inside(frequency_hz, low, high)
    return kept


def _inside(frequency_hz: Array, low_hz: float, high_hz: float) -> NDArray[np.bool_]:
    """Return True (n,) from low to high, ends included up to rounding."""
    slack = 1e-9 * np.abs(frequency_hz)
    return (frequency_hz >= low_hz - slack) & (frequency_hz <= high_hz + slack)


def detection_lines(odd: Lines, group: int, rng: np.random.Generator) -> Lines:
    """Return one random line of each ``group`` consecutive lines (n,): the lines left undriven.

    The lowest and the highest line and the remainder after the last whole group stay driven, so that every detection
    line lies inside the driven band.
    """
    chosen = []
    for first in range(0, odd.size - group + 1, group):
        low = 1 if first == 0 else 0
        high = group - 1 if first + group == odd.size else group
        chosen.append(int(odd[first + rng.integers(low, high)]))
    return np.array(chosen, dtype=np.int_)


def butterworth(frequency_hz: Array, cutoff_hz: float, order: int) -> Array:
    """Return the gain (n,) of a Butterworth low-pass."""
    with np.errstate(over="ignore"):  # gains underflow to 0
        return np.asarray(1.0 / np.sqrt(1.0 + (frequency_hz / cutoff_hz) ** (2 * order)), dtype=np.float64)


def best_random_phases(lines: Lines, amplitudes: Array, period: int, draws: int, rng: np.random.Generator) -> Array:
    """Return the phases (lines,) of the lowest crest factor among ``draws`` uniform random sets."""
    sets = [2.0 * np.pi * rng.random(lines.size) for _ in range(draws)]
    return (
        min(sets, key=lambda phases: multisine_crest_factor(lines, amplitudes, phases, period))
        if draws > 1
        else sets[0]
    )


def multisine_record(lines: Lines, amplitudes: Array, phases: Array, period: int, periods: int, settling: int) -> Array:
    """Return a run-in of ``settling`` samples and whole periods, shape (settling + periods * period,), continuous.

    The period is rotated so that the record begins as close to its mean as possible.
    """
    waveform = sum_of_sines(lines, amplitudes, phases, period)
    begin = _start_sample(waveform, settling, periods)
    return np.take(waveform, np.arange(begin, begin + settling + periods * period), mode="wrap")


def _start_sample(waveform: Array, settling: int, periods: int) -> int:
    """Return the sample of the period (n,) at which a record of ``settling`` samples and whole periods is nearest its
    mean.
    """
    n = waveform.size
    upto = np.concatenate([[0.0], np.cumsum(np.tile(waveform, 2))])
    over = settling % n
    run_in = upto[over : over + n] - upto[:n] + (settling // n) * upto[n]
    mean = (run_in + periods * upto[n]) / (settling + periods * n)
    return int(np.argmin(np.abs(waveform - mean)))


_DEFAULT_GROUP = 2
"""Default of ``group``."""
_MAX_PERIOD = 2**20
"""Maximum period, samples."""
_MAX_SECONDS = 600.0
"""Maximum length of a period and of the stimulus, s."""
_WHOLE_TOLERANCE = 1e-6
"""Tolerance for a period to count as a whole number of samples, relative: rounding of a decimal fraction."""

_LINES, _PHASES = range(2)
"""Indices of the independent random streams for lines and phases."""


@stimulus
class Multisine(Ranged):
    """Sines on chosen lines of a period, repeated exactly (Chen 2010, 6.1; Pintelon and Schoukens, 2nd ed., ch. 4-5).

    ``full`` drives every line of the band, ``odd`` every odd line, ``odd_random`` every odd line except one at random
    in each ``group`` of consecutive ones: the detection lines. Lines that are not driven have no power, so the response
    there is noise or nonlinear distortion; ``distortion`` of ``tissueid.identification.validation`` distinguishes the
    two. Frequencies in ``notches`` are excluded like those outside the band; they have no detection lines.

    Phases: ``low_crest`` minimises the crest factor from random starting points, ``schroeder`` uses Schroeder's
    formula, ``random`` keeps random phases, which a best linear approximation over several realisations requires, and
    selects the best of ``draws``. Realisations of one experiment differ in ``seed`` and share everything else,
    including ``lines_seed`` and thus the lines.

    The record is a run-in of ``settling_s`` followed by whole periods. It covers its range exactly and begins within
    one step of its mean, so a preload at the mean joins it smoothly. Its ``crest_factor`` is that of a period.
    """

    name: ClassVar[str] = "multisine"
    title: ClassVar[str] = marked("Multisine")

    period_s: float = Field(
        2.0, gt=0.0, le=_MAX_SECONDS, description=marked("Period, s: its reciprocal is the frequency resolution")
    )
    period_samples: int | None = Field(
        None, ge=8, le=_MAX_PERIOD, description=marked("Period in samples, instead of period_s")
    )
    periods: int = Field(
        2, ge=1, le=1000, description=marked("Number of whole periods; two or more separate noise from distortion")
    )
    settling_s: float = Field(0.25, ge=0.0, le=60.0, description=marked("Run-in before the first whole period, s"))
    lowest_hz: float = Field(0.0, ge=0.0, le=1e6, description=marked("Lowest driven frequency, Hz"))
    highest_hz: float = Field(200.0, gt=0.0, le=1e6, description=marked("Highest driven frequency, Hz"))
    lines: Literal["full", "odd", "odd_random"] = Field("odd_random", description=marked("Which lines are driven"))
    group: int | None = Field(
        None, ge=2, le=100, description=marked("odd_random: number of odd lines per detection line; 2 by default")
    )
    lines_seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("odd_random: the same seed gives the same lines"))
    notches: tuple[tuple[float, float], ...] = Field(
        (), max_length=1000, description=marked("Excluded bands (low, high), Hz")
    )
    spectrum: Literal["flat", "butterworth", "power_law", "table"] = Field(
        "flat", description=marked("Amplitude of the lines")
    )
    cutoff_hz: float = Field(100.0, gt=0.0, le=1e6, description=marked("butterworth: cutoff frequency, Hz"))
    order: int = Field(2, ge=1, le=12, description=marked("butterworth: order"))
    exponent: float = Field(
        1.0, ge=-4.0, le=4.0, description=marked("power_law: exponent e of amplitude = frequency^-e")
    )
    table: tuple[tuple[float, float], ...] = Field(
        (),
        max_length=10_000,
        description=marked("table: (frequency in Hz, relative amplitude), linear in between, constant outside"),
    )
    phases: Literal["low_crest", "schroeder", "random"] = Field("low_crest", description=marked("Phases of the lines"))
    draws: int = Field(2, ge=1, le=100, description=marked("Number of random phase sets to try; the best is kept"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("Realisation: the same seed gives the same phases"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._check_length()
        self._check_band()
        self._check_spectrum()
        if self.lines != "odd_random" and self.group is not None:
            raise UnusableInputError(
                "multisine.group",
                "detection lines (group) need odd random lines, not {lines}: set lines to odd_random, or omit group",
                lines=self.lines,
            )
        self._check_lines()
        return self

    @property
    def period(self) -> int:
        """Samples of one period."""
        return round(self.period_s * self.sample_rate) if self.period_samples is None else self.period_samples

    @property
    def resolution_hz(self) -> float:
        """Frequency of line 1, Hz."""
        return self.sample_rate / self.period

    def driven_lines(self) -> Lines:
        """Return the driven lines, rising, as multiples of the frequency of one period."""
        candidates = self._candidates()
        return np.setdiff1d(candidates, self.detection_lines())

    def detection_lines(self) -> Lines:
        """Return the undriven odd lines, rising; empty unless the lines are ``odd_random``."""
        if self.lines != "odd_random":
            return np.zeros(0, dtype=np.int_)
        return detection_lines(self._candidates(), self.group or _DEFAULT_GROUP, self._random(self.lines_seed, _LINES))

    def amplitudes(self) -> Array:
        """Return the relative amplitudes of the driven lines, (lines,)."""
        return self._relative(self._frequency(self.driven_lines()))

    def describe(self) -> dict[str, Any]:
        """Return the kind and its options as plain values, JSON-serialisable; the period both in seconds and in
        samples.
        """
        period = {"period_s": self.period / self.sample_rate, "period_samples": self.period}
        return super().describe() | period

    def planned_samples(self) -> int:
        """Return the number of samples of the run-in and the whole periods."""
        return round(self.settling_s * self.sample_rate) + self.periods * self.period

    def build(self) -> Stimulus:
        """Build the history: run-in and whole periods, shape (settling_s * sample_rate + periods * period,)."""
        driven, sizes = self.driven_lines(), self.amplitudes()
        shape = multisine_record(
            driven,
            sizes,
            self._chosen_phases(driven, sizes),
            self.period,
            self.periods,
            round(self.settling_s * self.sample_rate),
        )
        low, high, quantity = self.span
        lowest, highest = float(shape.min()), float(shape.max())
        values = np.clip(low + (shape - lowest) * ((high - low) / (highest - lowest)), low, high)
        return Stimulus(
            values=values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=crest_factor(values[-self.period :]),
            unit=quantity,
        )

    def _chosen_phases(self, driven: Lines, sizes: Array) -> Array:
        if self.phases == "schroeder":
            return schroeder_phases(sizes)
        rng = self._random(self.seed, _PHASES)
        if self.phases == "random":
            return best_random_phases(driven, sizes, self.period, self.draws, rng)
        starts = [2.0 * np.pi * rng.random(driven.size) for _ in range(self.draws)]
        candidates = [minimise_crest_factor(driven, sizes, start, self.period) for start in starts]
        return min(candidates, key=lambda phases: multisine_crest_factor(driven, sizes, phases, self.period))

    def _random(self, seed: int, stream: int) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64([seed, stream]))

    def _candidates(self) -> Lines:
        """Return the lines of the band with power outside the notches; only odd lines unless all are driven."""
        lines = lines_in_band(self.period, self.sample_rate, self.lowest_hz, self.highest_hz)
        frequency = self._frequency(lines)
        kept = outside_notches(frequency, self.notches) & (self._relative(frequency) > 0.0)
        return lines[kept if self.lines == "full" else kept & (lines % 2 == 1)]

    def _frequency(self, lines: Lines) -> Array:
        return np.asarray(lines * self.resolution_hz, dtype=np.float64)

    def _relative(self, frequency_hz: Array) -> Array:
        if self.spectrum == "butterworth":
            return butterworth(frequency_hz, self.cutoff_hz, self.order)
        if self.spectrum == "power_law":
            return np.asarray((frequency_hz / self.resolution_hz) ** -self.exponent, dtype=np.float64)
        if self.spectrum == "table":
            hz, size = np.array(self.table).T
            return np.asarray(np.interp(frequency_hz, hz, size), dtype=np.float64)
        return np.ones(frequency_hz.size)

    def _check_length(self) -> None:
        exact = self.period_s * self.sample_rate
        whole = max(1, round(exact))
        if self.period_samples is None and abs(exact - whole) > _WHOLE_TOLERANCE * whole:
            raise UnusableInputError(
                "multisine.period_fraction",
                "a period of {period_s:g} s is {exact:.6g} samples at {sample_rate:g} Hz, not a whole "
                "number: use {whole:.9g} s",
                period_s=self.period_s,
                exact=exact,
                sample_rate=self.sample_rate,
                whole=whole / self.sample_rate,
            )
        if self.period_samples is not None and "period_s" in self.model_fields_set and whole != self.period_samples:
            raise UnusableInputError(
                "multisine.period_twice",
                "a period of {period_s:g} s has {exact:.6g} samples, not {period_samples}: give one of the two",
                period_s=self.period_s,
                exact=exact,
                period_samples=self.period_samples,
            )
        if not 8 <= self.period <= _MAX_PERIOD:
            raise UnusableInputError(
                "multisine.period",
                "a period must have 8 to {limit} samples, not {period}",
                limit=_MAX_PERIOD,
                period=self.period,
            )
        seconds = self.settling_s + self.periods * self.period / self.sample_rate
        if seconds > _MAX_SECONDS:
            raise UnusableInputError(
                "multisine.length",
                "{periods} periods and their run-in last {seconds:g} s: a stimulus may last {limit:g} s",
                periods=self.periods,
                seconds=seconds,
                limit=_MAX_SECONDS,
            )

    def _check_band(self) -> None:
        if self.highest_hz >= 0.5 * self.sample_rate:
            raise UnusableInputError(
                "multisine.nyquist",
                "a highest frequency of {highest_hz:g} Hz needs a sample rate above {needed:g} Hz, not "
                "{sample_rate:g} Hz",
                highest_hz=self.highest_hz,
                needed=2 * self.highest_hz,
                sample_rate=self.sample_rate,
            )
        notch_name = marked("a notch")
        bands = [
            (marked("the band"), self.lowest_hz, self.highest_hz),
            *((notch_name, *notch) for notch in self.notches),
        ]
        for what, low, high in bands:
            if not 0.0 <= low < high:
                raise UnusableInputError(
                    "multisine.band",
                    "{what} must go from a lower to a higher frequency, not from {low:g} to {high:g} Hz",
                    what=what,
                    low=low,
                    high=high,
                )

    def _check_spectrum(self) -> None:
        if (self.spectrum == "table") != bool(self.table):
            raise UnusableInputError(
                "multisine.table_spectrum",
                "a table of amplitudes needs the spectrum 'table', and the spectrum 'table' needs a table",
            )
        if not self.table:
            return
        hz, size = np.array(self.table).T
        if np.any(np.diff(hz) <= 0.0) or np.any(hz < 0.0) or np.any(size < 0.0) or not np.any(size > 0.0):
            raise UnusableInputError(
                "multisine.table",
                "a table of amplitudes needs rising frequencies and nonnegative amplitudes that are not all zero",
            )

    def _check_lines(self) -> None:
        candidates = self._candidates()
        which = marked("line") if self.lines == "full" else marked("odd line")
        band = Message(
            "multisine.band_words",
            "{low:g} to {high:g} Hz at a resolution of {resolution:g} Hz",
            low=self.lowest_hz,
            high=self.highest_hz,
            resolution=self.resolution_hz,
        )
        if candidates.size < 2:
            suffix = marked(" after the notches") if self.notches else ""
            raise UnusableInputError(
                "multisine.lines",
                "a multisine needs at least two lines; {band} has {count} {which}{left}: widen the band or "
                "use a longer period",
                band=band,
                count=candidates.size or marked("no"),
                which=which,
                left=suffix,
            )
        with np.errstate(over="ignore", under="ignore"):
            power = float(np.sum(self._relative(self._frequency(candidates)) ** 2))
        if not np.finfo(np.float64).tiny <= power < np.inf:
            raise UnusableInputError(
                "multisine.power",
                "the total power of the lines is {power:g} and cannot be scaled: give amplitudes closer to "
                "1 or a higher cutoff",
                power=power,
            )
        group = self.group or _DEFAULT_GROUP
        if self.lines == "odd_random" and candidates.size < max(group, 3):
            raise UnusableInputError(
                "multisine.detection",
                "{band} has {size} odd lines, too few for a detection line in each group of {group}: widen "
                "the band, or use a longer period or a smaller group",
                band=band,
                size=candidates.size,
                group=group,
            )


def multisine_from_description(description: Mapping[str, Any]) -> Multisine | None:
    """Return the multisine of a stimulus description, with or without preload; None for another kind of stimulus.

    Raises:
        UnusableInputError: the description is of a multisine with invalid options.
    """
    inner = description.get("stimulus") if description.get("type") == GUIDED else description
    fields = dict(inner) if isinstance(inner, Mapping) else {}
    kind = fields.pop("type", None)
    return Multisine.from_options(fields) if kind == Multisine.name and "period_samples" in fields else None
