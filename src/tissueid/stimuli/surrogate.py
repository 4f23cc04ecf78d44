"""Surrogates: arrangement of given amplitudes in time to approximate a spectrum or an autocorrelation, quickly.

Both methods change all samples at once and then assign each the amplitude of its rank, so the amplitudes stay exact;
iteration reduces the spectral error that the assignment causes. :mod:`tissueid.stimuli.interchange` refines the result
by swapping pairs.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ITERATIONS = 30
"""Iterations of the spectral surrogate."""

_MAX_CORRECTIONS = 40
"""Maximum number of corrections of the lag surrogate."""
_FLOOR = 0.1, 0.02
"""Lower bounds of the target power in a correction, relative to the mean and to the maximum power density."""

_MIN_STEP = 0.01
"""Step size at which the line search stops."""

_STOP_RATIO = 0.98
"""Corrections stop when one leaves more than this share of the error."""


def first_mean_crossing(values: Array) -> int:
    """Return the index of the first sample after a sign change of values (n,), or 0 without one."""
    crossings = np.flatnonzero(np.diff(np.signbit(values)))
    return int(crossings[0]) + 1 if crossings.size else 0


def stable_order(values: Array) -> NDArray[np.intp]:
    """Return the indices that sort values (n,), those of equal values ascending.

    The default sort is several times as fast as the stable one, and the same where all values differ.
    """
    order = np.argsort(values)
    ascending = values[order]
    if not np.all(ascending[1:] > ascending[:-1]):
        order = np.argsort(values, kind="stable")
    return order


def assign_by_rank(values: Array, levels: Array) -> Array:
    """Replace values (n,) by the ascending levels (n,) of the same rank."""
    arranged = np.empty_like(levels)
    arranged[stable_order(values)] = levels
    return arranged


def spectral_surrogate(values: Array, levels: Array, amplitude: Array) -> Array:
    """Arrange levels (n,) to approximate an amplitude spectrum (n // 2 + 1,) by alternating projections.

    Spectrum and levels are restored alternately (Schreiber and Schmitz 1996), levels last, so they are exact.

    Args:
        values: (n,), gives the initial ranks and phases.
        levels: (n,), ascending.
        amplitude: of the real transform, in any unit.
    """
    n = values.size
    arranged = assign_by_rank(values, levels)
    for _ in range(_ITERATIONS):
        spectrum = scipy.fft.rfft(arranged)
        size = np.abs(spectrum)
        coloured = scipy.fft.irfft(
            np.divide(spectrum, size, out=np.zeros_like(spectrum), where=size > 0.0) * amplitude, n
        )
        arranged = assign_by_rank(coloured, levels)
    return arranged


def start_at_mean(values: Array) -> Array:
    """Rotate a signal (n,) to a mean crossing and let it begin with the value nearest the mean.

    The other samples keep their rank order. Signals without values near the mean, such as binary ones, begin with one
    of their values.
    """
    about = values - np.mean(values)
    turned = np.roll(about, -first_mean_crossing(about))
    levels = np.sort(values)
    first = int(np.argmin(np.abs(levels - np.mean(levels))))
    return np.concatenate([levels[first : first + 1], assign_by_rank(turned[1:], np.delete(levels, first))])


def lag_surrogate(values: Array, target: Array) -> Array:
    """Rearrange values (n,) to approximate a target autocorrelation (lags + 1,), all samples at once.

    The autocorrelation is the aperiodic one of :func:`tissueid.stimuli.interchange.autocorrelation`. A correction is a
    filter whose impulse response is the lag errors, divided by twice the target power: to first order the smallest
    change of the record that removes the errors. The first sample is not moved.
    """
    about = values - np.mean(values)
    order = stable_order(values[1:])
    levels, levels_about = values[1:][order], about[1:][order]
    n, lags = values.size, target.size - 1
    padded = int(scipy.fft.next_fast_len(n + lags, real=True))
    wanted = np.maximum(scipy.fft.rfft(_two_sided(target, padded)).real, 0.0)
    divisor = 2.0 * np.maximum(wanted, max(_FLOOR[0], _FLOOR[1] * float(np.max(wanted))))
    power = float(about @ about)

    def errors_of(signal: Array) -> tuple[NDArray[np.complex128], Array]:
        spectrum = scipy.fft.rfft(signal, padded)
        correlation = scipy.fft.irfft(spectrum.real**2 + spectrum.imag**2, padded)[: lags + 1]
        return spectrum, np.concatenate([[0.0], correlation[1:] / power - target[1:]])

    best = about
    spectrum, errors = errors_of(best)
    least, step = float(errors @ errors), 1.0
    for _ in range(_MAX_CORRECTIONS):
        correction = scipy.fft.rfft(_two_sided(errors, padded)).real / divisor
        moved = best - step * scipy.fft.irfft(correction * spectrum, padded)[:n]
        tried = np.concatenate([about[:1], assign_by_rank(moved[1:], levels_about)])
        tried_spectrum, tried_errors = errors_of(tried)
        error = float(tried_errors @ tried_errors)
        if error < least:
            worth = error < _STOP_RATIO * least
            best, spectrum, errors, least = tried, tried_spectrum, tried_errors, error
            if not worth:
                break
        else:
            step *= 0.5
            if step < _MIN_STEP:
                break
    return np.concatenate([values[:1], assign_by_rank(best[1:], levels)])


def _two_sided(one_sided: Array, n: int) -> Array:
    """Return the symmetric circular extension, n samples, n > 2 lags, of a function of the lag (lags + 1,)."""
    whole = np.zeros(n)
    whole[: one_sided.size] = one_sided
    whole[n - one_sided.size + 1 :] = one_sided[:0:-1]
    return whole
