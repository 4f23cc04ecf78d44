"""Safety values of a running test: force, coil temperature, contact, and the coil's linear region."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.instrument import Limits, force
from tissueid.instrument.thermal import WindingTemperature

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
        known = position_m[np.isfinite(position_m)]
        return not known.size or (self.low_m <= float(known.min()) and float(known.max()) <= self.high_m)


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
