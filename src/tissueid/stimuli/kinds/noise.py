"""Noise with a given spectrum and distribution over a range; fast, with an approximate spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from tissueid.errors import UnusableInputError
from tissueid.language import marked
from tissueid.stimuli.base import Array, OpenLoopKind, Stimulus, check_range_order, crest_factor, stimulus
from tissueid.stimuli.kinds.quasi_static import ramp
from tissueid.stimuli.shape_options import DistributionName, Shaped
from tissueid.stimuli.spectra import settling_samples
from tissueid.stimuli.surrogate import first_mean_crossing, spectral_surrogate


@stimulus
class Noise(Shaped):
    """Coloured noise scaled to a range with a given distribution (Chen 2010, 3.1.1).

    The default spectrum is white noise through a Butterworth low-pass.

    Gaussian: the noise is scaled so that a share ``clipped`` of the samples exceeds the range, and these are clipped.
    The default share is that of a Gaussian beyond three standard deviations.

    Any other distribution: the amplitudes are assigned by rank, which spreads power above the cutoff; spectrum and
    amplitudes are then restored alternately (Schreiber and Schmitz 1996), amplitudes last. The distribution and the
    range are exact, the spectrum is approximate. Where the two are incompatible, as for a binary signal and a smooth
    autocorrelation, the spectrum deviates. ``interchange`` reaches a stated error of the autocorrelation.

    The history begins at a mean crossing, so a preload at the mean joins it without a step.
    """

    name: ClassVar[str] = "noise"
    title: ClassVar[str] = marked("Noise")
    applies: ClassVar[Mapping[str, tuple[str, tuple[object, ...]]]] = {
        **Shaped.applies,
        "clipped": ("distribution", ("gaussian",)),
    }

    clipped: float = Field(
        0.0027, ge=0.0, le=0.1, description=marked("Gaussian: share of samples clipped at the ends of the range")
    )

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N or V."""
        shape = self._filtered() if self.spectrum == "butterworth" else self._coloured()
        if self.distribution == "gaussian":
            return self.as_stimulus(_gaussian(shape, self.clipped))
        levels = self.build_distribution().levels(shape.size)
        values = spectral_surrogate(shape, levels, np.abs(scipy.fft.rfft(shape)))
        return self.as_stimulus(np.roll(values, -first_mean_crossing(values - _middle(levels))))

    def _filtered(self) -> Array:
        """Return Gaussian noise (n,) through the settled low-pass, beginning at a zero crossing."""
        n = self.samples
        settle = settling_samples(self.cutoff_hz, self.sample_rate)
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal(n + 2 * settle)
        low_pass = scipy.signal.butter(self.order, self.cutoff_hz, fs=self.sample_rate, output="sos")
        filtered = scipy.signal.sosfilt(low_pass, white)[settle:]  # (n + settle,)
        start = first_mean_crossing(filtered[: settle + 1])
        return np.asarray(filtered[start : start + n], dtype=np.float64)

    def _coloured(self) -> Array:
        """Return Gaussian noise (n,) of the spectrum, cut from a record of 2 n samples, beginning at a
        zero crossing.
        """
        n = self.samples
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal(2 * n)
        amplitude = np.sqrt(self.build_spectrum().power(2 * n, self.sample_rate))
        coloured = scipy.fft.irfft(scipy.fft.rfft(white) * amplitude, 2 * n)
        start = first_mean_crossing(coloured[: n + 1])
        return np.asarray(coloured[start : start + n], dtype=np.float64)


def _middle(levels: Array) -> float:
    """Return the mean of levels (n,), set to 0 when it differs from 0 by rounding only."""
    mean = float(np.mean(levels))
    return mean if abs(mean) > 1e-12 else 0.0


def _gaussian(shape: Array, clipped: float) -> Array:
    """Scale values (n,) so that at most a share ``clipped`` lies outside -1 to 1, and clip those."""
    size = np.sort(np.abs(shape))
    reach = size[size.size - 1 - int(clipped * size.size)]
    return np.asarray(np.clip(shape / reach, -1.0, 1.0), dtype=np.float64)


_LEAST_HOLD_S = 0.25
"""Shortest time, s, at one mean force: two memories of the engine ``localized``."""


