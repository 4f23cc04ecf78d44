"""The bench: a plant on a tissue behind the converters, played block by block."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.converters import CHANNELS, Channel, Converters
from firmware_sim.plant import SAMPLE_RATE_HZ, STANDARD_GRAVITY, SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset
from firmware_sim.tissue import Tissue

FRAME_MASS_KG = 5.0
"""Mass that takes the coil's reaction: the desktop frame, an estimate."""

LEAST_SUBSTEPS = 3


@dataclass(frozen=True)
class Block:
    """What the converters saw in a block of n samples.

    ``codes`` has shape (n, channels), int16, columns in the order of the channel table; ``flags`` has shape (n,),
    uint16, bit k set where channel k saturated; ``button`` is the button's state.
    """

    codes: NDArray[np.int16]
    flags: NDArray[np.uint16]
    button: bool


class Bench:
    """A simulated instrument without its firmware.

    ``tissue`` is a preset's name or a Tissue. ``tilt_deg`` turns the stroke away from straight down: gravity's pull
    into the tissue follows its cosine. ``surface_m`` moves the tissue along the stroke. The same seed and commands give
    the same codes, however they are cut into blocks.

    Raises:
        ValueError: no such preset; the message lists those that exist.
    """

    def __init__(
        self,
        tissue: str | Tissue = DEFAULT,
        seed: int = 0,
        *,
        parameters: PlantParameters | None = None,
        tilt_deg: float = 0.0,
        surface_m: float | None = None,
        sample_rate_hz: float = SAMPLE_RATE_HZ,
    ) -> None:
        chosen = load_preset(tissue) if isinstance(tissue, str) else tissue
        self.tissue = chosen if surface_m is None else replace(chosen, surface_m=surface_m)
        self.seed = seed
        self.sample_rate_hz = sample_rate_hz
        self._substeps = max(LEAST_SUBSTEPS, round(SUBSTEPS * SAMPLE_RATE_HZ / sample_rate_hz))
        self.button = False
        base = parameters or PlantParameters()
        self._along, self._across = cos(radians(tilt_deg)), sin(radians(tilt_deg))
        self.parameters = replace(base, gravity_force_n=base.gravity_force_n * self._along)
        self.reset()

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channel table: name, unit, gain, offset."""
        return CHANNELS

    def reset(self) -> None:
        """Back to rest with the coil released, button up, and the noise from its beginning."""
        self.plant = Plant(self.parameters, self.tissue, sample_rate_hz=self.sample_rate_hz, substeps=self._substeps)
        self._converters = Converters(self.seed)
        self.button = False

    def snapshot(self) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """The state of plant and noise, for ``restore``."""
        return self.plant.state.copy(), self._converters.noise_state

    def restore(self, snapshot: tuple[NDArray[np.float64], dict[str, Any]]) -> None:
        """Back to a snapshot: the same commands give the same codes again."""
        self.plant.state = snapshot[0].copy()
        self._converters.noise_state = snapshot[1]

    def warm_up(self) -> None:
        """Compile the plant now (some seconds on first use) and go back to rest."""
        self.block(np.zeros(2), energised=False)
        self.reset()

    def block(self, commands_volts: NDArray[np.float64], energised: bool) -> Block:
        """Play commands, shape (n,), volts, one a sample, and convert what the sensors saw.

        While ``energised`` is false the coil is released: the commands are recorded and not played.

        Raises:
            ValueError: the commands are not finite or have more than one dimension.
        """
        volts, command_codes, clipped = self._converters.drive(np.asarray(commands_volts, dtype=np.float64))
        self.plant.energised = energised
        trace = self.plant.advance(volts)
        codes, flags = self._converters.read(self._analogue(volts, trace))
        codes[:, 0] = command_codes
        flags |= clipped.astype(np.uint16)
        return Block(codes, flags, self.button)

    def _analogue(self, volts: NDArray[np.float64], trace: NDArray[np.void]) -> NDArray[np.float64]:
        reaction = self.parameters.moving_mass_kg / FRAME_MASS_KG * trace["acceleration"]
        columns: dict[str, Any] = {
            "command": volts,
            "voltage": trace["filtered_voltage"],
            "current": trace["filtered_current"],
            "position": trace["filtered_position"],
            "temperature": trace["filtered_temperature"],
            # At rest an accelerometer reads the push that holds it up: here the stroke points down at no tilt.
            "accelerometer_x": STANDARD_GRAVITY * self._along - reaction,
            "accelerometer_y": STANDARD_GRAVITY * self._across,
        }
        return np.stack([np.broadcast_to(columns[channel.name], volts.shape) for channel in CHANNELS], axis=1).astype(
            np.float64
        )
