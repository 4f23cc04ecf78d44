"""Whether arriving samples can be true: a position that answers the force, a current that answers the voltage.

Judged in blocks of 10 ms, too short for the coil's mass to be still where it is pushed, long enough for the converters'
noise to vanish. The firmware judges on its own (docs/protocol.md, section 5).
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError

BLOCK_S = 0.01

POSITION_BLOCKS = 10
FROZEN_SWING_N = 0.3
"""Change of force over 100 ms by which a live position reading moves at all."""

STILL_SWING_N, STILL_M = 3.0, 6.0e-6
"""Change of force over 100 ms by which the probe moves further than this on anything but a broken sensor."""

JUMP_M_PER_S = 10.0
"""Faster than twice what the coil's whole force makes of its whole stroke."""

COIL_BLOCKS = 2
OPEN_VOLTS, OPEN_SHARE = 2.0, 0.15
"""From this voltage on, over 20 ms, less than this share of the current that it should drive: the coil is open."""

CURRENT_BLOCKS, CURRENT_SWING_V = 5, 1.0

STUCK_POSITION = "the position sensor does not move although the force does: check its plug and cable"
JUMPING_POSITION = "the position jumps further than the probe can go: check the position sensor's plug and cable"
DEAD_COIL = "the coil's current does not follow the voltage: check the coil's plug and cable"

_COLUMNS = ("command", "voltage", "current", "position")


class Plausibility:
    """Judges the samples of one run after another, as they arrive. Blocks with lost samples in them are passed over.

    ``begin`` forgets the run before. ``at_low_end`` says that the probe may lean on the near end of its stroke, where
    the position's converter ends as well.
    """

    def __init__(self, device: DeviceDescription) -> None:
        self._block = max(1, round(BLOCK_S * device.sample_rate_hz))
        self._jump_m = JUMP_M_PER_S / device.sample_rate_hz
        self._resistance_ohm = device.coil_resistance_ohm
        self._force_constant = device.force_constant_n_per_a
        self.begin()

    def begin(self, *, at_low_end: bool = False) -> None:
        """A run begins."""
        self._at_low_end = at_low_end
        self._pending = np.zeros((0, len(_COLUMNS)))
        # One row for each block seen: means of command, voltage, current and position, as they are and without sign
        # where that is asked for, and the extremes of current and position.
        self._seen: deque[dict[str, float]] = deque(maxlen=POSITION_BLOCKS)
        self._last_m = np.nan

    def take(self, samples: NDArray[np.void]) -> None:
        """Samples of the run, shape (k,), each once and in their order.

        Raises:
            InstrumentError: says what cannot be, and what to look at.
        """
        if samples.size == 0:
            return
        position = np.append(self._last_m, samples["position"])
        self._last_m = float(position[-1])
        if np.any(np.abs(np.diff(position)) > self._jump_m):  # beside a lost sample the difference is NaN: no jump
            raise InstrumentError(JUMPING_POSITION)
        rows = np.stack([samples[name] for name in _COLUMNS], axis=1)
        self._pending = np.concatenate((self._pending, rows))
        while self._pending.shape[0] >= self._block:
            block, self._pending = self._pending[: self._block], self._pending[self._block :]
            if np.isfinite(block).all():
                self._seen.append(_summary(block))
                self._judge_position()
                self._judge_current()

    def _judge_position(self) -> None:
        if len(self._seen) < POSITION_BLOCKS:
            return
        low, high = min(row["lowest_m"] for row in self._seen), max(row["highest_m"] for row in self._seen)
        if self._at_low_end and low <= 0.0:
            return
        swing = _spread([row["current"] for row in self._seen]) * self._force_constant
        frozen = low == high and swing >= FROZEN_SWING_N
        still = _spread([row["position"] for row in self._seen]) <= STILL_M and swing >= STILL_SWING_N
        if frozen or still:
            raise InstrumentError(STUCK_POSITION)

    def _judge_current(self) -> None:
        newest = list(self._seen)[-COIL_BLOCKS:]
        asked, measured, drawn = (
            sum(row[name] for row in newest) / len(newest) for name in ("asked_v", "measured_v", "drawn_a")
        )
        weak = drawn * self._resistance_ohm < OPEN_SHARE * measured
        if len(newest) == COIL_BLOCKS and min(asked, measured) >= OPEN_VOLTS and weak:
            raise InstrumentError(DEAD_COIL)
        newest = list(self._seen)[-CURRENT_BLOCKS:]
        frozen = min(row["lowest_a"] for row in newest) == max(row["highest_a"] for row in newest)
        swing = _spread([row["voltage"] for row in newest])
        if len(newest) == CURRENT_BLOCKS and frozen and swing >= CURRENT_SWING_V:
            raise InstrumentError(DEAD_COIL)


def _spread(few: list[float]) -> float:
    # Of a handful of numbers; numpy takes ten times as long to begin.
    return max(few) - min(few)


def _summary(block: NDArray[np.float64]) -> dict[str, float]:
    """10 ms in a few numbers. All columns at a time: this is done a hundred times a second, and more in simulation."""
    columns = np.ascontiguousarray(block.T)
    _, voltage, current, position = columns.mean(axis=1).tolist()
    asked, measured, drawn, _ = np.abs(columns).mean(axis=1).tolist()
    _, _, lowest_a, lowest_m = columns.min(axis=1).tolist()
    _, _, highest_a, highest_m = columns.max(axis=1).tolist()
    return {
        "asked_v": asked,
        "measured_v": measured,
        "drawn_a": drawn,
        "voltage": voltage,
        "current": current,
        "position": position,
        "lowest_a": lowest_a,
        "highest_a": highest_a,
        "lowest_m": lowest_m,
        "highest_m": highest_m,
    }
