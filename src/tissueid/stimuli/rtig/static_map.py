"""Histogram of the measured depth and its desired shape, which control the input (Chen 2010, 6.3.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.stimuli.base import Array

_REVERSAL_SHARE, _MIN_REVERSAL_SHARE = 0.5, 0.1
"""A sweep has reversed when the depth returns by the larger of these shares: of the covered span, of the range."""


class DepthHistogram:
    """Histogram of depths over evenly spaced bins, with the desired share of each bin.

    ``edges`` (bins + 1,) are depths, m; ``shares`` (bins,) sum to one. ``counts`` (bins,) are the samples so far,
    ``below`` and ``above`` those outside the range, ``lost`` those not received. All depths of the test, at most
    ``samples``, are kept for an exact distance.
    """

    def __init__(self, edges: Array, shares: Array, samples: int) -> None:
        self.edges = edges
        self.shares = shares
        self.samples = samples
        self.counts: NDArray[np.int64] = np.zeros(shares.size, dtype=np.int64)
        self.below = self.above = self.lost = 0
        self.seen = 0
        """Samples received or lost so far: index of the next one."""
        self.full_coverage_at: int | None = None
        """Number of samples until every bin held one; None while a bin is empty."""
        self.half_cycles = 0
        self._span = (np.inf, -np.inf)
        self._rising: bool | None = None
        self._turn = 0.0
        self._depths = np.empty(samples)
        self._held = 0
        self._width = float(edges[1] - edges[0])

    def add(self, depth: Array) -> None:
        """Count depths (n,), m, NaN where a sample was lost; samples beyond the length of the test are ignored."""
        depth = depth[: self.samples - self.seen]
        self.seen += depth.size
        received = depth[np.isfinite(depth)]
        self.lost += depth.size - received.size
        if received.size == 0:
            return
        self._depths[self._held : self._held + received.size] = received
        self._held += received.size
        self.below += int(np.count_nonzero(received < self.edges[0]))
        self.above += int(np.count_nonzero(received > self.edges[-1]))
        self.counts += self.bin_counts(received)
        if self.full_coverage_at is None and self.counts.all():
            self.full_coverage_at = self.seen
        self._count_cycles(float(received.mean()))

    def bin_counts(self, depth: Array) -> NDArray[np.int64]:
        """Return the number of depths (n,), m, in each bin, (bins,)."""
        inside = depth[(depth >= self.edges[0]) & (depth <= self.edges[-1])]
        index = np.minimum(((inside - self.edges[0]) / self._width).astype(np.int64), self.counts.size - 1)
        return np.bincount(index, minlength=self.counts.size)

    def missing_samples(self, ahead: Array, remaining: int, between: tuple[float, float]) -> Array:
        """Return the samples missing in each bin, (bins,), to reach the desired shares; negative where there are too
        many.

        Samples outside the range count for the outermost bins; compensating for them there would send more samples
        outside.

        Args:
            ahead: expected depths (n,), m, of samples that were generated and not yet measured.
            remaining: samples still to be generated; equal to the sum of the result when no bin has too many.
            between: lowest and highest reachable depth, m; nothing is requested beyond.
        """
        low, high = between
        centres = 0.5 * (self.edges[1:] + self.edges[:-1])
        within = (centres >= low) & (centres <= high) & (self.shares > 0.0)
        if not within.any():
            within = np.abs(centres - np.clip(0.5 * (low + high), centres[0], centres[-1])) <= 0.51 * self._width
        there = self.counts + self.bin_counts(ahead)
        first, last = np.flatnonzero(within)[[0, -1]]
        there[first] += self.below + int(there[:first].sum())
        there[last] += self.above + int(there[last + 1 :].sum())
        shares = np.where(within, np.maximum(self.shares, 1e-12), 0.0)
        total = float(there[within].sum()) + remaining
        return np.where(within, shares / shares.sum() * total - there, 0.0)

    @property
    def distance(self) -> float | None:
        """Kolmogorov distance of all depths so far from the desired distribution; None without depths."""
        return self.distance_between(float(self.edges[0]), float(self.edges[-1]))

    def distance_between(self, low: float, high: float) -> float | None:
        """Return the Kolmogorov distance of all depths so far from the desired distribution between two depths, m.

        None without depths, or where nothing is desired between the two.
        """
        n = self._held
        cumulative = np.concatenate([[0.0], np.cumsum(self.shares)])
        ends = np.interp([low, high], self.edges, cumulative)
        if n == 0 or ends[1] <= ends[0]:
            return None
        depths = np.sort(self._depths[:n])
        desired = (np.interp(np.clip(depths, low, high), self.edges, cumulative) - ends[0]) / (ends[1] - ends[0])
        steps = np.arange(n + 1) / n
        return float(max(np.max(steps[1:] - desired), np.max(desired - steps[:-1])))

    @property
    def reached(self) -> tuple[float, float] | None:
        """Depths, m, that bound the middle 98 % of the samples; None without samples."""
        if self._held == 0:
            return None
        low, high = np.quantile(self._depths[: self._held], [0.01, 0.99])
        return float(low), float(high)

    def _count_cycles(self, depth: float) -> None:
        """Count a half cycle when the mean depth of a block has reversed; see ``_REVERSAL_SHARE``."""
        low, high = self._span = min(self._span[0], depth), max(self._span[1], depth)
        back = max(_REVERSAL_SHARE * (high - low), _MIN_REVERSAL_SHARE * float(self.edges[-1] - self.edges[0]))
        if self._rising is None:
            if high - low > back:
                self._rising, self._turn = depth == high, depth
            return
        forward = 1.0 if self._rising else -1.0
        if forward * (depth - self._turn) > 0.0:
            self._turn = depth
        elif forward * (self._turn - depth) > back:
            self.half_cycles += 1
            self._rising, self._turn = not self._rising, depth


KNOTS = 20
"""Knots of F."""
_DAMPING_KNOTS = 4
"""Knots of B."""
_CURVATURE_WEIGHT = 0.3
"""Weight of a squared second difference of F, in samples."""

_ORIGIN_WEIGHT = 4.0
"""Weight of the prior of zero force at the surface, in samples."""

_OUTSIDE = 1.0
"""Distance beyond the ends, in knot spacings, up to which samples are used."""

_MIN_SLOPE, _MAX_SLOPE = 0.005, 60.0
"""Bounds of the slope of F, relative to force range over depth range."""


class StaticMap:
    """Estimates of F(y), B(y) and M; ``forget`` is the share of the accumulated weight that each sample removes."""

    def __init__(self, depth: tuple[float, float], force: tuple[float, float], slope: float, forget: float) -> None:
        self.knots = np.linspace(min(0.0, depth[0]), depth[1], KNOTS)
        self._step = float(self.knots[1] - self.knots[0])
        self._damping_depths = np.linspace(self.knots[0], self.knots[-1], _DAMPING_KNOTS)
        self._usual_keep = self._keep = 1.0 - forget
        usual = (force[1] - force[0]) / (depth[1] - depth[0])
        self._slopes = (_MIN_SLOPE * usual, _MAX_SLOPE * usual)
        n = KNOTS + _DAMPING_KNOTS + 1
        self._normal = np.zeros((n, n))
        self._right = np.zeros(n)
        bend = np.zeros((KNOTS - 2, n))
        for row in range(KNOTS - 2):
            bend[row, row : row + 3] = 1.0, -2.0, 1.0
        self._prior = _CURVATURE_WEIGHT * bend.T @ bend
        # Weak prior of the initial slope.
        weak = np.zeros((KNOTS - 1, n))
        for row in range(KNOTS - 1):
            weak[row, row : row + 2] = -1.0, 1.0
        self._prior += 1e-3 * weak.T @ weak
        self._prior_right = 1e-3 * weak.T @ np.full(KNOTS - 1, slope * self._step)
        origin = self._rows(np.zeros(1), np.zeros(1), np.zeros(1))[0]
        self._prior += _ORIGIN_WEIGHT * np.outer(origin, origin)
        ridge = np.arange(KNOTS, n)
        self._prior[ridge, ridge] += [*[1e-4] * _DAMPING_KNOTS, 1e-1]
        self._solve()

    def forget(self, rate_factor: float) -> None:
        """Set the forgetting rate to ``rate_factor`` times the usual rate."""
        self._keep = self._usual_keep**rate_factor

    def _rows(self, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Return the regressors (n, knots + damping knots + 1) of states (n,)."""
        n = depth.size
        rows = np.zeros((n, KNOTS + _DAMPING_KNOTS + 1))
        at = np.arange(n)
        position = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(position), 0, KNOTS - 2).astype(np.int64)
        rows[at, k] = 1.0 - (position - k)
        rows[at, k + 1] = position - k
        coarse = np.clip(
            (depth - self._damping_depths[0]) / (self._damping_depths[1] - self._damping_depths[0]),
            0.0,
            _DAMPING_KNOTS - 1.0,
        )
        k = np.minimum(coarse.astype(np.int64), _DAMPING_KNOTS - 2)
        rows[at, KNOTS + k] = (1.0 - (coarse - k)) * speed
        rows[at, KNOTS + k + 1] = (coarse - k) * speed
        rows[:, -1] = acceleration
        return rows

    def learn(self, force: Array, depth: Array, speed: Array, acceleration: Array) -> Array:
        """Update from states (n,) in SI and their measured force (n,), N, without NaN.

        Returns:
            One-step prediction errors of the force, N, (n,), computed before the update.
        """
        reach = _OUTSIDE * self._step
        near = (depth > self.knots[0] - reach) & (depth < self.knots[-1] + reach)
        keep = self._keep**force.size
        every = self._rows(depth, speed, acceleration)
        errors = force - self.force(depth) - every[:, KNOTS:-1] @ self._damping - self.mass * acceleration
        rows = every[near]
        self._normal = keep * self._normal + rows.T @ rows
        self._right = keep * self._right + rows.T @ force[near]
        self._solve()
        return np.asarray(errors)

    def _solve(self) -> None:
        solution = np.linalg.solve(self._normal + self._prior, self._right + self._prior_right)
        slopes = np.clip(np.diff(solution[:KNOTS]) / self._step, *self._slopes)
        # Clip slopes outwards from the best determined knot, so that the measured part does not shift.
        best = int(np.argmax(np.diagonal(self._normal)[:KNOTS]))
        steps = slopes * self._step
        self._force = np.empty(KNOTS)
        self._force[best] = solution[best]
        self._force[best + 1 :] = solution[best] + np.cumsum(steps[best:])
        self._force[:best] = solution[best] - np.cumsum(steps[:best][::-1])[::-1]
        self._damping = np.maximum(solution[KNOTS:-1], 0.0)
        self.mass = max(float(solution[-1]), 0.0)

    def force(self, depth: Array) -> Array:
        """Return F, N, at depths (n,), m; extrapolates linearly."""
        position = (depth - self.knots[0]) / self._step
        k = np.clip(np.floor(position), 0, KNOTS - 2).astype(np.int64)
        return np.asarray(self._force[k] + (position - k) * (self._force[k + 1] - self._force[k]))

    def slope(self, depth: Array) -> Array:
        """Return the slope of F, N/m, at depths (n,), m."""
        k = np.clip(np.floor((depth - self.knots[0]) / self._step), 0, KNOTS - 2).astype(np.int64)
        return np.asarray((self._force[k + 1] - self._force[k]) / self._step)

    def depth(self, force: float) -> float:
        """Return the depth, m, at which F equals a force, N; the nearest end if F does not reach it."""
        return float(np.interp(force, self._force, self.knots))

    def damping(self, depth: Array) -> Array:
        """Return B, N s/m, at depths (n,), m."""
        return np.interp(depth, self._damping_depths, self._damping)
