"""Interface of every instrument, real, simulated or replayed, its samples, and errors of calls in a wrong state."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError
from tissueid.instrument.limits import Limits
from tissueid.wire import Flag


@dataclass(frozen=True)
class Correction:
    """The reading of a channel is ``gain`` * true value + ``offset``.

    Raises:
        InstrumentError: the gain is not between 0.5 and 2, or the offset is not finite.
    """

    gain: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        if not (0.5 < self.gain < 2.0 and np.isfinite(self.offset)):
            raise InstrumentError(
                "calibration.implausible_correction",
                "a channel cannot have a gain of {gain:g} and an offset of {offset:g}",
                gain=self.gain,
                offset=self.offset,
            )


Corrections = Mapping[str, Correction]
"""Corrections by channel name. A channel without one needs no correction."""


def corrected(samples: NDArray[np.void], corrections: Corrections) -> NDArray[np.void]:
    """Return corrected samples, shape (k,) of SAMPLE; the argument is not changed."""
    if not corrections:
        return samples
    result = samples.copy()
    for name, correction in corrections.items():
        result[name] -= correction.offset
        result[name] /= correction.gain
    return result


def check_corrections(corrections: Corrections, channels: Sequence[str]) -> dict[str, Correction]:
    """Return a copy of the corrections.

    Raises:
        InstrumentError: a correction is not for one of the measured ``channels``.
    """
    for name in corrections:
        if name not in channels or name == "command":
            raise InstrumentError("calibration.unknown_channel", "there is no channel {name} to correct", name=name)
    return dict(corrections)


def checked_descriptions(nominal: DeviceDescription, device: DeviceDescription) -> tuple[DeviceDescription, ...]:
    """Return the descriptions for which limits must hold, so that a calibration never loosens a limit."""
    return (nominal,) if device is nominal else (nominal, device)


def calibration_while_running() -> InstrumentError:
    """Return the error for a calibration applied while a test is armed or running."""
    return InstrumentError("instrument.calibration_in_test", "a calibration can be applied between two tests only")


def nothing_loaded() -> InstrumentError:
    """Return the error for set-points announced before a stimulus is loaded."""
    return InstrumentError("instrument.nothing_loaded", "load the stimulus that comes before the set-points first")


def not_armed() -> InstrumentError:
    """Return the error for a start without a loaded and armed stimulus."""
    return InstrumentError("instrument.not_armed", "load and arm the stimulus before starting")


def unexpected_set_points(first: int, end: int) -> InstrumentError:
    """Return the error for set-points that were not announced."""
    return InstrumentError(
        "instrument.unexpected_set_points",
        "set-points {first} to {end} were not announced: call follow and arm first",
        first=first,
        end=end,
    )


def stage_while_running() -> InstrumentError:
    """Return the error for a stage movement while a test is armed or running."""
    return InstrumentError(
        "instrument.stage_in_test", "the stage moves only while the coil is free: end the test first"
    )


SIGNALS = ("command", "voltage", "current", "position", "temperature", "acceleration_x", "acceleration_y")
"""The recorded channels, SI: V, V, A, m, degC, m/s^2, m/s^2."""

SAMPLE = np.dtype([("index", "<u8"), *((name, "<f8") for name in SIGNALS), ("flags", "<u2")])
"""One sample in physical units. All signals of a sample that was not received are NaN and its flags are 0."""


@dataclass(frozen=True)
class Gap:
    """Gap of ``count`` missing samples from ``first_index``."""

    first_index: int
    count: int


@dataclass(frozen=True)
class Run:
    """Run of one stimulus, from sample ``first_index`` to before ``end_index``."""

    first_index: int
    samples: int

    @property
    def end_index(self) -> int:
        """Index of the first sample after the stimulus."""
        return self.first_index + self.samples


Observer = Callable[[NDArray[np.void]], None]
"""Callback for samples, shape (k,) of SAMPLE, k > 0. Must not raise."""


class Instrument(Protocol):
    """Interface of an instrument. Sequence of a test: open, load, arm, start, poll until the run is over, release,
    close.

    ``poll`` must be called at least every 100 ms while the coil is armed or running. Only ``poll`` sends the heartbeat
    for the firmware's watchdog, so that the coil is released if the host hangs.
    """

    nominal: DeviceDescription
    """The instrument's own properties."""
    device: DeviceDescription
    """The properties in use: the nominal ones, or those of the active calibration."""
    gaps: list[Gap]
    observer: Observer | None
    """Called with the samples of every ``poll``, in the same thread."""

    def use_calibration(self, device: DeviceDescription, corrections: Mapping[str, Correction]) -> None:
        """Use the device description and channel corrections of a calibration. Only while the coil is free.

        Limits must hold for the nominal properties as well as for the calibrated ones. Passing ``nominal`` and no
        corrections removes the calibration.

        Raises:
            InstrumentError: a test is armed or running, or a channel does not exist.
        """

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that arrived too late."""

    @property
    def held_samples(self) -> int:
        """Samples of the newest run that were held because their set-point was missing."""

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time between arrival and playing of a block of the newest run, s; None without a cable."""

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Load a stimulus, shape (n,), V at the device's sample rate."""

    def follow(self, samples: int, hold_v: float) -> None:
        """Announce, after ``load``, ``samples`` set-points that will be sent with ``send`` during the next run.

        If they are late, the command ramps to ``hold_v`` and stays there until they arrive. Valid for one run.
        """

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Send set-points, shape (k,), V, for the samples of the run from ``offset``, without waiting.

        The offset of the first set-point is the length of the loaded stimulus. ``poll`` raises later errors.
        """

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played."""

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``, reduced to the fixed limits of the instrument."""

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run."""

    def start(self) -> Run:
        """Energise the coil and play the stimulus."""

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return arrived samples, shape (k,) of SAMPLE, k >= 0; wait up to ``timeout_s`` for the first.

        The samples also go to ``observer``.
        """

    def move_stage(self, position_m: float | None) -> bool:
        """Move the fixture on a motorised stage to a position on the actuator, m; None moves it out of reach.

        Only while the coil is free. Return False, and do nothing, if the instrument has no stage.
        """

    def release(self) -> None:
        """Release the coil now. Never raises: without a link the watchdog of the firmware releases it."""

    def close(self) -> None:
        """Release the coil and close the port."""


def empty_samples(first_index: int, count: int) -> NDArray[np.void]:
    """Return ``count`` samples that were not received: shape (count,), all signals NaN."""
    samples = np.zeros(count, SAMPLE)
    samples["index"] = first_index + np.arange(count)
    for name in SIGNALS:
        samples[name] = np.nan
    return samples


def join_blocks(blocks: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Return blocks of samples as one new array, shape (k,) of SAMPLE.

    Copied block by block: np.concatenate compares the fields of all blocks, which takes longer than the copies.
    """
    samples = np.empty(sum([block.size for block in blocks]), SAMPLE)
    end = 0
    for block in blocks:
        samples[end : end + block.size] = block
        end += block.size
    return samples


_PLAYING = int(Flag.PLAYING)
"""As a plain number: numpy converts a member of an enumeration element by element."""


def is_not_played(samples: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return for each of the samples, shape (k,), whether it was received and is part of no run, shape (k,)."""
    return np.asarray(np.isfinite(samples["position"]) & ((samples["flags"] & _PLAYING) == 0))


def trim_at_release(samples: NDArray[np.void]) -> NDArray[np.void]:
    """Return the samples of a run, shape (k,), up to its release.

    Lost samples directly before the release are left out too, as it is unknown whether they were played.
    """
    not_played = is_not_played(samples)
    if not not_played.any():
        return samples
    idle = np.flatnonzero(not_played)
    played = np.flatnonzero(samples["flags"][: idle[0]] & Flag.PLAYING)
    return samples[: played[-1] + 1 if played.size else 0]


def force(samples: NDArray[np.void], device: DeviceDescription) -> NDArray[np.float64]:
    """Return the coil force, N, shape (k,): force constant times measured current."""
    return np.asarray(samples["current"]) * device.force_constant_n_per_a
