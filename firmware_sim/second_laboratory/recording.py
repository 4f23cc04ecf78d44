"""A complete test as the machine records it: from the command through all effects to rounded, noisy numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from firmware_sim.second_laboratory.coil_effects import COIL
from firmware_sim.second_laboratory.drive_effects import DRIVE
from firmware_sim.second_laboratory.effect import Effect, Signals
from firmware_sim.second_laboratory.environment_effects import ENVIRONMENT
from firmware_sim.second_laboratory.instruments import Machine, Truth
from firmware_sim.second_laboratory.integrator import LONGEST_STEP_S, simulate
from firmware_sim.second_laboratory.mechanics_effects import MECHANICS
from firmware_sim.second_laboratory.parameters import Floats, PlantModel
from firmware_sim.second_laboratory.sensing_effects import SENSING
from firmware_sim.second_laboratory.tissue_effects import TISSUE
from firmware_sim.second_laboratory.unlisted_effects import UNLISTED

SIGNALS = ("time", "command", "voltage", "current", "position", "temperature")
UNITS = ("s", "V", "V", "A", "m", "degC")
READINGS = ("voltage", "current", "position")
ROOM_DEG_C = 25.0

LISTED: tuple[type[Effect], ...] = (*DRIVE, *COIL, *MECHANICS, *TISSUE, *ENVIRONMENT, *SENSING)
EFFECTS: dict[str, type[Effect]] = {kind.name: kind for kind in (*LISTED, *UNLISTED)}
"""All effects by name, in the order in which a signal passes them."""
_ORDER = {name: place for place, name in enumerate(EFFECTS)}


@dataclass(frozen=True)
class PlannedTest:
    """A test of a session: its command, shape (samples,), V, and what the session file says about it."""

    number: int
    kind: str
    command: Floats
    stimulus: dict[str, Any]
    seed: int
    surface_m: float
    preload_s: float
    repeat_of: int = 0


@dataclass(frozen=True)
class Laboratory:
    """A machine on a tissue, or on a spring, with effects; ``longest_step_s`` is that of the integration."""

    machine: Machine
    truth: Truth
    effects: tuple[Effect, ...] = ()
    longest_step_s: float = LONGEST_STEP_S

    def record(self, test: PlannedTest, noise_seed: Sequence[int] | None = None) -> Signals:
        """Return the recorded signals of a test; without a seed there is neither noise nor rounding.

        Raises:
            DivergedError: the motion is not finite.
        """
        rate, samples = self.machine.sample_rate_hz, test.command.size
        holds = ceil(1.0 / (rate * self.longest_step_s) - 1e-9)
        step = 1.0 / (rate * holds)
        effects = self._acting(test)
        times = np.arange(samples) / rate
        command = test.command
        for effect in effects:
            command = effect.change_command(command, times, test.number)
        held = np.repeat(command * self.truth["gain"], holds)
        volts = (held, held)
        for effect in effects:
            volts = effect.change_voltage(volts, step, test.number)
        fine: Floats = np.asarray(np.arange(samples * holds + 1) * step, dtype=np.float64)
        moved = np.zeros(fine.size)
        for effect in effects:
            moved += effect.move_surface(fine, test.number)
        surface_speed = np.gradient(moved, step)
        plant = self._plant(test)
        for effect in effects:
            effect.change_plant(plant, step)
        motion, current = simulate(plant, step, volts, test.surface_m + moved, surface_speed)
        for effect in effects:
            motion = effect.change_motion(motion, step)
        read = clocked = fine[holds::holds]
        for effect in effects:
            clocked = effect.clock(clocked, test.number)
        position = motion[holds::holds] if clocked is read else np.interp(clocked, fine, motion)
        found = {"voltage": volts[1][holds - 1 :: holds], "current": current[holds::holds], "position": position}
        if noise_seed is not None:
            found = self._noisy(found, np.random.default_rng([*noise_seed, test.number]))
        for effect in effects:
            found = effect.change_readings(found, times, test.number)
        fixed = {"time": times, "command": test.command, "temperature": np.full(samples, ROOM_DEG_C)}
        return {name: (fixed | found)[name] for name in SIGNALS}

    def _acting(self, test: PlannedTest) -> list[Effect]:
        # On the spring there is no tissue and no body.
        absent = {"physiological_motion"} | {name for name, kind in EFFECTS.items() if kind.stage == "tissue"}
        acting = [item for item in self.effects if test.kind != "spring" or item.name not in absent]
        return sorted(acting, key=lambda item: _ORDER[item.name])

    def _plant(self, test: PlannedTest) -> PlantModel:
        plant = PlantModel()
        known = plant.values.dtype.names or ()
        for name, value in self.truth.items():
            if name in known:
                plant.values[name] = value
        plant.values["surface_m"] = test.surface_m
        if test.kind == "spring":
            plant.values["stiffness_n_per_m"] = self.truth["spring_n_per_m"]
            plant.values["tissue_damping_n_s_per_m"] = self.truth["spring_damping_n_s_per_m"]
            plant.values["tissue_mass_kg"] = self.truth["spring_mass_kg"]
            plant.values["stiffness_rate_per_m"] = plant.values["damping_rate_per_m"] = 0.0
        return plant

    def _noisy(self, found: Signals, random: np.random.Generator) -> Signals:
        noisy = {}
        for name in READINGS:
            step = self.machine.steps[name]
            values = found[name] + self.machine.noise[name] * random.standard_normal(found[name].size)
            noisy[name] = step * np.round(values / step)
        return noisy
