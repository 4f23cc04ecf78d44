"""What every instrument offers, real, simulated or replayed; and the samples that it delivers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.instrument.correction import Correction
from tissueid.instrument.limits import Limits
from tissueid.wire import Flag

SIGNALS = ("command", "voltage", "current", "position", "temperature", "acceleration_x", "acceleration_y")
"""The recorded channels, SI: V, V, A, m, degC, m/s^2, m/s^2."""

SAMPLE = np.dtype([("index", "<u8"), *((name, "<f8") for name in SIGNALS), ("flags", "<u2")])
"""One sample in physical units. All signals of a sample that was not received are NaN and its flags are 0."""


@dataclass(frozen=True)
class Gap:
    """Samples that were not received: ``count`` of them, from sample ``first_index`` on."""

    first_index: int
    count: int


@dataclass(frozen=True)
class Run:
    """One stimulus being played: its samples are ``first_index`` to ``first_index + samples``."""

    first_index: int
    samples: int

    @property
    def end_index(self) -> int:
        """The first sample after the stimulus."""
        return self.first_index + self.samples


Observer = Callable[[NDArray[np.void]], None]
"""Takes samples, shape (k,) of SAMPLE, k > 0, and must not raise."""


class Instrument(Protocol):
    """Connect, load, arm, start, poll until the run is over, release, close.

    ``poll`` must be called at least every 100 ms while the coil is armed or running: the heartbeat that keeps
    the firmware's watchdog quiet is sent there and nowhere else, so a host that hangs releases the coil.
    """

    nominal: DeviceDescription
    """What the instrument says of itself."""
    device: DeviceDescription
    """The figures to work with: the nominal ones, or a calibration's laid over them."""
    gaps: list[Gap]
    observer: Observer | None
    """Is called with the samples of every ``poll``, in its thread, whatever procedure polls."""

    def use_calibration(self, device: DeviceDescription, corrections: Mapping[str, Correction]) -> None:
        """From now on go by ``device``, and correct what is read channel by channel.

        Limits are judged by the nominal figures and what was read as well, whichever is the more cautious. With
        ``nominal`` and no corrections a calibration is out of force again. Only while the coil is free.

        Raises:
            InstrumentError: a test is armed or running, or there is no such channel.
        """

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that came after their time."""

    @property
    def held_samples(self) -> int:
        """Samples of the newest run whose command was not the stimulus' own, because its set-point was missing."""

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time by which a block of the newest run was there before it was played; None where no cable is."""

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Send a stimulus, shape (n,), V at the device's sample rate."""

    def follow(self, samples: int, hold_v: float) -> None:
        """After ``load``: while the next run goes on, ``samples`` set-points more will be sent with ``send``.

        Where they fail to come in time, the command goes softly to ``hold_v`` and stays there until they do. It is
        agreed for one run; the next one asks anew.
        """

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Set-points, shape (k,), V, for the run's samples from ``offset`` on, ahead of their time; does not wait.

        The first set-point's offset is the length of what was loaded. What goes wrong with them comes with ``poll``.
        """

    def finish(self) -> int:
        """End the run now as its stimulus would end, by a soft release; returns how many samples it had played."""

    def narrowed(self, limits: Limits) -> Limits:
        """These limits, or the instrument's own where it goes less far."""

    def arm(self, limits: Limits) -> None:
        """Agree on the limits; the next ``start`` plays the stimulus."""

    def start(self) -> Run:
        """Energise the coil and play."""

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Samples that arrived, shape (k,) of SAMPLE, k may be 0; waits up to ``timeout_s`` for the first.

        ``observer``, if there is one, gets them too.
        """

    def move_stage(self, position_m: float | None) -> bool:
        """Bring the fixture on a motorised stage to rest at a position on the actuator; None takes it out of reach.

        Only while the coil is free. Returns False, and does nothing, where the instrument has no such stage: then a
        person has to move it.
        """

    def release(self) -> None:
        """Free the coil now. Never raises: what cannot be said to the firmware its watchdog does."""

    def close(self) -> None:
        """Release, and let go of the port."""


def empty_samples(first_index: int, count: int) -> NDArray[np.void]:
    """``count`` samples that were not received: shape (count,), NaN throughout."""
    samples = np.zeros(count, SAMPLE)
    samples["index"] = first_index + np.arange(count)
    for name in SIGNALS:
        samples[name] = np.nan
    return samples


def not_played(samples: NDArray[np.void]) -> NDArray[np.bool_]:
    """Whether each of samples, shape (k,), was received and belongs to no run, shape (k,)."""
    return np.asarray(np.isfinite(samples["position"]) & ((samples["flags"] & Flag.PLAYING) == 0))


def until_released(samples: NDArray[np.void]) -> NDArray[np.void]:
    """Samples of a run, shape (k,), up to its release: those from the first that was not played on are left out.

    Samples that were lost right before it go as well: nothing says whether they were played.
    """
    gone = np.flatnonzero(not_played(samples))
    if not gone.size:
        return samples
    played = np.flatnonzero(samples["flags"][: gone[0]] & Flag.PLAYING)
    return samples[: played[-1] + 1 if played.size else 0]


def force(samples: NDArray[np.void], device: DeviceDescription) -> NDArray[np.float64]:
    """The force that the instrument believes, N: force constant times measured current, shape (k,)."""
    return np.asarray(samples["current"]) * device.force_constant_n_per_a
