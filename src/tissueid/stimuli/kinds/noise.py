"""Noise with a given spectrum and distribution over a range; fast, with an approximate spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import scipy
from pydantic import Field

from tissueid.language import marked
from tissueid.stimuli.base import Array, Stimulus, stimulus
from tissueid.stimuli.shape_options import Shaped
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
