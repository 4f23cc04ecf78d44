"""Signals and safety values of a running test, shared by the measuring thread and the window."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playback import Phase, Progress
from tissueid.acquisition.surface_detection import PLACE_S
from tissueid.device import DeviceDescription
from tissueid.instrument import Limits, force
from tissueid.instrument.force_profile import recorded_force
from tissueid.instrument.thermal import WindingTemperature

if TYPE_CHECKING:
    from tissueid.acquisition.live import LiveIdentification


_RECENT_S = 0.25
"""Duration over which the newest samples are evaluated, s."""
LIFTED_M = 0.3e-3
"""Distance above the detected surface at which the probe has left it, m; the accuracy of the detection."""
_LIFTED_SHARE = 0.05


@dataclass(frozen=True)
class LinearRange:
    """Range of position in which the coil is linear, m."""

    low_m: float
    high_m: float

    def holds(self, position_m: NDArray[np.float64]) -> bool:
        """Return whether all finite positions, shape (k,), are inside the limits; others are ignored."""
        finite = position_m[np.isfinite(position_m)]
        return not finite.size or (self.low_m <= float(finite.min()) and float(finite.max()) <= self.high_m)


def linear_region(device: DeviceDescription) -> LinearRange | None:
    """Return the linear region of the active calibration; None if there is none."""
    ends = [device.calibration.get(f"linear_region_{end}_m") for end in ("min", "max")]
    low, high = (float(end) if isinstance(end, int | float) else math.nan for end in ends)
    return LinearRange(low, high) if low < high else None


@dataclass(frozen=True)
class Safety:
    """Safety values at one moment; None means not known (yet).

    ``force_n`` is the greatest of the newest quarter of a second. ``model_c`` is the coil's temperature by the thermal
    model, ``temperature_c`` by its sensor. ``left_region`` stays true for the rest of the test.
    """

    limits: Limits
    force_n: float | None = None
    position_m: float | None = None
    temperature_c: float | None = None
    model_c: float | None = None
    contact: bool | None = None
    region: LinearRange | None = None
    left_region: bool = False


class SafetyWatch:
    """Follows the samples of one test. Not thread-safe: the owner holds a lock.

    ``winding`` False leaves the temperature by calculation out: a simulation in this process has no coil.
    """

    def __init__(self, device: DeviceDescription, limits: Limits, *, winding: bool = True) -> None:
        self.device = device
        self.region = linear_region(device)
        self.surface_m: float | None = None
        self._limits = limits
        self._winding = WindingTemperature(device) if winding else None
        self._recent = max(1, round(_RECENT_S * device.sample_rate_hz))
        self._force = self._position = self._temperature = np.zeros(0)
        self._left = False

    def take(self, samples: NDArray[np.void]) -> None:
        """Add new samples, shape (k,) of SAMPLE."""
        self._force = np.concatenate([self._force, force(samples, self.device)])[-self._recent :]
        self._position = np.concatenate([self._position, samples["position"]])[-self._recent :]
        self._temperature = np.concatenate([self._temperature, samples["temperature"]])[-self._recent :]
        if self._winding is not None:
            self._winding.take(samples["current"], samples["temperature"], 0.0)
        if self.region is not None and not self._left:
            self._left = not self.region.holds(samples["position"])

    def snapshot(self) -> Safety:
        """Return the current values."""
        contact = None
        position = self._position[np.isfinite(self._position)]
        if self.surface_m is not None and position.size:
            contact = bool(np.mean(position < self.surface_m - LIFTED_M) < _LIFTED_SHARE)
        force_n = np.abs(self._force[np.isfinite(self._force)])
        temperature = self._temperature[np.isfinite(self._temperature)]
        model_c = np.nan if self._winding is None else self._winding.temperature_c
        return Safety(
            limits=self._limits,
            position_m=float(np.median(position)) if position.size else None,
            force_n=float(force_n.max()) if force_n.size else None,
            temperature_c=float(np.median(temperature)) if temperature.size else None,
            model_c=None if np.isnan(model_c) else model_c,
            contact=contact,
            region=self.region,
            left_region=self._left,
        )


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
