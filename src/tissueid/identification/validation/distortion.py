"""Noise, even and odd distortion, and the best linear approximation, from an odd random-phase multisine.

Pintelon and Schoukens (System Identification: A Frequency Domain Approach, 2nd ed., ch. 4). Only odd lines are driven,
and not all of them. The variation between periods is noise; power on even lines is even nonlinearity, such as stiffness
that grows with depth; power on odd lines that are not driven, the detection lines, is odd nonlinearity. If the measured
input has power on undriven lines, the linear response to it is subtracted first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.second_order import Complex
from tissueid.messages import Message
from tissueid.records import Estimate, Record

Lines = NDArray[np.int_]

_PERIODIC_CORRELATION = 0.9
"""Minimum correlation of an input with itself one period later."""

_EQUAL_CORRELATION = 0.01
"""Largest difference of the correlation between the first repetition and a later one."""

_SHORTEST_OVERLAP = 0.02
"""Minimum overlap of two stretches that are correlated, as a share of the record."""

_DRIVEN_RANGE = 1e-3
_DRIVEN_SHARE = 0.1
"""Minimum power of a driven line, relative to the strongest of all and to the strongest near it."""

_NEIGHBOUR_LINES = 5
"""Number of odd lines to each side that count as near."""

_LARGEST_GAP = 20.0
"""Gap to the next line, in usual gaps, beyond which that line is not part of the stimulus."""


@dataclass(frozen=True, eq=False)
class Periods:
    """Spectra of the whole periods of a record, shape (periods, lines), lines 0 .. period / 2.

    ``input`` and ``output`` are discrete Fourier transforms of ``period`` samples; a linear drift of the period means
    was removed. ``tail`` is the difference (m,) of the output between the last settled samples before the first period
    and the samples one period later: twice the noise power; empty if the record has none.
    """

    period: int
    sample_rate_hz: float
    input: Complex
    output: Complex
    tail: Array


def find_period(u: Array) -> int:
    """Return the period of an input (n,), in samples.

    Raises:
        UnusableInputError: the input is not periodic, or fewer than 1.02 periods were recorded.
    """
    finite = np.isfinite(u)
    if not finite.any() or np.ptp(u[finite]) == 0.0:
        raise UnusableInputError("multisine.constant", "the input does not vary: it has no period")
    x = np.where(finite, u - np.mean(u[finite]), 0.0)
    n = x.size
    size = fft.next_fast_len(2 * n, real=True)
    auto = fft.irfft(np.abs(fft.rfft(x, size)) ** 2, size)[:n]
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    lag = np.arange(n)
    scale = np.sqrt(power[n - lag] * (power[n] - power[lag]))
    alike = np.where(scale > 0.0, auto / np.maximum(scale, 1e-300), 0.0)  # (n,)
    alike[max(2, int(n * (1.0 - _SHORTEST_OVERLAP))) :] = 0.0
    away = np.flatnonzero(alike < 0.5)  # beyond the peak about lag 0, which is broad for a smooth input
    first = int(away[0]) if away.size else n
    best = float(np.max(alike[first:], initial=0.0))
    if best < _PERIODIC_CORRELATION:
        raise UnusableInputError(
            "multisine.no_period", "the input is not periodic: at least two periods of a periodic stimulus are needed"
        )
    rising = np.flatnonzero(alike[first:] >= best - _EQUAL_CORRELATION) + first
    run = rising[: int(np.argmax(np.append(np.diff(rising) > 1, True))) + 1]  # only the first such peak
    return int(run[np.argmax(alike[run])])


def cut_periods(record: Record, period: int, settling: float) -> Periods:
    """Cut the whole periods out of a record, counted from its end; periods with a gap are left out.

    Args:
        record: one realisation of a periodic stimulus.
        period: samples.
        settling: time at the start that is not part of a period, s.

    Raises:
        UnusableInputError: no whole period is left.
    """
    n = len(record)
    count = max(0, (n - round(settling * record.sample_rate_hz)) // period) if period > 1 else 0
    first = n - count * period
    whole = np.array([bool(record.valid[first + k * period :][:period].all()) for k in range(count)])
    if not whole.any():
        raise UnusableInputError(
            "multisine.short",
            "no whole period of {samples} samples remains after {settling:g} s of settling: record longer",
            samples=period,
            settling=settling,
        )
    u = _without_drift(record.input[first:].reshape(count, period)[whole], np.flatnonzero(whole))
    y = _without_drift(record.output[first:].reshape(count, period)[whole], np.flatnonzero(whole))
    before = record.output[first - min(first // 2, period) : first]
    later = record.output[first - before.size + period : first + period]
    tail = before - later
    return Periods(
        period=period,
        sample_rate_hz=record.sample_rate_hz,
        input=fft.rfft(u, axis=1),
        output=fft.rfft(y, axis=1),
        tail=tail[np.isfinite(tail)],
    )


def _without_drift(periods: Array, number: Lines) -> Array:
    """Return the periods (periods, n) minus the straight line through their means.

    A drift adds power to every line, equal in each period, which would be taken for distortion.
    """
    if number.size < 2:
        return periods - float(periods.mean())
    slope, level = (float(c) for c in np.polyfit(number, periods.mean(axis=1), 1))
    n = periods.shape[1]
    inside = (np.arange(n) - (n - 1) / 2) / n
    return np.asarray(periods - level - slope * (number[:, None] + inside), dtype=np.float64)


def find_driven(power: Array) -> Lines:
    """Return the odd lines driven by a stimulus with this line power (lines,).

    The power of a driven line is well above that of the even lines near it, and not far below the strongest odd line
    near it.

    Raises:
        UnusableInputError: no odd line is above the even ones.
    """
    odd = np.arange(1, power.size, 2)
    even = np.arange(2, power.size, 2)
    near = 2 * _NEIGHBOUR_LINES + 1
    if odd.size < near or even.size < near:
        raise UnusableInputError(
            "multisine.short_period",
            "a period of fewer than {samples} samples has too few lines to separate",
            samples=4 * near,
        )
    strongest = np.lib.stride_tricks.sliding_window_view(np.pad(power[odd], _NEIGHBOUR_LINES), near).max(axis=1)
    quiet = np.median(
        np.lib.stride_tricks.sliding_window_view(np.pad(power[even], _NEIGHBOUR_LINES, mode="edge"), near), axis=1
    )
    background = quiet[np.minimum(np.arange(odd.size), quiet.size - 1)]
    driven = (power[odd] > _DRIVEN_SHARE * strongest) & (power[odd] > 10.0 * background)
    driven &= power[odd] > _DRIVEN_RANGE * float(np.max(power[1:]))
    if driven.sum() < 2:
        raise UnusableInputError(
            "multisine.not_odd",
            "the odd lines of the input do not stand out from the even ones: an odd random-phase multisine is needed",
        )
    return _strongest_group(odd[driven], power)


def _strongest_group(lines: Lines, power: Array) -> Lines:
    """Return the group of adjacent lines (k,) with the most power, without distant spurs such as mains interference."""
    gaps = np.diff(lines)
    usual = np.array(
        [float(np.median(gaps[max(0, i - _NEIGHBOUR_LINES) : i])) if i else float(gaps[0]) for i in range(gaps.size)]
    )
    groups = np.split(lines, np.flatnonzero(gaps > _LARGEST_GAP * usual) + 1)
    return np.asarray(max(groups, key=lambda group: float(np.sum(power[group]))), dtype=np.int_)


_NEIGHBOURS = 6
"""Detection lines over which the power of odd distortion is averaged at a driven line."""


@dataclass(frozen=True, eq=False)
class LineLevels:
    """Levels at some lines of the spectrum, each (k,), rms in the unit of the output.

    ``level`` is that of the output averaged over periods, at undriven lines minus the linear response. ``noise`` is the
    noise level of that average, NaN if unknown.
    """

    line: Lines
    frequency_hz: Array
    level: Array
    noise: Array


@dataclass(frozen=True, eq=False)
class Distortion:
    """Distortion analysis of an odd random-phase multisine.

    ``response`` (driven,) is the best linear approximation at ``driven.frequency_hz``, output per input;
    ``response_noise_std`` is its standard deviation due to noise, ``response_total_std`` that due to noise and
    nonlinearity, NaN if unknown. Both are of a complex number: root of the mean squared modulus.

    Sums are over the driven band: ``output_rms`` of all lines, ``noise_rms`` of one period, ``even_rms`` and
    ``odd_rms`` of the distortion with the noise subtracted, at least 0; None if unknown, and ``findings`` then names
    the experiment that gives them. The levels and their deviations hold for the phases of this record: other phases of
    the same spectrum may have half or twice the distortion power.
    """

    period: int
    periods: int
    realisations: int
    driven: LineLevels
    detection: LineLevels
    even: LineLevels
    response: Complex
    response_noise_std: Array
    response_total_std: Array
    output_rms: float
    noise_rms: Estimate | None
    even_rms: Estimate | None
    odd_rms: Estimate | None
    findings: tuple[str, ...]

    def relative_db(self, level: Estimate | None) -> float | None:
        """Return a level relative to the output's, in dB; None if it is zero or unknown."""
        if level is None or level.value <= 0.0:
            return None
        return 20.0 * float(np.log10(level.value / self.output_rms))


