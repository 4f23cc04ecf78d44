"""Where the depth should be next: sweeps through the range that stay where samples are wanted (Chen 2010, 6.3.1).

The thesis goes for the emptiest bin at every cycle. With a known static force the way there can be planned: the range
is swept from end to end, and the time spent in each bin is its want, divided by the sweeps that are left to fill it.
So the last sweep ends with the test, and the histogram ends flat.
"""

from __future__ import annotations

import numpy as np

from tissueid.stimuli.base import Array

_WORTH = 0.2
"""Want, in that of an even histogram, for which the sweep goes on as far as a bin at its end."""

_FASTEST, _SLOWEST = 0.35, 2.5
"""Least and most time in a bin, in that of an even sweep: neither throws nor plateaus."""

_CROSSING = 0.2
"""Time for a bin where nothing is desired, in that of an even sweep of a uniform distribution."""

_MOST_TURNS = 8
"""In one block, so that a range of next to nothing ends."""


class Sweep:
    """A target depth that moves by itself; ``edges`` (bins + 1,), m; ``traverse`` is the length of an even sweep."""

    def __init__(self, edges: Array, shares: Array, traverse: float) -> None:
        self._edges = edges
        self._shares = shares
        self._traverse = traverse
        self.place = float(edges[0])
        self.rising = True

    def advance(self, want: Array, remaining: int, limits: tuple[float, float], n: int) -> Array:
        """Move on by n samples: target depths (n,), m.

        Args:
            want: samples wanted in each bin, (bins,), before those that are made now.
            remaining: samples until the end of the test.
            limits: depths between which to stay, m.
            n: how many samples are made.
        """
        path = np.empty(n)
        done = 0
        asked = np.flatnonzero(want >= _WORTH * want.sum() / want.size)
        low, high = limits
        if asked.size:
            low = max(low, float(self._edges[asked[0]]))
            high = max(low, min(high, float(self._edges[asked[-1] + 1])))
        self.place = float(np.clip(self.place, low, high))
        for _ in range(_MOST_TURNS):
            times, depths = self._way(want, remaining - done, low, high)
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

    def _way(self, want: Array, remaining: int, low: float, high: float) -> tuple[Array, Array]:
        """The rest of the present sweep: times, samples from now, and the depths that they reach."""
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
        usual = np.maximum(even, _CROSSING * self._traverse / want.size)
        dwell = np.clip(want / (after + 1.0), _FASTEST * usual, _SLOWEST * usual)
        return np.concatenate([[0.0], np.cumsum(widths * dwell[bins])]), depths
