"""Soft start: whatever a run begins with, the coil's force grows from nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SOFT_START_S = 0.05


class SoftStart:
    """Keeps the first 50 ms of a run under a quarter of a sine from zero to the most that they ask for.

    A stimulus that rises by itself in that time, straight or by half a cosine as a preload does, lies under it and is
    played as it is. Of set-points that come so early the most is not known beforehand: each counts as its own.
    """

    def __init__(self, sample_rate_hz: float, step_v: float) -> None:
        self._samples = round(SOFT_START_S * sample_rate_hz)
        self._step_v = step_v
        self._peak_v = 0.0

    def begin(self, stimulus_v: NDArray[np.float64]) -> None:
        """A run of that stimulus, shape (n,), V, begins; set-points may follow it."""
        self._peak_v = float(np.abs(stimulus_v[: self._samples]).max(initial=0.0))

    def play(self, wanted_v: NDArray[np.float64], cursor: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """What is played in place of the commands from sample ``cursor`` on, V, and where it differs; both (n,)."""
        if cursor >= self._samples:
            return wanted_v, np.zeros(wanted_v.size, dtype=bool)
        part = np.minimum((cursor + 1.0 + np.arange(wanted_v.size)) / self._samples, 1.0)
        share = np.sin(0.5 * np.pi * part)
        most_v = share * np.maximum(self._peak_v, np.abs(wanted_v))
        # A step of the converter more is let pass: a rise in rounded steps is still a rise.
        softened = np.abs(wanted_v) > most_v + self._step_v
        return np.where(softened, np.clip(wanted_v, -most_v, most_v), wanted_v), softened
