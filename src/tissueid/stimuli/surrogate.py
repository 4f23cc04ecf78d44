"""Arranging given amplitudes in time so that they have a spectrum or an autocorrelation: quick, and nearly right.

Both ways move all samples at once and then give each the amplitude of its rank, so the amplitudes stay exactly what
they were; what the second step spoils of the first is brought down by repeating. The exchange of single pairs
(:mod:`tissueid.stimuli.interchange`) goes on from there.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ALTERNATIONS = 30

_CORRECTIONS = 40
_FLOOR = 0.1, 0.02
"""Of the mean and of the largest power density: where less is wanted, a correction asks for no larger a share."""

_LEAST_STEP = 0.01

_WORTH = 0.98
"""Corrections end when one leaves more than this share of the error."""


def mean_crossing(values: Array) -> int:
    """First sample after values (n,) change sign; their start where they do not."""
    crossings = np.flatnonzero(np.diff(np.signbit(values)))
    return int(crossings[0]) + 1 if crossings.size else 0


def ranked(values: Array, levels: Array) -> Array:
    """Replace values (n,) by the ascending levels (n,) of the same rank."""
    arranged = np.empty_like(levels)
    arranged[np.argsort(values, kind="stable")] = levels
    return arranged


def spectral_surrogate(values: Array, levels: Array, amplitude: Array) -> Array:
    """Give a signal the levels (n,) and nearly the amplitude spectrum (n // 2 + 1,), by alternation.

    The spectrum is restored, then the levels, in turn (Schreiber and Schmitz 1996); the levels are last, and exact.

    Args:
        values: (n,), whose ranks and phases it begins with.
        levels: (n,), ascending.
        amplitude: of the real transform, in any unit.
    """
    n = values.size
    arranged = ranked(values, levels)
    for _ in range(_ALTERNATIONS):
        spectrum = scipy.fft.rfft(arranged)
        size = np.abs(spectrum)
        coloured = scipy.fft.irfft(
            np.divide(spectrum, size, out=np.zeros_like(spectrum), where=size > 0.0) * amplitude, n
        )
        arranged = ranked(coloured, levels)
    return arranged


def first_at_the_mean(values: Array) -> Array:
    """Turn a signal (n,) round so that it crosses its mean at its start, and begin with the value nearest the mean.

    The rest keeps its ranks. Values that are all far from their mean, as two-valued ones are, begin with one of them.
    """
    about = values - np.mean(values)
    turned = np.roll(about, -mean_crossing(about))
    levels = np.sort(values)
    first = int(np.argmin(np.abs(levels - np.mean(levels))))
    return np.concatenate([levels[first : first + 1], ranked(turned[1:], np.delete(levels, first))])


def lag_surrogate(values: Array, target: Array) -> Array:
    """Rearrange values (n,) so that their autocorrelation comes nearer a target (lags + 1,), all samples at once.

    The autocorrelation is that of :func:`tissueid.stimuli.interchange.autocorrelation`, of the record as it is played
    and not as if it came round again. A correction is a filter with the lags' errors for its response, divided by
    twice the wanted power: to first order it moves the record by the least that removes the errors. The first sample
    stays.
    """
    about = values - np.mean(values)
    order = np.argsort(values[1:], kind="stable")
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
    for _ in range(_CORRECTIONS):
        correction = scipy.fft.rfft(_two_sided(errors, padded)).real / divisor
        moved = best - step * scipy.fft.irfft(correction * spectrum, padded)[:n]
        tried = np.concatenate([about[:1], ranked(moved[1:], levels_about)])
        tried_spectrum, tried_errors = errors_of(tried)
        error = float(tried_errors @ tried_errors)
        if error < least:
            worth = error < _WORTH * least
            best, spectrum, errors, least = tried, tried_spectrum, tried_errors, error
            if not worth:
                break
        else:
            step *= 0.5
            if step < _LEAST_STEP:
                break
    return np.concatenate([values[:1], ranked(best[1:], levels)])


def _two_sided(one_sided: Array, n: int) -> Array:
    """A symmetric function of the lag, given (lags + 1,), on a circle of n samples, n > 2 lags."""
    whole = np.zeros(n)
    whole[: one_sided.size] = one_sided
    whole[n - one_sided.size + 1 :] = one_sided[:0:-1]
    return whole
