"""Safety monitor of the coil: checks every sample of a run, independent of the host (docs/protocol.md, section 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Block
from firmware_sim.converters import Channel
from firmware_sim.limits import LIFT_S, ArmedLimits
from firmware_sim.plant import PlantParameters
from firmware_sim.plausibility import Plausibility, Readings
from firmware_sim.player import RELEASE_RAMP_S
from firmware_sim.thermal import WindingModel
from tissueid.wire import Fault

FORCE_CEILING = 1.01
"""Predicted force, relative to its limit, above which a command is reduced; the trip is at 1.05."""


class Guard:
    """The armed limits, the calculated winding temperature, and the plausibility of the sensors.

    The temperature and the newest positions are kept from block to block as long as the device has power; ``begin``
    resets the rest.
    """

    def __init__(self, channels: dict[str, Channel], coil: PlantParameters, sample_rate_hz: float) -> None:
        self.winding = WindingModel(coil.resistance_ohm, sample_rate_hz)
        self._channels = channels
        self._columns = {name: column for column, name in enumerate(channels)}
        self._coil = coil
        self._lift_samples = round(LIFT_S * sample_rate_hz)
        self._release_samples = round(RELEASE_RAMP_S * sample_rate_hz)
        self._rate = sample_rate_hz
        self.newest_m = np.full(3, np.nan)
        self._lifted = False
        self._plausibility = Plausibility(sample_rate_hz, coil.resistance_ohm, coil.force_constant_n_per_a)

    def begin(self, armed: ArmedLimits) -> None:
        """Start the monitoring of a run under these limits."""
        self._lifted = False
        self._plausibility.begin(seen_low_end=armed.min_position_m <= 0.0)

    def with_reduced_force(
        self, command_v: NDArray[np.float64], block: Block, armed: ArmedLimits
    ) -> NDArray[np.float64]:
        """Return commands, shape (n,), V, reduced where the force would exceed its limit; ``block`` is their result.

        The current follows the voltage within a sample (L/R is 0.08 ms), minus the back-EMF: F = k (V - k v) / R. A
        probe that moves against the force is therefore pushed harder than at rest. The speed at the start of a sample
        is extrapolated from the three positions before it; later samples of the block are not used. A command is never
        increased or reversed.
        """
        position = np.concatenate((self.newest_m, self._read(block, "position")))
        step = (position[1:-1] - position[:-2]) * self._rate
        speed = step[1:] + 0.5 * (step[1:] - step[:-1])
        coil = self._coil
        ceiling_v = FORCE_CEILING * armed.max_force_n * coil.resistance_ohm / coil.force_constant_n_per_a
        sign = np.sign(command_v)
        induced_v = coil.force_constant_n_per_a * speed * sign
        most_v = np.maximum(0.0, ceiling_v + induced_v) / coil.amplifier_gain
        return np.where(np.abs(command_v) > most_v, sign * most_v, command_v)

    def judge(self, block: Block, armed: ArmedLimits, first: int) -> tuple[int, Fault]:
        """Return index and kind of the first limit violation in a played block; NONE if there is none.

        ``first`` is the index of the block's first sample from the start of the run, including the samples of its
        release.
        """
        readings = Readings(
            **{name: self._read(block, name) for name in ("command", "voltage", "current", "position")},
            current_codes=block.codes[:, self._columns["current"]],
            position_codes=block.codes[:, self._columns["position"]],
        )
        found = [
            self._plausibility.first_fault(readings),
            armed.first_violation(
                block,
                self._channels,
                self._coil,
                first - self._release_samples,  # the release is in addition to the agreed samples
                self._near_limit_applies(readings.position_codes, armed, first),
            ),
        ]
        if self.winding.temperature_c > armed.max_temperature_c:
            found.append((0, Fault.OVER_TEMPERATURE))
        return min((item for item in found if item[1]), key=lambda item: item[0], default=(0, Fault.NONE))

    def _near_limit_applies(self, codes: NDArray[np.int16], armed: ArmedLimits, first: int) -> NDArray[np.bool_]:
        """Return the mask (n,) of samples for which the near limit applies: after the probe was inside it, or had time
        to be.
        """
        off = armed.off_near_end(codes, self._channels["position"])
        off |= first + np.arange(codes.size) >= self._lift_samples
        off = np.logical_or.accumulate(off) | self._lifted
        self._lifted = bool(off[-1]) if off.size else self._lifted
        return np.asarray(off)

    def update(self, block: Block) -> None:
        """Update temperature and positions with a block, played or not."""
        self.newest_m = np.concatenate((self.newest_m, self._read(block, "position")))[-3:]
        self.winding.advance(self._read(block, "current"), self._read(block, "temperature"))

    def _read(self, block: Block, name: str) -> NDArray[np.float64]:
        """Return a channel of a block in physical units, shape (n,)."""
        return self._channels[name].decode(block.codes[:, self._columns[name]])
