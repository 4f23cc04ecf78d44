"""A saved test, played back as if an instrument were measuring it again."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, UnusableInputError
from tissueid.instrument.correction import Correction
from tissueid.instrument.interface import SAMPLE, SIGNALS, Gap, Observer, Run
from tissueid.instrument.limits import Limits
from tissueid.wire import Flag

BLOCK = 20


class ReplayInstrument:
    """Delivers recorded signals in blocks of 20 samples. What is loaded is ignored but for its length.

    ``signals`` maps names to arrays of shape (n,), SI, as ``sessions.Test.signals`` does; a signal that the
    record lacks is delivered as NaN.

    Raises:
        UnusableInputError: there is nothing to replay.
    """

    def __init__(self, device: DeviceDescription, signals: Mapping[str, NDArray[np.float64]]) -> None:
        self.device = self.nominal = device
        self.gaps: list[Gap] = []
        self.observer: Observer | None = None
        self.late_blocks = self.held_samples = 0
        self.setpoint_margin_s: float | None = None
        usable = {name: signals[name] for name in SIGNALS if name in signals}
        if not usable:
            raise UnusableInputError("the record has no signal that an instrument delivers")
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
            InstrumentError: what was recorded went by the calibration that was in force then.
        """
        raise InstrumentError("a replay keeps the calibration that was in force when it was recorded")

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Take note of how many samples are wanted; no more than were recorded."""
        self._loaded = min(command_v.size, self._samples.size)

    def follow(self, samples: int, hold_v: float) -> None:
        """Refuse.

        Raises:
            InstrumentError: what was recorded does not answer.
        """
        raise InstrumentError("a replay plays what was recorded: it takes no stimulus that is made while it runs")

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Refuse.

        Raises:
            InstrumentError: what was recorded does not answer.
        """
        raise InstrumentError("a replay plays what was recorded: it takes no set-points")

    def finish(self) -> int:
        """End the replay here; returns how many samples were delivered."""
        self._running = False
        return min(self._cursor, self._loaded)

    def narrowed(self, limits: Limits) -> Limits:
        """These limits: it has none of its own."""
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
            raise InstrumentError("load and arm before starting")
        self._cursor, self._armed, self._running = 0, False, True
        return Run(0, self._loaded)

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """The next block at once, shape (k,) of SAMPLE; none when the run is over."""
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
        """False: a replay has no stage."""
        del position_m
        return False

    def release(self) -> None:
        """End the replay."""
        self._armed = self._running = False

    def close(self) -> None:
        """End the replay."""
        self.release()