@stimulus
class SteppedNoise(OpenLoopKind):
    """Small noise about successive mean forces: pushing in step by step, then pulling back (Chen 2010, 3.4).

    The means are evenly spaced from the least force plus the amplitude to the greatest force minus the amplitude, so
    that no sample leaves the range. With ``direction`` "both" they rise from the lowest to the highest and return; the
    highest is held once, so ``levels`` means give 2 ``levels`` - 1 holds. Two means are joined by a raised cosine of
    ``rise_s``, and one realisation of the noise runs through the whole test. The preload holds the first mean.

    With ``course`` "ramp" or "sine" the mean moves from end to end without holds, in the same time (Chen 2010, 5).

    The engine ``localized`` fits mass, damping and stiffness about each mean; without holds its option ``levels`` says
    about which loads.
    """

    name: ClassVar[str] = "stepped_noise"
    title: ClassVar[str] = marked("Small noise at several loads")
    applies: ClassVar[Mapping[str, tuple[str, tuple[object, ...]]]] = {"rise_s": ("course", ("steps",))}

    force_min_n: float = Field(0.5, ge=-100.0, le=100.0, description=marked("Least force, N"))
    force_max_n: float = Field(8.5, ge=-100.0, le=100.0, description=marked("Greatest force, N"))
    levels: int = Field(6, ge=2, le=50, description=marked("Number of mean forces"))
    amplitude_n: float = Field(
        0.5, ge=0.01, le=50.0, description=marked("Amplitude of the noise about each mean force, N")
    )
    level_s: float = Field(1.5, ge=_LEAST_HOLD_S, le=60.0, description=marked("Time at each mean force, s"))
    direction: Literal["both", "in", "out"] = Field(
        "both", description=marked("in: rising forces, out: falling forces, both: rising, then falling")
    )
    rise_s: float = Field(0.05, ge=0.002, le=1.0, description=marked("Time from one mean force to the next, s"))
    course: Literal["steps", "ramp", "sine"] = Field(
        "steps", description=marked("Course of the mean force: held in steps, or moving as a ramp or a sine")
    )
    distribution: DistributionName = Field("gaussian", description=marked("Distribution of the noise"))
    cutoff_hz: float = Field(200.0, gt=0.0, description=marked("Cutoff frequency of the noise, Hz"))
    order: int = Field(8, ge=1, le=12, description=marked("Order of its low-pass"))
    sample_rate: float = Field(2000.0, gt=0.0, le=1e6, description=marked("Sample rate, Hz"))
    seed: int = Field(0, ge=0, le=2**63 - 1, description=marked("Random seed: the same seed gives the same samples"))

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_range_order("force", self.force_min_n, self.force_max_n, "N")
        if not self.force_max_n - self.force_min_n > 2.0 * self.amplitude_n:
            raise UnusableInputError(
                "stepped_noise.amplitude",
                "an amplitude of {amplitude:g} N leaves no room for steps between {low:g} and {high:g} N: lower "
                "the amplitude or widen the range",
                amplitude=self.amplitude_n,
                low=self.force_min_n,
                high=self.force_max_n,
            )
        if self.rise_s > 0.5 * self.level_s:
            raise UnusableInputError(
                "stepped_noise.rise",
                "a rise of {rise_s:g} s takes more than half of the {level_s:g} s at each mean force: shorten it",
                rise_s=self.rise_s,
                level_s=self.level_s,
            )
        self.check_size()
        self._noise()  # refuses a cutoff, order or distribution that it cannot make
        return self

    @property
    def means_n(self) -> Array:
        """Mean forces in the order of the test, N, shape (holds,)."""
        rising = np.linspace(self.force_min_n + self.amplitude_n, self.force_max_n - self.amplitude_n, self.levels)
        if self.direction == "in":
            return rising
        return rising[::-1] if self.direction == "out" else np.concatenate([rising, rising[-2::-1]])

    def planned_samples(self) -> int:
        """Return the number of samples of all holds."""
        holds = 2 * self.levels - 1 if self.direction == "both" else self.levels
        return holds * round(self.level_s * self.sample_rate)

    def build(self) -> Stimulus:
        """Build the history, shape (holds * level_s * sample_rate,), N."""
        means = self.means_n
        values = (self._steps() if self.course == "steps" else self._moving()) + self._noise().build().values
        return Stimulus(
            values=np.clip(values, self.force_min_n, self.force_max_n),
            sample_rate_hz=self.sample_rate,
            description=self.describe(),
            seed=self.seed,
            crest_factor=crest_factor(values),
            start_value=float(means[0]),
        )

    def _steps(self) -> Array:
        hold = round(self.level_s * self.sample_rate)
        rise = max(1.0, self.rise_s * self.sample_rate)
        share = 0.5 * (1.0 - np.cos(np.pi * np.minimum(np.arange(1, hold + 1) / rise, 1.0)))
        before = np.concatenate([self.means_n[:1], self.means_n[:-1]])
        return np.ravel(before[:, None] + (self.means_n - before)[:, None] * share)

    def _moving(self) -> Array:
        """Return a mean force that moves from the first mean to the last, N, by way of the highest for "both"."""
        n, lowest, highest = self.planned_samples(), float(self.means_n.min()), float(self.means_n.max())
        share = ramp(n) if self.direction == "both" else np.linspace(0.0, 1.0, n)
        if self.course == "sine":
            share = 0.5 * (1.0 - np.cos(np.pi * share))
        return lowest + (highest - lowest) * (share if self.direction != "out" else 1.0 - share)

    def _noise(self) -> Noise:
        """Return the specification of the noise about the means.

        Raises:
            UnusableInputError: its options are not valid.
        """
        return Noise.from_options(
            {
                "force_min_n": -self.amplitude_n,
                "force_max_n": self.amplitude_n,
                "distribution": self.distribution,
                "cutoff_hz": self.cutoff_hz,
                "order": self.order,
                "seconds": self.planned_samples() / self.sample_rate,
                "sample_rate": self.sample_rate,
                "seed": self.seed,
            }
        )
