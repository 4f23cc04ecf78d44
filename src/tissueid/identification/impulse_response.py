"""Correlations, and finite impulse responses of a prepared record from them (Chen 2010, Eq. 3.2).

The input side is factored once for any number of outputs, as the Wiener iteration estimates many responses to one
input.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft, linalg, signal

from tissueid.errors import UnusableInputError
from tissueid.identification.base import Array, Mask
from tissueid.identification.preparation import PreparedRecord, scored_samples, typical_samples
from tissueid.messages import Message

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
        correction = right[n]
        for k in range(n):
            correction -= solution[k] * lags[k]
        correction /= error
        reverse = predictor[: n + 1][::-1]
        for k in range(n + 1):
            solution[k] += correction * reverse[k]
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
    finite = np.isfinite(x)
    if finite.all():
        return np.asarray(signal.oaconvolve(x, kernel)[: x.size], dtype=np.float64)
    response = np.asarray(signal.oaconvolve(np.where(finite, x, 0.0), kernel)[: x.size], dtype=np.float64)
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
    left_vectors, gains, right = np.linalg.svd(regression)
    regression = (left_vectors * np.minimum(gains, _LARGEST_GAIN)) @ right
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


RIDGE = 1e-3
"""Ridge added to the diagonal of R relative to the input power, except for plain biased correlations.

It stabilises lags combinations that the input does not excite, for complete windows and tapered signals; in plain
biased correlations the ends of the record have that effect. For a force without power above 200 Hz, the power within
the band is five times the mean, so that the ridge reduces the response there by 0.02 %.
"""

EXTRA_MEMORY_S = 0.005
"""Additional memory, s (``typical_samples``), for which a response is estimated and then cut off.

