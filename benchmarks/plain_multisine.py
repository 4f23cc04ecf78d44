"""Low crest factors after Guillaume et al. (1991): Levenberg-Marquardt on the L2p norms, in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_NORMS = (2, 4, 8, 16, 32, 64, 128, 256)
"""p of L2p."""

_STEPS = 50
_SMALL = 1e-4
"""Relative decrease of the norm below which the search for one p ends."""


def low_crest(lines: NDArray[np.int_], amplitudes: Array, phases: Array, size: int) -> Array:
    """Minimise the peak over the phases (lines,), on a grid of ``size`` points, from given phases."""
    turns = np.outer(2.0 * np.pi * np.arange(size) / size, lines)  # (size, lines)
    for p in _NORMS:
        phases = _least(turns, amplitudes, phases, p)
    return phases


def _least(turns: Array, amplitudes: Array, phases: Array, p: int) -> Array:
    """Minimise the sum of squares of x^p: residuals x^p, Jacobian p x^(p - 1) dx / dphase, x relative to its peak."""
    x = np.cos(turns + phases) @ amplitudes
    scale = np.max(np.abs(x))
    cost = np.sum((x / scale) ** (2 * p))
    damping = 1e-3
    for _ in range(_STEPS):
        slope = -np.sin(turns + phases) * (amplitudes / scale)  # (size, lines)
        jacobian = (p * (x / scale) ** (p - 1))[:, None] * slope
        gram = jacobian.T @ jacobian
        gradient = jacobian.T @ (x / scale) ** p
        before = cost
        while True:
            damped = gram + damping * np.diag(np.diag(gram) + 1e-12 * np.trace(gram))
            tried = phases - np.linalg.solve(damped, gradient)
            x_tried = np.cos(turns + tried) @ amplitudes
            cost_tried = np.sum((np.abs(x_tried) / scale) ** (2 * p))
            if cost_tried < cost:
                phases, x, cost, damping = tried, x_tried, cost_tried, max(damping / 10.0, 1e-12)
                break
            damping *= 10.0
            if damping > 1e12:
                return phases
        if before - cost < _SMALL * before:
            return phases
        new = np.max(np.abs(x))
        cost, scale = cost * (scale / new) ** (2 * p), new
    return phases
