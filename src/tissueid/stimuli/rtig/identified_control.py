"""Offset of the RTIG input with identification: sweeps through the identified static force (Chen 2010, 6.3.2).

The static force gives the offset for each depth. The feedback of Eq. 6.9 corrects the rest: creep, hand motion, a wrong
surface position. Its gain follows the local stiffness.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from tissueid.stimuli.base import Array
from tissueid.stimuli.feedback import BLOCK
from tissueid.stimuli.rtig.histogram import DepthHistogram
from tissueid.stimuli.rtig.local_identification import LocalIdentification
from tissueid.stimuli.rtig.static_map import StaticMap

_MIN_MISSING_SHARE = 0.2
"""Minimum share of the mean missing samples per bin for which a sweep extends to a bin at the end of the range."""

_MIN_DWELL, _MAX_DWELL = 0.35, 2.5
"""Shortest and longest dwell time in a bin, relative to an even sweep: limits the speed and avoids plateaus."""

_CROSSING_DWELL = 0.2
"""Time to cross a bin with a desired share of zero, relative to an even sweep of a uniform distribution."""

_MAX_REVERSALS = 8
"""Maximum number of turns in one block; ends the loop when the range is almost empty."""


class TargetSweep:
    """Generator of target depths. ``edges`` (bins + 1,), m; ``traverse``: samples in one even sweep."""

    def __init__(self, edges: Array, shares: Array, traverse: float) -> None:
        self._edges = edges
        self._shares = shares
        self._traverse = traverse
        self.place = float(edges[0])
        self.rising = True

    def advance(self, want: Array, remaining: int, limits: tuple[float, float], n: int) -> Array:
        """Return the next n target depths (n,), m.

        Args:
            want: samples missing in each bin, (bins,), before this block.
            remaining: samples until the end of the test.
            limits: lowest and highest target depth, m.
            n: number of samples.
        """
        path = np.empty(n)
        done = 0
        asked = np.flatnonzero(want >= _MIN_MISSING_SHARE * want.sum() / want.size)
        low, high = limits
        if asked.size:
            low = max(low, float(self._edges[asked[0]]))
            high = max(low, min(high, float(self._edges[asked[-1] + 1])))
        self.place = float(np.clip(self.place, low, high))
        for _ in range(_MAX_REVERSALS):
            times, depths = self._plan_sweep(want, remaining - done, low, high)
            ask = np.arange(1, n - done + 1, dtype=np.float64)
            inside = ask <= times[-1]
            count = int(np.count_nonzero(inside))
            path[done : done + count] = np.interp(ask[:count], times, depths)
            done += count
            if done == n:
                self.place = float(path[-1])
                return path
            self.place = float(depths[-1])
            self.rising = not self.rising
        path[done:] = self.place
        return path

    def _plan_sweep(self, want: Array, remaining: int, low: float, high: float) -> tuple[Array, Array]:
        """Return the rest of the current sweep: times in samples from now, and depths, m."""
        edges = self._edges
        if self.rising:
            depths = np.concatenate([[self.place], edges[(edges > self.place) & (edges < high)], [high]])
        else:
            depths = np.concatenate([[self.place], edges[(edges < self.place) & (edges > low)][::-1], [low]])
        middles = 0.5 * (depths[1:] + depths[:-1])
        widths = np.abs(np.diff(depths)) / (edges[1] - edges[0])
        bins = np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, want.size - 1)
        even = self._traverse * self._shares
        ahead = float(np.sum(widths * even[bins]))
        after = max(0.0, np.round((remaining - ahead) / self._traverse))
        usual = np.maximum(even, _CROSSING_DWELL * self._traverse / want.size)
        dwell = np.clip(want / (after + 1.0), _MIN_DWELL * usual, _MAX_DWELL * usual)
        return np.concatenate([[0.0], np.cumsum(widths * dwell[bins])]), depths


LEVELS = 6
"""Depth levels of the scatter statistics."""
_ITERATIONS = 12
"""Iterations of the multiplicative update in :meth:`Scatter.targets`."""
_WEIGHT = 100.0
"""Weight of the initial scatter estimate, samples."""


class Scatter:
    """Mean and standard deviation of depth minus target, by level of the target; ``edges`` (bins + 1,), m."""

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
        """Update from targets (n,), m, and deviations of the depth from them (n,), m; no NaN."""
        level = np.searchsorted(self._bounds, target)
        new = np.stack([np.bincount(level, weight, LEVELS) for weight in (np.ones(away.size), away, away**2)])
        self._sums = self._keep ** new[0] * self._sums + new

    @property
    def bias(self) -> Array:
        """Mean deviation by level, m, (LEVELS,)."""
        return np.asarray(self._sums[1] / self._sums[0])

    @property
    def spread(self) -> Array:
        """Standard deviation of the deviation by level, m, (LEVELS,)."""
        return np.asarray(np.sqrt(np.maximum(self._sums[2] / self._sums[0] - self.bias**2, 0.0)))

    def targets(self, want: Array, remaining: int) -> Array:
        """Return the time at targets in each bin, (bins,), in samples that sum to ``remaining``.

        Richardson-Lucy deconvolution of ``want`` (bins,), the samples missing by depth, with the scatter; negative
        entries count as zero.
        """
        wanted = np.maximum(want, 0.0)
        wanted *= remaining / max(float(wanted.sum()), 1e-9)
        spread = np.maximum(np.interp(self._centres, self._middles, self.spread), self._least)
        mean = self._centres + np.interp(self._centres, self._middles, self.bias)
        below = special.ndtr((self._edges - mean[:, None]) / spread[:, None])  # (targets, edges)
        below[:, 0], below[:, -1] = 0.0, 1.0  # samples outside the range count for the outermost bins
        chance = np.diff(below, axis=1)
        time = np.full(wanted.size, remaining / wanted.size)
        for _ in range(_ITERATIONS):
            time *= chance @ (wanted / np.maximum(time @ chance, 1e-9 * remaining))
        return np.asarray(time * (remaining / max(float(time.sum()), 1e-9)))


_CORRECTION = 0.1
"""Share of the mean deviation that a block corrects; twice this value oscillates with a delay of four blocks."""

_FADE = 0.97
"""Decay of the correction from block to block."""
_MAX_CORRECTION = 0.25
"""Maximum correction, relative to the depth range."""

_STIFFNESS_LIMITS = (0.5, 2.0)
"""Accepted local stiffness, relative to the local slope of the static force."""

_SCATTER_S = 2.0
"""Time constant of the scatter statistics, s."""
_MIN_STOCHASTIC = 0.25
"""Minimum share of the stochastic part."""
_MAX_SCATTER = 0.06
"""Standard deviation of the depth, relative to its range, above which the stochastic part is attenuated."""


class IdentifiedController:
    """Controller of the offsets and of the amplitude of the stochastic part, block by block.

    ``density`` is the two-sided power density of the full stochastic part, N^2 s.
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
        self._last_share = 1.0
        self._span = float(histogram.edges[-1] - histogram.edges[0])
        self._scatter = Scatter(histogram.edges, 1.0 / (_SCATTER_S * sample_rate))
        self._targets = np.full(histogram.samples + BLOCK, np.nan)
        self._correction = 0.0
        self._begun = False
        self.reachable = (float(histogram.edges[0]), float(histogram.edges[-1]))

    def learn(self, depth: Array, first: int) -> None:
        """Process depths (n,), m, NaN where a sample was lost, from sample index ``first`` of the test on."""
        target = self._targets[first : first + depth.size]
        depth = depth[: target.size]
        known = np.isfinite(target) & np.isfinite(depth)
        if not known.any():
            return
        away = depth[known] - target[known]
        self._scatter.learn(target[known], away)
        share = _CORRECTION * away.size / BLOCK
        most = _MAX_CORRECTION * self._span
        self._correction = float(np.clip(_FADE * self._correction - share * away.mean(), -most, most))

    def offset(self, made: int, depth: float) -> tuple[Array, Array]:
        """Return the next offsets, N, (BLOCK,), and the share of the stochastic part to add, (BLOCK,).

        ``made`` is the number of samples generated before; ``depth``, m, is the starting depth when there was no
        target.
        """
        histogram, edges, static = self._histogram, self._histogram.edges, self._static
        if not self._begun:
            self._sweep.place = float(np.clip(depth, edges[0], edges[-1]))
            self._begun = True
        ahead = self._targets[histogram.seen : made]
        low = max(float(edges[0]), min(static.depth(self._force[0]), float(edges[-1])))
        self.reachable = (low, max(low, min(float(edges[-1]), static.depth(self._force[1]))))
        remaining = max(BLOCK, histogram.samples - made)
        want = histogram.missing_samples(ahead[np.isfinite(ahead)], remaining, self.reachable)
        before = self._sweep.place
        path = self._sweep.advance(self._scatter.targets(want, remaining), remaining, self.reachable, BLOCK)
        self._targets[made : made + BLOCK] = path[: max(0, self._targets.size - made)]
        speed = np.diff(path, prepend=before) * self._rate
        offset = static.force(path) + static.damping(path) * speed + self._gain(float(path.mean())) * self._correction
        return offset, self._stochastic_share(float(path.mean()))

    def reset(self) -> None:
        """Reset the path and the correction while another controller generates the blocks."""
        self._begun = False
        self._correction = 0.0

    def _gain(self, depth: float) -> float:
        """Return the stiffness at a depth, N/m: the identified one, limited to ``_STIFFNESS_LIMITS`` times the static
        slope.
        """
        slope = float(self._static.slope(np.array([depth]))[0])
        system = self._local.at(depth)
        return (
            slope
            if system is None
            else float(np.clip(system.stiffness, _STIFFNESS_LIMITS[0] * slope, _STIFFNESS_LIMITS[1] * slope))
        )

    def _stochastic_share(self, depth: float) -> Array:
        """Return the share of the stochastic part, (BLOCK,): reduced where it would scatter the depth too much.

        A force of two-sided power density S gives the depth of a second-order system the variance S / (2 B K).
        """
        system = self._local.at(depth)
        goal = 1.0
        if system is not None and self._density > 0.0:
            scatter = float(np.sqrt(self._density / (2.0 * system.damping * system.stiffness)))
            goal = float(np.clip(_MAX_SCATTER * self._span / scatter, _MIN_STOCHASTIC, 1.0))
        before, self._last_share = self._last_share, goal
        return before + (goal - before) * np.arange(1, BLOCK + 1) / BLOCK
