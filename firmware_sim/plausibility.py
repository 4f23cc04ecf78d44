"""Plausibility of the sensors: position against force, and current against voltage (docs/protocol.md, section 5).

Samples are checked in blocks of 10 ms during a run. A mean over 10 ms is insensitive to components too fast to move a
mass, and to converter noise; a code that does not change for that long cannot come from a working sensor.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.converters import CODE_MAX, CODE_MIN
from tissueid.wire import Fault

BLOCK_S = 0.01

FROZEN_BLOCKS = 10
"""A position code frozen for 100 ms while the force changes by FROZEN_SWING_N is a sensor fault."""
FROZEN_SWING_N = 0.3

STILL_SWING_N, STILL_M = 3.0, 6.0e-6
"""A position within STILL_M for 100 ms while the force changes by STILL_SWING_N is a sensor fault: 5e5 N/m is stiffer
than any tissue, rubber or end stop.
"""

JUMP_M_PER_S = 10.0
"""Largest plausible speed: the coil cannot accelerate the probe to half of it within its stroke."""

OPEN_BLOCKS, OPEN_VOLTS, OPEN_SHARE = 2, 2.0, 0.15
"""Open coil: over 20 ms the mean of commanded and measured voltage exceeds this, and the current is below this share of
the expected one. Back-EMF reduces the current by a fifth at most.
"""

CURRENT_BLOCKS, CURRENT_SWING_V = 5, 1.0
"""A current code frozen for 50 ms while the voltage changes by this much is a sensor fault."""


@dataclass(frozen=True)
class Readings:
    """A block of n samples of the converters, all of shape (n,): V, V, A, m, and the codes of current and position."""

    command: NDArray[np.float64]
    voltage: NDArray[np.float64]
    current: NDArray[np.float64]
    position: NDArray[np.float64]
    current_codes: NDArray[np.int16]
    position_codes: NDArray[np.int16]

    def table(self) -> NDArray[np.float64]:
        """Return all of them, shape (n, 6)."""
        rows = np.empty((self.position.size, 6))
        for k, column in enumerate((self.command, self.voltage, self.current, self.position)):
            rows[:, k] = column
        rows[:, 4], rows[:, 5] = self.current_codes, self.position_codes
        return rows


@dataclass(frozen=True)
class _Summary:
    """Summary of a block of 10 ms."""

    asked_v: float
    measured_v: float
    mean_v: float
    drawn_a: float
    force_n: float
    position_m: float
    current_codes: tuple[float, float]
    position_codes: tuple[float, float]


class Plausibility:
    """Checks one run. ``begin`` resets it for the next.

    ``seen_low_end``: the probe may press on the near end of its stroke, where the converter saturates too.
    """

    def __init__(self, sample_rate_hz: float, resistance_ohm: float, force_constant_n_per_a: float) -> None:
        self._block = max(1, round(BLOCK_S * sample_rate_hz))
        self._jump_m = JUMP_M_PER_S / sample_rate_hz
        self._resistance_ohm = resistance_ohm
        self._force_constant = force_constant_n_per_a
        self.begin(seen_low_end=False)

    def begin(self, *, seen_low_end: bool) -> None:
        """Start a run."""
        self._seen_low_end = seen_low_end
        self._pending = np.zeros((0, 6))
        self._last_position_m: float | None = None
        self._history: deque[_Summary] = deque(maxlen=FROZEN_BLOCKS)

    def first_fault(self, readings: Readings) -> tuple[int, Fault]:
        """Return index and kind of the first implausible reading in a block; NONE if there is none."""
        jump = self._jump(readings.position)
        offset = -self._pending.shape[0]
        self._pending = np.concatenate((self._pending, readings.table())) if self._pending.size else readings.table()
        while self._pending.shape[0] >= self._block:
            done, self._pending = self._pending[: self._block], self._pending[self._block :]
            offset += self._block
            self._history.append(self._summary(done))
            if jump is not None and jump < offset:
                break
            if (fault := self._judge()) is not Fault.NONE:
                return offset - 1, fault
        return (0, Fault.NONE) if jump is None else (jump, Fault.SENSOR)

    def _jump(self, position: NDArray[np.float64]) -> int | None:
        """Return the first sample whose distance from the one before is not possible."""
        if position.size == 0:
            return None
        before = position[0] if self._last_position_m is None else self._last_position_m
        self._last_position_m = float(position[-1])
        broken = np.abs(position - np.concatenate(((before,), position[:-1]))) > self._jump_m
        return int(np.argmax(broken)) if broken.any() else None

    def _summary(self, rows: NDArray[np.float64]) -> _Summary:
        columns = np.ascontiguousarray(rows.T)
        count = rows.shape[0]
        asked, measured, drawn = (np.add.reduce(np.abs(columns[:3]), axis=1) / count).tolist()
        voltage, current, position = (np.add.reduce(columns[1:4], axis=1) / count).tolist()
        lowest, highest = (
            np.minimum.reduce(columns[4:], axis=1).tolist(),
            np.maximum.reduce(columns[4:], axis=1).tolist(),
        )
        return _Summary(
            asked,
            measured,
            voltage,
            drawn,
            current * self._force_constant,
            position,
            (lowest[0], highest[0]),
            (lowest[1], highest[1]),
        )

    def _judge(self) -> Fault:
        """Return the fault indicated by the newest blocks together."""
        if self._position_is_dead():
            return Fault.SENSOR
        return Fault.OPEN_COIL if self._current_is_dead() else Fault.NONE

    def _position_is_dead(self) -> bool:
        newest = self._history[-1].position_codes
        if newest[0] == CODE_MAX:
            return True
        if len(self._history) < FROZEN_BLOCKS:
            return False
        swing = _range([item.force_n for item in self._history])
        codes = [code for item in self._history for code in item.position_codes]
        low, high = min(codes), max(codes)
        at_the_end = self._seen_low_end and low == CODE_MIN
        if swing >= FROZEN_SWING_N and low == high and not at_the_end:
            return True
        still = _range([item.position_m for item in self._history]) <= STILL_M
        return bool(swing >= STILL_SWING_N and still and not at_the_end)

    def _current_is_dead(self) -> bool:
        newest = list(self._history)[-OPEN_BLOCKS:]
        if len(newest) == OPEN_BLOCKS:
            asked, measured, drawn = (
                sum(getattr(item, name) for item in newest) / OPEN_BLOCKS
                for name in ("asked_v", "measured_v", "drawn_a")
            )
            if min(asked, measured) >= OPEN_VOLTS and drawn * self._resistance_ohm < OPEN_SHARE * measured:
                return True
        newest = list(self._history)[-CURRENT_BLOCKS:]
        codes = [code for item in newest for code in item.current_codes]
        swing = _range([item.mean_v for item in newest])
        return bool(len(newest) == CURRENT_BLOCKS and min(codes) == max(codes) and swing >= CURRENT_SWING_V)


def _range(values: list[float]) -> float:
    return max(values) - min(values)
