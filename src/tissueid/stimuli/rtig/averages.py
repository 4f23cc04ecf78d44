"""What was measured, as it comes: put in order, averaged down, and differentiated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.stimuli.base import Array

_ENOUGH = 0.6
"""Share of the samples of an average that must have been received."""


@dataclass(frozen=True)
class States:
    """Averages over ``every`` samples: force, N, depth, m, and its derivatives by time; each (n,), NaN where unknown.

    Speed and acceleration are central differences, so a state is that of the average before the newest.
    """

    force: Array
    depth: Array
    speed: Array
    acceleration: Array


class Averages:
    """Samples in, averages of ``every`` samples out, whatever the samples are cut into."""

    def __init__(self, every: int, sample_rate: float) -> None:
        self._every = every
        self._step = every / sample_rate
        self._left = np.empty((2, 0))
        self._last = np.full((2, 2), np.nan)

    def take(self, force: Array, depth: Array) -> States:
        """Take force (k,), N, and depth (k,), m, both NaN where a sample was lost."""
        signals = np.concatenate([self._left, [force, depth]], axis=1)
        whole = signals.shape[1] // self._every
        cut = whole * self._every
        self._left = signals[:, cut:]
        parts = signals[:, :cut].reshape(2, whole, self._every)
        received = np.isfinite(parts[0])
        enough = received.sum(axis=1) >= _ENOUGH * self._every
        share = received / np.maximum(received.sum(axis=1, keepdims=True), 1)
        averages = np.where(enough, (np.where(received, parts, 0.0) * share).sum(axis=2), np.nan)
        course = np.concatenate([self._last, averages], axis=1)  # (2, 2 + whole)
        self._last = course[:, -2:]
        depth = course[1]
        return States(
            force=course[0, 1:-1],
            depth=depth[1:-1],
            speed=(depth[2:] - depth[:-2]) / (2.0 * self._step),
            acceleration=(depth[2:] - 2.0 * depth[1:-1] + depth[:-2]) / self._step**2,
        )
