"""The dataset of a diagnosis: the tests of a session, with the purpose of each sample."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from hashlib import blake2b
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.gap.equivalent_oscillator import Equivalent
from tissueid.gap.excitation import UPSTREAM, DrivenBy, interpolated
from tissueid.twin.simulation import MeasuredSignals

FloatArray = NDArray[np.float64]
Fixture = Literal["tissue", "spring", "air"]

CHANNELS = ("voltage", "current", "position")
"""Recorded signals that the chain predicts, in downstream order."""
AT_SURFACE_M = 1e-4
LEAST_NOISE = {"voltage": 1e-4, "current": 1e-5, "position": 1e-8}
"""Least noise of a channel, SI: a channel without visible noise would get infinite weight."""


class Purpose(IntEnum):
    """Purpose of a sample. A sample that was not received has none."""

    NOTHING = 0
    FIT = 1
    CHOICE = 2
    """Held out of every fit; candidates are chosen by it."""
    CHECK = 3
    """Held out of fit and choice; the stated closed share is verified on it."""


@dataclass(frozen=True)
class DatasetTest:
    """One test: command and recorded signals, shape (n,), SI.

    ``signals`` holds the recorded ones of ``CHANNELS``, NaN where a sample was not received. ``purpose``, shape (n,),
    is the purpose of each sample.
    """

    number: int
    kind: str
    fixture: Fixture
    command: FloatArray = field(repr=False)
    signals: dict[str, FloatArray] = field(repr=False)
    purpose: NDArray[np.int8] = field(repr=False)
    sample_rate_hz: float
    surface_m: float
    repeat_of: int | None = None
    driven_by: DrivenBy = "command"
    """Kind of signal in ``command``: the command (V), the recorded voltage (V) across the coil, the recorded current
    (A) through it, or an input as the force (N) on an equivalent oscillator."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Recorded signals downstream of the excitation, which the chain predicts."""
        return tuple(name for name in CHANNELS if name in self.signals and name not in UPSTREAM[self.driven_by])

    @cached_property
    def played(self) -> tuple[float, bytes]:
        """Sample rate and hash of the command: equal for a test and its repeats."""
        return self.sample_rate_hz, blake2b(self.command.tobytes(), digest_size=16).digest()

    def excitation(self, tracking_rad_s: float = 0.0) -> MeasuredSignals:
        """Return the excitation if it was measured, and the position for an observer of a bandwidth above 0.

        It is the same object every time.
        """
        if tracking_rad_s not in self._excitations:
            self._excitations[tracking_rad_s] = MeasuredSignals(
                voltage=self.command if self.driven_by == "voltage" else None,
                current=self.command if self.driven_by == "current" else None,
                position=interpolated(self.signals["position"]) if tracking_rad_s > 0.0 else None,
                tracking_rad_s=tracking_rad_s,
            )
        return self._excitations[tracking_rad_s]

    @cached_property
    def _excitations(self) -> dict[float, MeasuredSignals]:
        return {}

    @property
    def quiet(self) -> bool:
        """Whether the test has no stimulus."""
        return self.kind == "quiet"

    @property
    def starts_at_surface(self) -> bool:
        """Whether the probe rests at the surface when the test begins; otherwise the surface is less certain."""
        return bool(np.isfinite(self._first_position_m)) and abs(self._first_position_m - self.surface_m) < AT_SURFACE_M

    @property
    def starting_position_m(self) -> float:
        """Position at which the test begins: the surface, unless the first readings differ."""
        at_surface = self.starts_at_surface or not np.isfinite(self._first_position_m)
        return self.surface_m if at_surface else self._first_position_m

    @cached_property
    def _first_position_m(self) -> float:
        position = self.signals["position"]
        first = position[np.isfinite(position)][:3]
        return float(np.median(first)) if first.size else float("nan")

    @cached_property
    def spreads(self) -> dict[str, float]:
        """Standard deviation of each recorded signal, SI."""
        return {name: float(np.nanstd(values)) for name, values in self.signals.items()}

    def serving(self, purpose: Purpose) -> NDArray[np.bool_]:
        """Return True for samples of a purpose, shape (n,)."""
        return np.asarray(self.purpose == purpose)


@dataclass(frozen=True)
class Prior:
    """Prior of a coordinate in fitted units; without ``std`` a starting value only."""

    value: float
    std: float | None = None


@dataclass(frozen=True)
class Dataset:
    """All tests of a session that the diagnosis uses, the nominal instrument and the noise of each channel.

    ``noise`` is the standard deviation of each channel's sensor noise, SI.
    """

    instrument: DeviceDescription
    tests: tuple[DatasetTest, ...]
    noise: dict[str, float]
    remarks: tuple[str, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    """Priors of coordinates from a saved twin, by name."""
    unmodelled: Mapping[str, float] = field(default_factory=dict)
    """Error that a saved twin is known to leave in tests on tissue, by channel, as a share of the standard deviation of
    the recorded signal."""
    equivalent: Equivalent | None = None
    """Conversion of input-output records to force and motion; None where the instrument is known."""
    gravity_m_s2: tuple[float, float] = (0.0, GRAVITY_M_S2)
    """Gravity along the stroke and its standard deviation; by default the device can have any orientation."""
    tracking_rad_s: float = 0.0
    """Bandwidth of an observer that pulls each simulated motion towards the recorded one; 0 in every result."""
    impulsive: Mapping[str, float] = field(default_factory=dict)
    """Noise with outliers of channels that have outliers; ``noise`` is then without."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that are predicted in every test."""
        return tuple(name for name in CHANNELS if all(name in test.channels for test in self.tests))

    @property
    def recorded(self) -> tuple[str, ...]:
        """Channels that every test has, predicted or used as the excitation."""
        return tuple(name for name in CHANNELS if all(name in test.signals for test in self.tests))

    @property
    def full(self) -> bool:
        """Whether there is more than one kind of test."""
        return len({test.kind for test in self.tests}) > 1
