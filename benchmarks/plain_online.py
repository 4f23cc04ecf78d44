"""Online methods of Chen 2010, Appendices C.1.2 and C.1.3, in vectorised numpy: references of the benchmarks.

As written, C.1.3 multiplies two full matrices in Eq. 6.4; here the product of vector and matrix is computed first, as
is usual in numpy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Rls:
    """Eqs. 6.1-6.5, with the regressor of an offset after those of the lags."""

    def __init__(self, lags: int, variance: float, constant: float, forgetting: float = 1.0) -> None:
        self.regressor = np.zeros(lags + 1)
        self.regressor[lags] = constant
        self.response = np.zeros(lags + 1)
        self.covariance = variance * np.eye(lags + 1)
        self.forgetting = forgetting
        self.taken = 0

    def update(self, u: float, y: float) -> float:
        x = self.regressor
        x[1:-1] = x[:-2]
        x[0] = u
        self.taken += 1
        if self.taken < x.size - 1:
            return float("nan")
        error = y - float(x @ self.response)
        product = self.covariance @ x
        gain = product / (self.forgetting + float(x @ product))
        self.covariance = (self.covariance - np.outer(gain, product)) / self.forgetting
        self.response = self.response + gain * error
        return error


class Als:
    """Eqs. 6.6-6.8, the step divided by the energy of the regressor plus a constant."""

    def __init__(self, lags: int, step: float, floor: float) -> None:
        self.regressor = np.zeros(lags)
        self.response = np.zeros(lags)
        self.total = np.zeros(lags)
        self.step = step
        self.floor = floor
        self.taken = 0

    def update(self, u: float, y: float) -> float:
        x = self.regressor
        x[1:] = x[:-1]
        x[0] = u
        self.taken += 1
        if self.taken < x.size:
            return float("nan")
        error = y - float(x @ self.response)
        self.response = self.response + self.step * error / (float(x @ x) + self.floor) * x
        self.total += self.response
        return error
