"""Joint design of amplitude distribution and autocorrelation by swapping samples (Hunter and Kearney 1983).

The autocorrelation is the biased estimate of the aperiodic record: r(k) = sum over i of z(i) z(i + k), divided by the
sum of z(i)^2, where z is the record minus its mean and i runs over all samples with a successor k samples later. It is
not circular, because a test plays the record once. The error is the sum over lags 1 to ``lags`` of the squared
difference from the target; lag 0 is 1 by definition. Rearranging samples changes neither their mean nor their energy,
so the amplitudes stay exact and a swap of two samples changes r(k) by four products (Chen 2010, 6.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.stimuli.spectra import Spectrum
from tissueid.stimuli.surrogate import lag_surrogate, spectral_surrogate, start_at_mean

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

TRIED, ACCEPTED = 0, 1


# Reassociation of sums allows SIMD instructions.
@njit(cache=True, fastmath={"reassoc", "contract"}, nogil=True)
def _swap_gain(x: Array, errors: Array, change: Array, first: int, second: int) -> float:
    """Fill the change (lags,) of the autocorrelation at lags 1, 2, ... and return the change of the sum of squared
    errors.

    Each product of a swapped sample with a neighbour changes by the difference of the two samples. The product of the
    two samples with each other, at the lag between them, does not change.
    """
    lags, mirrored = errors.size, x.shape[1]
    i, j = first + lags, second + lags
    apart = x[0, j] - x[0, i]
    after_i, before_i = x[0, i + 1 : i + 1 + lags], x[1, mirrored - i : mirrored - i + lags]
    after_j, before_j = x[0, j + 1 : j + 1 + lags], x[1, mirrored - j : mirrored - j + lags]
    gain = 0.0
    for k in range(lags):
        step = apart * (after_i[k] + before_i[k] - after_j[k] - before_j[k])
        change[k] = step
        gain += step * (2.0 * errors[k] + step)
    between = abs(first - second) - 1
    if 0 <= between < lags:
        counted = change[between]
        step = counted - apart * apart
        change[between] = step
        gain += step * (2.0 * errors[between] + step) - counted * (2.0 * errors[between] + counted)
    return gain


@njit(cache=True, nogil=True)
def _apply_swap(x: Array, errors: Array, change: Array, rank: Integers, first: int, second: int) -> None:
    lags = errors.size
    for k in range(lags):
        errors[k] += change[k]
    i, j = first + lags, second + lags
    x[0, i], x[0, j] = x[0, j], x[0, i]
    x[1, x.shape[1] - 1 - i], x[1, x.shape[1] - 1 - j] = x[0, i], x[0, j]
    rank[first], rank[second] = rank[second], rank[first]


@njit(cache=True, nogil=True)
def try_random_pairs(
    x: Array,
    errors: Array,
    change: Array,
    rank: Integers,
    pairs: Integers,
    counts: Integers,
    error: float,
    tolerance: float,
) -> float:
    """Try to swap given pairs (m, 2) of samples and keep the swaps that lower the error. Return the error.

    Stops at the tolerance. Updates ``x``, the autocorrelation ``errors`` (lags,), the ``rank`` (n,) of each sample and
    ``counts`` in place; ``change`` (lags,) is a work array.
    """
    for t in range(pairs.shape[0]):
        if error <= tolerance:
            break
        first, second = pairs[t, 0], pairs[t, 1]
        counts[TRIED] += 1
        gain = _swap_gain(x, errors, change, first, second)
        if gain < 0.0:
            _apply_swap(x, errors, change, rank, first, second)
            counts[ACCEPTED] += 1
            error += gain
    return error


@njit(cache=True, nogil=True)
def try_guided_pairs(
    x: Array,
    errors: Array,
    change: Array,
    rank: Integers,
    sample_of_rank: Integers,
    levels: Array,
    gradient: Array,
    curvature: float,
    nearby: Array,
    picks: Integers,
    spreads: Array,
    counts: Integers,
    error: float,
    tolerance: float,
) -> float:
    """Try to swap each picked sample (m,) with the partner of the largest predicted improvement. Return the error.

    Candidate partners: samples whose rank differs by distances that double from ``spreads`` (m,), 1 to 2, in both
    directions, and the ``nearby.size`` neighbours in time on either side. The improvement is predicted from the
    ``gradient`` (n,) of half the error with respect to each sample, computed at the start of the sweep, and the mean
    second-order term: ``curvature`` for any two samples, ``nearby`` (r,) for samples 1, 2, ... apart. Only the best
    candidate is evaluated exactly. ``sample_of_rank`` (n,) is the sample index of each of the ascending ``levels``
    (n,). The first sample is never moved. Updates the same arrays as :func:`try_random_pairs`.
    """
    n = levels.size
    for t in range(picks.size):
        if error <= tolerance:
            break
        picked = picks[t]
        r = rank[picked]
        promised, partner = 0.0, -1
        distance = spreads[t]
        while distance < n:
            for side in (-1, 1):
                s = r + side * int(distance)
                if s < 0 or s >= n or sample_of_rank[s] == 0:
                    continue
                apart = levels[s] - levels[r]
                promise = apart * (2.0 * (gradient[picked] - gradient[sample_of_rank[s]]) + curvature * apart)
                if promise < promised:
                    promised, partner = promise, sample_of_rank[s]
            distance *= 2.0
        for k in range(nearby.size):
            for neighbour in (picked - 1 - k, picked + 1 + k):
                if neighbour < 1 or neighbour >= n:
                    continue
                apart = levels[rank[neighbour]] - levels[r]
                promise = apart * (2.0 * (gradient[picked] - gradient[neighbour]) + nearby[k] * apart)
                if promise < promised:
                    promised, partner = promise, neighbour
        counts[TRIED] += 1
        if partner < 0:
            continue
        gain = _swap_gain(x, errors, change, picked, partner)
        if gain < 0.0:
            _apply_swap(x, errors, change, rank, picked, partner)
            sample_of_rank[rank[picked]], sample_of_rank[rank[partner]] = picked, partner
            counts[ACCEPTED] += 1
            error += gain
    return error


MAX_DRIFT = 1e-10
"""Maximum difference between an incrementally updated lag and its recomputed value; a larger one is a defect."""


@dataclass(frozen=True)
class InterchangeProgress:
    """Progress of the interchange: swaps tried, their maximum, the current error, and the tolerance."""

    tried: int
    max_trials: int
    error: float
    tolerance: float


_NEARBY = 32
"""Neighbours in time, on either side, that are partner candidates when few amplitudes are distinct."""

OnProgress = Callable[[InterchangeProgress], bool | None]
"""Callback after every sweep, several times a second; returning False stops the search at the current result."""


@dataclass(frozen=True, eq=False)
class InterchangeResult:
    """Result of the interchange.

    ``values`` (n,) are the samples of the start in a new order. ``error_before`` and ``error`` are sums of squares over
    the ``lags``; ``error`` is recomputed from the values. ``drift`` is the largest difference between an incrementally
    updated lag and its recomputed value. ``history`` (m, 3) holds tried swaps, accepted swaps and the error, from start
    to end (Chen 2010, Fig. 6.2b).
    """

    values: Array
    target: Array
    error_before: float
    error: float
    tried: int
    accepted: int
    history: Array
    drift: float
    tolerance: float

    @property
    def reached(self) -> bool:
        """Whether the error is at most the tolerance."""
        return self.error <= self.tolerance

    @property
    def lags(self) -> int:
        """Number of lags over which the error is summed."""
        return self.target.size - 1


def autocorrelation(values: Array, lags: int) -> Array:
    """Return the biased autocorrelation (lags + 1,) of values (n,) minus their mean, 1 at lag 0, computed directly.

    Raises:
        UnusableInputError: fewer samples than lags, or all samples equal.
    """
    about = _normalised(values, lags)
    return np.array([1.0] + [float(about[:-k] @ about[k:]) for k in range(1, lags + 1)])


def _normalised(values: Array, lags: int) -> Array:
    """Return values (n,) with zero mean and unit energy, or raise where the autocorrelation is undefined."""
    if lags >= values.size:
        raise UnusableInputError(
            "interchange.short",
            "{size} samples have no autocorrelation at {lags} lags: use a longer stimulus",
            size=values.size,
            lags=lags,
        )
    if np.ptp(values) == 0.0:
        raise UnusableInputError("interchange.constant", "all samples are equal: there is no autocorrelation")
    about = values - np.mean(values)
    return np.asarray(about / np.sqrt(about @ about), dtype=np.float64)


def initial_arrangement(levels: Array, spectrum: Spectrum, lags: int, sample_rate_hz: float, seed: int) -> Array:
    """Arrange levels (n,) so that their autocorrelation approximates that of a spectrum: start of the interchange.

    Steps: coloured Gaussian noise, its iterated surrogate with these levels, rotation to a mean crossing, and a
    correction for the lags of the aperiodic record.
    """
    white = np.random.Generator(np.random.PCG64(seed)).standard_normal(levels.size)
    amplitude = np.sqrt(spectrum.power(levels.size, sample_rate_hz))
    shape = fft.irfft(fft.rfft(white) * amplitude, levels.size)
    start = start_at_mean(spectral_surrogate(shape, np.sort(levels), amplitude))
    return lag_surrogate(start, spectrum.autocorrelation(lags, sample_rate_hz))


def interchange(
    start: Array,
    target: Array,
    *,
    tolerance: float,
    max_trials: int,
    seed: int = 0,
    guided: bool = True,
    on_progress: OnProgress | None = None,
) -> InterchangeResult:
    """Swap pairs of samples, keeping the swaps that lower the error, until the error is at most the tolerance.

    With ``guided``, a sample is drawn at random and its partner is selected by the predicted improvement; without, both
    are drawn at random, as in the original method. The first sample is never moved. All lags are updated with each
    swap, recomputed after every sweep, and verified at the end.

    Args:
        start: (n,), samples in their initial order.
        target: autocorrelation (lags + 1,), 1 at lag 0.
        tolerance: error at which to stop.
        max_trials: maximum number of swaps to try.
        seed: of the random draws; the same seed gives the same result.
        guided: select partners by predicted improvement.
        on_progress: called after every sweep; an exception from it ends the search.

    Raises:
        UnusableInputError: the target does not begin with 1, or there are too few samples for its lags.
        ArithmeticError: the final verification failed, which is a defect.
    """
    if target.size < 2 or abs(target[0] - 1.0) > 1e-9:
        raise UnusableInputError(
            "interchange.target", "a target autocorrelation must be 1 at lag 0 and have at least lag 1"
        )
    search = _Search(np.asarray(start, dtype=np.float64), np.asarray(target, dtype=np.float64), seed)
    while search.error > tolerance and search.tried < max_trials:
        search.sweep(min(search.sweep_size(guided), max_trials - search.tried), tolerance, guided)
        progress = InterchangeProgress(search.tried, max_trials, search.error, tolerance)
        if on_progress is not None and on_progress(progress) is False:
            break
    return search.verified_result(tolerance)


class _Search:
    """State of a running interchange."""

    def __init__(self, start: Array, target: Array, seed: int) -> None:
        self._start, self._target = start, target
        lags = target.size - 1
        self._sample_of_rank = np.argsort(start, kind="stable")
        self._rank = np.empty_like(self._sample_of_rank)
        self._rank[self._sample_of_rank] = np.arange(start.size)
        about = _normalised(start, lags)
        self._levels = about[self._sample_of_rank]
        x = np.concatenate([np.zeros(lags), about, np.zeros(lags)])
        self._x = np.array([x, x[::-1]])
        self._padded = int(fft.next_fast_len(start.size + lags, real=True))
        self._draw = np.random.Generator(np.random.PCG64(seed))
        self._counts = np.zeros(2, dtype=np.int64)
        self._work = np.empty(lags)
        # Four products change at each lag, each of power 1 / n; those of close samples partly cancel.
        self._curvature = 4.0 * lags / start.size
        tied = (
            np.count_nonzero(np.diff(self._levels)) < start.size // 2
        )  # rank distance then says little about amplitude
        self._nearby = self._curvature * (1.0 - target[1 : _NEARBY + 1]) if tied else np.empty(0)
        self._errors, self._gradient = self._recompute()
        self.error = float(self._errors @ self._errors)
        self._drift = 0.0
        self._history = [(0.0, 0.0, self.error)]

    @property
    def tried(self) -> int:
        return int(self._counts[TRIED])

    def sweep_size(self, guided: bool) -> int:
        """Return the number of swaps between two gradient updates; random pairs need no gradient."""
        return max(64, self._start.size // 20) if guided else max(10_000, self._start.size)

    def sweep(self, trials: int, tolerance: float, guided: bool) -> None:
        """Try ``trials`` swaps, then recompute all lags."""
        n = self._start.size
        if guided:
            try_guided_pairs(
                self._x,
                self._errors,
                self._work,
                self._rank,
                self._sample_of_rank,
                self._levels,
                self._gradient,
                self._curvature,
                self._nearby,
                self._draw.integers(1, n, trials),
                self._draw.uniform(1.0, 2.0, trials),
                self._counts,
                self.error,
                tolerance,
            )
        else:
            pairs = self._draw.integers(1, n, (trials, 2))
            try_random_pairs(self._x, self._errors, self._work, self._rank, pairs, self._counts, self.error, tolerance)
        followed = self._errors
        self._errors, self._gradient = self._recompute()
        self._drift = max(self._drift, float(np.max(np.abs(followed - self._errors))))
        self.error = float(self._errors @ self._errors)
        self._history.append((float(self._counts[TRIED]), float(self._counts[ACCEPTED]), self.error))

    def verified_result(self, tolerance: float) -> InterchangeResult:
        """Return the result after verification against values recomputed from the samples."""
        values = np.sort(self._start)[self._rank]
        errors = autocorrelation(values, self._errors.size)[1:] - self._target[1:]
        difference = float(np.max(np.abs(errors - self._errors)))
        if not max(difference, self._drift) <= MAX_DRIFT or not np.array_equal(np.sort(values), np.sort(self._start)):
            raise ArithmeticError(
                f"interchange verification failed: final lag error {difference:.1e}, drift {self._drift:.1e}"
            )
        return InterchangeResult(
            values=values,
            target=self._target,
            error_before=self._history[0][2],
            error=float(errors @ errors),
            tried=self.tried,
            accepted=int(self._counts[ACCEPTED]),
            history=np.array(self._history),
            drift=self._drift,
            tolerance=tolerance,
        )

    def _recompute(self) -> tuple[Array, Array]:
        """Return the errors (lags,) recomputed from the samples, and the gradient (n,) of half their sum of squares."""
        n, lags = self._start.size, self._target.size - 1
        spectrum = fft.rfft(self._x[0, lags : lags + n], self._padded)
        correlation = fft.irfft(spectrum.real**2 + spectrum.imag**2, self._padded)
        errors = np.asarray(correlation[1 : lags + 1] - self._target[1:], dtype=np.float64)
        response = np.zeros(self._padded)
        response[1 : lags + 1] = errors
        response[self._padded - lags :] = errors[::-1]
        gradient = fft.irfft(fft.rfft(response).real * spectrum, self._padded)[:n]
        return errors, np.asarray(gradient, dtype=np.float64)
