"""The stochastic part of the input: low-passed noise made block by block without a seam (Chen 2010, Eq. 6.9)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import signal, special

from tissueid.stimuli.base import Array
from tissueid.stimuli.spectra import settling

Shape = Literal["uniform", "gaussian"]

_GAUSSIAN_REACH = 3.0
"""Standard deviations that count as the reach of a Gaussian; what goes beyond is held there."""


class StochasticStream:
    """White noise through a Butterworth low-pass, within -1 to 1, whose filter runs on from block to block.

    A low-pass makes any noise more Gaussian. The uniform shape is given back by the distribution function of the
    Gaussian that the filtered noise is.
    """

    def __init__(self, shape: Shape, cutoff_hz: float, order: int, sample_rate: float, seed: int) -> None:
        self._shape = shape
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._low_pass = signal.butter(order, cutoff_hz, fs=sample_rate, output="sos")
        settle = settling(cutoff_hz, sample_rate)
        impulse = np.zeros(settle)
        impulse[0] = 1.0
        self._spread = float(np.linalg.norm(signal.sosfilt(self._low_pass, impulse)))
        self._state = np.zeros((self._low_pass.shape[0], 2))
        self.take(settle)

    @staticmethod
    def variance(shape: Shape) -> float:
        """Variance of the values."""
        return 1.0 / 3.0 if shape == "uniform" else 1.0 / _GAUSSIAN_REACH**2

    def take(self, n: int) -> Array:
        """The next n values, shape (n,), from -1 to 1."""
        filtered, self._state = signal.sosfilt(self._low_pass, self._random.standard_normal(n), zi=self._state)
        normal = filtered / self._spread
        if self._shape == "gaussian":
            return np.asarray(np.clip(normal / _GAUSSIAN_REACH, -1.0, 1.0))
        return np.asarray(special.erf(normal / np.sqrt(2.0)))
