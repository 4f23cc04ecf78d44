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

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.second_order import Complex
from tissueid.identification.validation.multisine import Lines, Periods, cut_periods, find_driven, find_period
from tissueid.messages import Message
from tissueid.records import Estimate, Record

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
    power = np.mean([np.abs(one.input.mean(axis=0)) ** 2 for one in cut], axis=0)  # (lines,)
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
        ratios = np.array([one.output[:, driven].mean(axis=0) / one.input[:, driven].mean(axis=0) for one in cut])
        self.responses = ratios  # (realisations, driven)
        self.response = ratios.mean(axis=0)
        everywhere = np.interp(self.band, driven, self.response.real) + 1j * np.interp(
            self.band, driven, self.response.imag
        )
        self.left = [one.output[:, self.band] - everywhere * one.input[:, self.band] for one in cut]
        self.freedom = sum(left.shape[0] - 1 for left in self.left)
        self.periods = min(left.shape[0] for left in self.left)

    def separate(self) -> Distortion:
        single = self._noise_power()  # (band,) of one period, or None
        share = float(np.mean([1.0 / left.shape[0] for left in self.left]))
        known = np.full(self.band.size, np.nan) if single is None else single * share
        stood = np.mean([np.abs(left.mean(axis=0)) ** 2 for left in self.left], axis=0)  # (band,) averaged output
        output = np.mean([np.abs(one.output[:, self.band].mean(axis=0)) ** 2 for one in self.cut], axis=0)
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

        input_power = np.mean([np.abs(one.input[:, self.driven].mean(axis=0)) ** 2 for one in self.cut], axis=0)
        total = np.full(self.driven.size, np.nan)
        if len(self.cut) > 1:
            total = np.sqrt(np.var(self.responses, axis=0, ddof=1) / len(self.cut))
        odd: Estimate | None = None
        if np.any(is_detection):
            weights = self._interpolation_weights(self.band[is_detection])  # (driven, detection)
            odd = self._sum(stood[is_detection], known[is_detection], 1.0 + weights.sum(axis=0))
            if len(self.cut) == 1:
                beyond = weights @ (stood - np.nan_to_num(known))[is_detection] + np.nan_to_num(known)[self.at_driven]
                total = np.sqrt(np.maximum(beyond, 0.0) / input_power)
        elif len(self.cut) > 1:
            left = np.array([one.mean(axis=0)[self.at_driven] for one in self.left])
            spread = np.sum(np.abs(left) ** 2, axis=0) / (len(self.cut) - 1)
            odd = self._sum(spread, known[self.at_driven], np.ones(self.driven.size), of_these_phases=False)
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
            driven=self._levels(self.is_driven, output, known),
            detection=self._levels(is_detection, stood, known),
            even=self._levels(is_even, stood, known),
            response=self.response,
            response_noise_std=np.sqrt(known[self.at_driven] / input_power / len(self.cut)),
            response_total_std=total,
            output_rms=self._rms_of(float(np.sum(output))),
            noise_rms=None if single is None else self._noise_rms(single),
            even_rms=self._sum(stood[is_even], known[is_even], np.ones(int(is_even.sum()))),
            odd_rms=odd,
            findings=tuple(findings),
        )

    def _noise_power(self) -> Array | None:
        """Return the variance (band,) of a line of one period; for a single period from its run-in, assuming white
        noise.
        """
        if self.freedom > 0:
            about = [np.sum(np.abs(left - left.mean(axis=0)) ** 2, axis=0) for left in self.left]
            return np.asarray(np.sum(about, axis=0) / self.freedom, dtype=np.float64)
        tail = np.concatenate([one.tail - one.tail.mean() for one in self.cut if one.tail.size > 1] or [np.zeros(0)])
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
        samples = self.freedom * power.size if self.freedom else sum(one.tail.size for one in self.cut) / 2
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
