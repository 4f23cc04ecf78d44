"""Noise with a spectrum and a distribution over a range, quickly and nearly right."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import scipy
from pydantic import Field

from tissueid.language import marked
from tissueid.stimuli.base import Array, Stimulus, stimulus
from tissueid.stimuli.shape_options import Shaped
from tissueid.stimuli.spectra import settling
from tissueid.stimuli.surrogate import mean_crossing, spectral_surrogate


@stimulus
class Noise(Shaped):
    """Gaussian noise with a spectrum, brought to a range and a distribution (Chen 2010, 3.1.1).

    The default spectrum is white noise through a Butterworth low-pass.

    Gaussian: the noise is scaled so that the share ``clipped`` of its samples reaches the ends of the range, and those
    are held there. The default share is that of a Gaussian beyond three standard deviations.

    Any other distribution: the noise is given its amplitudes by rank, which spills power above the cut-off; its
    spectrum and its amplitudes are restored in turn until both hold (the alternation of Schreiber and Schmitz 1996),
    the amplitudes last. So the range is kept exactly and used as the distribution has it, and the spectrum is nearly
    the noise's own. Where the two cannot both be had, as with a binary signal and a round-topped autocorrelation, it
    is the spectrum that gives way. ``interchange`` brings the autocorrelation to what was asked, and says how near.

    The history begins where it crosses its mean, so a preload at the mean leads into it without a step.
    """

    name: ClassVar[str] = "noise"
    title: ClassVar[str] = marked("Noise")

    clipped: float = Field(
        0.0027, ge=0.0, le=0.1, description=marked("Gaussian: share of samples held at the range's ends")
    )

    def build(self) -> Stimulus:
        """Build the history, shape (seconds * sample_rate,), N or V."""
        shape = self._filtered() if self.spectrum == "butterworth" else self._coloured()
        if self.distribution == "gaussian":
            return self.as_stimulus(_gaussian(shape, self.clipped))
        levels = self.wanted_distribution().levels(shape.size)
        values = spectral_surrogate(shape, levels, np.abs(scipy.fft.rfft(shape)))
        return self.as_stimulus(np.roll(values, -mean_crossing(values - _middle(levels))))

    def _filtered(self) -> Array:
        """Gaussian noise (n,) through the low-pass, which has settled; begins where it crosses zero."""
        n = self.samples
        settle = settling(self.cutoff_hz, self.sample_rate)
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal(n + 2 * settle)
        low_pass = scipy.signal.butter(self.order, self.cutoff_hz, fs=self.sample_rate, output="sos")
        filtered = scipy.signal.sosfilt(low_pass, white)[settle:]  # (n + settle,)
        start = mean_crossing(filtered[: settle + 1])
        return np.asarray(filtered[start : start + n], dtype=np.float64)

    def _coloured(self) -> Array:
        """Gaussian noise (n,) of the spectrum, cut from twice as much; begins where it crosses zero."""
        n = self.samples
        white = np.random.Generator(np.random.PCG64(self.seed)).standard_normal(2 * n)
        amplitude = np.sqrt(self.wanted_spectrum().power(2 * n, self.sample_rate))
        coloured = scipy.fft.irfft(scipy.fft.rfft(white) * amplitude, 2 * n)
        start = mean_crossing(coloured[: n + 1])
        return np.asarray(coloured[start : start + n], dtype=np.float64)


def _middle(levels: Array) -> float:
    """Mean of levels (n,), exactly 0 where only rounding keeps it from being so."""
    mean = float(np.mean(levels))
    return mean if abs(mean) > 1e-12 else 0.0


def _gaussian(shape: Array, clipped: float) -> Array:
    """Scale to -1 .. 1 so that at most a share ``clipped`` of the samples lies beyond, and hold those at the ends."""
    size = np.sort(np.abs(shape))
    reach = size[size.size - 1 - int(clipped * size.size)]
    return np.asarray(np.clip(shape / reach, -1.0, 1.0), dtype=np.float64)
