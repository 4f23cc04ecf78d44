"""Playback, sample by sample: soft start, stimulus, set-points and soft release."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_sim.setpoints import Setpoints
from firmware_sim.soft_start import SoftStart
from tissueid.wire import Flag

RELEASE_RAMP_S = 0.05


class Player:
    """One run after another. ``begin`` sets up a run, ``command`` returns the next commands, ``account`` advances it.

    ``cursor`` counts the samples of the run, including those of the release; ``length`` is where the release begins.
    """

    def __init__(self, setpoints: Setpoints, sample_rate_hz: float, step_v: float) -> None:
        self.ramp_samples = round(RELEASE_RAMP_S * sample_rate_hz)
        self._setpoints = setpoints
        self._soft_start = SoftStart(sample_rate_hz, step_v)
        self.begin(np.zeros(0), 0)

    def begin(self, stimulus_v: NDArray[np.float64], length: int) -> None:
        """Set up a run of a stimulus, shape (n,), V, that has ``length`` samples including its set-points."""
        self.stimulus_v = stimulus_v
        self._soft_start.begin(stimulus_v)
        self._setpoints.begin(stimulus_v.size)
        self.cursor, self.length = 0, length
        self.held_samples = 0
        self._present_v = 0.0

    @property
    def played(self) -> int:
        """Number of played samples of the newest run, without those of the release."""
        return min(self.cursor, self.length)

    @property
    def releasing(self) -> bool:
        """Whether all samples of the run itself have been played."""
        return self.cursor >= self.length

    @property
    def over(self) -> bool:
        """Whether the release has ended."""
        return self.cursor >= self.length + self.ramp_samples

    def finish(self) -> None:
        """End the run at the present sample."""
        self.length = self.played

    def command(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.uint16]]:
        """Return volts for up to ``count`` samples, and the flags of their source."""
        if self.releasing:
            done = self.cursor - self.length
            count = min(count, self.ramp_samples - done)
            weight = 1.0 - (done + 1.0 + np.arange(count)) / self.ramp_samples
            return self._present_v * weight, np.zeros(count, np.uint16)
        count = min(count, self.length - self.cursor)
        if self.cursor < self.stimulus_v.size:
            wanted = self.stimulus_v[self.cursor : self.cursor + count]
            flags = np.full(wanted.size, Flag.PLAYING, np.uint16)
        else:
            wanted, held = self._setpoints.play(self.cursor, count, self._present_v)
            flags = np.where(held, Flag.PLAYING | Flag.HELD, Flag.PLAYING).astype(np.uint16)
        volts, softened = self._soft_start.play(wanted, self.cursor)
        return volts, flags | np.where(softened, Flag.SOFT_START, 0).astype(np.uint16)

    def account(self, command: NDArray[np.float64], flags: NDArray[np.uint16]) -> None:
        """Advance the run by the samples that were played."""
        if not self.releasing:
            self._present_v = float(command[-1])
        self.cursor += command.size
        self.held_samples += int(np.count_nonzero(flags & Flag.HELD))
