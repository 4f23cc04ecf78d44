"""Limits of one test as agreed by ARM, and the check of samples against them (docs/protocol.md, section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Block
from firmware_sim.converters import CODE_MAX, CODE_MIN, Channel
from firmware_sim.plant import PlantParameters
from tissueid.wire import Fault

MAX_RUN_S = 90.0
"""Longest stimulus with its set-points, s: one minute of set-points after the preload."""

FORCE_MARGIN = 1.05
"""Ratio of the trip level to the limit, so that converter noise on a test at the limit does not end it."""


GENTLE_FORCE_N = 2.0
"""Force limit up to which the probe may press against the ends of its stroke, which locates them."""

BEYOND_STROKE_M = 1.0e-3
"""Largest distance of the position limits beyond the ends of the stroke in that case."""

LIFT_S = 0.5
"""Time at the start of a run in which the probe may leave the near end, where it rests if the device points upwards, s.
"""


def static_force_n(volts: NDArray[np.float64], coil: PlantParameters) -> NDArray[np.float64]:
    """Return the absolute force of the coil at rest, N; motion against the force increases it."""
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

    @property
    def gentle(self) -> bool:
        """Whether the probe may press against the ends of its stroke."""
        return self.max_force_n <= GENTLE_FORCE_N

    def within(
        self,
        max_force_n: float,
        max_temperature_c: float,
        sample_rate_hz: float,
        channels: dict[str, Channel],
        coil: PlantParameters,
    ) -> bool:
        """Return whether all limits are valid, none exceeds that of the device, and a reading can lie within each."""
        beyond = BEYOND_STROKE_M if self.gentle else 0.0
        figures = (self.max_force_n, self.min_position_m, self.max_position_m, self.max_temperature_c)
        step_n = channels["current"].gain * coil.force_constant_n_per_a
        coldest_c = channels["temperature"].offset + CODE_MIN * channels["temperature"].gain
        return bool(
            np.all(np.isfinite(figures))
            and step_n <= self.max_force_n <= max_force_n
            and -beyond <= self.min_position_m
            and self.max_position_m - self.min_position_m >= channels["position"].gain
            and self.max_position_m <= coil.stroke_m + beyond
            and coldest_c <= self.max_temperature_c <= max_temperature_c
            and 0 < self.max_samples <= MAX_RUN_S * sample_rate_hz
        )

    def permits(self, volts: NDArray[np.float64], coil: PlantParameters) -> bool:
        """Return whether no command, shape (n,), V, exceeds the force limit at rest."""
        return bool(static_force_n(volts, coil).max() <= self.max_force_n * FORCE_MARGIN)

    def first_violation(
        self,
        block: Block,
        channels: dict[str, Channel],
        coil: PlantParameters,
        first: int,
        lifted: NDArray[np.bool_] | bool = True,
    ) -> tuple[int, Fault]:
        """Return index and kind of the first limit violation in a block; ``first`` is the index of its first sample in
        the run.

        Where ``lifted`` is false, shape (n,), the probe may still rest at the near end. A reading at the end of its
        converter violates the limit on that side, which the converter could not read beyond.
        """
        samples = block.codes.shape[0]
        columns = list(channels)

        def codes(name: str) -> NDArray[np.int16]:
            return block.codes[:, columns.index(name)]

        current, position, temperature = codes("current"), codes("position"), codes("temperature")
        force = np.abs(channels["current"].decode(current)) * coil.force_constant_n_per_a
        far = channels["position"].decode(position) > self.max_position_m
        if not self.gentle:
            far |= position == CODE_MAX
        checks = (
            (Fault.OVER_FORCE, (force > self.max_force_n * FORCE_MARGIN) | _at_an_end(current)),
            (Fault.STROKE, ~self.off_near_end(position, channels["position"]) & lifted | far),
            (
                Fault.OVER_TEMPERATURE,
                (channels["temperature"].decode(temperature) > self.max_temperature_c) | (temperature == CODE_MAX),
            ),
            (Fault.OVER_TIME, first + np.arange(samples) >= self.max_samples),
            (Fault.BUTTON, np.full(samples, block.button)),
        )
        found = [(int(np.argmax(broken)), fault) for fault, broken in checks if broken.any()]
        return min(found, key=lambda item: item[0]) if found else (0, Fault.NONE)

    def off_near_end(self, codes: NDArray[np.int16], channel: Channel) -> NDArray[np.bool_]:
        """Return where position codes, shape (n,), lie inside the near limit."""
        inside = channel.decode(codes) >= self.min_position_m
        return np.asarray(inside if self.gentle else inside & (codes > CODE_MIN))


def _at_an_end(codes: NDArray[np.int16]) -> NDArray[np.bool_]:
    return np.asarray((codes == CODE_MIN) | (codes == CODE_MAX))
