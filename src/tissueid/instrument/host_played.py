"""Playback of a run in this process: stimulus, set-points, held level where they are missing, soft release."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import TissueIDError
from tissueid.instrument.interface import (
    SAMPLE,
    SIGNALS,
    Corrections,
    Gap,
    Observer,
    Run,
    calibration_while_running,
    check_corrections,
    checked_descriptions,
    corrected,
    not_armed,
    nothing_loaded,
    unexpected_set_points,
)
from tissueid.instrument.limits import Limits, check_command, check_limits, check_stimulus
from tissueid.instrument.replies import released_by_faults
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.wire import Fault, Flag

RAMP_S = 0.05
"""Duration of the ramp to the held level, and to zero at the end of a run, s."""

FADE_S = 0.005
"""Duration of the fade from the held level back to the set-points, s."""

STARVED_S = 0.5
"""Time without set-points after which the run ends, s."""

SOFT_START_S = 0.05
"""Duration of the soft start, s: the bound on the command rises as a quarter sine to the peak of this time."""

# Plain numbers: operations on members of an enumeration take most of the time of a block.
_PLAYED, _HELD, _SOFTENED = int(Flag.PLAYING | Flag.ENERGISED), int(Flag.HELD), int(Flag.SOFT_START)


class Playback:
    """One run of ``stimulus``, shape (n,), V, and ``following`` set-points (docs/protocol.md, 4.5 and 5)."""

    def __init__(
        self, stimulus: NDArray[np.float64], sample_rate_hz: float, following: int = 0, hold_v: float = 0.0
    ) -> None:
        # NaN: a set-point that has not arrived.
        self._volts = np.concatenate((stimulus, np.full(following, np.nan)))
        self._first = stimulus.size
        self._length = self._volts.size
        self._hold_v = hold_v
        self._ramp, self._fade, self._starved_after = (
            max(1, round(seconds * sample_rate_hz)) for seconds in (RAMP_S, FADE_S, STARVED_S)
        )
        self._soft = max(1, round(SOFT_START_S * sample_rate_hz))
        self._peak_v = float(np.abs(stimulus[: self._soft]).max(initial=0.0))
        self._cursor = 0
        self._present_v = self._from_v = 0.0
        self._holding = self._fading = self._missing = 0
        self.late_blocks = self.held_samples = 0

    @property
    def first(self) -> int:
        """Index of the first set-point in the run."""
        return self._first

    @property
    def planned(self) -> int:
        """Samples of the stimulus and of all announced set-points."""
        return self._volts.size

    @property
    def played(self) -> int:
        """Samples played so far, without the soft release."""
        return min(self._cursor, self._length)

    @property
    def over(self) -> bool:
        """Whether the soft release is complete."""
        return self._cursor >= self._length + self._ramp

    @property
    def starved(self) -> bool:
        """Whether set-points have been missing for ``STARVED_S``."""
        return self._missing >= self._starved_after

    def take(self, offset: int, volts: NDArray[np.float64]) -> None:
        """Add set-points, shape (k,), V, for the samples from ``offset``; those that are too late are dropped."""
        self.late_blocks += offset < self._cursor
        wanted = volts[max(0, self._cursor - offset) :]
        self._volts[offset + volts.size - wanted.size : offset + volts.size] = wanted
        if wanted.size:
            self._missing = 0

    def finish(self) -> int:
        """End the run and return the number of samples played."""
        self._length = self.played
        return self._length

    def block(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.uint16]]:
        """Return the next ``count`` commands, V, and their flags, both of shape (count,); zeros after the end."""
        commands, flags = np.zeros(count), np.zeros(count, np.uint16)
        inside = max(0, min(count, self._length - self._cursor))
        volts, sources = [], []
        for number, wanted_v in enumerate(self._volts[self._cursor : self._cursor + inside].tolist(), self._cursor):
            held = self._hold() if math.isnan(wanted_v) else self._follow(wanted_v)
            softened = self._soften(number)
            volts.append(self._present_v)
            sources.append(_PLAYED | (_HELD if held else 0) | (_SOFTENED if softened else 0))
            self.held_samples += held
        commands[:inside], flags[:inside] = volts, sources
        if inside == count:
            self._cursor += count
            return commands, flags
        done = self._cursor + np.arange(inside, count) - self._length  # samples of the release before each
        ramp = done < self._ramp
        commands[inside:][ramp] = self._present_v * (1.0 - (done[ramp] + 1.0) / self._ramp)
        flags[inside:][ramp] = int(Flag.ENERGISED)
        self._cursor += count
        return commands, flags

    def _soften(self, number: int) -> bool:
        """Limit the command of sample ``number`` to the curve of the soft start; return whether that lowered it."""
        if number >= self._soft - 1:
            return False
        share = math.sin(0.5 * math.pi * (number + 1) / self._soft)
        most_v = share * max(self._peak_v, abs(self._present_v))
        if abs(self._present_v) <= most_v * (1.0 + 1e-9):
            return False
        self._present_v = math.copysign(most_v, self._present_v)
        return True

    def _hold(self) -> bool:
        """Ramp to the held level for one sample; return True."""
        if self._holding == 0:
            self._from_v = self._present_v
        self._fading = 0
        self._holding = min(self._holding + 1, self._ramp)
        self._missing += 1
        self._present_v = self._from_v + (self._hold_v - self._from_v) * self._holding / self._ramp
        return True

    def _follow(self, wanted_v: float) -> bool:
        """Play the set-point of one sample; return whether it is still fading back from the held level."""
        self._missing = 0
        if self._holding:
            self._from_v, self._holding, self._fading = self._present_v, 0, self._fade
        share = 1.0 - self._fading / (self._fade + 1)
        self._present_v = self._from_v + (wanted_v - self._from_v) * share if self._fading else wanted_v
        faded = self._fading > 0
        self._fading = max(0, self._fading - 1)
        return faded


BLOCK = 20
"""Samples that one poll delivers."""


class HostPlayedInstrument(ABC):
    """Playing, limits and checks of an instrument without firmware. Every poll returns the next ``BLOCK`` samples.

    Args:
        device: properties of the instrument.
        winding: whether to calculate the temperature of the coil.
    """

    def __init__(self, device: DeviceDescription, *, winding: bool) -> None:
        self.device = self.nominal = device
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        self._checks = SampleMonitor(device, winding=winding)
        self._corrections: Corrections = {}
        self.command = np.zeros(0)
        self._following = 0
        self._hold_v = 0.0
        self._playback = Playback(self.command, device.sample_rate_hz)
        self._limits: Limits | None = None
        self.current_run: Run | None = None
        self._index = 0
        self.energised = False

    @abstractmethod
    def _exchange(self, samples: NDArray[np.void]) -> None:
        """Play the commands of ``samples``, shape (BLOCK,) of SAMPLE, and fill in the other signals."""

    @abstractmethod
    def _coil_c(self) -> NDArray[np.float64]:
        """Return the newest readings of the temperature sensor of the coil, degC, shape (k,)."""

    @abstractmethod
    def _run_begins(self) -> None:
        """Prepare what changes from run to run."""

    def _run_is_over(self, run: Run) -> bool:
        """Whether the checks of a run end."""
        return self._index >= run.end_index

    def use_calibration(self, device: DeviceDescription, corrections: Corrections) -> None:
        """Use the device description and channel corrections of a calibration.

        Raises:
            InstrumentError: a test is armed or running, or a channel does not exist.
        """
        if self._limits is not None or self.current_run is not None:
            raise calibration_while_running()
        self._corrections = check_corrections(corrections, SIGNALS)
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Load a stimulus, shape (n,), V."""
        self.command = np.asarray(command_v, np.float64)
        self._following = 0

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points of the newest run that arrived too late."""
        return self._playback.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples of the newest run that were held because their set-point was missing."""
        return self._playback.held_samples

    @property
    def setpoint_margin_s(self) -> float | None:
        """None: there is no cable."""
        return None

    def follow(self, samples: int, hold_v: float) -> None:
        """Announce ``samples`` set-points that will be sent during the next run, after the loaded stimulus.

        Raises:
            InstrumentError: nothing is loaded.
        """
        if not self.command.size:
            raise nothing_loaded()
        self._following, self._hold_v = samples, hold_v

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Add set-points, shape (k,), V, for the samples of the run from ``offset``.

        Raises:
            LimitError: a limit would be exceeded.
            InstrumentError: these set-points were not announced by ``follow``.
        """
        end = offset + command_v.size
        if self._limits is None or not self._playback.first <= offset < end <= self._playback.planned:
            raise unexpected_set_points(offset, end)
        for description in checked_descriptions(self.nominal, self.device):
            check_command(command_v, description, self._limits)
        self._playback.take(offset, command_v)

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``: the instrument has none of its own."""
        return limits

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run.

        Raises:
            LimitError: the stimulus would exceed them.
        """
        check_limits(limits, self.nominal)
        for description in checked_descriptions(self.nominal, self.device):
            check_stimulus(self.command, description, limits, self._following)
            if self._following:
                check_command(np.array([self._hold_v]), description, limits)
        self._checks.arm(self._coil_c(), limits)
        self._limits = limits
        self._playback = Playback(self.command, self.device.sample_rate_hz, self._following, self._hold_v)
        self._following = 0
        self.energised = False

    def start(self) -> Run:
        """Play the stimulus from the next poll on.

        Raises:
            InstrumentError: not armed.
        """
        if self._limits is None:
            raise not_armed()
        self.current_run = Run(self._index, self._playback.planned)
        self.energised = True
        self._run_begins()
        return self.current_run

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return the next block, shape (20,) of SAMPLE.

        Raises:
            LimitError, InstrumentError: a check of the samples failed; the coil is released.
        """
        del timeout_s
        samples = np.zeros(BLOCK, SAMPLE)
        samples["index"] = self._index + np.arange(BLOCK)
        if self.energised:
            samples["command"], samples["flags"] = self._playback.block(BLOCK)
            self.energised = not self._playback.over
        self._exchange(samples)
        self._index += BLOCK
        read, samples = samples, corrected(samples, self._corrections)
        try:
            calibrated = None if self.device is self.nominal else (samples, self.device)
            self._checks.check(read, None if self.current_run is None else self._limits, self.current_run, calibrated)
        except TissueIDError:
            self.release()
            raise
        if self.current_run is not None:
            if self._playback.starved:
                self.release()
                raise released_by_faults(Fault.STARVED)
            if self._run_is_over(self.current_run):
                self.current_run = None
                self._limits = None
        if self.observer is not None:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played."""
        played = self._playback.finish()
        if self.current_run is None:
            self._limits = None
        else:
            self.current_run = Run(self.current_run.first_index, played)
        return played

    def release(self) -> None:
        """Release the coil: the command is zero from the next sample."""
        self.current_run = None
        self._limits = None
        self.energised = False

    def close(self) -> None:
        """Release."""
        self.release()
