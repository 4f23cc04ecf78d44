"""Bench: a plant on a tissue with sensors and converters, simulated block by block."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.coil import coil_profile
from firmware_sim.converters import CHANNELS, Channel, ChannelError, Converters
from firmware_sim.effects.base import Effect
from firmware_sim.effects.environment import PhysiologicalMotion
from firmware_sim.effects.sensing import DroppedSamples, Quantization
from firmware_sim.plant import SAMPLE_RATE_HZ, STANDARD_GRAVITY, SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import DEFAULT, load_preset
from firmware_sim.tissue import FREE_AIR, Tissue
from firmware_sim.variation import PRESSING_N, Variation, compressed_share

FRAME_MASS_KG = 5.0
"""Mass of the desktop frame, which takes the reaction of the coil; an estimate."""

LEAST_SUBSTEPS = 3


@dataclass(frozen=True)
class Block:
    """Samples of the converters in a block of n samples.

    ``codes`` has shape (n, channels), int16, columns in the order of the channel table; ``flags`` has shape (n,),
    uint16, with bit k set if channel k saturated; ``button`` is the state of the button.
    """

    codes: NDArray[np.int16]
    flags: NDArray[np.uint16]
    button: bool


@dataclass(frozen=True)
class Snapshot:
    """State of plant, noise and stuck sensors at one moment."""

    plant: NDArray[np.float64]
    noise: dict[str, Any]
    frozen: dict[str, int] = field(default_factory=dict)
    newest: NDArray[np.int16] | None = None
    memory: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    worked: tuple[int, int] = (0, 0)


class Bench:
    """A simulated instrument without firmware.

    ``tissue`` is the name of a preset or a Tissue. ``tilt_deg`` is the angle of the stroke from straight down; gravity
    along the stroke follows its cosine. ``surface_m`` moves the tissue along the stroke. The same seed and commands
    give the same codes for any division into blocks.

    ``parameters`` are the true parameters of the device; ``nominal`` are those that it announces, by default the same.
    ``coil`` names the profile of the force constant along the stroke. ``channel_errors`` are the errors of the
    converters' scales against the announced table. ``frame_mass_kg`` takes the reaction of the coil. ``effects`` are
    added to the plant. With ``variation`` the tissue differs between subjects, placings and tests; see ``begin_test``.

    Faults, at any time:

    - ``stuck``: names of sensor channels whose codes are frozen; - ``coil_open``: the coil is disconnected: no current
    and no electrical damping; - ``supply_share``: supply voltage of the amplifier relative to normal, which scales its
    limit; - ``sensor_supply_share``: supply voltage of the sensors relative to nominal, which scales the
    potentiometer's reading.

    Raises:
        ValueError: there is no such preset, coil or channel (the message lists those that exist), or an effect is not
            possible on this tissue or on a streaming instrument.
    """

    def __init__(
        self,
        tissue: str | Tissue = DEFAULT,
        seed: int = 0,
        *,
        parameters: PlantParameters | None = None,
        nominal: PlantParameters | None = None,
        tilt_deg: float = 0.0,
        surface_m: float | None = None,
        sample_rate_hz: float = SAMPLE_RATE_HZ,
        coil: str = "ideal",
        channel_errors: Mapping[str, ChannelError] | None = None,
        sensor_supply_share: float = 1.0,
        frame_mass_kg: float = FRAME_MASS_KG,
        effects: Iterable[Effect] = (),
        variation: Variation | None = None,
    ) -> None:
        chosen = load_preset(tissue) if isinstance(tissue, str) else tissue
        self.tissue = chosen if surface_m is None else replace(chosen, surface_m=surface_m)
        self._fixture = self.tissue
        self._variation = variation if variation is not None and variation.acts else None
        self._placed: Tissue | None = None
        self._placing = -1
        self._place(self._fixture)
        self.seed = seed
        self.sample_rate_hz = sample_rate_hz
        self.substeps = max(LEAST_SUBSTEPS, round(SUBSTEPS * SAMPLE_RATE_HZ / sample_rate_hz))
        base = parameters or PlantParameters()
        self.along, self._across = cos(radians(tilt_deg)), sin(radians(tilt_deg))
        self.parameters = replace(base, gravity_force_n=base.gravity_force_n * self.along)
        self.nominal = nominal or base
        self.coil = coil_profile(coil, base.stroke_m)
        self._errors = dict(channel_errors or {})
        self._frame_mass_kg = frame_mass_kg
        self._healthy_sensor_supply = sensor_supply_share
        acting = [effect for effect in effects if effect.acts]
        if self._variation is not None and not any(isinstance(effect, PhysiologicalMotion) for effect in acting):
            acting.append(self._variation.motion(self._fixture))
        self.effects = tuple(effect for effect in acting if effect.acts)
        if any(isinstance(effect, DroppedSamples) for effect in self.effects):
            raise ValueError("dropped_samples moves a whole record up: it is for the laboratory, not for a bench")
        self._coarse = next((effect for effect in self.effects if isinstance(effect, Quantization)), None)
        self.reset()

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The channel table: name, unit, gain, offset."""
        return CHANNELS

    def _place(self, fixture: Tissue | None) -> None:
        """Put the probe on a fixture, or on nothing, and draw what this placing varies."""
        self._placed = fixture
        self._placing += 1
        self._test = 0
        self._compressed = 0.0
        self._worked = (0, 0)
        self._draw()

    def _draw(self) -> None:
        self.tissue = FREE_AIR if self._placed is None else self._placed
        if self._variation is not None and self._placed is not None:
            self.tissue = self._variation.tissue(self._placed, self._placing, self._test, self._compressed)

    def begin_test(self) -> None:
        """Restart the noise by seed and number of the run, and draw the tissue that the run meets.

        A run has the same noise whenever the host starts it. Without variation the tissue stays the same. Otherwise it
        varies between runs, and stays compressed by those before it until it recovers or the probe is placed again.
        """
        self._runs += 1
        self.converters.restart_noise([self.seed, self._runs])
        if self._variation is None:
            return
        pressed_s, passed_s = (samples / self.sample_rate_hz for samples in self._worked)
        self._compressed = compressed_share(self._compressed, pressed_s, passed_s)
        self._worked = (0, 0)
        self._test += 1
        self._draw()
        self.plant.tissue = self.tissue

    def reset(self) -> None:
        """Reset to rest with the coil released, button up, no faults, and the noise restarted.

        The tissue keeps its position.
        """
        self.plant = Plant(
            self.parameters,
            self.tissue,
            sample_rate_hz=self.sample_rate_hz,
            substeps=self.substeps,
            coil=self.coil,
            effects=self.effects,
        )
        self.converters = Converters(self.seed, errors=self._errors)
        self._runs = 0
        self.button = False
        self.stuck: set[str] = set()
        self.coil_open = False
        self.supply_share = 1.0
        self.sensor_supply_share = self._healthy_sensor_supply
        self.frozen: dict[str, int] = {}
        self._newest: NDArray[np.int16] | None = None

    def place_fixture(self, position_m: float | None) -> None:
        """Move the tissue so that its surface is at a position on the stroke, m, and let the plant come to rest.

        None removes the tissue: the coil falls to its stop. The coil is released meanwhile and keeps its temperature.

        Raises:
            ValueError: the position is not on the stroke.
        """
        self._place(None if position_m is None else replace(self._fixture, surface_m=position_m))
        self.plant.tissue = self.tissue
        self.plant.energised = False
        self.plant.settle()

    def snapshot(self) -> Snapshot:
        """Return the state of plant, noise and sensors, for ``restore``."""
        return Snapshot(
            self.plant.state.copy(),
            self.converters.noise_state,
            dict(self.frozen),
            self._newest,
            self.plant.memory if self.effects else None,
            self._worked,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot: the same commands then give the same codes again."""
        self.plant.state = snapshot.plant.copy()
        self.converters.noise_state = snapshot.noise
        self.frozen = dict(snapshot.frozen)
        self._newest = snapshot.newest
        self._worked = snapshot.worked
        if snapshot.memory is not None:
            self.plant.memory = snapshot.memory

    def warm_up(self) -> None:
        """Compile the plant (some seconds on first use) and reset it."""
        self.block(np.zeros(2), energised=False)
        self.reset()

    def block(self, commands_volts: NDArray[np.float64], energised: bool) -> Block:
        """Play commands, shape (n,), volts, one per sample, and return the converted sensor signals.

        While ``energised`` is false the coil is released: the commands are recorded but not played.

        Raises:
            ValueError: the commands are not finite or have more than one dimension, or ``stuck`` names no sensor.
        """
        volts, command_codes, clipped = self.converters.drive(np.asarray(commands_volts, dtype=np.float64))
        self.plant.energised = energised
        self.plant.coil_open = self.coil_open
        self.plant.supply_share = self.supply_share
        trace = self.plant.advance(volts)
        if self._variation is not None:
            force_n = self.parameters.force_constant_n_per_a * trace["current"]
            pressed, passed = self._worked
            self._worked = pressed + int(np.count_nonzero(force_n > PRESSING_N)), passed + trace.size
        codes, flags = self.converters.read(self._analogue(volts, trace))
        codes[:, 0] = command_codes
        if self._coarse is not None:
            k = [channel.name for channel in CHANNELS].index("position")
            codes[:, k] = CHANNELS[k].encode(self._coarse.applied(CHANNELS[k].decode(codes[:, k])))[0]
        flags |= clipped.astype(np.uint16)
        if self.stuck or self.frozen:
            self._freeze(codes, flags)
        if codes.shape[0]:
            self._newest = codes[-1].copy()
        return Block(codes, flags, self.button)

    def _freeze(self, codes: NDArray[np.int16], flags: NDArray[np.uint16]) -> None:
        # Stuck sensors repeat their last code, which does not count as saturated again.
        names = [channel.name for channel in CHANNELS]
        for name in self.stuck:
            if name not in names[1:]:
                raise ValueError(f"no sensor {name!r} that could be stuck; there are: {', '.join(names[1:])}")
        self.frozen = {name: code for name, code in self.frozen.items() if name in self.stuck}
        if not codes.shape[0]:
            return
        newest = codes[0] if self._newest is None else self._newest
        for name in self.stuck:
            k = names.index(name)
            codes[:, k] = self.frozen.setdefault(name, int(newest[k]))
            flags &= ~np.uint16(1 << k)

    def _analogue(self, volts: NDArray[np.float64], trace: NDArray[np.void]) -> NDArray[np.float64]:
        reaction = self.parameters.moving_mass_kg / self._frame_mass_kg * trace["acceleration"]
        columns: dict[str, Any] = {
            "command": volts,
            "voltage": trace["filtered_voltage"],
            "current": trace["filtered_current"],
            # The potentiometer is ratiometric to its supply; the converter has a separate reference.
            "position": trace["filtered_position"] * self.sensor_supply_share,
            "temperature": trace["filtered_temperature"],
            # At rest an accelerometer reads the reaction to gravity; without tilt the stroke points down.
            "accelerometer_x": STANDARD_GRAVITY * self.along - reaction,
            "accelerometer_y": STANDARD_GRAVITY * self._across,
        }
        table = np.empty((volts.size, len(CHANNELS)))
        for k, channel in enumerate(CHANNELS):
            table[:, k] = columns[channel.name]
        return table
