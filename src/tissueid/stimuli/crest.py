"""Phases that give a sum of sines a low crest factor.

From any start the clipping of Van der Ouderaa, Schoukens and Renneboog (1988) takes away the worst, then the L2p norms
of Guillaume, Schoukens, Pintelon and Kollar (1991) are minimised for growing p, each by L-BFGS with its gradient from
one Fourier transform. For p without end the norm is the peak itself.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.stimuli.base import Array

Lines = NDArray[np.int_]

_CLIPPINGS = 300
_LOWEST_CLIP = 0.75
_HIGHEST_CLIP = 0.99
"""Share of the peak at which the first and the last clipping cuts."""

_NORMS = (4, 8, 16, 32, 64, 128, 256, 512)
_STEPS = 200
"""Steps of the minimisation, at most, for each norm."""

_MOST_POINTS = 100_000_000
"""Grid points times steps, at most: some seconds. Long periods have many lines, and fewer steps do for them."""

_CORRECTIONS = 20
"""Pairs that L-BFGS remembers."""

_PER_CYCLE = 16
"""Grid points in a cycle of the highest line, at least: between them a peak can rise by 2 % at most."""


def summed(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """One period (period,) of the sum of amplitude * cos(2 pi line k / period + phase); lines below period / 2."""
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * period * amplitudes * np.exp(1j * phases)
    return np.asarray(scipy.fft.irfft(spectrum, period), dtype=np.float64)


def grid_size(lines: Lines, period: int) -> int:
    """Points of a grid over one period on which the peak of such a sum can be read: a multiple of the period."""
    return period * max(1, -(-_PER_CYCLE * int(lines[-1]) // period))


def peak_ratio(lines: Lines, amplitudes: Array, phases: Array, period: int) -> float:
    """Crest factor of the sum, between samples too."""
    values = summed(lines, amplitudes, phases, grid_size(lines, period))
    return float(np.max(np.abs(values)) / np.sqrt(0.5 * np.sum(amplitudes**2)))


def schroeder_phases(amplitudes: Array) -> Array:
    """Phases (lines,) whose group delay spreads the lines' power evenly over the period (Schroeder 1970, Eq. 11)."""
    share = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(share)[:-1]])
    return np.asarray(-2.0 * np.pi * np.cumsum(below), dtype=np.float64)


def lowered(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """Phases (lines,) of a low crest factor near where the given ones (lines,) lead.

    Args:
        lines: driven lines, rising, multiples of the frequency of one period.
        amplitudes: of the lines, positive; they are kept.
        phases: where to start.
        period: samples.
    """
    size = grid_size(lines, period)
    share = min(1.0, _MOST_POINTS / (size * (_CLIPPINGS + len(_NORMS) * _STEPS)))
    best = _clipped(lines, amplitudes, phases, size, round(share * _CLIPPINGS))
    lowest = peak_ratio(lines, amplitudes, best, period)
    found = best
    for norm in _NORMS:
        found = scipy.optimize.minimize(
            _log_norm,
            found,
            args=(lines, amplitudes, size, norm),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": max(1, round(share * _STEPS)), "maxcor": _CORRECTIONS},
        ).x
        reached = peak_ratio(lines, amplitudes, found, period)
        if reached < lowest:
            best, lowest = found, reached
    return np.asarray(best, dtype=np.float64)


def _clipped(lines: Lines, amplitudes: Array, phases: Array, size: int, count: int) -> Array:
    """The best phases met while peaks are cut off and amplitudes restored in turn, ``count`` times, ever less deep."""
    best, lowest = phases, np.inf
    for share in np.linspace(_LOWEST_CLIP, _HIGHEST_CLIP, max(2, count)):
        values = summed(lines, amplitudes, phases, size)
        peak = float(np.max(np.abs(values)))
        if peak < lowest:
            best, lowest = phases, peak
        phases = np.angle(scipy.fft.rfft(np.clip(values, -share * peak, share * peak))[lines])
    return best


def _log_norm(phases: Array, lines: Lines, amplitudes: Array, size: int, norm: int) -> tuple[float, Array]:
    """Logarithm of the mean of |x|^norm to the power 1 / norm, and its gradient (lines,) by the phases."""
    values = summed(lines, amplitudes, phases, size)
    peak = float(np.max(np.abs(values)))
    ratio = values / peak
    high = ratio ** (norm - 1)
    mean = float(np.mean(high * ratio))
    # d log norm / d x is high / (size mean peak); d x / d phase is the real part of i amplitude exp(i (phase + w t)).
    weights = scipy.fft.rfft(high)[lines] / (size * mean * peak)
    gradient = -np.imag(amplitudes * np.exp(1j * phases) * np.conj(weights))
    return float(np.log(peak) + np.log(mean) / norm), np.asarray(gradient, dtype=np.float64)
