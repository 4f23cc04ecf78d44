"""Tissues of ``simulated://`` addresses."""

from __future__ import annotations

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


@dataclass(frozen=True)
class SimulatedTissue:
    """Parameters of the tissue, effects in the order of evaluation, and the variation between repeats."""

    tissue: Tissue
    effects: Effects = field(default_factory=dict)
    variation: Variation = Variation()

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
        if self.effects:
            effects["added_mass"]["mass_kg"] *= mass
            damping_effect = effects["directional_damping"]
            damping_effect["difference"] = min(direction * damping_effect["difference"], _MAX_DIFFERENCE)
        return tissue, effects


_MAX_DIFFERENCE = 0.97
"""Greatest difference of damping by direction: above 1 the damping would be negative in one direction."""

_SKIN_EFFECTS: Effects = {
    "added_mass": {"mass_kg": 0.032, "reach_m": 4e-3, "exponent": 1.0},
    "directional_damping": {"difference": 0.85, "speed_m_s": 0.04},
    "viscoelasticity": {"ratio": 0.26, "time_s": 0.08, "decades": 1.0, "growth": 1.0, "tilt": 0.0},
    "contact_loss": {"slowing_s": 0.1, "adhesion_n": 0.02},
}
"""Effects of skin. Contact loss is last because it acts on the sum of the others."""

_REPEATS = Variation(0.04, 0.02, 0.03, 0.03, 0.07, 0.1e-3)
"""Variation that reproduces the individual coefficients of variation of Chen 2010, Table 7.1, within a
factor of 1.5.
"""

TISSUES = {
    # Chosen for a standard test to give nearly what Chen 2010 found on the posterior forearm: mass, damping, stiffness
    # of 3.1.3 and the variance accounted for of Table 3.1; the softer anterior site after 7.1.2.
    "forearm": SimulatedTissue(Tissue(0.010, 0.006, 5.2, 240.0, 55.0, 470.0), _SKIN_EFFECTS, _REPEATS),
    "anterior-forearm": SimulatedTissue(Tissue(0.010, 0.006, 5.0, 200.0, 50.0, 360.0), _SKIN_EFFECTS, _REPEATS),
    # The tissue of the twin without effects or variation.
    "baseline": SimulatedTissue(Tissue()),
    "spring": SimulatedTissue(spring(0.005, 1000.0)),
}
