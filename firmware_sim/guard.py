"""The guard over the coil: it judges every sample of a run, whatever the host says (docs/protocol.md, section 5)."""

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


class Guard:
    """Holds the limits that were armed, the winding's temperature by calculation, and what the sensors can say.

    The temperature goes on from block to block as long as the device has power; ``begin`` begins the rest anew.
    """

    def __init__(self, channels: dict[str, Channel], coil: PlantParameters, sample_rate_hz: float) -> None:
        self.winding = WindingModel(coil.resistance_ohm, sample_rate_hz)
        self._channels = channels
        self._columns = {name: column for column, name in enumerate(channels)}
        self._coil = coil
        self._lift_samples = round(LIFT_S * sample_rate_hz)
        self._release_samples = round(RELEASE_RAMP_S * sample_rate_hz)
        self._lifted = False
        self._plausibility = Plausibility(sample_rate_hz, coil.resistance_ohm, coil.force_constant_n_per_a)

    def begin(self, armed: ArmedLimits) -> None:
        """A run under these limits begins."""
        self._lifted = False
        self._plausibility.begin(seen_low_end=armed.min_position_m <= 0.0)

    def judge(self, block: Block, armed: ArmedLimits, first: int) -> tuple[int, Fault]:
        """Where in a block that was played the first limit is broken, and which; NONE when none is.

        ``first`` numbers the block's first sample from the start of the run, the samples of its release with them.
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
                first - self._release_samples,  # the release comes on top of what was agreed
                self._off_the_end(readings.position, armed, first),
            ),
        ]
        if self.winding.temperature_c > armed.max_temperature_c:
            found.append((0, Fault.OVER_TEMPERATURE))
        return min((item for item in found if item[1]), key=lambda item: item[0], default=(0, Fault.NONE))

    def _off_the_end(self, position: NDArray[np.float64], armed: ArmedLimits, first: int) -> NDArray[np.bool_]:
        """From which sample on, shape (n,), the near limit counts: once the probe was inside it, or had the time to."""
        off = (position >= armed.min_position_m) | (first + np.arange(position.size) >= self._lift_samples)
        off = np.logical_or.accumulate(off) | self._lifted
        self._lifted = bool(off[-1]) if off.size else self._lifted
        return np.asarray(off)

    def live_on(self, block: Block) -> None:
        """A block has passed, played or not: the winding warms or cools."""
        self.winding.advance(self._read(block, "current"), self._read(block, "temperature"))

    def _read(self, block: Block, name: str) -> NDArray[np.float64]:
        """A channel of a block in physical units, shape (n,)."""
        return self._channels[name].decode(block.codes[:, self._columns[name]])
