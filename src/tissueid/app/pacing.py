"""An instrument without a clock of its own, held to real time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.instrument import Instrument, Limits, Observer, Run
from tissueid.instrument.correction import Correction

Wait = Callable[[float], object]
"""Waits for so many seconds, or less when there is a reason to."""


class PacedInstrument:
    """An instrument without a clock of its own, held to real time so that people can watch.

    ``wait`` is called with the seconds by which the samples are ahead; ``clock`` gives seconds that never go back.
    """

    def __init__(self, paced: Instrument, wait: Wait, clock: Callable[[], float] = time.monotonic) -> None:
        self.nominal, self.device, self.gaps = paced.nominal, paced.device, paced.gaps
        self._paced = paced
        self._wait = wait
        self._clock = clock
        self._started = clock()
        self._delivered = 0

    @property
    def observer(self) -> Observer | None:
        """What gets the samples of every poll too."""
        return self._paced.observer

    @observer.setter
    def observer(self, observer: Observer | None) -> None:
        self._paced.observer = observer

    def use_calibration(self, device: DeviceDescription, corrections: Mapping[str, Correction]) -> None:
        """Pass a calibration on."""
        self._paced.use_calibration(device, corrections)
        self.device = self._paced.device

    def load(self, command_v: NDArray[np.float64]) -> None:
        """Pass the stimulus on."""
        self._paced.load(command_v)

    @property
    def late_blocks(self) -> int:
        """Blocks of set-points that came after their time."""
        return self._paced.late_blocks

    @property
    def held_samples(self) -> int:
        """Samples whose set-point was missing."""
        return self._paced.held_samples

    @property
    def setpoint_margin_s(self) -> float | None:
        """Least time by which a block was there before it was played."""
        return self._paced.setpoint_margin_s

    def follow(self, samples: int, hold_v: float) -> None:
        """Pass on that set-points will follow."""
        self._paced.follow(samples, hold_v)

    def send(self, offset: int, command_v: NDArray[np.float64]) -> None:
        """Pass set-points on."""
        self._paced.send(offset, command_v)

    def finish(self) -> int:
        """Pass on that the run ends here."""
        return self._paced.finish()

    def narrowed(self, limits: Limits) -> Limits:
        """The limits that hold."""
        return self._paced.narrowed(limits)

    def arm(self, limits: Limits) -> None:
        """Pass the limits on."""
        self._paced.arm(limits)

    def start(self) -> Run:
        """Play; from now on samples come in real time."""
        self._started, self._delivered = self._clock(), 0
        return self._paced.start()

    def poll(self, timeout_s: float) -> NDArray[np.void]:
        """The next samples, at the moment when the last of them is due."""
        samples = self._paced.poll(timeout_s)
        self._delivered += samples.size
        ahead = self._started + self._delivered / self.device.sample_rate_hz - self._clock()
        if ahead > 0.0:
            self._wait(ahead)
        return samples

    def move_stage(self, position_m: float | None) -> bool:
        """Pass on where the stage is to bring what lies under the probe."""
        return self._paced.move_stage(position_m)

    def release(self) -> None:
        """Free the coil."""
        self._paced.release()

    def close(self) -> None:
        """Release, and let go."""
        self._paced.close()
