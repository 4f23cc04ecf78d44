"""Correlations and the normal equations of a finite impulse response (Chen 2010, Eqs. 3.2-3.5).

Without gaps, the biased correlations of the thesis are computed by FFT, and the Toeplitz matrix R is solved and
inverted in O(lags^2). With gaps, only complete windows are summed; R is then not Toeplitz and is solved as a dense
matrix. Missing samples are never interpolated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, signal

from tissueid.identification.base import Array, Mask

ROWS_AT_ONCE = 8192

_LARGEST_ERROR = 1e-6
"""Largest accepted relative error of a solution."""


class Correlator:
    """Correlations and convolutions of one input x (n,) with its mean removed, over ``lags`` lags."""

    def __init__(self, x: Array, lags: int) -> None:
        self._n = x.size
        self._lags = lags
        self._length = fft.next_fast_len(x.size + lags - 1, real=True)
        self._spectrum = fft.rfft(x, self._length)

    def auto(self) -> Array:
        """Return the biased correlation of x with itself at lags 0 .. lags - 1, shape (lags,) (Eq. 3.3)."""
        return self._at_lags(self._spectrum.real**2 + self._spectrum.imag**2)

    def cross(self, y: Array) -> Array:
        """Return the biased correlation of x with the later y (n,) at lags 0 .. lags - 1, shape (lags,) (Eq. 3.4)."""
        return self._at_lags(np.conj(self._spectrum) * fft.rfft(y, self._length))

    def convolve(self, kernel: Array) -> Array:
        """Return the first n samples of the convolution of kernel (lags,) and x: the response of a system at rest
        before.
        """
        product = self._spectrum * fft.rfft(kernel, self._length)
        return np.asarray(fft.irfft(product, self._length)[: self._n], dtype=np.float64)

    def _at_lags(self, product: NDArray[Any]) -> Array:
        return np.asarray(fft.irfft(product, self._length)[: self._lags] / self._n, dtype=np.float64)


def toeplitz_solve(first_column: Array, right: Array) -> Array:
    """Solve R h = p for a symmetric positive definite Toeplitz matrix R given by its first column (m,).

    Raises:
        numpy.linalg.LinAlgError: R is not positive definite to working precision.
    """
    return np.asarray(linalg.solve_toeplitz(first_column, right, check_finite=False), dtype=np.float64)


def toeplitz_inverse(first_column: Array) -> Array:
    """Return the inverse of a symmetric positive definite Toeplitz matrix in O(m^2) (Gohberg and Semencul 1972)."""
    m = first_column.size
    unit = np.zeros(m)
    unit[0] = 1.0
    x = toeplitz_solve(first_column, unit)
    shifted = np.concatenate([[0.0], x[:0:-1]])
    half = (m + 1) // 2  # the inverse is symmetric under rotation by 180 degrees: compute its upper half
    upper = np.outer(x[:half], x) - np.outer(shifted[:half], shifted)  # (half, m)
    upper /= x[0]
    for row in range(1, half):
        upper[row, 1:] += upper[row - 1, :-1]
    return np.vstack([upper, upper[: m - half][::-1, ::-1]])


def condition_number(first_column: Array) -> float:
    """Return the 1-norm condition number of a symmetric positive definite Toeplitz matrix (m,), by one more solution.

    The norm of the inverse is that of its middle column, which is the largest or within a few percent of it if there
    are many more samples than lags. The 1-norm condition number lies between that of the 2-norm and m times it.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite to working precision.
    """
    m = first_column.size
    unit = np.zeros(m)
    unit[m // 2] = 1.0
    middle = toeplitz_solve(first_column, unit)
    through_middle = np.concatenate([first_column[m // 2 : 0 : -1], first_column[: m - m // 2]])  # middle row of R
    if not (middle[m // 2] > 0.0 and abs(float(through_middle @ middle) - 1.0) < _LARGEST_ERROR):
        raise np.linalg.LinAlgError("the correlation matrix is not positive definite to working precision")
    to_lag = np.cumsum(np.abs(first_column))  # column j of R holds lags 0 .. j above and 1 .. m - 1 - j below
    norm = float(np.max(to_lag + to_lag[::-1])) - abs(float(first_column[0]))
    return norm * float(np.abs(middle).sum())


def lagged_products(x: Array, used: Mask, lags: int) -> Array:
    """Return the mean products of x[n - i] and x[n - j] over the used samples n, shape (lags, lags).

    ``used`` (n,) must mark only samples whose window of ``lags`` inputs is complete.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.where(np.isfinite(x), x, 0.0), lags)  # oldest first
    mask = used[lags - 1 :]
    total = np.zeros((lags, lags))
    for first in range(0, windows.shape[0], ROWS_AT_ONCE):
        some = slice(first, first + ROWS_AT_ONCE)
        block = windows[some][mask[some]]
        total += block.T @ block
    return total[::-1, ::-1] / int(used.sum())


def convolve_at_rest(kernel: Array, x: Array) -> Array:
    """Return the first n samples of the convolution of kernel (m,) and x (n,): the response of a system at rest before.

    Outputs whose memory contains a NaN are NaN.
    """
    finite = np.isfinite(x)
    if finite.all():
        return np.asarray(signal.oaconvolve(x, kernel)[: x.size], dtype=np.float64)
    response = np.asarray(signal.oaconvolve(np.where(finite, x, 0.0), kernel)[: x.size], dtype=np.float64)
    missing = np.cumsum(~finite)  # (n,)
    touched = missing.copy()
    touched[kernel.size :] -= missing[: -kernel.size]
    response[touched > 0] = np.nan
    return response
