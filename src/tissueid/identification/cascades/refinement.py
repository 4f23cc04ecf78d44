"""Least squares over all blocks of a cascade: Levenberg-Marquardt on the error of the free run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.identification.base import Array
from tissueid.identification.cascades.blocks import Blocks, CascadeData, Signals, run, slopes
from tissueid.identification.levenberg_marquardt import minimise
from tissueid.identification.static_nonlinearity import StaticNonlinearity

_ROUNDS = 3

_EXCEEDED, _UNDERFILLED = 0.02, 0.7
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


def refine(blocks: Blocks, data: CascadeData, iterations: int = 40, tolerance: float = 1e-6) -> Fitted:
    """Minimise the simulation error over all blocks. The result is never worse than the start.

    ``tolerance`` is the relative decrease of the squared error below which the iteration ends. The damping is scaled by
    the sensitivities, so that it does not depend on the division of gains between blocks.
    """
    problem = _SimulationError(data)
    best = Fitted(blocks, squared_error(blocks, data))
    for _ in range(_ROUNDS):
        before = best.rss
        start = problem.point(_with_refitted_outer_curve(best, data).blocks)
        found = minimise(problem, start, most_steps=iterations, tolerance=tolerance, idle_steps=2).point
        tried = Fitted(found.blocks, found.cost)
        if tried.rss < best.rss:
            best = tried
        if before - best.rss <= 10.0 * tolerance * before or _fits_range(best.blocks, data):
            break
    return best


@dataclass(frozen=True, eq=False)
class _Point:
    """Blocks with the signals between them, the errors of the fitted rows (m,) and their sum of squares."""

    blocks: Blocks
    signals: Signals
    error: Array
    cost: float

    @property
    def theta(self) -> Array:
        return self.blocks.vector


class _SimulationError:
    """The squared error of a cascade by all its parameters."""

    def __init__(self, data: CascadeData) -> None:
        self._data = data

    def point(self, blocks: Blocks) -> _Point:
        """Return blocks with their signals and their squared error."""
        signals = run(blocks, self._data)
        error = self._data.measured - signals.output[self._data.rows]
        return _Point(blocks, signals, error, float(error @ error))

    def linearised(self, at: _Point) -> tuple[Array, Array]:
        by_all = slopes(at.blocks, self._data, at.signals)  # (p, rows)
        return by_all @ by_all.T, by_all @ at.error

    def attempt(self, at: _Point, step: Array) -> _Point:
        return self.point(at.blocks.with_vector(at.theta + step))

    def refresh(self, _at: _Point) -> bool:
        return False


def _fits_range(blocks: Blocks, data: CascadeData) -> bool:
    if blocks.outer is None:
        return True
    inside = run(blocks, data).inside[data.rows]
    width = blocks.outer.high - blocks.outer.low
    return bool(
        inside.min() >= blocks.outer.low - _EXCEEDED * width
        and inside.max() <= blocks.outer.high + _EXCEEDED * width
        and np.ptp(inside) >= _UNDERFILLED * width
    )


def _with_refitted_outer_curve(fitted: Fitted, data: CascadeData) -> Fitted:
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
