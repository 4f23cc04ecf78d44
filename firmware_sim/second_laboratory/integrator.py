"""Fixed-step fourth-order Runge-Kutta integration of the plant, compiled.

The classical scheme (Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, 1993, II.1) with a step
of at most 25 microseconds; memories of slipping elements and of contact change between the steps. Voltage, surface and
the delayed speed of a reflex are linear within a step, the voltage with a jump between steps.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from firmware_sim.second_laboratory import coil_laws, mechanics_laws, parameters, tissue_laws
from firmware_sim.second_laboratory.coil_laws import coil_rates, force_constant, motor_force
from firmware_sim.second_laboratory.mechanics_laws import frame_rates, mechanical_resistance, remember_bearing
from firmware_sim.second_laboratory.parameters import (
    BEARING_SLIP,
    CELL_CURRENT,
    CELLS,
    CURRENT,
    ELEMENTS,
    FRAME,
    FRAME_SPEED,
    MEMORIES,
    POSITION,
    SPEED,
    STATES,
    Floats,
    PlantModel,
)
from firmware_sim.second_laboratory.tissue_laws import recruited_mass, remember_tissue, tissue_force

LONGEST_STEP_S = 25e-6
"""Longest step of the integration; halving it changes the baseline by less than 1e-4 of the deviation of a
signal (measured: current 6e-5, position 1e-8)."""


@njit
def plant_rates(
    p: Any,
    tables: Floats,
    y: Floats,
    rates: Floats,
    memory: Floats,
    time: float,
    volts: float,
    surface: float,
    surface_speed: float,
    stretch_speed: float,
) -> None:
    """Set the rates of all states at one instant."""
    rates[:] = 0.0
    place, speed = y[POSITION] - y[FRAME], y[SPEED] - y[FRAME_SPEED]
    depth, depth_rate = y[POSITION] - surface, y[SPEED] - surface_speed
    constant = force_constant(p, tables, y, place)
    coil_rates(p, tables, y, rates, volts, constant, place, speed)
    inner = motor_force(p, tables, y, constant, place)
    inner -= mechanical_resistance(p, tables, y, rates, memory, place, speed)
    outer = tissue_force(p, tables, y, rates, memory, time, depth, depth_rate, stretch_speed)
    added, slope = recruited_mass(p, depth)
    lifted = p.contact_share > 0.0 and depth <= 0.0
    mass = p.mass_kg + p.tissue_mass_kg * (1.0 - p.contact_share if lifted else 1.0) + added
    rates[POSITION] = y[SPEED]
    rates[SPEED] = (inner + p.weight_n - outer - 0.5 * slope * depth_rate * depth_rate) / mass
    frame_rates(p, y, rates, inner)


def _checksum() -> str:
    """Return a checksum of all compiled laws: numba's cache sees changes in one file only."""
    files = (parameters, coil_laws, mechanics_laws, tissue_laws)
    paths = [Path(__file__), *(Path(str(module.__file__)) for module in files)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


def _compiled(checksum: str) -> Callable[..., int]:
    # The closure over the checksum is part of the key in the cache.
    @njit(cache=True, error_model="numpy")
    def integrate(
        p: Any,
        tables: Floats,
        y: Floats,
        memory: Floats,
        step: float,
        before: Floats,
        after: Floats,
        surface: Floats,
        surface_speed: Floats,
        motion: Floats,
        current: Floats,
    ) -> int:
        len(checksum)
        first, second, third, fourth = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
        trial = np.empty(STATES)
        steps = before.size
        stretch = np.zeros(steps + 1)
        motion[0], current[0] = y[POSITION] - y[FRAME], y[CURRENT]
        for k in range(steps):
            time = k * step
            late = k - p.reflex_delay
            stretch0 = stretch[late] if late >= 0 else 0.0
            stretch1 = stretch[late + 1] if late >= 0 else 0.0
            middle, half = 0.5 * (before[k] + after[k]), 0.5 * step
            surface_half = 0.5 * (surface[k] + surface[k + 1])
            speed_half = 0.5 * (surface_speed[k] + surface_speed[k + 1])
            stretch_half = 0.5 * (stretch0 + stretch1)
            plant_rates(p, tables, y, first, memory, time, before[k], surface[k], surface_speed[k], stretch0)
            trial[:] = y + half * first
            plant_rates(p, tables, trial, second, memory, time + half, middle, surface_half, speed_half, stretch_half)
            trial[:] = y + half * second
            plant_rates(p, tables, trial, third, memory, time + half, middle, surface_half, speed_half, stretch_half)
            trial[:] = y + step * third
            plant_rates(
                p, tables, trial, fourth, memory, time + step, after[k], surface[k + 1], surface_speed[k + 1], stretch1
            )
            y += step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
            place, depth = y[POSITION] - y[FRAME], y[POSITION] - surface[k + 1]
            remember_bearing(p, memory, place)
            remember_tissue(p, y, memory, time + step, depth)
            stretch[k + 1] = y[SPEED] - surface_speed[k + 1]
            motion[k + 1], current[k + 1] = place, y[CURRENT]
            if not np.isfinite(place + y[CURRENT]):
                return k
        return steps

    return integrate  # type: ignore[no-any-return]


_INTEGRATE = _compiled(_checksum())


class DivergedError(RuntimeError):
    """The simulated motion left the finite numbers."""


def simulate(
    plant: PlantModel, step_s: float, volts: tuple[Floats, Floats], surface: Floats, surface_speed: Floats
) -> tuple[Floats, Floats]:
    """Return position relative to the frame (m) and current (A) at the ends of all steps, the start included.

    The probe starts at rest at the surface with the current that the first voltage drives through the resistance.

    Args:
        plant: parameters and tables.
        step_s: length of a step.
        volts: voltage at the beginning and at the end of every step, shape (steps,) each.
        surface: position of the surface, shape (steps + 1,).
        surface_speed: its speed, shape (steps + 1,).

    Raises:
        DivergedError: the motion is not finite.
    """
    before, after = volts
    y, memory = start(plant, float(before[0]), float(surface[0]))
    motion, current = np.empty(before.size + 1), np.empty(before.size + 1)
    done = _INTEGRATE(
        plant.values, plant.tables, y, memory, step_s, before, after, surface, surface_speed, motion, current
    )
    if done < before.size:
        raise DivergedError(f"the simulated motion diverges after {done * step_s:.3f} s")
    return motion, current


def start(plant: PlantModel, volts: float, surface_m: float) -> tuple[Floats, Floats]:
    """Return the states and memories at the beginning of a test, shapes (STATES,) and (MEMORIES,)."""
    y, memory = np.zeros(STATES), np.zeros(MEMORIES)
    y[POSITION] = surface_m
    y[CURRENT] = volts / float(plant.values["resistance_ohm"])
    y[CELL_CURRENT : CELL_CURRENT + CELLS] = y[CURRENT]
    memory[BEARING_SLIP : BEARING_SLIP + ELEMENTS] = surface_m
    memory[-1] = 1.0
    return y, memory
