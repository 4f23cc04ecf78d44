"""Playback of a run in this process: stimulus, set-points, held level where they are missing, soft release."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

import tissueid.wire as wire
from tissueid.device import DeviceDescription
from tissueid.instrument import run_machine as machine
from tissueid.instrument.interface import (
    SAMPLE,
    SIGNALS,
    Corrections,
    Gap,
    Observer,
    Run,
    check_corrections,
    corrected,
    not_armed,
)
from tissueid.instrument.limits import Limits
from tissueid.instrument.run_machine import Mode, RunState
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.wire import Fault, Flag, MessageType, Result

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
    """An instrument without firmware: this process plays. Every poll returns the next ``BLOCK`` samples.

    ``state`` is that of the machine (:mod:`tissueid.instrument.run_machine`), whose requests are carried out here.

    Args:
        device: properties of the instrument.
        winding: whether to calculate the temperature of the coil.
        tail: number of samples after a run until its checks end.
        temperature_c: readings of the temperature sensor before the first samples, shape (k,), degC.
    """

    def __init__(
        self, device: DeviceDescription, *, winding: bool, tail: int = 0, temperature_c: NDArray[np.float64]
    ) -> None:
        self.device = self.nominal = device
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        checks = SampleMonitor(device, winding=winding)
        self.state = RunState(
            device.model, Mode.FREE, nominal=device, checks=checks, tail=tail, temperature_c=temperature_c
        )
        self.energised = False
        self._playback = Playback(np.zeros(0), device.sample_rate_hz)
        self._index = 0
        self._answer = machine.GiveAnswer()

    @abstractmethod
    def _exchange(self, samples: NDArray[np.void]) -> None:
        """Play the commands of ``samples``, shape (BLOCK,) of SAMPLE, and fill in the other signals."""

    @abstractmethod
    def _run_begins(self) -> None:
        """Prepare what changes from run to run."""

    def _coil_off(self) -> None:
        """Release the coil: the command is zero from the next sample."""
        self.energised = False

    @property
    def current_run(self) -> Run | None:
        """The run that is played; None between two runs."""
        return self.state.run

    def use_calibration(self, device: DeviceDescription, corrections: Corrections) -> None:
        """Use the device description and channel corrections of a calibration.

        Raises:
            InstrumentError: a test is armed or running, or a channel does not exist.
        """
        self._do(machine.CalibrationChosen(self._now, device, check_corrections(corrections, SIGNALS)))
        self.device = device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Load a stimulus, shape (n,), V."""
        self._do(machine.LoadAsked(self._now, np.asarray(command_v, np.float64)))

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
        self._do(machine.FollowAsked(self._now, samples, hold_v))

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Add set-points, shape (k,), V, for the samples of the run from ``offset``.

        Raises:
            LimitError: a limit would be exceeded.
            InstrumentError: these set-points were not announced by ``follow``.
        """
        self._do(machine.SetPointsGiven(self._now, offset, command_v))
        self._playback.take(offset, command_v)

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``: the instrument has none of its own."""
        return limits

    def arm(self, limits: Limits) -> None:
        """Set the limits of the next run; release the coil if a run is not over.

        Raises:
            LimitError: the stimulus would exceed them.
        """
        if self.state.run is not None:
            self.release()
        self._do(machine.ArmAsked(self._now, limits))

    def start(self) -> Run:
        """Play the stimulus from the next poll on.

        Raises:
            InstrumentError: not armed.
        """
        if self.state.mode is not Mode.ARMED:
            raise not_armed()
        self._do(machine.StartAsked(self._now))
        return Run(self._index, self._playback.planned)

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
        self._do(machine.SamplesTaken(self._now, samples))
        if self._playback.starved and self.state.run is not None:
            self._report(Fault.STARVED)
        if (error := self.state.error) is not None:
            self._do(machine.ClearAsked(self._now))
            self._report(Fault.NONE)
            raise error
        samples = corrected(samples, self.state.corrections)
        if self.observer is not None:
            self.observer(samples)
        return samples

    def finish(self) -> int:
        """End the run now by its soft release, and return the number of samples played."""
        self._do(machine.FinishAsked(self._now))
        return self._answer.detail

    def release(self) -> None:
        """Release the coil: the command is zero from the next sample."""
        self._do(machine.StopAsked(self._now))

    def close(self) -> None:
        """Release."""
        self.release()

    @property
    def _now(self) -> float:
        """The time by the samples, s: the machine waits for nothing here."""
        return self._index / self.nominal.sample_rate_hz

    def _do(self, event: machine.RunEvent) -> None:
        """Let an event happen, and carry out the actions and requests that follow from it.

        Raises:
            TissueIDError: what is asked for is not possible.
        """
        self.state, actions = machine.step(self.state, event)
        for action in actions:
            match action:
                case machine.SendFrame(kind=kind) if kind is not MessageType.HEARTBEAT:
                    self._confirm(action, self._carry_out(kind))
                case machine.ReleaseCoil():
                    self._coil_off()
                    if action.stop is not None:
                        self._confirm(action.stop, 0)
                case machine.GiveAnswer():
                    self._answer = action
                    if action.error is not None:
                        raise action.error

    def _carry_out(self, kind: MessageType) -> int:
        """Carry out a request and return the detail of its answer."""
        if kind is MessageType.ARM:
            state = self.state
            self._playback = Playback(state.command_v, self.device.sample_rate_hz, state.following, state.hold_v)
        elif kind is MessageType.START:
            self._run_begins()
            self.energised = True
            return self._index
        elif kind is MessageType.FINISH:
            return self._playback.finish()
        return 0

    def _confirm(self, request: machine.SendFrame, detail: int) -> None:
        """Give the machine the answer to a request."""
        fields = {"request_type": request.kind, "request_sequence": request.sequence, "result": Result.OK}
        payload = wire.pack(wire.ACK, detail=detail, **fields)
        frame = wire.Frame(MessageType.ACK, sample_index=self._index, payload=payload)
        self._do(machine.FrameReceived(self._now, frame))

    def _report(self, faults: Fault) -> None:
        """Give the machine a STATUS with these faults."""
        fields = dict.fromkeys(wire.STATUS.names or (), 0) | {"faults": faults}
        frame = wire.Frame(MessageType.STATUS, sample_index=self._index, payload=wire.pack(wire.STATUS, **fields))
        self._do(machine.FrameReceived(self._now, frame))
