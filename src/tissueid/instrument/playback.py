"""Playback of a run in this process: stimulus, set-points, held level where they are missing, soft release."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.wire import Flag

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