def distortion(
    records: Record | Sequence[Record],
    period: int | None = None,
    driven: Sequence[int] | None = None,
    settling: float = 0.125,
) -> Distortion:
    """Separate noise, even and odd distortion in records of an odd random-phase multisine.

    Args:
        records: records of one realisation of the phases each, with one or more periods.
        period: samples; None to estimate it from the first record.
        driven: the driven lines, as multiples of the frequency of one period; None to estimate them.
        settling: time at the start of each record before the response is periodic, s.

    Raises:
        UnusableInputError: no period, no whole period, no driven odd lines, or records that do not match.
    """
    realisations = [records] if isinstance(records, Record) else list(records)
    if not realisations:
        raise UnusableInputError("distortion.no_record", "no record is given")
    if any(r.sample_rate_hz != realisations[0].sample_rate_hz for r in realisations):
        raise UnusableInputError("distortion.sample_rates", "the realisations have different sample rates")
    samples = find_period(realisations[0].input) if period is None else period
    cut = [cut_periods(record, samples, settling) for record in realisations]
    power = np.mean([np.abs(realisation.input.mean(axis=0)) ** 2 for realisation in cut], axis=0)  # (lines,)
    lines = find_driven(power) if driven is None else _checked(driven, power)
    return _Separation(cut, lines).separate()


