"""Effects between force and motion, without the tissue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from firmware_sim.second_laboratory.effect import Effect, TestMotion, chosen, log_uniform
from firmware_sim.second_laboratory.parameters import POSITION_FORCE, Floats, PlantModel


@dataclass(frozen=True)
class _Friction(Effect):
    """Dry friction whose level may differ by direction."""

    form: str
    level_n: float
    pull_share: float
    """Level outwards divided by the level inwards."""
    give_m: float
    """Presliding distance."""
    static_ratio: float
    stribeck_m_s: float

    @classmethod
    def _drawn(cls, random: np.random.Generator, test: TestMotion, pull_share: float) -> Self:
        form = chosen(random, "lugre", "dahl", "maxwell slip")
        stribeck = test.speed_m_s * log_uniform(random, 0.1, 0.6) if form == "lugre" else 0.0
        give = max(test.swing_m * log_uniform(random, 0.02, 0.15), 1e-5)
        level = test.force_n * 0.08
        return cls(1.0, form, level, pull_share, give, float(random.uniform(1.1, 1.6)), stribeck)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set bristles or slipping elements; the presliding distance stays when the level changes."""
        push = self.size * self.level_n
        if push <= 0.0:
            return
        pull = push * self.pull_share
        values = plant.values
        if self.form == "maxwell slip":
            # Elements of equal stiffness that slip one after the other round the presliding distance.
            limits = self.give_m * np.array([0.25, 0.6, 1.0, 1.6, 2.4])
            values["bearing_slips"] = limits.size
            values["bearing_push_m"][: limits.size] = limits
            values["bearing_pull_m"][: limits.size] = limits * self.pull_share
            values["bearing_n_per_m"][: limits.size] = push / limits.sum()
            return
        values["coulomb_n"][:] = push, pull
        values["bristle_n_per_m"] = 0.5 * (push + pull) / self.give_m
        values["static_ratio"] = self.static_ratio
        values["stribeck_m_s"] = self.stribeck_m_s
        if self.form == "lugre":
            # Damping of the bristles: a fifth of critical.
            values["bristle_n_s_per_m"] = 0.4 * np.sqrt(values["bristle_n_per_m"] * values["mass_kg"])


@dataclass(frozen=True)
class DryFriction(_Friction):
    """Dry friction by the law of LuGre, Dahl, or slipping Maxwell elements.

    Sources: Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419; Dahl, Aerospace
    Corp. TOR-0158(3107-18)-1 (1968); Al-Bender, Lampaert and Swevers, IEEE Trans. Autom. Control 50 (2005) 1883.
    """

    name = "dry_friction"
    stage = "mechanics"
    largest = 12.0

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw equal levels in both directions."""
        return cls._drawn(random, test, 1.0)


@dataclass(frozen=True)
class DirectionalFriction(_Friction):
    """The same laws with another level outwards than inwards.

    Sources: as ``DryFriction``; asymmetric levels after Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30
    (1994) 1083.
    """

    name = "directional_friction"
    stage = "mechanics"
    largest = 12.0

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a ratio of the levels of at least 2, either way."""
        ratio = log_uniform(random, 2.0, 6.0)
        return cls._drawn(random, test, ratio if random.random() < 0.5 else 1.0 / ratio)


@dataclass(frozen=True)
class QuadraticDrag(Effect):
    """Air forced through a narrow vent: c |v|^n with n from 1.5 to 2.5.

    Source: Idelchik, Handbook of Hydraulic Resistance (2007), chapter 1.
    """

    name = "quadratic_drag"
    stage = "mechanics"
    largest = 30.0

    power: float
    drag_n: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a tenth of the force at the typical speed."""
        power = float(random.uniform(1.5, 2.5))
        return cls(1.0, power, 0.1 * test.force_n / test.speed_m_s**power)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set coefficient and power."""
        plant.values["drag_n"] = self.size * self.drag_n
        plant.values["drag_power"] = self.power


@dataclass(frozen=True)
class EndStop(Effect):
    """Rubber bumper near one end of the motion: spring and damper that only push, linear or stiffening.

    Source: Shaw and Holmes, J. Sound Vib. 90 (1983) 129 (piecewise linear oscillator).
    """

    name = "end_stop"
    stage = "mechanics"
    largest = 40.0

    form: str
    side: float
    place_m: float
    stiffness_n_per_m: float
    cubic_m: float
    damping_ratio: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a bumper that part of the motion reaches."""
        side = 1.0 if random.random() < 0.7 else -1.0
        place = test.mean_m + side * test.swing_m * float(random.uniform(0.3, 1.6))
        stiffness = 2.0 * test.stiffness_n_per_m
        cubic = test.swing_m * float(random.uniform(0.3, 1.0))
        return cls(
            1.0, chosen(random, "linear", "stiffening"), side, place, stiffness, cubic, random.uniform(0.05, 0.4)
        )

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the bumper."""
        values = plant.values
        stiffness = self.size * self.stiffness_n_per_m
        values["stop_m"], values["stop_side"], values["stop_n_per_m"] = self.place_m, self.side, stiffness
        values["stop_n_per_m3"] = stiffness / self.cubic_m**2 if self.form == "stiffening" else 0.0
        values["stop_n_s_per_m"] = 2.0 * self.damping_ratio * np.sqrt(stiffness * values["mass_kg"])


@dataclass(frozen=True)
class MountResonance(Effect):
    """Frame on spring and damper that takes the reaction of the coil; the position is read relative to it.

    Source: Den Hartog, Mechanical Vibrations (1956), section 3.2.
    """

    name = "mount_resonance"
    stage = "mechanics"
    largest = 30.0

    mass_ratio: float
    rate_hz: float
    damping_ratio: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a frame of about twenty times the moving mass."""
        return cls(1.0, 0.05, log_uniform(random, 12.0, 110.0), log_uniform(random, 0.01, 0.12))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the frame; a heavier one moves less."""
        values = plant.values
        values["frame_ratio"] = self.size * self.mass_ratio
        values["frame_rad_s"] = 2.0 * np.pi * self.rate_hz
        values["frame_damping_ratio"] = self.damping_ratio


@dataclass(frozen=True)
class Cogging(Effect):
    """Periodic force along the stroke with one or two harmonics.

    Source: Gieras, Piech and Tomczuk, Linear Synchronous Motors (2012), section 3.10.
    """

    name = "cogging"
    stage = "mechanics"
    largest = 20.0

    force_n: float
    pitch_m: float
    phase_rad: float
    second: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a pitch of one to six deviations of the motion."""
        second = float(random.uniform(0.1, 0.5)) if random.random() < 0.6 else 0.0
        pitch = test.swing_m * log_uniform(random, 1.2, 6.0)
        return cls(1.0, 0.08 * test.force_n, pitch, float(random.uniform(0.0, 2.0 * np.pi)), second)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate the force over forty periods either side of the origin."""

        def law(place: Floats) -> Floats:
            angle = 2.0 * np.pi * place / self.pitch_m + self.phase_rad
            return self.size * self.force_n * (np.sin(angle) + self.second * np.sin(2.0 * angle + 1.0))

        plant.tabulate(POSITION_FORCE, -20.0 * self.pitch_m, 40.0 * self.pitch_m, law)


MECHANICS: tuple[type[Effect], ...] = (
    DryFriction,
    DirectionalFriction,
    QuadraticDrag,
    EndStop,
    MountResonance,
    Cogging,
)
