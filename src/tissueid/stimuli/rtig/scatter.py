"""How far the depth strays from its target, and which targets make up for it.

The stochastic part of the force scatters the depth about its target, most where the tissue is soft. A sweep up to the
edges would then send half of the samples there out of the range. What is wanted of the depths is therefore taken back
to what is wanted of the targets, by the iteration of Richardson (1972) and Lucy (1974).
"""

from __future__ import annotations

import numpy as np
from scipy import special

from tissueid.stimuli.base import Array

LEVELS = 6
_ITERATIONS = 12
_WEIGHT = 100.0
"""Samples that the first guess of the scatter counts for."""


class Scatter:
    """Mean and spread of the distance from target to depth, by level of the target; ``edges`` (bins + 1,), m."""

    def __init__(self, edges: Array, forget: float) -> None:
        self._edges = edges
        self._centres = 0.5 * (edges[1:] + edges[:-1])
        self._keep = 1.0 - forget
        span = float(edges[-1] - edges[0])
        self._bounds = np.linspace(edges[0], edges[-1], LEVELS + 1)[1:-1]
        self._middles = edges[0] + span * (np.arange(LEVELS) + 0.5) / LEVELS
        self._sums = np.zeros((3, LEVELS))  # samples, distances, squares
        self._sums[0] = _WEIGHT
        self._sums[2] = _WEIGHT * (0.05 * span) ** 2
        self._least = 0.25 * float(edges[1] - edges[0])

    def learn(self, target: Array, away: Array) -> None:
        """Take targets (n,), m, and how far away from them the depths were, (n,), m; no NaN."""
        level = np.searchsorted(self._bounds, target)
        new = np.stack([np.bincount(level, weight, LEVELS) for weight in (np.ones(away.size), away, away**2)])
        self._sums = self._keep ** new[0] * self._sums + new

    @property
    def bias(self) -> Array:
        """Mean distance by level, m, (LEVELS,)."""
        return np.asarray(self._sums[1] / self._sums[0])

    @property
    def spread(self) -> Array:
        """Standard deviation of the distance by level, m, (LEVELS,)."""
        return np.asarray(np.sqrt(np.maximum(self._sums[2] / self._sums[0] - self.bias**2, 0.0)))

    def targets(self, want: Array, remaining: int) -> Array:
        """Time wanted at targets in each bin, (bins,), in samples that add up to ``remaining``.

        ``want`` (bins,) are the samples wanted of depths; what is negative cannot be had.
        """
        wanted = np.maximum(want, 0.0)
        wanted *= remaining / max(float(wanted.sum()), 1e-9)
        spread = np.maximum(np.interp(self._centres, self._middles, self.spread), self._least)
        mean = self._centres + np.interp(self._centres, self._middles, self.bias)
        below = special.ndtr((self._edges - mean[:, None]) / spread[:, None])  # (targets, edges)
        below[:, 0], below[:, -1] = 0.0, 1.0  # what goes beyond counts for the outermost bins
        chance = np.diff(below, axis=1)
        time = np.full(wanted.size, remaining / wanted.size)
        for _ in range(_ITERATIONS):
            time *= chance @ (wanted / np.maximum(time @ chance, 1e-9 * remaining))
        return np.asarray(time * (remaining / max(float(time.sum()), 1e-9)))
