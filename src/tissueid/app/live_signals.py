"""The signals of a running test, shared by the measuring thread and the window."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playback import Phase, Progress
from tissueid.acquisition.surface_detection import PLACE_S
from tissueid.app.safety import Safety, SafetyWatch
from tissueid.device import DeviceDescription
from tissueid.instrument.force_profile import recorded_force

if TYPE_CHECKING:
    from tissueid.acquisition.live import LiveIdentification

CAPACITY = 1 << 16
"""Capacity in samples; the longest test that a profile allows at 2 kHz has 62,400."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The signals at one moment; arrays of shape (n,), oldest first, NaN for lost samples.

    ``time_s`` counts from the start of the preload, as a session's does, and is negative while the probe is placed.
    ``phase`` is None before the first sample; ``fraction`` (0 to 1) tells how much of the phase's run is played.
    ``safety`` is None until it is known which instrument answers, ``total_s`` (the run with its preload) until it is
    known what is played. ``voltage_v`` is measured across the coil.
    """

    time_s: Array
    force_n: Array
    position_m: Array
    phase: Phase | None
    fraction: float
    safety: Safety | None = None
    total_s: float | None = None
    voltage_v: Array = field(default_factory=lambda: np.zeros(0))


class LiveSignals:
    """A thread-safe ring buffer of the newest samples; neither thread blocks the other for long.

    ``device``, ``greatest_force_n``, ``total_s`` (how long it lasts) and ``identification`` are set by the one that
    adds once it knows the instrument; the one that looks asks the latter for its newest view.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.device: DeviceDescription | None = None
        self.identification: LiveIdentification | None = None
        self.greatest_force_n: float | None = None
        self.total_s: float | None = None
        self._watch: SafetyWatch | None = None
        self._lock = threading.Lock()
        self._ring = np.full((4, capacity), np.nan)  # time, force, position, voltage
        self._added = 0
        self._phase: Phase | None = None
        self._fraction = 0.0
        self._first_index: dict[bool, int] = {}

    def begin(self, watch: SafetyWatch) -> None:
        """Set the instrument and its limits."""
        with self._lock:
            self.device, self._watch = watch.device, watch

    def placed(self, surface_m: float) -> None:
        """Set the position of the surface, m."""
        with self._lock:
            if self._watch is not None:
                self._watch.surface_m = surface_m

    def add(self, progress: Progress, device: DeviceDescription) -> None:
        """Add the progress of a guided test."""
        samples = progress.samples
        with self._lock:
            self._phase, self._fraction = progress.phase, progress.fraction
            if not samples.size:
                return
            if self._watch is not None:
                self._watch.take(samples)
            placing = progress.phase is Phase.PLACE
            first = self._first_index.setdefault(placing, int(samples["index"][0]))
            time_s = (samples["index"] - first) / device.sample_rate_hz - (PLACE_S if placing else 0.0)
            force_n = recorded_force(samples, device)
            rows = np.stack([time_s, force_n, samples["position"], samples["voltage"]])  # (4, k)
            capacity = self._ring.shape[1]
            places = (self._added + np.arange(samples.size)) % capacity
            self._ring[:, places[-capacity:]] = rows[:, -capacity:]
            self._added += samples.size

    def snapshot(self) -> Snapshot:
        """Return a copy of the current signals."""
        with self._lock:
            capacity = self._ring.shape[1]
            if self._added <= capacity:
                rows = self._ring[:, : self._added].copy()
            else:
                rows = np.roll(self._ring, -(self._added % capacity), axis=1)
            safety = None if self._watch is None else self._watch.snapshot()
            signals = rows[0], rows[1], rows[2]
            return Snapshot(*signals, self._phase, self._fraction, safety, self.total_s, rows[3])


def decimated(time_s: Array, values: Array, low_s: float, high_s: float, columns: int) -> tuple[Array, Array]:
    """Least and greatest value in each pixel column of a plot that shows ``low_s`` to ``high_s``.

    Takes time (n,), rising, and values (..., n), returns at most 2 columns of each: all that such a plot can show. A
    column of lost samples is NaN, so that the line is broken there. Few samples pass as they are.
    """
    if time_s.size <= 2 * columns or high_s <= low_s:
        return time_s, values
    column = np.floor((time_s - low_s) * (columns / (high_s - low_s)))
    starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1.0))
    extremes = [extreme.reduceat(values, starts, axis=-1) for extreme in (np.fmin, np.fmax)]
    return np.repeat(time_s[starts], 2), np.stack(extremes, axis=-1).reshape(*values.shape[:-1], -1)
