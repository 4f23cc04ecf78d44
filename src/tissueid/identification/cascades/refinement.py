"""Least squares over all blocks of a cascade: Levenberg-Marquardt on the error of the free run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from tissueid.identification.cascades.blocks import Blocks, CascadeData, run, slopes
from tissueid.identification.static_nonlinearity import StaticNonlinearity

_ROUNDS = 3
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-10, 1e5
_UNFELT = 1e-12
"""Relative sensitivity below which a parameter is not changed."""

_LEFT, _HOLLOW = 0.02, 0.7
"""The outer curve is refitted when z exceeds its range by the first share of it, or fills less than the second."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """Blocks with the sum of squared errors over the fitted rows."""

    blocks: Blocks
    rss: float


def squared_error(blocks: Blocks, data: CascadeData) -> float:
    """Return the sum of squared errors of the free run over the fitted rows."""
    error = data.measured - run(blocks, data).output[data.rows]
    return float(error @ error)


def refine(blocks: Blocks, data: CascadeData, iterations: int = 40, settled: float = 1e-6) -> Fitted:
    """Minimise the simulation error over all blocks. The result is never worse than the start.

    ``settled`` is the relative decrease of the squared error below which the iteration ends. The damping is scaled by
    the sensitivities, so that it does not depend on the division of gains between blocks.
    """
    best = Fitted(blocks, squared_error(blocks, data))
    for _ in range(_ROUNDS):
        before = best.rss
        tried = _descend(_laid_anew(best, data), data, iterations, settled)
        if tried.rss < best.rss:
            best = tried
        if before - best.rss <= 10.0 * settled * before or _fits_range(best.blocks, data):
            break
    return best


def _descend(fitted: Fitted, data: CascadeData, iterations: int, settled: float) -> Fitted:
    blocks, rss = fitted.blocks, fitted.rss
    signals = run(blocks, data)
    damping = _FIRST_DAMPING
    idle = 0
    for _ in range(iterations):
        by_all = slopes(blocks, data, signals)  # (p, rows)
        error = data.measured - signals.output[data.rows]
        gram = by_all @ by_all.T
        right = by_all @ error
        size = np.sqrt(np.diag(gram))
        felt = size > _UNFELT * float(np.max(size))
        gram = gram[np.ix_(felt, felt)] / np.outer(size[felt], size[felt])
        right = right[felt] / size[felt]
        gained = 0.0
        while damping <= _MOST_DAMPING:
            step = np.zeros(size.size)
            step[felt] = linalg.solve(gram + damping * np.eye(right.size), right, assume_a="pos") / size[felt]
            tried = blocks.with_vector(blocks.vector + step)
            passing = run(tried, data)
            left = data.measured - passing.output[data.rows]
            tried_rss = float(left @ left)
            if tried_rss < rss:
                gained, blocks, rss, signals = rss - tried_rss, tried, tried_rss, passing
                damping = max(_LEAST_DAMPING, damping / 5.0)
                break
            damping *= 4.0
        if gained == 0.0:
            break
        idle = idle + 1 if gained <= settled * rss else 0
        if idle == 2:
            break
    return Fitted(blocks, rss)


def _fits_range(blocks: Blocks, data: CascadeData) -> bool:
    if blocks.outer is None:
        return True
    inside = run(blocks, data).inside[data.rows]
    width = blocks.outer.high - blocks.outer.low
    return bool(
        inside.min() >= blocks.outer.low - _LEFT * width
        and inside.max() <= blocks.outer.high + _LEFT * width
        and np.ptp(inside) >= _HOLLOW * width
    )


def _laid_anew(fitted: Fitted, data: CascadeData) -> Fitted:
    """Return the system with its outer curve refitted over the present range of its argument."""
    outer = fitted.blocks.outer
    if outer is None or _fits_range(fitted.blocks, data):
        return fitted
    inside = run(fitted.blocks, data).inside[data.rows]
    target = outer(inside) if fitted.blocks.second is not None else data.measured
    blocks = with_outer(fitted.blocks, outer.refit(inside, target))
    return Fitted(blocks, squared_error(blocks, data))


def with_outer(blocks: Blocks, outer: StaticNonlinearity) -> Blocks:
    """Return the blocks with another outer curve. If no block follows it, its value at rest becomes the offset."""
    offset = blocks.offset if blocks.second is not None else float(outer(np.zeros(1))[0])
    return replace(blocks, outer=outer, offset=offset)
