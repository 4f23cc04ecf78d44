"""Bench without physics, in whole numbers: the readings of ``boards/posix/plant.c`` with ``--plant script``."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Block
from firmware_sim.converters import CHANNELS, CODE_MAX, CODE_MIN, Channel
from firmware_sim.plant import PlantParameters


def _quotient(number: int, divisor: int) -> int:
    """Return the quotient rounded towards zero, as C does."""
    quotient = abs(number) // divisor
    return quotient if number >= 0 else -quotient


@dataclass
class ScriptBench:
    """In place of a Bench for the Python firmware; the disturbances are those of ``lockstep.Disturbance``."""

    sample_rate_hz: float = 2000.0
    nominal: PlantParameters = field(default_factory=PlantParameters)
    channels: tuple[Channel, ...] = CHANNELS
    button: bool = False
    supply_share: float = 1.0
    position_stuck: bool = False
    coil_open: bool = False
    _position: int = 0
    _index: int = 0

    def snapshot(self) -> tuple[int, int]:
        """Return the state."""
        return self._position, self._index

    def restore(self, snapshot: tuple[int, int]) -> None:
        """Restore a state."""
        self._position, self._index = snapshot

    def begin_test(self) -> None:
        """Accept the start of a run; nothing varies."""

    def place_fixture(self, position_m: float | None) -> None:
        """Accept any position; there is no fixture."""

    def block(self, commands_volts: NDArray[np.float64], energised: bool) -> Block:
        """Return the readings of commands, shape (n,), V."""
        command, _ = self.channels[0].encode(commands_volts)
        codes = np.zeros((command.size, len(self.channels)), np.int16)
        flags = np.zeros(command.size, np.uint16)
        for k, code in enumerate(command.tolist()):
            codes[k], flags[k] = self._step(code, energised)
        return Block(codes, flags, self.button)

    def _step(self, command: int, energised: bool) -> tuple[tuple[int, ...], int]:
        number = (self._index * 2654435761 & 0xFFFFFFFF) >> 16
        self._index += 1
        volts = command if energised else 0
        current = 0 if self.coil_open else _quotient(volts * 5, 6) + number % 7 - 3
        position = self._position + number % 201 - 100 + _quotient(current, 64)
        if number % 8192 == 0:
            position += 15000
        saturated = not CODE_MIN <= position <= CODE_MAX
        if not self.position_stuck:
            self._position = min(max(position, CODE_MIN), CODE_MAX)
        readings = (command, volts, current, self._position, -20185 + number % 3, number % 1000, number % 100)
        return readings, int(saturated)
