"""Set-points: a stimulus that the host generates while it is played, and its replacement when the host is late.

Specified in ``docs/protocol.md``, section 4.5. This module only counts samples; it has no frames, states or clocks.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.wire import Result

BUFFER_SAMPLES = 8192
"""Capacity of the buffer ahead of the played sample: 4 s at 2 kHz."""

HOLD_RAMP_S = 0.05
FADE_S = 0.005
STARVED_S = 0.5


class Setpoints:
    """The set-points of one run: those from ``first`` to ``end``, counted from the first sample of the stimulus.

    ``agree`` sets their number, ``begin`` clears the buffer for a run, ``take`` fills it, ``play`` empties it sample by
    sample. ``late_blocks`` is reset by the next run.
    """

    def __init__(self, sample_rate_hz: float) -> None:
        self._hold_ramp = round(HOLD_RAMP_S * sample_rate_hz)
        self._fade = round(FADE_S * sample_rate_hz)
        self._starved = round(STARVED_S * sample_rate_hz)
        # Ring buffer: sample k is stored at k modulo its length.
        self._volts = np.zeros(BUFFER_SAMPLES)
        self._known = np.zeros(BUFFER_SAMPLES, dtype=bool)
        self.samples = 0
        self.hold_v = 0.0
        self.begin(0)

    def agree(self, samples: int, hold_v: float) -> None:
        """Agree on ``samples`` set-points after the stimulus; missing ones are replaced by a ramp to ``hold_v``."""
        self.samples, self.hold_v = samples, hold_v

    def begin(self, first: int) -> None:
        """Start a run whose stimulus has ``first`` samples."""
        self.first, self.end = first, first + self.samples
        self._known[:] = False
        self.late_blocks = 0
        self._missing = 0
        self._holding = 0
        self._fading = 0
        self._from = 0.0

    @property
    def starved(self) -> bool:
        """Whether set-points have been missing for so long that the run must end."""
        return self._missing >= self._starved

    def next_missing(self, cursor: int) -> int:
        """Return the first sample from ``cursor`` on that is still missing; ``end`` if there is none."""
        start = max(cursor, self.first)
        stop = min(start + BUFFER_SAMPLES, self.end)
        samples = np.arange(start, stop)
        missing = samples[~self._known[samples % BUFFER_SAMPLES]]
        return int(missing[0]) if missing.size else stop

    def take(self, offset: int, volts: NDArray[np.float64], cursor: int) -> Result:
        """Store set-points, shape (k,), V, for the samples from ``offset`` on; ``cursor`` is the next sample to be
        played.
        """
        end, wanted_from = offset + volts.size, max(cursor, self.first)
        if volts.size == 0 or offset < self.first or end > self.end:
            return Result.BAD_ARGUMENT
        if end > wanted_from + BUFFER_SAMPLES:
            return Result.TOO_LARGE
        wanted = volts[max(0, wanted_from - offset) :]
        if wanted.size:
            place = np.arange(end - wanted.size, end) % BUFFER_SAMPLES
            self._volts[place] = wanted
            self._known[place] = True
            self._missing = 0
        if offset < wanted_from:
            self.late_blocks += 1
            return Result.LATE
        return Result.OK

    def play(self, cursor: int, count: int, present_v: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return volts for the samples from ``cursor`` on, and the mask of held samples; both of shape (count,).

        ``present_v`` is the previous command. Fewer than ``count`` samples are returned if the run is starved at the
        last one.
        """
        volts, held = np.empty(count), np.zeros(count, dtype=bool)
        for k in range(count):
            place = (cursor + k) % BUFFER_SAMPLES
            if self._known[place]:
                self._known[place] = False
                present_v, held[k] = self._resume(float(self._volts[place]))
                self._missing = 0
            else:
                present_v, held[k] = self._hold(present_v), True
                self._missing += 1
            volts[k] = present_v
            if self.starved:
                volts, held = volts[: k + 1], held[: k + 1]
                break
        return volts, held

    def _hold(self, present_v: float) -> float:
        """Return the command of one sample without a set-point: on the ramp to the hold level, or at it."""
        if self._holding == 0:
            self._from = present_v
        self._holding = min(self._holding + 1, self._hold_ramp)
        self._fading = 0
        return self._from + (self.hold_v - self._from) * self._holding / self._hold_ramp

    def _resume(self, wanted_v: float) -> tuple[float, bool]:
        """Return the command of one sample with a set-point; after a hold it is faded in without a jump."""
        if self._holding:
            self._from += (self.hold_v - self._from) * self._holding / self._hold_ramp
            self._holding, self._fading = 0, self._fade
        if self._fading == 0:
            return wanted_v, False
        share = 1.0 - self._fading / (self._fade + 1)
        self._fading -= 1
        return self._from + (wanted_v - self._from) * share, True
