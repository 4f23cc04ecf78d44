"""The offset of the input with identification: sweeps through the identified static force (Chen 2010, 6.3.2).

The static force says what offset holds each depth, so the feedback of Eq. 6.9 is left with what that does not explain:
creep, a moving hand, a surface that was taken for another. There the gain follows the local stiffness.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from tissueid.stimuli.base import Array
from tissueid.stimuli.feedback import BLOCK
from tissueid.stimuli.rtig.histogram import DepthHistogram
from tissueid.stimuli.rtig.local_identification import LocalIdentification
from tissueid.stimuli.rtig.static_map import StaticMap
from tissueid.stimuli.rtig.target_sweep import TargetSweep

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


_CORRECTION = 0.1
"""Share of the mean distance from the target that a block corrects; four blocks late, twice that would ring."""

_FADE = 0.97
_MOST_CORRECTION = 0.25
"""Of the range of depth."""

_BELIEVED = (0.5, 2.0)
"""Local stiffnesses that are believed, in the slope of the static force there."""

_SCATTER_S = 2.0
_QUIETEST = 0.25
_MOST_SCATTER = 0.06
"""Standard deviation of the depth about its target, in its range, from which the stochastic part is turned down."""


class Scheduled:
    """Offsets and the size of the stochastic part, block by block.

    ``density`` is the power density of the whole stochastic part, two-sided, N^2 s.
    """

    def __init__(
        self,
        histogram: DepthHistogram,
        static: StaticMap,
        local: LocalIdentification,
        sweep: TargetSweep,
        force: tuple[float, float],
        sample_rate: float,
        density: float,
    ) -> None:
        self._histogram = histogram
        self._static = static
        self._local = local
        self._sweep = sweep
        self._force = force
        self._rate = sample_rate
        self._density = density
        self._loud = 1.0
        self._span = float(histogram.edges[-1] - histogram.edges[0])
        self._scatter = Scatter(histogram.edges, 1.0 / (_SCATTER_S * sample_rate))
        self._targets = np.full(histogram.samples + BLOCK, np.nan)
        self._correction = 0.0
        self._begun = False
        self.reachable = (float(histogram.edges[0]), float(histogram.edges[-1]))

    def learn(self, depth: Array, first: int) -> None:
        """Take depths (n,), m, NaN where one was lost, from sample ``first`` of the test on."""
        target = self._targets[first : first + depth.size]
        depth = depth[: target.size]
        known = np.isfinite(target) & np.isfinite(depth)
        if not known.any():
            return
        away = depth[known] - target[known]
        self._scatter.learn(target[known], away)
        share = _CORRECTION * away.size / BLOCK
        most = _MOST_CORRECTION * self._span
        self._correction = float(np.clip(_FADE * self._correction - share * away.mean(), -most, most))

    def offset(self, made: int, depth: float) -> tuple[Array, Array]:
        """The next offsets, N, (BLOCK,), and the share of the stochastic part that goes with them, (BLOCK,).

        ``made`` is how many samples were made before, ``depth`` is where to begin when there was no target, m.
        """
        histogram, edges, static = self._histogram, self._histogram.edges, self._static
        if not self._begun:
            self._sweep.place = float(np.clip(depth, edges[0], edges[-1]))
            self._begun = True
        ahead = self._targets[histogram.seen : made]
        low = max(float(edges[0]), min(static.depth(self._force[0]), float(edges[-1])))
        self.reachable = (low, max(low, min(float(edges[-1]), static.depth(self._force[1]))))
        remaining = max(BLOCK, histogram.samples - made)
        want = histogram.want(ahead[np.isfinite(ahead)], remaining, self.reachable)
        before = self._sweep.place
        path = self._sweep.advance(self._scatter.targets(want, remaining), remaining, self.reachable, BLOCK)
        self._targets[made : made + BLOCK] = path[: max(0, self._targets.size - made)]
        speed = np.diff(path, prepend=before) * self._rate
        offset = static.force(path) + static.damping(path) * speed + self._gain(float(path.mean())) * self._correction
        return offset, self._loudness(float(path.mean()))

    def rest(self) -> None:
        """Another controller makes the blocks: begin afresh when it is asked again."""
        self._begun = False
        self._correction = 0.0

    def _gain(self, depth: float) -> float:
        """Stiffness at a depth, N/m: the identified one as far as the static force bears it out."""
        slope = float(self._static.slope(np.array([depth]))[0])
        system = self._local.at(depth)
        return slope if system is None else float(np.clip(system.stiffness, _BELIEVED[0] * slope, _BELIEVED[1] * slope))

    def _loudness(self, depth: float) -> Array:
        """Share of the stochastic part that is played, (BLOCK,): less where it would throw the depth about.

        Force of a power density S, two-sided, gives a second-order system the variance S / (2 B K).
        """
        system = self._local.at(depth)
        goal = 1.0
        if system is not None and self._density > 0.0:
            scatter = float(np.sqrt(self._density / (2.0 * system.damping * system.stiffness)))
            goal = float(np.clip(_MOST_SCATTER * self._span / scatter, _QUIETEST, 1.0))
        before, self._loud = self._loud, goal
        return before + (goal - before) * np.arange(1, BLOCK + 1) / BLOCK
