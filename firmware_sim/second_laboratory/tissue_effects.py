"""Effects of the tissue: what it does besides stiffness and damping that grow exponentially with depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from firmware_sim.second_laboratory.effect import Effect, TestMotion, chosen, log_uniform
from firmware_sim.second_laboratory.parameters import LAYER, Floats, PlantModel


@dataclass(frozen=True)
class TissueStiffening(Effect):
    """A deeper layer that engages: Fung's exponential, Ogden's solid in compression, or Hertz contact with bone.

    Sources: Fung, Am. J. Physiol. 213 (1967) 1532; Ogden, Proc. R. Soc. A 326 (1972) 565; Johnson, Contact Mechanics
    (1985), chapter 4.
    """

    name = "tissue_stiffening"
    stage = "tissue"
    largest = 30.0

    form: str
    begins_m: float
    thickness_m: float
    force_n: float
    exponent: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a layer that the deeper part of the motion reaches."""
        begins = max(test.depth_m + test.swing_m * float(random.uniform(-1.0, 1.2)), 0.3 * test.depth_m)
        form = chosen(random, "fung", "ogden", "hertz")
        exponent = float(random.uniform(4.0, 12.0)) if form == "ogden" else float(random.uniform(0.8, 2.5))
        thickness = test.swing_m * log_uniform(random, 4.0, 12.0)
        return cls(1.0, form, begins, thickness, 0.3 * test.stiffness_n_per_m * test.swing_m, exponent)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Tabulate the force of the layer by depth; beyond 60 % of its thickness it goes on with constant slope."""
        typical = 0.2 * self.thickness_m

        def bare(pressed: Floats) -> Floats:
            if self.form == "fung":
                return np.asarray(np.expm1(self.exponent * pressed / typical) / np.expm1(self.exponent))
            if self.form == "hertz":
                return (pressed / typical) ** 1.5
            # Uniaxial compression: sigma = 2 mu / alpha (stretch^(-alpha/2) - stretch^alpha).
            stretch = 1.0 - pressed / self.thickness_m
            return (stretch ** (-self.exponent / 2.0) - stretch**self.exponent) / (0.3 * self.exponent)

        def law(depth: Floats) -> Floats:
            pressed = np.maximum(depth - self.begins_m, 0.0)
            most = (0.3 if self.form == "fung" else 0.6) * self.thickness_m
            inside = np.minimum(pressed, most)
            end = np.array([most, 0.999 * most])
            slope = -np.diff(bare(end))[0] / (0.001 * most)
            return np.asarray(self.size * self.force_n * (bare(inside) + slope * (pressed - inside)))

        plant.tabulate(LAYER, 0.0, self.begins_m + 4.0 * self.thickness_m, law)


@dataclass(frozen=True)
class Viscoelasticity(Effect):
    """Relaxation: a Prony sum of two to five branches on depth or on the elastic force, or a Scott Blair element.

    The Scott Blair element of order b is six branches at times in geometric progression with strengths t^(-b).
    Sources: Fung, Biomechanics (1993), 7.6 (quasi-linear); Scott Blair, J. Colloid Sci. 2 (1947) 21; Oustaloup, Levron,
    Mathieu and Nanot, IEEE Trans. Circuits Syst. I 47 (2000) 25.
    """

    name = "viscoelasticity"
    stage = "tissue"
    largest = 20.0

    form: str
    times_s: tuple[float, ...]
    shares: tuple[float, ...]

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw times between 5 ms and the length of the test."""
        form = chosen(random, "prony", "quasi-linear prony", "scott blair")
        if form == "scott blair":
            times = np.geomspace(2e-3, 2.0 * test.duration_s, 6)
            shares = times ** -float(random.uniform(0.1, 0.35))
        else:
            count = int(random.integers(2, 6))
            times = np.sort(np.exp(random.uniform(np.log(5e-3), np.log(0.5 * test.duration_s), count)))
            shares = random.uniform(0.3, 1.0, count)
        shares = 0.3 * shares / shares.sum()
        return cls(1.0, form, tuple(float(item) for item in times), tuple(float(item) for item in shares))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the branches."""
        values, count = plant.values, len(self.times_s)
        values["branches"] = count
        values["branch_share"][:count] = self.size * np.array(self.shares)
        values["branch_rate_hz"][:count] = 1.0 / np.array(self.times_s)
        values["branch_exponential"] = 1.0 if self.form == "quasi-linear prony" else 0.0


@dataclass(frozen=True)
class TissueHysteresis(Effect):
    """Rate-independent loops: Bouc-Wen, or play elements after Prandtl and Ishlinskii.

    Sources: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; Visintin, Differential Models of Hysteresis (1994), chapter 3.
    """

    name = "tissue_hysteresis"
    stage = "tissue"
    largest = 15.0

    form: str
    force_n: float
    length_m: float
    power: float
    gamma: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw loops about as long as the motion."""
        length = test.swing_m * log_uniform(random, 0.3, 1.5)
        power, gamma = float(random.uniform(1.0, 2.0)), float(random.uniform(0.5, 0.8))
        return cls(1.0, chosen(random, "bouc-wen", "play elements"), 0.1 * test.force_n, length, power, gamma)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the loop or the elements."""
        values, force = plant.values, self.size * self.force_n
        if self.form == "bouc-wen":
            values["loop_n"], values["loop_yield_m"] = force, self.length_m
            values["loop_power"], values["loop_gamma"] = self.power, self.gamma
            return
        limits = self.length_m * np.array([0.3, 0.7, 1.2, 1.9, 2.9, 4.2])
        weights = np.exp(-limits / self.length_m)
        values["tissue_slips"] = limits.size
        values["tissue_slip_m"][:] = limits
        values["tissue_n_per_m"][:] = force * weights / np.sum(weights * limits)


@dataclass(frozen=True)
class Preconditioning(Effect):
    """Stiffness that falls as the tissue is worked: exponential by path or by time, or logarithmic by path.

    Sources: Fung, Biomechanics (1993), 7.5; Sverdlik and Lanir, J. Biomech. Eng. 124 (2002) 78.
    """

    name = "preconditioning"
    stage = "tissue"
    largest = 4.0

    form: str
    share: float
    scale: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a scale of a part of the test's path or duration."""
        form = chosen(random, "path", "time", "logarithm of path")
        whole = test.duration_s * (1.0 if form == "time" else 0.8 * test.speed_m_s)
        scale = whole * (
            log_uniform(random, 0.15, 0.8) if form != "logarithm of path" else log_uniform(random, 0.02, 0.1)
        )
        return cls(1.0, form, 0.15 if form != "logarithm of path" else 0.05, scale)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set share and scale."""
        kinds = {"path": 0.0, "time": 1.0, "logarithm of path": 2.0}
        plant.values["soften_share"] = min(self.size * self.share, 0.6)
        plant.values["soften_scale"], plant.values["soften_kind"] = self.scale, kinds[self.form]


@dataclass(frozen=True)
class AddedMass(Effect):
    """Mass recruited with depth, linear or saturating, in Lagrange's form M a + M' v^2 / 2.

    Sources: von Gierke, Oestreicher, Franke, Parrack and von Wittern, J. Appl. Physiol. 4 (1952) 886; Irschik and Holl,
    Appl. Mech. Rev. 57 (2004) 145.
    """

    name = "added_mass"
    stage = "tissue"
    largest = 40.0

    form: str
    slope_kg_per_m: float
    length_m: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a third of the moving mass at the mean depth."""
        form = chosen(random, "linear", "saturating")
        length = test.depth_m * log_uniform(random, 0.3, 1.0) if form == "saturating" else 0.0
        return cls(1.0, form, 0.3 * test.plant["mass_kg"] / test.depth_m, length)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the slope at the surface and the length over which it saturates."""
        plant.values["added_kg_per_m"] = self.size * self.slope_kg_per_m
        plant.values["added_length_m"] = self.length_m


@dataclass(frozen=True)
class ContactLoss(Effect):
    """A contact that only pushes, whose damping vanishes at the surface, with or without an adhesive neck.

    Sources: Hunt and Crossley, J. Appl. Mech. 42 (1975) 440; Johnson, Kendall and Roberts, Proc. R. Soc. A 324 (1971)
    301 (pull-off later than touch-down).
    """

    name = "contact_loss"
    stage = "tissue"
    largest = 1.0
    fixed_size = True

    form: str
    damping_length_m: float
    adhesion_n: float
    reach_m: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw an adhesion of a few percent of the force."""
        form = chosen(random, "without adhesion", "with adhesion")
        adhesion = test.force_n * log_uniform(random, 0.02, 0.1) if form == "with adhesion" else 0.0
        damping = test.swing_m * log_uniform(random, 0.05, 0.3)
        return cls(1.0, form, damping, adhesion, test.swing_m * log_uniform(random, 0.1, 0.4))

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set the contact; a size below 1 leaves part of the pull."""
        values = plant.values
        values["contact_share"], values["contact_length_m"] = self.size, self.damping_length_m
        values["adhesion_n"], values["adhesion_reach_m"] = self.size * self.adhesion_n, self.reach_m


@dataclass(frozen=True)
class DirectionalDamping(Effect):
    """Damping that differs by the direction of motion, switched or smooth.

    Source: Surace, Worden and Tomlinson, Proc. Inst. Mech. Eng. D 206 (1992) 3 (bilinear and smooth dampers).
    """

    name = "directional_damping"
    stage = "tissue"
    largest = 2.8

    form: str
    share: float
    speed_m_s: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw which direction is damped more."""
        form = chosen(random, "switched", "smooth")
        speed = test.speed_m_s * log_uniform(random, 0.2, 1.0) if form == "smooth" else 0.0
        return cls(1.0, form, 0.3 * float(random.choice([-1.0, 1.0])), speed)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set share and speed."""
        plant.values["direction_share"] = np.clip(self.size * self.share, -0.9, 0.9)
        plant.values["direction_speed_m_s"] = self.speed_m_s


@dataclass(frozen=True)
class Reflex(Effect):
    """Stretch reflex: indentation faster than a threshold makes, after a delay, a twitch that pushes back.

    Sources: Thilmann, Fellows and Garms, Brain 114 (1991) 233 (threshold of speed); Milner-Brown, Stein and Yemm,
    J. Physiol. 230 (1973) 359 (critically damped twitch).
    """

    name = "reflex"
    stage = "tissue"
    largest = 30.0

    gain_n_s_per_m: float
    threshold_m_s: float
    delay_s: float
    twitch_s: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a delay of 20 to 60 ms and a contraction time of 10 to 40 ms."""
        threshold = test.speed_m_s * float(random.uniform(0.2, 1.0))
        delay, twitch = log_uniform(random, 0.02, 0.06), log_uniform(random, 0.01, 0.04)
        return cls(1.0, 0.5 * test.force_n / test.speed_m_s, threshold, delay, twitch)

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set gain, threshold, delay and twitch."""
        values = plant.values
        values["reflex_n_s_per_m"], values["reflex_threshold_m_s"] = self.size * self.gain_n_s_per_m, self.threshold_m_s
        values["reflex_rate_hz"], values["reflex_delay"] = 1.0 / self.twitch_s, round(self.delay_s / step_s)


TISSUE: tuple[type[Effect], ...] = (
    TissueStiffening,
    Viscoelasticity,
    TissueHysteresis,
    Preconditioning,
    AddedMass,
    ContactLoss,
    DirectionalDamping,
    Reflex,
)
