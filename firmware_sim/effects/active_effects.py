"""Active effects of one plant: their parameters, their state, and the compiled loop."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from firmware_sim import kernel
from firmware_sim.effects import base, in_order, motion
from firmware_sim.effects.base import Array, Effect


class ActiveEffects:
    """Effects with their state. ``start_s`` is the session time at the start of a test.

    Raises:
        ValueError: an effect is given twice.
    """

    def __init__(self, effects: Iterable[Effect], start_s: float = 0.0) -> None:
        self.effects = tuple(effect for effect in in_order(effects) if effect.acts)
        self.start_s = start_s
        self._figures: Array = np.zeros((len(base.ROWS), base.WIDTH))
        for effect in self.effects:
            row = effect.row()
            self._figures[base.ROWS.index(effect.name), : row.size] = row
        self.reset()

    def __bool__(self) -> bool:
        """Return whether any effect is active."""
        return bool(self.effects)

    @property
    def needs_depth(self) -> bool:
        """Whether any effect depends on the depth in the tissue."""
        return any(effect.stage == "tissue" or effect.name == "physiological_motion" for effect in self.effects)

    def reset(self) -> None:
        """Reset the state of all effects."""
        self._memory: Array = np.zeros((len(base.ROWS) + 1, base.MEMORY))
        self._rings: Array = np.zeros((base.RINGS, base.RING_LENGTH))

    @property
    def memory(self) -> tuple[Array, Array]:
        """Copy of the state of all effects."""
        return self._memory.copy(), self._rings.copy()

    @memory.setter
    def memory(self, memory: tuple[Array, Array]) -> None:
        self._memory, self._rings = memory[0].copy(), memory[1].copy()

    def advance(
        self, commands: Array, state: Array, plant: Array, tissue: Array, interval_s: float, substeps: int
    ) -> tuple[Array, Array]:
        """Simulate commands, shape (n,); return the columns of ``kernel.advance``, and the inputs of the converters.

        ``state`` is updated. The second array has shape (n, 3): voltage, current, position.
        """
        out = np.empty((commands.size, kernel.OUT_COLUMNS))
        seen = np.empty((commands.size, motion.SEEN_COLUMNS))
        motion.advance(
            commands,
            state,
            plant,
            tissue,
            interval_s,
            substeps,
            out,
            seen,
            self._figures,
            self._memory,
            self._rings,
            self.start_s,
        )
        return out, seen
