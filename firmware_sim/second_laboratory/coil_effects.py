"""Effects between the voltage of the coil and its force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from firmware_sim.second_laboratory.effect import Effect, TestMotion, chosen, log_uniform
from firmware_sim.second_laboratory.parameters import (
    FORCE_CURVE,
    INDUCTANCE_CURVE,
    RELUCTANCE,
    SATURATION,
    Floats,
    PlantModel,
)


@dataclass(frozen=True)
class EddyCurrents(Effect):
    """Part of the inductance with losses: one or two shorted rings, or a skin effect of half order in four cells.

    A ring coupled by a transformer is a cell L_c parallel to R_c in series with the coil; cells with inductances
    proportional to the root of their time constants approximate the impedance K s^(1/2).
    Sources: Vanderkooy, J. Audio Eng. Soc. 37 (1989) 119; Leach, J. Audio Eng. Soc. 50 (2002) 442.
    """

    name = "eddy_currents"
    stage = "coil"
    largest = 10.0

    form: str
    share: float
    times_s: tuple[float, ...]

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw time constants of 0.15 to 5 ms."""
        form = chosen(random, "ring", "two rings", "skin effect")
        if form == "ring":
            times: tuple[float, ...] = (log_uniform(random, 3e-4, 3e-3),)
        elif form == "two rings":
            times = (log_uniform(random, 1.5e-4, 6e-4), log_uniform(random, 1e-3, 5e-3))
        else:
            times = tuple(float(item) for item in np.geomspace(1.5e-4, log_uniform(random, 2e-3, 8e-3), 4))
        return cls(1.0, form, 0.4, times)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Replace part of the inductance by a larger one with losses, in cells."""
        share = self.size * self.share
        if share <= 0.0:
            return
        values = plant.values
        lossy = share * float(values["inductance_h"])
        parts = np.sqrt(self.times_s)
        values["inductance_h"] *= 1.0 - min(0.6 * share, 0.5)
        values["cells"] = parts.size
        values["cell_h"][: parts.size] = lossy * parts / parts.sum()
        values["cell_ohm"][: parts.size] = values["cell_h"][: parts.size] / np.array(self.times_s)


@dataclass(frozen=True)
class CoilHeating(Effect):
    """Resistance that follows the dissipated heat: one body, or winding and former.

    Sources: Zuccatti, J. Audio Eng. Soc. 38 (1990) 34; Button, J. Audio Eng. Soc. 40 (1992) 32.
    """

    name = "coil_heating"
    stage = "coil"
    largest = 6.0

    form: str
    rise_per_j: float
    time_s: float
    body_share: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a rise of the resistance of about 10 % in one test."""
        form = chosen(random, "one body", "two bodies")
        heat = test.plant["resistance_ohm"] * (test.current_a**2 + test.current_mean_a**2) * test.duration_s
        time = test.duration_s * log_uniform(random, 0.15, 2.0)
        share = float(random.uniform(0.05, 0.4)) if form == "two bodies" else 0.0
        return cls(1.0, form, 0.1 / heat * (1.0 + test.duration_s / time), time, share)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set heat capacity and conductance."""
        plant.values["heat_per_j"] = self.size * self.rise_per_j
        plant.values["heat_rate_hz"] = 1.0 / self.time_s
        plant.values["heat_share"] = self.body_share


@dataclass(frozen=True)
class InductancePosition(Effect):
    """Inductance that grows as the coil enters the iron: a polynomial of third degree, or a hyperbolic tangent.

    The law of induction d(L i)/dt includes the voltage of motion; the force that belongs to it is the separate effect
    ``reluctance_force``. Source: Klippel, J. Audio Eng. Soc. 54 (2006) 907.
    """

    name = "inductance_position"
    stage = "coil"
    largest = 8.0

    form: str
    change: float
    middle_m: float
    width_m: float
    bend: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a change of 10 % over two deviations of the motion."""
        change = 0.1 * float(random.choice([-1.0, 1.0]))
        middle = test.mean_m + test.swing_m * float(random.uniform(-1.5, 1.5))
        width = test.swing_m * log_uniform(random, 1.5, 5.0)
        form = chosen(random, "polynomial", "tanh")
        return cls(1.0, form, change * width / test.swing_m / 2.0, middle, width, float(random.uniform(-0.3, 0.3)))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate the relative inductance."""

        def law(place: Floats) -> Floats:
            way = (place - self.middle_m) / self.width_m
            if self.form == "polynomial":
                way = np.clip(way, -3.0, 3.0)
                course = way + self.bend * way**2 - 0.03 * way**3
            else:
                course = np.tanh(way)
            return np.clip(1.0 + self.size * self.change * course, 0.35, 3.0)

        plant.tabulate(INDUCTANCE_CURVE, self.middle_m - 8.0 * self.width_m, self.middle_m + 8.0 * self.width_m, law)


@dataclass(frozen=True)
class ForceConstantPosition(Effect):
    """Bell curve of the force constant along the stroke, as measured: power bell, or a coil that leaves its gap.

    Source: Klippel, J. Audio Eng. Soc. 54 (2006) 907, section 2.2 (overhung and underhung coils).
    """

    name = "force_constant_position"
    stage = "coil"
    largest = 6.0

    form: str
    centre_m: float
    half_width_m: float
    power: float
    edge: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a bell whose side lies at the working point."""
        form = chosen(random, "power bell", "leaving the gap")
        half = test.swing_m * log_uniform(random, 4.0, 12.0)
        side = float(random.choice([-1.0, 1.0])) * half * float(random.uniform(0.3, 0.9))
        return cls(
            1.0, form, test.mean_m + side, half, float(random.uniform(2.0, 4.0)), float(random.uniform(0.2, 0.6))
        )

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate the relative force constant, at most 1."""

        def law(place: Floats) -> Floats:
            way = (place - self.centre_m) / self.half_width_m
            if self.form == "power bell":
                lost = 1.0 - np.exp(-0.5 * np.abs(way) ** self.power)
            else:
                top = np.tanh(1.0 / self.edge)
                lost = 1.0 - 0.5 * (np.tanh((way + 1.0) / self.edge) - np.tanh((way - 1.0) / self.edge)) / top
            return np.clip(1.0 - self.size * lost, 0.15, 1.0)

        reach = 4.0 * self.half_width_m
        plant.tabulate(FORCE_CURVE, self.centre_m - reach, self.centre_m + reach, law)


@dataclass(frozen=True)
class FluxSaturation(Effect):
    """Force constant by current: Froelich's curve, hyperbolic tangent, or flux modulation with the current's sign.

    Sources: Fischer and Moser, Archiv fuer Elektrotechnik 42 (1956) 286; Klippel, J. Audio Eng. Soc. 54 (2006) 907.
    """

    name = "flux_saturation"
    stage = "coil"
    largest = 10.0

    form: str
    share: float
    current_a: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a loss of about 10 % at the typical current."""
        typical = abs(test.current_mean_a) + test.current_a
        return cls(1.0, chosen(random, "froelich", "tanh", "modulation"), float(random.uniform(0.08, 0.2)), typical)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate the relative force constant by current."""

        def law(current: Floats) -> Floats:
            ratio = self.size * self.share * current / self.current_a
            if self.form == "froelich":
                return 1.0 / (1.0 + np.abs(ratio))
            if self.form == "tanh":
                steep = np.maximum(np.abs(3.0 * ratio), 1e-9)
                return np.tanh(steep) / steep
            return 1.0 - 0.8 * np.tanh(ratio / 0.8)

        plant.tabulate(SATURATION, -15.0 * self.current_a, 15.0 * self.current_a, law)


@dataclass(frozen=True)
class ReluctanceForce(Effect):
    """Force i^2/2 dL/dx of the coenergy, with a slope of the inductance that is constant or falls along the stroke.

    Source: Woodson and Melcher, Electromechanical Dynamics I (1968), section 3.1.
    """

    name = "reluctance_force"
    stage = "coil"
    largest = 20.0

    form: str
    half_slope_h_per_m: float
    middle_m: float
    width_m: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a force of 10 % of the coil's at the typical current."""
        typical = abs(test.current_mean_a) + test.current_a
        slope = 0.1 * test.plant["force_constant_n_per_a"] / typical * float(random.choice([-1.0, 1.0]))
        form = chosen(random, "constant slope", "falling slope")
        return cls(1.0, form, slope, test.mean_m + test.swing_m * float(random.uniform(-1, 1)), 6.0 * test.swing_m)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate half the slope."""

        def law(place: Floats) -> Floats:
            way = (place - self.middle_m) / self.width_m
            course = np.ones(place.size) if self.form == "constant slope" else 1.0 - 0.6 * np.tanh(way)
            return self.size * self.half_slope_h_per_m * course

        plant.tabulate(RELUCTANCE, self.middle_m - 10.0 * self.width_m, self.middle_m + 10.0 * self.width_m, law)


COIL: tuple[type[Effect], ...] = (
    EddyCurrents,
    CoilHeating,
    InductancePosition,
    ForceConstantPosition,
    FluxSaturation,
    ReluctanceForce,
)
