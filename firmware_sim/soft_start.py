"""Soft start: the force of the coil grows from zero for any stimulus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SOFT_START_S = 0.05


class SoftStart:
    """Limits the first 50 ms of a run to a quarter sine from zero to the largest command in that time.

    A stimulus that rises gradually in that time, linearly or by half a cosine as a preload does, is not changed. For
    set-points in that time the largest command is not known beforehand: each is limited relative to itself.
    """

    def __init__(self, sample_rate_hz: float, step_v: float) -> None:
        self._samples = round(SOFT_START_S * sample_rate_hz)
        self._step_v = step_v
        self._peak_v = 0.0

    def begin(self, stimulus_v: NDArray[np.float64]) -> None:
        """Start a run of this stimulus, shape (n,), V; set-points may follow it."""
        self._peak_v = float(np.abs(stimulus_v[: self._samples]).max(initial=0.0))

    def play(self, wanted_v: NDArray[np.float64], cursor: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the limited commands from sample ``cursor`` on, V, and where they differ; both (n,)."""
        if cursor >= self._samples:
            return wanted_v, np.zeros(wanted_v.size, dtype=bool)
        part = np.minimum((cursor + 1.0 + np.arange(wanted_v.size)) / self._samples, 1.0)
        share = np.sin(0.5 * np.pi * part)
        most_v = share * np.maximum(self._peak_v, np.abs(wanted_v))
        # One converter step is tolerated, because of rounding.
        softened = np.abs(wanted_v) > most_v + self._step_v
        return np.where(softened, np.clip(wanted_v, -most_v, most_v), wanted_v), softened
