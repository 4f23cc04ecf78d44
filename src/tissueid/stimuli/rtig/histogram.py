"""Where the output was, and where it should have been: the counts that the input is steered by (Chen 2010, 6.3.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.stimuli.base import Array

_BACK, _LEAST_BACK = 0.5, 0.1
"""A sweep has turned when the depth has come back by that share of what was covered so far, or of the range."""


class DepthHistogram:
    """Depths sorted into evenly spaced bins, and the desired share of each bin.

    ``edges`` (bins + 1,) are depths, m; ``shares`` (bins,) sum to one. ``counts`` (bins,) are the samples so far,
    ``below`` and ``above`` those outside the range, ``lost`` those that were not received. All depths of the test, at
    most ``samples``, are kept for an exact distance.
    """

    def __init__(self, edges: Array, shares: Array, samples: int) -> None:
        self.edges = edges
        self.shares = shares
        self.samples = samples
        self.counts: NDArray[np.int64] = np.zeros(shares.size, dtype=np.int64)
        self.below = self.above = self.lost = 0
        self.seen = 0
        """Samples that were received or lost so far: the number of the next one."""
        self.covered: int | None = None
        """Samples it took until every bin held one; None while there are empty ones."""
        self.half_cycles = 0
        self._span = (np.inf, -np.inf)
        self._rising: bool | None = None
        self._turn = 0.0
        self._depths = np.empty(samples)
        self._held = 0
        self._width = float(edges[1] - edges[0])

    def add(self, depth: Array) -> None:
        """Count depths (n,), m, NaN where one was lost; what is beyond the length of the test is left out."""
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
        self.counts += self.sorted_in(received)
        if self.covered is None and self.counts.all():
            self.covered = self.seen
        self._count_cycles(float(received.mean()))

    def sorted_in(self, depth: Array) -> NDArray[np.int64]:
        """How many of depths (n,), m, fall into each bin, (bins,)."""
        inside = depth[(depth >= self.edges[0]) & (depth <= self.edges[-1])]
        place = np.minimum(((inside - self.edges[0]) / self._width).astype(np.int64), self.counts.size - 1)
        return np.bincount(place, minlength=self.counts.size)

    def want(self, ahead: Array, remaining: int, between: tuple[float, float]) -> Array:
        """Samples wanted in each bin, (bins,), of the ``remaining`` ones; negative where there are too many already.

        Args:
            ahead: depths (n,), m, of the samples that were made and not measured yet, as far as they are known.
            remaining: samples that are still to be made. Without too many anywhere this is what all wants add up to.
            between: depths, m, beyond which nothing is wanted, because it cannot be had.

        What was beyond counts for the outermost bins: to make up for it there would send still more of it beyond.
        """
        low, high = between
        centres = 0.5 * (self.edges[1:] + self.edges[:-1])
        within = (centres >= low) & (centres <= high) & (self.shares > 0.0)
        if not within.any():
            within = np.abs(centres - np.clip(0.5 * (low + high), centres[0], centres[-1])) <= 0.51 * self._width
        there = self.counts + self.sorted_in(ahead)
        first, last = np.flatnonzero(within)[[0, -1]]
        there[first] += self.below + int(there[:first].sum())
        there[last] += self.above + int(there[last + 1 :].sum())
        shares = np.where(within, np.maximum(self.shares, 1e-12), 0.0)
        total = float(there[within].sum()) + remaining
        return np.where(within, shares / shares.sum() * total - there, 0.0)

    @property
    def distance(self) -> float | None:
        """Kolmogorov distance of all depths so far from the desired distribution; None while there are none."""
        return self.distance_between(float(self.edges[0]), float(self.edges[-1]))

    def distance_between(self, low: float, high: float) -> float | None:
        """Kolmogorov distance of all depths so far from what is desired between two depths, m; None without any."""
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
        """Depths, m, between which the middle 98 % of the samples lay; None while there are none."""
        if self._held == 0:
            return None
        low, high = np.quantile(self._depths[: self._held], [0.01, 0.99])
        return float(low), float(high)

    def _count_cycles(self, depth: float) -> None:
        """Count a half when the mean depth of a block has come back by half of what was covered so far."""
        low, high = self._span = min(self._span[0], depth), max(self._span[1], depth)
        back = max(_BACK * (high - low), _LEAST_BACK * float(self.edges[-1] - self.edges[0]))
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
