"""Correlations and the normal equations of a finite impulse response (Chen 2010, Eqs. 3.2-3.5).

Without gaps, the biased correlations of the thesis are computed by FFT, and the Toeplitz matrix R is solved and
inverted in O(lags^2). With gaps, only complete windows are summed; R is then not Toeplitz and is solved as a dense
matrix. Missing samples are never interpolated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import typical_samples

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
    """Solve R h = p, with p (m,), for a symmetric positive definite Toeplitz matrix R given by its first column (m,).

    Raises:
        numpy.linalg.LinAlgError: R is not positive definite to working precision.
    """
    solution, error = _levinson(np.ascontiguousarray(first_column), np.ascontiguousarray(right))
    if not error > 0.0:
        raise np.linalg.LinAlgError("the correlation matrix is not positive definite to working precision")
    return np.asarray(solution, dtype=np.float64)


# Reordering of sums is allowed, so that the compiler can use vector instructions.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _levinson(column: Array, right: Array) -> tuple[Array, float]:
    """Return the solution (m,) by the symmetric recursion of Levinson (1946), and the last prediction error.

    An error that is not positive ends the recursion: R is not positive definite.
    """
    m = column.size
    backwards = column[::-1].copy()
    predictor, longer, solution = np.zeros(m), np.zeros(m), np.zeros(m)
    predictor[0] = 1.0
    error = column[0]
    for n in range(m):
        lags = backwards[m - 1 - n : m - 1]  # n .. 1
        if n > 0:
            product = 0.0
            for k in range(n):
                product += predictor[k] * lags[k]
            reflection = -product / error
            reverse = predictor[: n + 1][::-1]
            for k in range(n + 1):
                longer[k] = predictor[k] + reflection * reverse[k]
            predictor, longer = longer, predictor
            error *= 1.0 - reflection * reflection
        if not error > 0.0:
            break
        left = right[n]
        for k in range(n):
            left -= solution[k] * lags[k]
        left /= error
        reverse = predictor[: n + 1][::-1]
        for k in range(n + 1):
            solution[k] += left * reverse[k]
    return solution, error


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
    from scipy.signal import oaconvolve  # whose import takes half a second

    finite = np.isfinite(x)
    if finite.all():
        return np.asarray(oaconvolve(x, kernel)[: x.size], dtype=np.float64)
    response = np.asarray(oaconvolve(np.where(finite, x, 0.0), kernel)[: x.size], dtype=np.float64)
    missing = np.cumsum(~finite)  # (n,)
    touched = missing.copy()
    touched[kernel.size :] -= missing[: -kernel.size]
    response[touched > 0] = np.nan
    return response


DEPENDENCE_TIME_S = 0.05
"""Lag, s, up to which a prewhitened coloured residual is treated as autocorrelated (``typical_samples``)."""

_SIGNIFICANT = 4.0
"""Threshold of the autocorrelation, in standard deviations of white noise, above which a signal is coloured."""

_LARGEST_GAIN = 0.97
"""Bound on the singular values of the prewhitening filter, so that its inverse is stable (Andrews and Monahan 1992)."""


def dependence_samples(residual: Array, sample_rate_hz: float) -> int:
    """Return the number of samples over which a residual (n,) is autocorrelated: 1 for a white residual."""
    longest = max(1, min(typical_samples(DEPENDENCE_TIME_S, sample_rate_hz), residual.size // 8))
    correlation = Correlator(residual - residual.mean(), longest).auto()
    white = np.all(np.abs(correlation[1:]) <= _SIGNIFICANT / np.sqrt(residual.size) * correlation[0])
    return 1 if white else longest


def widening_of_blocks(share: float) -> float:
    """Return the correction factor of a standard deviation from blocks of this share of the samples.

    It allows for their small number (Kiefer and Vogelsang 2005).
    """
    return 1.0 + (2.9694 * share + 0.416 * share**2 - 0.5324 * share**3) / 1.9600


def long_run_covariance(terms: Array, block: int) -> Array:
    """Return the covariance (p, p) of the column sums of autocorrelated rows (n, p).

    The rows are prewhitened by a first-order vector autoregression, summed over overlapping blocks of ``block`` rows,
    which is the Bartlett kernel (Newey and West 1987), and recoloured (Andrews and Monahan 1992). The result is
    positive semidefinite. It is widened for the uncertainty of the estimated covariance itself, so that 1.96 standard
    deviations contain 95 % (Kiefer and Vogelsang 2005, for the Bartlett kernel).
    """
    block = max(1, min(block, terms.shape[0] // 8))
    size = np.sqrt(np.mean(terms**2, axis=0))
    size[size == 0.0] = 1.0
    rows = terms / size
    before, after = rows[:-1], rows[1:]
    regression = np.linalg.lstsq(before, after, rcond=1e-10)[0].T  # after = regression @ before + innovation
    left, gains, right = np.linalg.svd(regression)
    regression = (left * np.minimum(gains, _LARGEST_GAIN)) @ right
    colouring = np.linalg.inv(np.eye(size.size) - regression) * size[:, None]
    innovations = _block_covariance(after - before @ regression.T, block)
    return np.asarray(
        widening_of_blocks(block / terms.shape[0]) ** 2 * colouring @ innovations @ colouring.T, dtype=np.float64
    )


def _block_covariance(rows: Array, block: int) -> Array:
    n, p = rows.shape
    padded = np.zeros((n + 2 * block - 1, p))
    padded[block : block + n] = rows
    running = np.cumsum(padded, axis=0)
    sums = running[block:] - running[:-block]
    return np.asarray(sums.T @ sums / block, dtype=np.float64)
