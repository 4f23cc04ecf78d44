"""Band-limited noise with a Gaussian or uniform distribution over a range of force."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from scipy import fft, signal

from tissueid.errors import UnusableInputError
from tissueid.stimuli.base import Array, Ranged, Stimulus, crest_factor, stimulus

_SETTLE_CYCLES = 40
"""Periods of the cut-off frequency after which the start of the filter has died away."""

_ALTERNATIONS = 30


@stimulus
class Noise(Ranged):
    """White noise through a Butterworth low-pass, brought to a range of force (Chen 2010, 3.1.1).

    Gaussian: the filtered noise is scaled so that the share ``clipped`` of its samples reaches the ends of the
    range, and those are held there. The default share is that of a Gaussian beyond three standard deviations.

    Uniform: the filtered noise is given a uniform distribution by rank, which spills power above the cut-off; its
    spectrum and its distribution are restored in turn until both hold (the alternation of Schreiber and Schmitz
    1996), the distribution last. So the range is kept exactly and used evenly, and no more power is left above
    twice the cut-off than in the Gaussian kind, about one part in ten thousand.

    The history begins where it crosses its mean, so a preload at the mean leads into it without a step.
    """

    name: ClassVar[str] = "noise"

    distribution: Literal["gaussian", "uniform"] = Field("gaussian", description="Distribution of the force")
    cutoff_hz: float = Field(200.0, gt=0.0, description="Cut-off frequency of the low-pass, Hz")
    order: int = Field(8, ge=1, le=12, description="Order of the low-pass")
    seconds: float = Field(4.0, gt=0.0, le=600.0, description="Length, s")
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description="Samples a second")
    seed: int = Field(0, ge=0, le=2**63 - 1, description="The same seed gives the same samples")
    clipped: float = Field(0.0027, ge=0.0, le=0.1, description="Gaussian: share of samples held at the range's ends")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.cutoff_hz >= 0.5 * self.sample_rate:
            raise UnusableInputError(
                f"a cut-off of {self.cutoff_hz:g} Hz needs more than {2 * self.cutoff_hz:g} samples a second, "
                f"not {self.sample_rate:g}"
            )
        if round(self.seconds * self.sample_rate) < 16:
            raise UnusableInputError(f"{self.seconds:g} s at {self.sample_rate:g} Hz is too short for noise")
        return self

    def build(self) -> Stimulus:
        """Build the force history, shape (seconds * sample_rate,), N."""
        n = round(self.seconds * self.sample_rate)
        settle = int(np.ceil(_SETTLE_CYCLES * self.sample_rate / self.cutoff_hz))
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal(n + 2 * settle)
        low_pass = signal.butter(self.order, self.cutoff_hz, fs=self.sample_rate, output="sos")
        filtered = signal.sosfilt(low_pass, white)[settle:]  # (n + settle,)
        start = _mean_crossing(filtered[: settle + 1])
        shape = filtered[start : start + n]
        unit = _uniform(shape) if self.distribution == "uniform" else _gaussian(shape, self.clipped)
        low, high, quantity = self.span
        values = low + 0.5 * (unit + 1.0) * (high - low)
        return Stimulus(
            values=values,
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=crest_factor(values),
            unit=quantity,
        )


def _mean_crossing(values: Array) -> int:
    """First sample after values (n,) change sign; their start where they do not."""
    crossings = np.flatnonzero(np.diff(np.signbit(values)))
    return int(crossings[0]) + 1 if crossings.size else 0


def _gaussian(shape: Array, clipped: float) -> Array:
    """Scale to -1 .. 1 so that at most a share ``clipped`` of the samples lies beyond, and hold those at the ends."""
    size = np.sort(np.abs(shape))
    reach = size[size.size - 1 - int(clipped * size.size)]
    return np.asarray(np.clip(shape / reach, -1.0, 1.0), dtype=np.float64)


def _uniform(shape: Array) -> Array:
    """Give a signal (n,) evenly spread values over -1 .. 1 and keep its power spectrum, by alternation."""
    n = shape.size
    levels = np.linspace(-1.0, 1.0, n)
    power = np.abs(fft.rfft(shape))
    values = _ranked(shape, levels)
    for _ in range(_ALTERNATIONS):
        spectrum = fft.rfft(values)
        size = np.abs(spectrum)
        coloured = fft.irfft(np.divide(spectrum, size, out=np.zeros_like(spectrum), where=size > 0.0) * power, n)
        values = _ranked(coloured, levels)
    return np.roll(values, -_mean_crossing(values))


def _ranked(values: Array, levels: Array) -> Array:
    """Replace values (n,) by the levels (n,) of the same rank."""
    ranked = np.empty_like(levels)
    ranked[np.argsort(values, kind="stable")] = levels
    return ranked
