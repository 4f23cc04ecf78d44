"""Tissues of ``simulated://`` addresses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissueid.twin.chain_parameters import Tissue, spring

Effects = Mapping[str, Mapping[str, float]]
"""Parameters by name, SI, of each effect by name."""


@dataclass(frozen=True)
class Variation:
    """Variation between tests of one site: relative standard deviations.

    ``mass`` is for all of the tissue's mass, ``direction`` for the difference of damping by direction. ``surface_m`` is
    the standard deviation of the surface position, m, between placements.
    """

    stiffness: float = 0.0
    stiffness_growth: float = 0.0
    damping: float = 0.0
    mass: float = 0.0
    direction: float = 0.0
    surface_m: float = 0.0

    def scaled(self, size: float) -> Variation:
        """Return standard deviations that are ``size`` times as large."""
        return Variation(**{name: size * value for name, value in vars(self).items()})


@dataclass(frozen=True)
class SimulatedTissue:
    """Parameters of the tissue, effects, and the variation between repeats.

    ``between_subjects`` is the variation between subjects, ``compression_m`` the depth by which tests compress the
    surface lastingly, ``breath_m`` the amplitude of breathing; they only act if asked for (``of_subject``, ``varied``).
    """

    tissue: Tissue
    effects: Effects = field(default_factory=dict)
    variation: Variation = Variation()
    between_subjects: Variation = Variation()
    compression_m: float = 0.0
    breath_m: float = 0.0

    def of_subject(self, subject: int) -> SimulatedTissue:
        """Return the same site of another person; a number always gives the same person."""
        random = np.random.default_rng([_PEOPLE, subject])
        tissue, effects = replace(self, variation=self.between_subjects).drawn(random)
        return replace(self, tissue=tissue, effects=effects)

    def heavier(self, factor: float) -> SimulatedTissue:
        """Return the tissue with ``factor`` times its mass."""
        effects = {name: dict(values) for name, values in self.effects.items()}
        if "added_mass" in effects:
            effects["added_mass"]["mass_kg"] *= factor
        return replace(self, tissue=replace(self.tissue, mass_kg=factor * self.tissue.mass_kg), effects=effects)

    def varied(self, size: float) -> SimulatedTissue:
        """Return the tissue with ``size`` times its variation between tests, lasting compression and body motion."""
        return replace(
            self,
            variation=self.variation.scaled(size),
            compression_m=size * self.compression_m,
            breath_m=size * self.breath_m,
            effects={_MOTION: {}} | dict(self.effects) if size * self.breath_m > 0.0 else self.effects,
        )

    def compressed(self, figures: Tissue, share: float) -> tuple[Tissue, float]:
        """Return the tissue after a share of the lasting compression, and by how much its surface lies deeper, m.

        The surface gives way, and the layers below keep their stiffness and damping against position.
        """
        deeper_m = share * self.compression_m
        return replace(
            figures,
            stiffness_n_per_m=figures.stiffness_n_per_m * math.exp(figures.stiffness_growth_per_m * deeper_m),
            damping_n_s_per_m=figures.damping_n_s_per_m * math.exp(figures.damping_growth_per_m * deeper_m),
        ), deeper_m

    def placed(self, random: np.random.Generator) -> float:
        """Draw the surface position of a placement, m."""
        return self.tissue.surface_m + self.variation.surface_m * float(random.standard_normal())

    def drawn(self, random: np.random.Generator) -> tuple[Tissue, Effects]:
        """Draw the parameters of one test."""
        v = self.variation
        spreads = np.array([v.stiffness, v.stiffness_growth, v.damping, v.mass, v.direction])
        stiffness, growth, damping, mass, direction = map(float, np.exp(spreads * random.standard_normal(5)))
        tissue = replace(
            self.tissue,
            mass_kg=mass * self.tissue.mass_kg,
            damping_n_s_per_m=damping * self.tissue.damping_n_s_per_m,
            stiffness_n_per_m=stiffness * self.tissue.stiffness_n_per_m,
            stiffness_growth_per_m=growth * self.tissue.stiffness_growth_per_m,
        )
        effects = {name: dict(values) for name, values in self.effects.items()}
        if _MOTION in effects:
            effects[_MOTION] = self._motion(random)
        if "added_mass" in effects:
            effects["added_mass"]["mass_kg"] *= mass
            damping_effect = effects["directional_damping"]
            damping_effect["difference"] = min(direction * damping_effect["difference"], _MAX_DIFFERENCE)
        return tissue, effects

    def _motion(self, random: np.random.Generator) -> dict[str, float]:
        """Draw breathing and pulse of one test: amplitudes as in rest, phases at random."""
        # Imported here: the effects import scipy.linalg, and this module is needed for the names of the tissues.
        from tissueid.twin.catalogue import effect
        from tissueid.twin.effects.physiological_motion import BEGINNING, RATES

        heights = {parameter.name: 0.0 for parameter in effect(_MOTION).parameters}
        heights |= dict(zip(RATES, BEGINNING, strict=True))
        for name, amplitude_m in (("breathing", self.breath_m), ("pulse", _PULSE_SHARE * self.breath_m)):
            turn = 2.0 * math.pi * float(random.random())
            heights[f"{name}_cosine_1_m"] = amplitude_m * math.cos(turn)
            heights[f"{name}_sine_1_m"] = amplitude_m * math.sin(turn)
        return heights


_PEOPLE = 71
"""Stream of the draws of people, separate from those of instruments."""

COMPRESSING_N, COMPRESSING_S = 1.0, 1.5
"""Force, N, above which skin is compressed lastingly, and the time constant of the compression, s."""

_MOTION = "physiological_motion"
_PULSE_SHARE = 0.15
"""Amplitude of the pulse relative to breathing."""

_MAX_DIFFERENCE = 0.97
"""Greatest difference of damping by direction: above 1 the damping would be negative in one direction."""

_SKIN_EFFECTS: Effects = {
    "added_mass": {"mass_kg": 0.032, "reach_m": 4e-3, "exponent": 1.0},
    "directional_damping": {"difference": 0.85, "speed_m_s": 0.04},
    "viscoelasticity": {"ratio": 0.26, "time_s": 0.08, "decades": 1.0, "growth": 1.0, "tilt": 0.0},
    "contact_loss": {"slowing_s": 0.1, "adhesion_n": 0.02},
}

_REPEATS = Variation(0.04, 0.02, 0.03, 0.03, 0.07, 0.1e-3)
"""Variation that reproduces the individual coefficients of variation of Chen 2010, Table 7.1, within a
factor of 1.5.
"""

_PEOPLE_SPREAD = Variation(0.35, 0.08, 0.08, 0.2, 0.2)
"""Variation between subjects that gives the population's coefficients of variation of Chen 2010, Table 7.2 (mean of the
sites), within a factor of 1.5.
"""

_COMPRESSION_M = 0.5e-3
"""Lasting compression by the first test, m: below 1 mm (Chen 2010, 7.1.2)."""
_BREATH_M = 0.08e-3
"""Amplitude of breathing, m: with it the curve of a test varies as in Chen 2010, Table 7.1."""

TISSUES = {
    # Chosen for a standard test to give nearly what Chen 2010 found on the posterior forearm: mass, damping, stiffness
    # of 3.1.3 and the variance accounted for of Table 3.1; the softer anterior site after 7.1.2.
    "forearm": SimulatedTissue(
        Tissue(0.010, 0.006, 5.2, 240.0, 55.0, 470.0),
        _SKIN_EFFECTS,
        _REPEATS,
        _PEOPLE_SPREAD,
        _COMPRESSION_M,
        _BREATH_M,
    ),
    "anterior-forearm": SimulatedTissue(
        Tissue(0.010, 0.006, 5.0, 200.0, 50.0, 360.0),
        _SKIN_EFFECTS,
        _REPEATS,
        _PEOPLE_SPREAD,
        _COMPRESSION_M,
        _BREATH_M,
    ),
    # The tissue of the twin without effects or variation.
    "baseline": SimulatedTissue(Tissue()),
    "spring": SimulatedTissue(spring(0.005, 1000.0)),
}