Effects beyond the last lag (a longer response, nonlinearity, noise) are attributed to the last lags, over the
correlation time of the input: 5 ms for a force without power above 200 Hz.
"""


_DECAYED = 0.1
"""Share of the peak below which a kernel has decayed."""

_DENSE_LAGS = 500
"""Number of lags up to which a Toeplitz matrix is multiplied as a dense matrix."""

_FEWEST_LAGS = 5
"""Shortest memory, samples."""


@dataclass(frozen=True, eq=False)
class ImpulseResponses:
    """The factored input side of Eq. 3.2.

    ``prepared.memory_samples`` is the number of estimated lags, which may exceed the number that is used:
    :func:`with_extra_memory`. ``input`` (n,) is the input minus its mean; ``fade`` (fitted samples,) is the taper of
    input and output before correlation. R (lags, lags) is stored by its first column if it is Toeplitz, else by its
    pseudo-inverse. ``condition`` is its condition number, in the 1-norm in the first case and in the 2-norm in the
    second. ``ridge`` was added to its diagonal.
    """

    prepared: PreparedRecord
    input: Array
    correlator: Correlator
    fade: Array
    column: Array | None
    pseudo_inverse: Array | None
    condition: float
    warnings: tuple[str, ...] = ()
    ridge: float = 0.0

    def kernel(self, output: Array) -> Array:
        """Return the impulse response per sample (lags,) for an output (n,); its mean is removed."""
        return self.solve(self.products(output))

    def products(self, output: Array) -> Array:
        """Return the right-hand side of Eq. 3.2, (lags,), for an output (n,); its mean is removed."""
        prepared = self.prepared
        if prepared.gapless:
            y = output[prepared.part]
            return self.correlator.cross((y - y.mean()) * self.fade)
        y = np.where(prepared.used, output - output[prepared.used].mean(), 0.0)
        return self.correlator.cross(y) * (y.size / int(prepared.used.sum()))

    def solve(self, right: Array) -> Array:
        """Return the solution h (lags,) of R h = right (lags,)."""
        return self.inverse @ right if self.column is None else toeplitz_solve(self.column, right)

    def without_unexcited(self, kernel: Array) -> Array:
        """Return a kernel (lags,) without its components in directions that the input hardly excites."""
        return kernel - self.ridge * (self.inverse @ kernel)

    @cached_property
    def inverse(self) -> Array:
        """Inverse of R, shape (lags, lags), or its pseudo-inverse."""
        if self.pseudo_inverse is not None:
            return self.pseudo_inverse
        assert self.column is not None
        return toeplitz_inverse(self.column)


def with_extra_memory(prepared: PreparedRecord) -> PreparedRecord:
    """Return the record prepared for a response longer by ``EXTRA_MEMORY_S``, or less if there are too few samples."""
    record, part = prepared.record, prepared.part
    spare = part.stop - part.start - prepared.memory_samples
    lags = prepared.memory_samples + min(typical_samples(EXTRA_MEMORY_S, record.sample_rate_hz), spare)
    used = scored_samples(record, lags, part)
    if int(used.sum()) < lags:
        return prepared
    mean = prepared.output_mean if prepared.gapless else float(np.mean(record.output[used]))
    return replace(prepared, used=used, memory_samples=lags, output_mean=mean)


def factor_input(
    prepared: PreparedRecord, *, pseudo_inverse: bool = False, tolerance: float = 1e-12, taper: float = 0.0
) -> ImpulseResponses:
    """Factor the input side of Eq. 3.2: biased correlations without gaps, sums over complete windows with gaps.

    Args:
        prepared: the record.
        pseudo_inverse: use the pseudo-inverse of the dense matrix, as Appendix C.1.1, instead of the recursion.
        tolerance: for the pseudo-inverse, singular values below this share of the largest are dropped.
        taper: share of the fitted samples, half at each end, over which both signals are tapered. An abrupt end has
            power
            at all frequencies; at frequencies that the input does not excite it would dominate and cause outliers in
                the
            response.
    """
    x = prepared.record.input - prepared.input_mean
    lags = prepared.memory_samples
    if not prepared.gapless:
        # Only outputs with complete windows are used, so the zeros for missing inputs have no effect.
        correlator = Correlator(np.where(np.isfinite(x), x, 0.0), lags)
        fade = np.ones(0)
        r = lagged_products(x, prepared.used, lags)
        if pseudo_inverse:
            inverse, condition = _pseudo_inverse(r, tolerance)
        else:
            ridge = RIDGE * float(np.trace(r)) / lags
            inverse, condition = _pseudo_inverse(r + ridge * np.eye(lags), 0.0)
            return ImpulseResponses(prepared, x, correlator, fade, None, inverse, condition, ridge=ridge)
        return ImpulseResponses(prepared, x, correlator, fade, None, inverse, condition)
    inside = x[prepared.part]
    fade = signal.windows.tukey(inside.size, taper)
    correlator = Correlator(inside * fade, lags)
    column = correlator.auto()
    ridge = RIDGE * float(column[0]) if taper > 0.0 else 0.0
    column[0] += ridge
    warnings: tuple[str, ...] = ()
    if not pseudo_inverse:
        try:
            return ImpulseResponses(prepared, x, correlator, fade, column, None, condition_number(column), ridge=ridge)
        except np.linalg.LinAlgError:
            warnings = (
                Message(
                    "impulse_response.pseudo_inverse",
                    "the input does not excite every lag of the memory: the pseudo-inverse is used",
                ),
            )
    inverse, condition = _pseudo_inverse(linalg.toeplitz(column), tolerance)
    return ImpulseResponses(prepared, x, correlator, fade, None, inverse, condition, warnings)


def _pseudo_inverse(r: Array, tolerance: float) -> tuple[Array, float]:
    """Return the pseudo-inverse and 2-norm condition number of a positive semidefinite R (lags, lags)."""
    values, vectors = linalg.eigh(r)
    kept = values > tolerance * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return inverse, float(values[-1] / values[0]) if values[0] > 0.0 else float("inf")


def memory_warnings(kernel: Array) -> tuple[str, ...]:
    """Return a warning if a kernel (lags,) has not decayed at its end: the memory is too short."""
    if kernel.size < _FEWEST_LAGS:
        return (
            Message(
                "impulse_response.few_lags",
                "the memory is only {samples} samples long: lengthen it, or do not rely on the parameters",
                samples=int(kernel.size),
            ),
        )
    late = kernel[int(0.8 * kernel.size) : int(0.95 * kernel.size)]
    if late.size < 3 or abs(float(np.mean(late))) <= _DECAYED * float(np.max(np.abs(kernel))):
        return ()
    return (
        Message(
            "impulse_response.short_memory",
            "the response has not decayed within the memory: lengthen it, or do not rely on the parameters",
        ),
    )


def kernel_std(inverse: Array, x: Array, residuals: Array) -> Array:
    """Return standard deviations of a kernel (lags,) for coloured noise that is independent of the input.

    The covariance is inv(R) S inv(R) / n, where S is the Toeplitz matrix of the product spectrum of input x (n,) and
    residuals (n,). NaN residuals are missing: the sums are scaled by the number of known ones.
    """
    lags = inverse.shape[0]
    finite = np.isfinite(residuals)
    length = fft.next_fast_len(2 * x.size, real=True)
    x_power = np.abs(fft.rfft(np.where(np.isfinite(x), x, 0.0), length)) ** 2 / np.isfinite(x).sum()
    error = np.where(finite, residuals - np.mean(residuals[finite]), 0.0)
    error_correlation = fft.irfft(np.abs(fft.rfft(error, length)) ** 2, length) / finite.sum()
    lag = np.minimum(np.arange(length), length - np.arange(length))
    error_power = fft.rfft(error_correlation * np.maximum(0.0, 1.0 - lag / lags), length).real
    score_correlation = fft.irfft(x_power * error_power, length)[:lags]
    # (lags, lags): a dense product is several times faster for few lags.
    whole = lags <= _DENSE_LAGS
    spread = (
        linalg.toeplitz(score_correlation) @ inverse if whole else linalg.matmul_toeplitz(score_correlation, inverse)
    )
    variance = np.einsum("ij,ij->j", spread, inverse) / finite.sum()
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SegmentAverage:
    """Mean impulse response per sample (lags,) of the accepted segments, its standard deviations, and their numbers."""

    kernel: Array
    std: Array
    accepted: int
    rejected: int


def segment_average(
    prepared: PreparedRecord, segment: float, most_condition: float, tolerance: float
) -> SegmentAverage:
    """Average the responses of segments that overlap by half; ill-conditioned ones are rejected (Chen 2010, C.1.1).

    Each response is the pseudo-inverse solution for the correlations of its segment about the means. The deviations are
    those of the mean over disjoint segments, half of all. Segments with a gap are left out.

    Args:
        prepared: the record; its memory is that of the response.
        segment: length of a segment, s.
        most_condition: condition number of the correlation matrix from which a segment is rejected.
        tolerance: singular values below this share of the largest are dropped.

    Raises:
        UnusableInputError: fewer than two segments are accepted.
    """
    record, part, lags = prepared.record, prepared.part, prepared.memory_samples
    length = max(2 * lags, round(segment * record.sample_rate_hz))
    kernels: list[Array] = []
    rejected = 0
    for first in range(part.start, part.stop - length + 1, max(1, length // 2)):
        u, y = record.input[first : first + length], record.output[first : first + length]
        if not (np.all(np.isfinite(u)) and np.all(np.isfinite(y))):
            continue
        correlator = Correlator(u - u.mean(), lags)
        inverse, condition = _pseudo_inverse(linalg.toeplitz(correlator.auto()), tolerance)
        if condition < most_condition:
            kernels.append(inverse @ correlator.cross(y - y.mean()))
        else:
            rejected += 1
    if len(kernels) < 2:
        raise UnusableInputError(
            "lms.too_few_segments",
            "{accepted} of {all} segments have a condition number below {limit:g}, and two are needed: take "
            "shorter segments, or a higher limit",
            accepted=len(kernels),
            all=len(kernels) + rejected,
            limit=most_condition,
        )
    estimates = np.array(kernels)
    std = np.std(estimates, axis=0, ddof=1) * np.sqrt(2.0 / len(kernels))
    return SegmentAverage(estimates.mean(axis=0), std, len(kernels), rejected)
