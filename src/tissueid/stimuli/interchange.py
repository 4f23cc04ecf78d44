"""Amplitudes and autocorrelation jointly: exchange samples until both are right (Hunter and Kearney 1983).

The autocorrelation is the biased estimate of the record as it is played: r(k) = sum over i of z(i) z(i + k), divided by
the sum of z(i)^2, where z is the record less its mean and i runs over all samples that have one k later. It is not
taken as if the record came round again, because a test plays it once. The error is the sum over lags 1 to ``lags`` of
the squared difference from the target; lag 0 is 1 by definition. Rearranging samples changes neither their mean nor
their energy, so the amplitudes stay exact and a swap of two samples changes r(k) by four products (Chen 2010, 6.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.stimuli import _interchange as kernel
from tissueid.stimuli.spectra import Spectrum
from tissueid.stimuli.surrogate import first_at_the_mean, lag_surrogate, spectral_surrogate

Array = NDArray[np.float64]

AGREEMENT = 1e-10
"""Largest difference of a lag that is updated with each swap from its recomputed value."""


@dataclass(frozen=True)
class Progress:
    """How far it has come: swaps tried, of at most, and the error, which is to fall to the tolerance."""

    tried: int
    max_trials: int
    error: float
    tolerance: float


_NEARBY = 32
"""Neighbours in time, on either side, that are looked at where few amplitudes are distinct."""

OnProgress = Callable[[Progress], bool | None]
"""Called a few times a second or more; the search ends where it stands when it returns False."""


@dataclass(frozen=True, eq=False)
class Interchanged:
    """What came of it.

    ``values`` (n,) are those of the start in another order. ``error_before`` and ``error`` are sums of squares over
    the ``lags``, the latter audited: worked out from the values alone, lag by lag. ``drift`` is the largest difference
    found between a lag that is updated with each swap and its recomputed value. ``history`` (m, 3) holds tried
    swaps, accepted swaps and the error, from the start to the end (Chen 2010, Fig. 6.2b).
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
        """True when the error is at most the tolerance."""
        return self.error <= self.tolerance

    @property
    def lags(self) -> int:
        """Lags over which the error is summed."""
        return self.target.size - 1


def autocorrelation(values: Array, lags: int) -> Array:
    """Biased autocorrelation (lags + 1,) of values (n,) less their mean, 1 at lag 0, worked out lag by lag.

    Raises:
        UnusableInputError: there are no more samples than lags, or all are equal.
    """
    about = _unit(values, lags)
    return np.array([1.0] + [float(about[:-k] @ about[k:]) for k in range(1, lags + 1)])


def _unit(values: Array, lags: int) -> Array:
    """Values (n,) less their mean, of unit energy; refused when they have no autocorrelation at these lags."""
    if lags >= values.size:
        raise UnusableInputError(
            Message(
                "interchange.short",
                "{size} samples have no autocorrelation at {lags} lags: use a longer stimulus",
                size=values.size,
                lags=lags,
            )
        )
    if np.ptp(values) == 0.0:
        raise UnusableInputError(Message("interchange.constant", "all samples are equal: there is no autocorrelation"))
    about = values - np.mean(values)
    return np.asarray(about / np.sqrt(about @ about), dtype=np.float64)


def arrange(levels: Array, spectrum: Spectrum, lags: int, sample_rate_hz: float, seed: int) -> Array:
    """Arrange levels (n,) so that their autocorrelation is near a spectrum's: where the interchange begins.

    Noise of the spectrum, an iterated surrogate of it with these levels, turned to begin at its mean, and corrected
    for the lags of the record as it is played.
    """
    white = np.random.Generator(np.random.PCG64(seed)).standard_normal(levels.size)
    amplitude = np.sqrt(spectrum.power(levels.size, sample_rate_hz))
    shape = fft.irfft(fft.rfft(white) * amplitude, levels.size)
    start = first_at_the_mean(spectral_surrogate(shape, np.sort(levels), amplitude))
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
) -> Interchanged:
    """Swap pairs of samples, each swap kept when it lowers the error, until the error is at most the tolerance.

    Guided, a sample is drawn and its partner chosen by what the gradient of the error promises, among ranks near and
    far; otherwise both are drawn, as in the original. The first sample stays where it is. All lags are followed from
    swap to swap, recomputed after every sweep, and checked at the end.

    Args:
        start: (n,), the samples in the order to begin with.
        target: autocorrelation (lags + 1,), 1 at lag 0.
        tolerance: error at which to stop.
        max_trials: swaps to try, at most.
        seed: of the drawing; the same seed gives the same result.
        guided: choose partners.
        on_progress: called after every sweep; an exception from it ends the search.

    Raises:
        UnusableInputError: the target does not begin with 1, or there are too few samples for its lags.
        ArithmeticError: the result does not pass its audit, which is a defect.
    """
    if target.size < 2 or abs(target[0] - 1.0) > 1e-9:
        raise UnusableInputError(
            Message("interchange.target", "a target is an autocorrelation from lag 0, where it is 1, to lag 1 at least")
        )
    search = _Search(np.asarray(start, dtype=np.float64), np.asarray(target, dtype=np.float64), seed)
    while search.error > tolerance and search.tried < max_trials:
        search.sweep(min(search.size_of_sweep(guided), max_trials - search.tried), tolerance, guided)
        progress = Progress(search.tried, max_trials, search.error, tolerance)
        if on_progress is not None and on_progress(progress) is False:
            break
    return search.audited(tolerance)


