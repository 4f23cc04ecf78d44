"""The offset of the input from the histogram alone, without knowing the tissue (Chen 2010, 6.3.1).

Once a block: go for the bin that lacks most samples, by a share of the way, and less of it near the edges. The thesis
measures and acts at once; here a block is made ``lead`` blocks ahead of what was measured. What was sent in between is
therefore taken to have moved the depth by its force over the gain, or the loop would push again for a depth that is on
its way already.
"""

from __future__ import annotations

import numpy as np

from tissueid.stimuli.base import Array
from tissueid.stimuli.feedback import BLOCK
from tissueid.stimuli.rtig.histogram import DepthHistogram

_SHARE = 0.3
"""Part of the way to the wanted bin that a block goes, away from the edges."""

_EDGE = 0.15
"""Share of the range at either end over which the edge modulation takes hold."""

_PATIENCE = 6
"""Blocks at the end of the force range after which the depth that it gives is taken for the end of the depths."""


class Plain:
    """Offsets by Eq. 6.9, block by block.

    Args:
        histogram: of the depths so far.
        gain: change of force for a change of depth, N/m.
        edge_modulation: what is left of the gain at the edges of the range, 0 to 1.
        force: range of the force, N.
    """

    def __init__(
        self, histogram: DepthHistogram, gain: float, edge_modulation: float, force: tuple[float, float]
    ) -> None:
        self._histogram = histogram
        self._gain = gain
        self._edge_modulation = edge_modulation
        self._force = force
        self._at_end = 0
        self._reach = [float(histogram.edges[0]), float(histogram.edges[-1])]

    def offset(self, last: float, measured: tuple[float, float], pending: Array) -> Array:
        """The next offsets, N, shape (BLOCK,).

        Args:
            last: offset at the end of the block before, N.
            measured: mean depth of the newest samples, m, and the mean offset that they belong to, N.
            pending: offsets (n,) of the samples that were made and not measured yet, N.
        """
        edges, histogram = self._histogram.edges, self._histogram
        low, high = float(edges[0]), float(edges[-1])
        depth, then = measured
        expected = np.clip(depth + (np.append(pending, last) - then) / self._gain, low, high)
        self._watch_ends(last, depth)
        centres = 0.5 * (edges[1:] + edges[:-1])
        want = histogram.want(expected[:-1], BLOCK, (self._reach[0], self._reach[1]))
        want[(centres < self._reach[0]) | (centres > self._reach[1])] = -np.inf
        here = float(expected[-1])
        # Of bins that lack as much the nearest, so that an even histogram is swept and not jumped about in.
        target = float(centres[np.lexsort((np.abs(centres - here), -want))[0]])
        from_edge = min(here - low, high - here) / (_EDGE * (high - low))
        toward_edge = (target > here) == (here > 0.5 * (low + high))
        modulation = self._edge_modulation + (1.0 - self._edge_modulation) * min(1.0, from_edge)
        change = self._gain * _SHARE * (modulation if toward_edge else 1.0) * (target - here)
        goal = float(np.clip(last + change, *self._force))  # Eq. 6.9
        return last + (goal - last) * np.arange(1, BLOCK + 1) / BLOCK

    def _watch_ends(self, last: float, depth: float) -> None:
        """Give up depths that the range of force does not reach, and take them back when they are reached after all."""
        edges = self._histogram.edges
        ends = (last <= self._force[0], last >= self._force[1])
        self._at_end = self._at_end + 1 if any(ends) else 0
        bin_width = float(edges[1] - edges[0])
        if self._at_end >= _PATIENCE:
            if ends[1]:
                self._reach[1] = max(self._reach[0] + bin_width, min(self._reach[1], depth))
            else:
                self._reach[0] = min(self._reach[1] - bin_width, max(self._reach[0], depth))
        self._reach[1] = max(self._reach[1], min(depth, float(edges[-1])))
        self._reach[0] = min(self._reach[0], max(depth, float(edges[0])))
