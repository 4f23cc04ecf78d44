"""The signals of a finished test as the quality gate looks at them: filled, filtered and cut once for all checks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tissueid.acquisition.quality.setting import Setting, setting_of
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.sessions import Test

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CUT_OFF_HZ = 120.0
"""Below it motion can be told from the noise of the position: 1 um there is 0.6 m/s^2, 0.03 N of 60 g."""

_EDGE_S = 0.01
"""What is next to a gap, or to an end of the record, is not known after filtering."""
_FEWEST = 200
"""Samples of a stimulus below which nothing can be said of it."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """One test and the device that it was made with. Arrays have shape (n,), the samples of the whole test."""

    test: Test
    device: DeviceDescription

    @property
    def setting(self) -> Setting:
        """The words for what stands under the probe."""
        return setting_of(self.test.kind)

    @property
    def rate(self) -> float:
        """Samples a second."""
        return self.test.sample_rate_hz

    @cached_property
    def first(self) -> int:
        """The first sample after the preload."""
        return min(round(self.test.preload_s * self.rate), self.test.samples)

    @property
    def mechanical(self) -> bool:
        """Whether there is force and position, and enough of them to judge."""
        return int(self.known.sum()) >= _FEWEST

    def signal(self, name: str) -> Array | None:
        """A signal with NaN where it was not received; None where the test lacks it or holds nothing of it."""
        values = self.test.signals.get(name)
        return values if values is not None and bool(np.isfinite(values).any()) else None

    def stimulus(self, name: str) -> Array:
        """What was received of a signal after the preload, shape (k,); empty where there is none."""
        values = self.signal(name)
        if values is None:
            return np.zeros(0)
        values = values[self.first :]
        return values[np.isfinite(values)]

    @cached_property
    def received(self) -> Mask:
        """Samples with force and position."""
        force, position = self.signal("force"), self.signal("position")
        if force is None or position is None:
            return np.zeros(self.test.samples, dtype=np.bool_)
        return np.asarray(np.isfinite(force) & np.isfinite(position))

    @cached_property
    def known(self) -> Mask:
        """Samples of the stimulus at which the filtered signals are known: no gap, no end within 10 ms."""
        edge = round(_EDGE_S * self.rate)
        lost = np.concatenate([[0], np.cumsum(~self.received)])
        place = np.arange(self.test.samples)
        low, high = np.maximum(place - edge, 0), np.minimum(place + edge + 1, self.test.samples)
        inside = (place >= max(edge, self.first)) & (place < self.test.samples - edge)
        return np.asarray(inside & (lost[high] == lost[low]))

    @cached_property
    def force(self) -> Array:
        """Coil force below the cut-off, N."""
        return self._filtered("force", 0)

    @cached_property
    def position(self) -> Array:
        """Position below the cut-off, m."""
        return self._filtered("position", 0)

    @cached_property
    def velocity(self) -> Array:
        """Its derivative, m/s."""
        return self._filtered("position", 1)

    @cached_property
    def acceleration(self) -> Array:
        """Its second derivative, m/s^2."""
        return self._filtered("position", 2)

    @cached_property
    def weight_n(self) -> float:
        """Pull of gravity on the moving part along the stroke, N into the tissue: as noted, or straight down."""
        along = self.test.notes.get("gravity_along_stroke_m_s2")
        gravity = along if isinstance(along, int | float) and abs(along) < 2.0 * GRAVITY_M_S2 else GRAVITY_M_S2
        return self.device.moving_mass_kg * float(gravity)

    @cached_property
    def contact_force(self) -> Array:
        """What is left of coil force and weight after the moving part's own inertia and friction, N: tissue's share."""
        own = self.device.moving_mass_kg * self.acceleration + self.device.bearing_damping_n_s_per_m * self.velocity
        return self.force + self.weight_n - own

    def _filtered(self, name: str, derivative: int) -> Array:
        spectrum, frequency, length, trend = self._spectra[name]
        shaped = spectrum * np.exp(-0.5 * (frequency / CUT_OFF_HZ) ** 2) * (2j * np.pi * frequency) ** derivative
        values = np.asarray(fft.irfft(shaped, length)[: self.test.samples], dtype=np.float64)
        first, slope = trend
        if derivative == 0:
            return values + first + slope * np.arange(self.test.samples)
        return values + slope * self.rate if derivative == 1 else values

    @cached_property
    def _spectra(self) -> dict[str, tuple[NDArray[np.complex128], Array, int, tuple[float, float]]]:
        """Spectra of the signals, filled across gaps and without the line from end to end, mirrored to close up."""
        found = {}
        place = np.arange(self.test.samples)
        for name in ("force", "position"):
            values = self.test.signals[name]
            values = np.interp(place, place[self.received], values[self.received])
            slope = (values[-1] - values[0]) / max(1, values.size - 1)
            level = values - values[0] - slope * place
            # Odd about its ends, value and slope go on across them.
            length = fft.next_fast_len(2 * values.size, real=True)
            closed = np.zeros(length)
            closed[: values.size] = level
            closed[length - values.size + 1 :] = -level[:0:-1]
            frequency = fft.rfftfreq(length, 1.0 / self.rate)
            found[name] = (fft.rfft(closed), frequency, length, (float(values[0]), float(slope)))
        return found


def runs(mask: Mask) -> list[tuple[int, int]]:
    """First and one-past-last index of every stretch of True in a mask of shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]


def longest(mask: Mask) -> int:
    """Samples in the longest stretch of True."""
    return max((end - first for first, end in runs(mask)), default=0)
