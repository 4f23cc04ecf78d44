"""Effects that no list of candidates has: an honest diagnosis leaves them unexplained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit

from firmware_sim.second_laboratory.effect import Effect, TestMotion, log_uniform
from firmware_sim.second_laboratory.parameters import Floats, PlantModel


@njit(cache=True)
def _followed(target: Floats, most: float) -> Floats:
    """Return what follows ``target`` by at most ``most`` per step, at the beginnings and the last end of the steps."""
    out = np.empty(target.size + 1)
    at = target[0]
    out[0] = at
    for k in range(target.size):
        at += min(max(target[k] - at, -most), most)
        out[k + 1] = at
    return out


@dataclass(frozen=True)
class AmplifierSlewRate(Effect):
    """Output stage whose voltage changes at a limited rate.

    Source: Solomon, IEEE J. Solid-State Circuits 9 (1974) 314.
    """

    name = "amplifier_slew_rate"
    stage = "drive"
    listed = False
    largest = 30.0

    v_per_s: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw the typical change of the command in one hold."""
        return cls(1.0, test.volts_rate * log_uniform(random, 1.0, 2.0))

    def change_voltage(self, volts: tuple[Floats, Floats], step_s: float, number: int) -> tuple[Floats, Floats]:
        """Follow the held voltage."""
        if self.size <= 0.0:
            return volts
        found = _followed(0.5 * (volts[0] + volts[1]), self.v_per_s / self.size * step_s)
        return found[:-1], found[1:]


@dataclass(frozen=True)
class PeriodicDrag(Effect):
    """Eddy currents in a slotted guide: resistance proportional to speed that varies periodically along the stroke.

    Source: Saslow, Am. J. Phys. 60 (1992) 693 (drag of a moving magnet).
    """

    name = "periodic_magnetic_drag"
    stage = "mechanics"
    listed = False
    largest = 40.0

    damping_n_s_per_m: float
    pitch_m: float
    phase_rad: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw slots one to four deviations of the motion apart."""
        damping = 0.15 * test.force_n / test.speed_m_s
        pitch = test.swing_m * log_uniform(random, 1.0, 4.0)
        return cls(1.0, damping, pitch, float(random.uniform(0.0, 2.0 * np.pi)))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the drag."""
        plant.values["periodic_drag_n_s_per_m"] = self.size * self.damping_n_s_per_m
        plant.values["periodic_drag_rad_per_m"] = 2.0 * np.pi / self.pitch_m
        plant.values["periodic_drag_phase_rad"] = self.phase_rad


@dataclass(frozen=True)
class CableDrag(Effect):
    """Cable with slack: a spring and a damper act only where it is taut, at either side.

    Source: Shaw and Holmes, J. Sound Vib. 90 (1983) 129 (springs with clearance).
    """

    name = "cable_drag"
    stage = "mechanics"
    listed = False
    largest = 40.0

    middle_m: float
    slack_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a slack of about the motion's deviation."""
        middle = test.mean_m + test.swing_m * float(random.uniform(-0.3, 0.3))
        slack = test.swing_m * float(random.uniform(0.4, 1.2))
        damping = 0.4 * test.force_n / test.speed_m_s * log_uniform(random, 0.5, 2.0)
        return cls(1.0, middle, slack, 0.3 * test.stiffness_n_per_m, damping)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the cable."""
        values = plant.values
        values["cable_middle_m"], values["cable_slack_m"] = self.middle_m, self.slack_m
        values["cable_n_per_m"] = self.size * self.stiffness_n_per_m
        values["cable_n_s_per_m"] = self.size * self.damping_n_s_per_m


@dataclass(frozen=True)
class StiffnessWave(Effect):
    """Stiffness of the tissue that rises and falls with humidity and temperature in the course of the test.

    Source: Papir, Hsu and Wildnauer, Biochim. Biophys. Acta 399 (1975) 170.
    """

    name = "tissue_stiffness_wave"
    stage = "tissue"
    listed = False
    largest = 8.0

    share: float
    period_s: float
    phase_rad: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw two to eight periods in the test."""
        period = test.duration_s / log_uniform(random, 2.0, 8.0)
        return cls(1.0, 0.08, period, float(random.uniform(0.0, 2.0 * np.pi)))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the wave."""
        plant.values["wave_share"] = min(self.size * self.share, 0.6)
        plant.values["wave_rad_s"], plant.values["wave_phase_rad"] = 2.0 * np.pi / self.period_s, self.phase_rad


@dataclass(frozen=True)
class LateralSlip(Effect):
    """Skin that is dragged sideways by the probe, sticks, and slips with a jump when the normal force is too small.

    Source: Adams, Briscoe and Johnson, Tribol. Lett. 26 (2007) 239.
    """

    name = "lateral_stick_slip"
    stage = "tissue"
    listed = False
    largest = 20.0

    stiffness_n_per_m: float
    static: float
    kinetic: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a stiffness of which the typical motion slips."""
        static = log_uniform(random, 0.08, 0.2)
        stiffness = test.stiffness_n_per_m * log_uniform(random, 0.3, 1.0)
        return cls(1.0, stiffness, static, static * float(random.uniform(0.2, 0.6)))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the friction; the distance before slip stays when the size changes."""
        values = plant.values
        values["lateral_n_per_m"] = self.size * self.stiffness_n_per_m
        values["lateral_static"], values["lateral_kinetic"] = self.size * self.static, self.size * self.kinetic


UNLISTED: tuple[type[Effect], ...] = (AmplifierSlewRate, PeriodicDrag, CableDrag, StiffnessWave, LateralSlip)
