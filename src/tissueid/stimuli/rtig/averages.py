"""Decimation and differentiation of measured samples as they arrive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.stimuli.base import Array

_MIN_RECEIVED_SHARE = 0.6
"""Minimum share of received samples in an average."""


@dataclass(frozen=True)
class States:
    """Averages over ``every`` samples: force, N, depth, m, and its time derivatives; each (n,), NaN where unknown.

    Speed and acceleration are central differences, so a state lags the newest average by one.
    """

    force: Array
    depth: Array
    speed: Array
    acceleration: Array


class Averages:
    """Average samples in groups of ``every``, independently of how the input is split into calls."""

    def __init__(self, every: int, sample_rate: float) -> None:
        self._every = every
        self._step = every / sample_rate
        self._left = np.empty((2, 0))
        self._last = np.full((2, 2), np.nan)

    def take(self, force: Array, depth: Array) -> States:
        """Process force (k,), N, and depth (k,), m, NaN where a sample was lost; return the new states."""
        signals = np.concatenate([self._left, [force, depth]], axis=1)
        whole = signals.shape[1] // self._every
        cut = whole * self._every
        self._left = signals[:, cut:]
        parts = signals[:, :cut].reshape(2, whole, self._every)
        received = np.isfinite(parts[0])
        enough = received.sum(axis=1) >= _MIN_RECEIVED_SHARE * self._every
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
