"""The two device models: parameters, frame mass and force limit."""

from __future__ import annotations

from dataclasses import dataclass

from firmware_sim.bench import FRAME_MASS_KG
from firmware_sim.plant import STANDARD_GRAVITY, PlantParameters


@dataclass(frozen=True)
class DeviceModel:
    """A device model: its title in the handshake, its parameters, its frame and its largest force limit."""

    title: str
    plant: PlantParameters
    frame_mass_kg: float
    max_force_n: float


DESKTOP = DeviceModel("desktop indenter (simulated)", PlantParameters(), FRAME_MASS_KG, 15.0)


def _handheld() -> DeviceModel:
    """Return the handheld device of thesis 2.2.2: 9.5 ohm, 0.35 T, 39.5 g of 256 g, 32 mm.

    The rest is estimated from the desktop device. With wire of the same gage its length is proportional to its
    resistance; with the same diameter the number of turns is proportional to the length. The force constant B l is
    therefore 3 N/A * (0.35 / 0.53) * (9.5 / 12), and the inductance 1 mH * (9.5 / 12)^2. Copper mass and cooling
    surface, and with them the thermal parameters, are proportional to the length of the wire. The force limit
    corresponds to the same current as that of the desktop, 5 A.
    """
    desktop = DESKTOP.plant
    wire = 9.5 / desktop.resistance_ohm
    force_constant = desktop.force_constant_n_per_a * (0.35 / 0.53) * wire
    mass = 0.0395
    figures = PlantParameters(
        resistance_ohm=9.5,
        inductance_h=desktop.inductance_h * wire**2,
        force_constant_n_per_a=force_constant,
        moving_mass_kg=mass,
        gravity_force_n=mass * STANDARD_GRAVITY,
        thermal_resistance_k_per_w=desktop.thermal_resistance_k_per_w / wire,
        heat_capacity_j_per_k=desktop.heat_capacity_j_per_k * wire,
    )
    greatest = DESKTOP.max_force_n / desktop.force_constant_n_per_a * force_constant
    return DeviceModel("handheld indenter (simulated)", figures, 0.256 - mass, round(greatest, 1))


HANDHELD = _handheld()
MODELS = {"desktop": DESKTOP, "handheld": HANDHELD}
