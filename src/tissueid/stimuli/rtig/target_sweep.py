"""Target depth of RTIG: sweeps through the range that dwell where the histogram lacks samples (Chen 2010, 6.3.1).

The thesis selects the emptiest bin at every cycle. With an estimated static force the path can be planned: the range
is swept from end to end, and the dwell time in a bin is its missing samples divided by the number of sweeps left. The
last sweep ends with the test, with a flat histogram.
"""

from __future__ import annotations

import numpy as np

from tissueid.stimuli.base import Array

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