class _Search:
    """An interchange under way."""

    def __init__(self, start: Array, target: Array, seed: int) -> None:
        self._start, self._target = start, target
        lags = target.size - 1
        self._place = np.argsort(start, kind="stable")
        self._rank = np.empty_like(self._place)
        self._rank[self._place] = np.arange(start.size)
        about = _unit(start, lags)
        self._levels = about[self._place]
        x = np.concatenate([np.zeros(lags), about, np.zeros(lags)])
        self._x = np.array([x, x[::-1]])
        self._padded = int(fft.next_fast_len(start.size + lags, real=True))
        self._draw = np.random.Generator(np.random.PCG64(seed))
        self._counts = np.zeros(2, dtype=np.int64)
        self._room = np.empty(lags)
        # Four products change at each lag, each of power 1 / n; those of close samples cancel as far as they are alike.
        self._curvature = 4.0 * lags / start.size
        tied = np.count_nonzero(np.diff(self._levels)) < start.size // 2  # ranks then do not tell near from far
        self._nearby = self._curvature * (1.0 - target[1 : _NEARBY + 1]) if tied else np.empty(0)
        self._errors, self._gradient = self._recomputed()
        self.error = float(self._errors @ self._errors)
        self._drift = 0.0
        self._history = [(0.0, 0.0, self.error)]

    @property
    def tried(self) -> int:
        return int(self._counts[kernel.TRIED])

    def size_of_sweep(self, guided: bool) -> int:
        """Swaps between two gradients, which grow old; drawn pairs need none."""
        return max(64, self._start.size // 20) if guided else max(10_000, self._start.size)

    def sweep(self, trials: int, tolerance: float, guided: bool) -> None:
        """Try ``trials`` swaps, and recompute all lags."""
        n = self._start.size
        if guided:
            kernel.try_chosen(
                self._x,
                self._errors,
                self._room,
                self._rank,
                self._place,
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
            kernel.try_pairs(self._x, self._errors, self._room, self._rank, pairs, self._counts, self.error, tolerance)
        followed = self._errors
        self._errors, self._gradient = self._recomputed()
        self._drift = max(self._drift, float(np.max(np.abs(followed - self._errors))))
        self.error = float(self._errors @ self._errors)
        self._history.append((float(self._counts[kernel.TRIED]), float(self._counts[kernel.ACCEPTED]), self.error))

    def audited(self, tolerance: float) -> Interchanged:
        """The result, worked out from its values alone."""
        values = np.sort(self._start)[self._rank]
        errors = autocorrelation(values, self._errors.size)[1:] - self._target[1:]
        apart = float(np.max(np.abs(errors - self._errors)))
        if not max(apart, self._drift) <= AGREEMENT or not np.array_equal(np.sort(values), np.sort(self._start)):
            raise ArithmeticError(
                f"the interchange fails its audit: its lags are off by {apart:.1e}, in between by {self._drift:.1e}"
            )
        return Interchanged(
            values=values,
            target=self._target,
            error_before=self._history[0][2],
            error=float(errors @ errors),
            tried=self.tried,
            accepted=int(self._counts[kernel.ACCEPTED]),
            history=np.array(self._history),
            drift=self._drift,
            tolerance=tolerance,
        )

    def _recomputed(self) -> tuple[Array, Array]:
        """Errors (lags,) from the samples as they stand, and the gradient (n,) of half their sum of squares."""
        n, lags = self._start.size, self._target.size - 1
        spectrum = fft.rfft(self._x[0, lags : lags + n], self._padded)
        correlation = fft.irfft(spectrum.real**2 + spectrum.imag**2, self._padded)
        errors = np.asarray(correlation[1 : lags + 1] - self._target[1:], dtype=np.float64)
        response = np.zeros(self._padded)
        response[1 : lags + 1] = errors
        response[self._padded - lags :] = errors[::-1]
        gradient = fft.irfft(fft.rfft(response).real * spectrum, self._padded)[:n]
        return errors, np.asarray(gradient, dtype=np.float64)
