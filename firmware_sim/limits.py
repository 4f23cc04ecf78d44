"""The limits of one test as ARM agreed on them, and how samples are judged by them (docs/protocol.md, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Block
from firmware_sim.converters import Channel
from firmware_sim.plant import PlantParameters
from tissueid.wire import Fault

MAX_RUN_S = 90.0
"""Longest stimulus with its set-points: a minute of them, and the preload before it."""

FORCE_MARGIN = 1.05
"""Trips are set this far above the limit, so that converter noise on a test at the limit does not end it."""


GENTLE_FORCE_N = 2.0
"""Up to this force the probe may go to the ends of its stroke and lean on them: that is how they are found."""

BEYOND_STROKE_M = 1.0e-3
"""How far the limits may then lie beyond either end."""

LIFT_S = 0.5
"""A device that points upwards has its free probe at the near end: a run may take so long to lift it off."""


def static_force_n(volts: NDArray[np.float64], coil: PlantParameters) -> NDArray[np.float64]:
    """The coil's force at standstill, N, without its sign; motion against the push raises it."""
    return np.abs(volts) * (coil.amplifier_gain * coil.force_constant_n_per_a / coil.resistance_ohm)


@dataclass(frozen=True)
class ArmedLimits:
    """The limits that ARM agreed on, and the token that its START must repeat."""

    token: int
    max_force_n: float
    min_position_m: float
    max_position_m: float
    max_temperature_c: float
    max_samples: int

    def within(self, max_force_n: float, max_temperature_c: float, stroke_m: float, sample_rate_hz: float) -> bool:
        """Whether all of them are sound and none goes beyond the device's own."""
        beyond = BEYOND_STROKE_M if self.max_force_n <= GENTLE_FORCE_N else 0.0
        figures = (self.max_force_n, self.min_position_m, self.max_position_m, self.max_temperature_c)
        return bool(
            np.all(np.isfinite(figures))
            and 0 < self.max_force_n <= max_force_n
            and -beyond <= self.min_position_m < self.max_position_m <= stroke_m + beyond
            and self.max_temperature_c <= max_temperature_c
            and 0 < self.max_samples <= MAX_RUN_S * sample_rate_hz
        )

    def permits(self, volts: NDArray[np.float64], coil: PlantParameters) -> bool:
        """Whether no command, shape (n,), V, pushes harder at standstill than was agreed."""
        return bool(static_force_n(volts, coil).max() <= self.max_force_n * FORCE_MARGIN)

    def first_violation(
        self,
        block: Block,
        channels: dict[str, Channel],
        coil: PlantParameters,
        first: int,
        lifted: NDArray[np.bool_] | bool = True,
    ) -> tuple[int, Fault]:
        """Where in a block the first limit is broken, and which; ``first`` counts its first sample from the start.

        Where ``lifted`` is false, shape (n,), the probe has not come off the near end yet, and need not have.
        """
        samples = block.codes.shape[0]
        columns = list(channels)

        def physical(name: str) -> NDArray[np.float64]:
            return channels[name].decode(block.codes[:, columns.index(name)])

        force = np.abs(physical("current")) * coil.force_constant_n_per_a
        position = physical("position")
        checks = (
            (Fault.OVER_FORCE, force > self.max_force_n * FORCE_MARGIN),
            (Fault.STROKE, (position < self.min_position_m) & lifted | (position > self.max_position_m)),
            (Fault.OVER_TEMPERATURE, physical("temperature") > self.max_temperature_c),
            (Fault.OVER_TIME, first + np.arange(samples) >= self.max_samples),
            (Fault.BUTTON, np.full(samples, block.button)),
        )
        found = [(int(np.argmax(broken)), fault) for fault, broken in checks if broken.any()]
        return min(found, key=lambda item: item[0]) if found else (0, Fault.NONE)