def _checked(driven: Sequence[int], power: Array) -> Lines:
    lines = np.unique(np.asarray(driven, dtype=np.int_))
    if lines.size < 2 or lines[0] < 1 or lines[-1] >= power.size or np.any(lines % 2 == 0):
        raise UnusableInputError(
            "distortion.driven_lines",
            "driven lines must be at least two odd numbers from 1 to {largest}",
            largest=int(power.size) - 1,
        )
    if np.any(power[lines] <= 0.0):
        raise UnusableInputError(
            "distortion.line_without_input", "a line that is declared as driven has no input power"
        )
    return lines


class _Separation:
    """The spectra of all realisations in the driven band, and their separation."""

    def __init__(self, cut: Sequence[Periods], driven: Lines) -> None:
        self.cut = cut
        self.driven = driven
        self.band = np.arange(driven[0], driven[-1] + 1)
        self.at_driven = driven - driven[0]  # positions in the band
        self.is_driven = np.isin(self.band, driven)
        ratios = np.array(
            [
                realisation.output[:, driven].mean(axis=0) / realisation.input[:, driven].mean(axis=0)
                for realisation in cut
            ]
        )
        self.responses = ratios  # (realisations, driven)
        self.response = ratios.mean(axis=0)
        everywhere = np.interp(self.band, driven, self.response.real) + 1j * np.interp(
            self.band, driven, self.response.imag
        )
        self.residuals = [
            realisation.output[:, self.band] - everywhere * realisation.input[:, self.band] for realisation in cut
        ]
        self.freedom = sum(residual.shape[0] - 1 for residual in self.residuals)
        self.periods = min(residual.shape[0] for residual in self.residuals)

    def separate(self) -> Distortion:
        single = self._noise_power()  # (band,) of one period, or None
        share = float(np.mean([1.0 / residual.shape[0] for residual in self.residuals]))
        noise = np.full(self.band.size, np.nan) if single is None else single * share
        stood = np.mean(
            [np.abs(residual.mean(axis=0)) ** 2 for residual in self.residuals], axis=0
        )  # (band,) averaged output
        output = np.mean(
            [np.abs(realisation.output[:, self.band].mean(axis=0)) ** 2 for realisation in self.cut], axis=0
        )
        is_even = self.band % 2 == 0
        is_detection = ~is_even & ~self.is_driven
        findings: list[str] = (
            []
            if single is not None
            else [
                Message(
                    "distortion.one_period",
                    "one period does not show noise: record two or more, or a longer settling time",
                )
            ]
        )

        input_power = np.mean(
            [np.abs(realisation.input[:, self.driven].mean(axis=0)) ** 2 for realisation in self.cut], axis=0
        )
        total = np.full(self.driven.size, np.nan)
        if len(self.cut) > 1:
            total = np.sqrt(np.var(self.responses, axis=0, ddof=1) / len(self.cut))
        odd: Estimate | None = None
        if np.any(is_detection):
            weights = self._interpolation_weights(self.band[is_detection])  # (driven, detection)
            odd = self._sum(stood[is_detection], noise[is_detection], 1.0 + weights.sum(axis=0))
            if len(self.cut) == 1:
                beyond = weights @ (stood - np.nan_to_num(noise))[is_detection] + np.nan_to_num(noise)[self.at_driven]
                total = np.sqrt(np.maximum(beyond, 0.0) / input_power)
        elif len(self.cut) > 1:
            means = np.array([residual.mean(axis=0)[self.at_driven] for residual in self.residuals])
            spread = np.sum(np.abs(means) ** 2, axis=0) / (len(self.cut) - 1)
            odd = self._sum(spread, noise[self.at_driven], np.ones(self.driven.size), of_these_phases=False)
        else:
            findings.append(
                Message(
                    "distortion.no_odd_level",
                    "odd distortion cannot be separated from the linear response: leave odd lines undriven, or "
                    "record more phases",
                )
            )
        return Distortion(
            period=self.cut[0].period,
            periods=self.periods,
            realisations=len(self.cut),
            driven=self._levels(self.is_driven, output, noise),
            detection=self._levels(is_detection, stood, noise),
            even=self._levels(is_even, stood, noise),
            response=self.response,
            response_noise_std=np.sqrt(noise[self.at_driven] / input_power / len(self.cut)),
            response_total_std=total,
            output_rms=self._rms_of(float(np.sum(output))),
            noise_rms=None if single is None else self._noise_rms(single),
            even_rms=self._sum(stood[is_even], noise[is_even], np.ones(int(is_even.sum()))),
            odd_rms=odd,
            findings=tuple(findings),
        )

    def _noise_power(self) -> Array | None:
        """Return the variance (band,) of a line of one period; for a single period from its run-in, assuming white
        noise.
        """
        if self.freedom > 0:
            about = [np.sum(np.abs(residual - residual.mean(axis=0)) ** 2, axis=0) for residual in self.residuals]
            return np.asarray(np.sum(about, axis=0) / self.freedom, dtype=np.float64)
        tail = np.concatenate(
            [realisation.tail - realisation.tail.mean() for realisation in self.cut if realisation.tail.size > 1]
            or [np.zeros(0)]
        )
        if tail.size < 2 * len(self.cut) + 30:
            return None
        return np.full(self.band.size, self.cut[0].period * float(np.mean(tail**2)) / 2.0)

    def _interpolation_weights(self, detection: Lines) -> Array:
        """Return the weights (driven, detection) that interpolate the power of odd distortion to the driven lines."""
        count = min(_NEIGHBOURS, detection.size)
        nearest = np.argsort(np.abs(self.driven[:, None] - detection), axis=1)[:, :count]  # (driven, count)
        weights = np.zeros((self.driven.size, detection.size))
        np.put_along_axis(weights, nearest, 1.0 / count, axis=1)
        return weights

    def _sum(self, power: Array, noise: Array, weights: Array, of_these_phases: bool = True) -> Estimate:
        """Return the level of a weighted sum of the power of lines (k,), minus the noise if known.

        A line of weight w represents w - 1 others, each a complex Gaussian number; noise acts on each line itself.
        """
        blur = np.where(np.isfinite(noise), noise, 0.0)
        clean = power - blur
        total = float(np.sum(weights * clean))
        others = weights * (weights - 1.0) if of_these_phases else weights
        variance = np.sum(weights**2 * (2.0 * np.maximum(clean, 0.0) * blur + blur**2) + others * power**2 / 2.0)
        spread = float(np.sqrt(variance / len(self.cut)))
        level = self._rms_of(max(total, 0.0))
        return Estimate(level, self._rms_of(max(total, 0.0) + spread) - level)

    def _noise_rms(self, power: Array) -> Estimate:
        level = self._rms_of(float(np.sum(power)))
        samples = (
            self.freedom * power.size if self.freedom else sum(realisation.tail.size for realisation in self.cut) / 2
        )
        return Estimate(level, level / (2.0 * np.sqrt(samples)))

    def _levels(self, which: Mask, power: Array, noise: Array) -> LineLevels:
        line = self.band[which]
        return LineLevels(
            line=line,
            frequency_hz=line * self.cut[0].sample_rate_hz / self.cut[0].period,
            level=self._rms(power[which]),
            noise=self._rms(noise[which]),
        )

    def _rms(self, power: Array) -> Array:
        """Return the rms of a sine whose transform has this squared modulus."""
        return np.asarray(np.sqrt(2.0 * power) / self.cut[0].period, dtype=np.float64)

    def _rms_of(self, power: float) -> float:
        return float(np.sqrt(2.0 * power)) / self.cut[0].period
