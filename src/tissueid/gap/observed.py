"""What was observed: the tests of a session as the diagnosis uses them, and which samples serve which purpose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from hashlib import blake2b
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.gap.driving import UPSTREAM, DrivenBy
from tissueid.gap.equivalent import Equivalent

FloatArray = NDArray[np.float64]
Fixture = Literal["tissue", "spring", "air"]

CHANNELS = ("voltage", "current", "position")
"""Recorded signals that the chain predicts, downstream in this order."""
AT_SURFACE_M = 1e-4
LEAST_NOISE = {"voltage": 1e-4, "current": 1e-5, "position": 1e-8}
"""SI; of a channel that shows none, since no converter is finer: it would otherwise weigh without end."""


class Purpose(IntEnum):
    """What a sample serves. A sample that was not received serves nothing."""

    NOTHING = 0
    FIT = 1
    CHOICE = 2
    """Held out of every fit; candidates are chosen by it."""
    CHECK = 3
    """Held out of fit and choice; the announced figures are checked on it."""


@dataclass(frozen=True)
class ObservedTest:
    """One test: command and recorded signals, shape (n,), SI.

    ``signals`` holds those of ``CHANNELS`` that were recorded, NaN where a sample was not received. ``purpose``, shape
    (n,), says what each sample serves.
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
    """Whether ``command`` holds the command (V), or what was recorded in its stead: the voltage (V) across the coil,
    the current (A) through it, or a bare input as the force (N) on an equivalent mass."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Recorded signals downstream of what drives the test: those that the chain predicts."""
        return tuple(name for name in CHANNELS if name in self.signals and name not in UPSTREAM[self.driven_by])

    @cached_property
    def played(self) -> tuple[float, bytes]:
        """Sample rate and fingerprint of what was played: alike for a test and its repeats."""
        return self.sample_rate_hz, blake2b(self.command.tobytes(), digest_size=16).digest()

    @property
    def quiet(self) -> bool:
        """Whether nothing was asked of the coil."""
        return self.kind == "quiet"

    @property
    def starts_at_surface(self) -> bool:
        """Whether the probe rests at the surface as the test begins; otherwise where that lies is less certain."""
        position = self.signals["position"]
        first = position[np.isfinite(position)][:3]
        return bool(first.size) and abs(float(np.median(first)) - self.surface_m) < AT_SURFACE_M

    def serving(self, purpose: Purpose) -> NDArray[np.bool_]:
        """True where a sample serves that purpose, shape (n,)."""
        return np.asarray(self.purpose == purpose)


@dataclass(frozen=True)
class Belief:
    """What is believed of a coordinate, as it is fitted; without ``std`` it is no more than where to start."""

    value: float
    std: float | None = None


@dataclass(frozen=True)
class Observed:
    """All tests of a session that the diagnosis uses, the nominal instrument and the noise of each channel.

    ``noise`` is the standard deviation of each channel's sensor noise, SI.
    """

    instrument: DeviceDescription
    tests: tuple[ObservedTest, ...]
    noise: dict[str, float]
    remarks: tuple[str, ...] = ()
    beliefs: Mapping[str, Belief] = field(default_factory=dict)
    """What a saved twin holds of coordinates, by their names."""
    equivalent: Equivalent | None = None
    """How bare records of input and output became force and motion; None where the instrument is known."""
    impulsive: Mapping[str, float] = field(default_factory=dict)
    """Channels whose noise comes in impulses, with what it is with them in it; ``noise`` then is without."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that are predicted in every test."""
        return tuple(name for name in CHANNELS if all(name in test.channels for test in self.tests))

    @property
    def recorded(self) -> tuple[str, ...]:
        """Channels that every test has, whether they are predicted or drive it."""
        return tuple(name for name in CHANNELS if all(name in test.signals for test in self.tests))

    @property
    def full(self) -> bool:
        """Whether there is more than one kind of test."""
        return len({test.kind for test in self.tests}) > 1
