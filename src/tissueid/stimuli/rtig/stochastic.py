"""Stochastic part of the RTIG input: low-passed noise generated block by block, continuous (Chen 2010, Eq. 6.9)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import signal, special

from tissueid.stimuli.base import Array
from tissueid.stimuli.spectra import settling_samples

Shape = Literal["uniform", "gaussian"]

_GAUSSIAN_CLIP = 3.0
"""Clipping level of Gaussian noise, in standard deviations; scaled to 1."""


class StochasticStream:
    """Generator of low-passed noise within -1 to 1 whose filter state continues from block to block.

    Filtering makes noise Gaussian. The uniform shape is obtained by applying the Gaussian distribution function to the
    filtered noise.
    """

    def __init__(self, shape: Shape, cutoff_hz: float, order: int, sample_rate: float, seed: int) -> None:
        self._shape = shape
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._low_pass = signal.butter(order, cutoff_hz, fs=sample_rate, output="sos")
        settle = settling_samples(cutoff_hz, sample_rate)
        impulse = np.zeros(settle)
        impulse[0] = 1.0
        self._spread = float(np.linalg.norm(signal.sosfilt(self._low_pass, impulse)))
        self._state = np.zeros((self._low_pass.shape[0], 2))
        self.take(settle)

    @staticmethod
    def variance(shape: Shape) -> float:
        """Return the variance of the values for a shape."""
        return 1.0 / 3.0 if shape == "uniform" else 1.0 / _GAUSSIAN_CLIP**2

    def take(self, n: int) -> Array:
        """Return the next n values, shape (n,), from -1 to 1."""
        filtered, self._state = signal.sosfilt(self._low_pass, self._random.standard_normal(n), zi=self._state)
        normal = filtered / self._spread
        if self._shape == "gaussian":
            return np.asarray(np.clip(normal / _GAUSSIAN_CLIP, -1.0, 1.0))
        return np.asarray(special.erf(normal / np.sqrt(2.0)))
