"""Phase optimisation of multisines for a low crest factor.

Clipping (Van der Ouderaa, Schoukens and Renneboog 1988) gives a starting point; then the L2p norms are minimised for
growing p (Guillaume, Schoukens, Pintelon and Kollar 1991), each by L-BFGS with the gradient from one Fourier transform.
The norm tends to the peak as p grows.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from tissueid.stimuli.base import Array

Lines = NDArray[np.int_]

_CLIPPINGS = 300
"""Maximum number of clipping iterations."""
_FIRST_CLIP_LEVEL = 0.75
"""Clipping level of the first iteration, as a share of the peak."""
_LAST_CLIP_LEVEL = 0.99
"""Clipping level of the last iteration, as a share of the peak."""

_NORMS = (4, 8, 16, 32, 64, 128, 256, 512)
"""Exponents of the norms that are minimised, in this order."""
_MAX_ITERATIONS = 200
"""Maximum number of L-BFGS iterations for each norm."""

_MAX_EVALUATIONS = 100_000_000
"""Maximum of grid points times iterations: a few seconds. Long periods get fewer iterations."""

_CORRECTIONS = 20
"""Number of L-BFGS correction pairs."""

_PER_CYCLE = 16
"""Minimum grid points per cycle of the highest line: the peak between points is underestimated by at most 2 %."""


def sum_of_sines(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """Return one period (period,) of the sum of amplitude * cos(2 pi line k / period + phase); lines
    below period / 2.
    """
    spectrum = np.zeros(period // 2 + 1, dtype=np.complex128)
    spectrum[lines] = 0.5 * period * amplitudes * np.exp(1j * phases)
    return np.asarray(scipy.fft.irfft(spectrum, period), dtype=np.float64)


def grid_size(lines: Lines, period: int) -> int:
    """Return the number of points of a grid over one period that resolves the peak: a multiple of ``period``."""
    return period * max(1, -(-_PER_CYCLE * int(lines[-1]) // period))


def multisine_crest_factor(lines: Lines, amplitudes: Array, phases: Array, period: int) -> float:
    """Return the crest factor of the multisine, with the peak evaluated between samples too."""
    values = sum_of_sines(lines, amplitudes, phases, grid_size(lines, period))
    return float(np.max(np.abs(values)) / np.sqrt(0.5 * np.sum(amplitudes**2)))


def schroeder_phases(amplitudes: Array) -> Array:
    """Return phases (lines,) whose group delay spreads the power evenly over the period (Schroeder 1970, Eq. 11)."""
    share = amplitudes**2 / np.sum(amplitudes**2)
    below = np.concatenate([[0.0], np.cumsum(share)[:-1]])
    return np.asarray(-2.0 * np.pi * np.cumsum(below), dtype=np.float64)


def minimise_crest_factor(lines: Lines, amplitudes: Array, phases: Array, period: int) -> Array:
    """Return phases (lines,) of a low crest factor: a local minimum near the given phases.

    Args:
        lines: driven lines, rising, multiples of the frequency of one period.
        amplitudes: of the lines, positive; not changed.
        phases: starting point (lines,), rad.
        period: samples.
    """
    size = grid_size(lines, period)
    share = min(1.0, _MAX_EVALUATIONS / (size * (_CLIPPINGS + len(_NORMS) * _MAX_ITERATIONS)))
    best = _clip_iterations(lines, amplitudes, phases, size, round(share * _CLIPPINGS))
    lowest = multisine_crest_factor(lines, amplitudes, best, period)
    found = best
    for norm in _NORMS:
        found = scipy.optimize.minimize(
            _log_norm,
            found,
            args=(lines, amplitudes, size, norm),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": max(1, round(share * _MAX_ITERATIONS)), "maxcor": _CORRECTIONS},
        ).x
        reached = multisine_crest_factor(lines, amplitudes, found, period)
        if reached < lowest:
            best, lowest = found, reached
    return np.asarray(best, dtype=np.float64)


def _clip_iterations(lines: Lines, amplitudes: Array, phases: Array, size: int, count: int) -> Array:
    """Return the best phases of ``count`` iterations of clipping peaks and restoring amplitudes, with a rising clip
    level.
    """
    best, lowest = phases, np.inf
    for share in np.linspace(_FIRST_CLIP_LEVEL, _LAST_CLIP_LEVEL, max(2, count)):
        values = sum_of_sines(lines, amplitudes, phases, size)
        peak = float(np.max(np.abs(values)))
        if peak < lowest:
            best, lowest = phases, peak
        phases = np.angle(scipy.fft.rfft(np.clip(values, -share * peak, share * peak))[lines])
    return best


def _log_norm(phases: Array, lines: Lines, amplitudes: Array, size: int, norm: int) -> tuple[float, Array]:
    """Return the logarithm of the ``norm``-norm of x, (mean |x|^norm)^(1/norm), and its gradient (lines,) by the
    phases.
    """
    values = sum_of_sines(lines, amplitudes, phases, size)
    peak = float(np.max(np.abs(values)))
    ratio = values / peak
    high = ratio ** (norm - 1)
    mean = float(np.mean(high * ratio))
    # d log norm / d x is high / (size mean peak); d x / d phase is the real part of i amplitude exp(i (phase + w t)).
    weights = scipy.fft.rfft(high)[lines] / (size * mean * peak)
    gradient = -np.imag(amplitudes * np.exp(1j * phases) * np.conj(weights))
    return float(np.log(peak) + np.log(mean) / norm), np.asarray(gradient, dtype=np.float64)
