"""Instrument that plays back a saved test."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.instrument.interface import SAMPLE, SIGNALS, Correction, Gap, Observer, Run, not_armed
from tissueid.instrument.limits import Limits
from tissueid.wire import Flag

BLOCK = 20
"""Samples that one poll delivers."""


class ReplayInstrument:
    """Delivers recorded signals in blocks of ``BLOCK`` samples. Only the length of a loaded stimulus matters.

    Args:
        device: the device of the recording.
        signals: arrays of shape (n,), SI, by name, as in ``sessions.Test.signals``; missing signals are NaN.

    Raises:
        UnusableInputError: the recording has no signal of an instrument.
    """

    def __init__(self, device: DeviceDescription, signals: Mapping[str, NDArray[np.float64]]) -> None:
        self.device = self.nominal = device
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        self.late_blocks = self.held_samples = 0
        self.setpoint_margin_s: float | None = None
        usable = {name: signals[name] for name in SIGNALS if name in signals}
        if not usable:
            raise UnusableInputError("replay.no_signal", "the recording has no signal that an instrument delivers")
        length = next(iter(usable.values())).size
        self._samples = np.zeros(length, SAMPLE)
        self._samples["index"] = np.arange(length)
        self._samples["flags"] = Flag.PLAYING | Flag.ENERGISED
        for name in SIGNALS:
            self._samples[name] = usable.get(name, np.nan)
        self._cursor = 0
        self._loaded = 0
        self._armed = self._running = False

    def use_calibration(self, device: DeviceDescription, corrections: Mapping[str, Correction]) -> None:
        """Refuse.

        Raises:
            InstrumentError: always.
        """
        raise InstrumentError("replay.calibration", "a replay keeps the calibration of its recording")

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Set the number of samples to play: those of the stimulus, at most those of the recording."""
        self._loaded = min(command_v.size, self._samples.size)

    def follow(self, samples: int, hold_v: float) -> None:
        """Refuse.

        Raises:
            InstrumentError: always.
        """
        raise InstrumentError(
            "replay.feedback", "a replay plays a recording: it takes no stimulus that is made while it runs"
        )

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Refuse.

        Raises:
            InstrumentError: always.
        """
        raise InstrumentError("replay.set_points", "a replay plays a recording: it takes no set-points")

    def finish(self) -> int:
        """End the replay and return the number of samples delivered."""
        self._running = False
        return min(self._cursor, self._loaded)

    def effective_limits(self, limits: Limits) -> Limits:
        """Return ``limits``: a replay has none of its own."""
        return limits

    def arm(self, limits: Limits) -> None:
        """Accept: nothing moves in a replay."""
        del limits
        self._armed = self._loaded > 0

    def start(self) -> Run:
        """Play from the first recorded sample.

        Raises:
            InstrumentError: not loaded and armed.
        """
        if not self._armed:
            raise not_armed()
        self._cursor, self._armed, self._running = 0, False, True
        return Run(0, self._loaded)

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """Return the next block without waiting, shape (k,) of SAMPLE; empty when the run is over."""
        del timeout_s
        if not self._running:
            return np.zeros(0, SAMPLE)
        block = self._samples[self._cursor : min(self._cursor + BLOCK, self._loaded)].copy()
        self._cursor += block.size
        self._running = self._cursor < self._loaded
        if self.observer is not None and block.size:
            self.observer(block)
        return block

    def move_stage(self, position_m: float | None) -> bool:
        """Return False: a replay has no stage."""
        del position_m
        return False

    def release(self) -> None:
        """End the replay."""
        self._armed = self._running = False

    def close(self) -> None:
        """End the replay."""
        self.release()
