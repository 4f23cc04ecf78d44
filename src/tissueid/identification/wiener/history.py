"""The second-order system of a kernel alone, for the history of an iteration (Chen 2010, Fig. 3.9b).

The final linear stage is fitted to the measured output, with its uncertainty. For the passes on the way there the
answer is wanted without one, and the kernel says it: the system whose response to the input is nearest to that of the
kernel, with the power of the input as the weight of each frequency. No time series is made.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from tissueid.identification.base import Array
from tissueid.identification.second_order import Hold, SecondOrder, sampled_response

_ITERATIONS = 30
_SETTLED = 1e-6
_IDLE = 1e-9
"""Share of the strongest frequency's power below which a frequency of the input says nothing."""


class KernelSystems:
    """Second-order systems of kernels driven by one input x (n,), its mean removed and zero where it is missing."""

    def __init__(self, x: Array, sample_rate_hz: float, hold: Hold) -> None:
        self._length = fft.next_fast_len(x.size, real=True)
        power = np.abs(fft.rfft(x, self._length)) ** 2
        power[0] = 0.0  # an offset is free
        self._driven = power > _IDLE * float(power.max())
        self._weights = np.sqrt(power[self._driven])
        self._rate = sample_rate_hz
        self._hold: Hold = hold

    def nearest(self, kernel: Array, start: SecondOrder) -> SecondOrder:
        """The system nearest to a kernel (lags,) per sample, by Gauss-Newton on log M, log B, log K from a start."""
        wanted = fft.rfft(kernel, self._length)[self._driven]
        theta = np.log([start.mass, start.damping, start.stiffness])
        error, slopes = self._evaluate(theta, wanted)
        for _ in range(_ITERATIONS):
            step = np.linalg.lstsq(slopes @ slopes.T, slopes @ error, rcond=1e-12)[0]
            step /= max(1.0, float(np.max(np.abs(step))))
            while np.max(np.abs(step)) > _SETTLED:
                tried_error, tried_slopes = self._evaluate(theta + step, wanted)
                if np.dot(tried_error, tried_error) < np.dot(error, error):
                    theta, error, slopes = theta + step, tried_error, tried_slopes
                    break
                step *= 0.5
            if np.max(np.abs(step)) <= _SETTLED:
                break
        mass, damping, stiffness = np.exp(theta)
        return SecondOrder(float(mass), float(damping), float(stiffness))

    def _evaluate(self, theta: Array, wanted: Array) -> tuple[Array, Array]:
        """Weighted error (2 driven,) and slopes (3, 2 driven) of the modelled response, real parts then imaginary."""
        mass, damping, stiffness = np.exp(theta)
        system = SecondOrder(float(mass), float(damping), float(stiffness))
        response, slopes = sampled_response(system, self._length, self._rate, self._hold)
        error = self._weights * (wanted - response[self._driven])
        weighted = self._weights * slopes[:, self._driven]
        return np.concatenate([error.real, error.imag]), np.concatenate([weighted.real, weighted.imag], axis=1)
