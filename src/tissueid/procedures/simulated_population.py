"""Subjects, materials and lotions of the simulated population: what is put in, and not known to the analysis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissueid.instrument.tissues import TISSUES, SimulatedTissue, Variation
from tissueid.twin.chain_parameters import Tissue

SITES: Mapping[str, str] = {
    "right posterior forearm": "forearm",
    "right anterior forearm": "anterior-forearm",
    "left posterior forearm": "forearm",
    "left anterior forearm": "anterior-forearm",
}
"""Sites in the order of the thesis, and their simulated tissues."""
HEAVIER_MALE: Mapping[str, float] = {"left anterior forearm": 1.6, "right anterior forearm": 1.5}
"""Mass of the tissue of males relative to females. Tissue is 0.4 of the moving mass, so the scaled mass rises by 24 and
20 %: the thesis finds both sites with p < 0.01 (Table 7.3a), and 16 subjects find these in most studies.
"""
HEAVIER_PER_BMI = 0.08
"""Relative change of the tissue's mass at the anterior sites for 1 kg/m² of body mass index, chosen (Fig. 7.6) so that
16 subjects find it in most studies. With 0.03 they found it in one of five.
"""
MEAN_BMI = 23.0
ETHNICITIES = ("Caucasian", "Asian", "African American", "Hispanic")
"""Groups of thesis 7.1.1, equally often and without an effect."""
PEOPLE = Variation(0.4, 0.08, 0.04, 0.1, 0.4)
"""Variation between subjects, in addition to the effects of gender and body mass index, for Table 7.2 at four sites.
That of ``TISSUES`` counts on the noise of single tests for C2; here C2 varies with the difference of damping by
direction, which bends the curve.
"""
LOTIONS: Mapping[str, float] = {"moisturising lotion": 0.9, "hydrating lotion": 1.05}
"""Stiffness of the skin at constant force under each lotion relative to that without: down for one, slightly up for
the other, mass and damping alike (thesis 7.4). Factors chosen: the thesis prints none.
"""
LOTION_SITE, LOTION_MINUTES = "right anterior forearm", 60.0
_LIKE = Variation(stiffness=0.02, stiffness_growth=0.02, damping=0.02, mass=0.02, surface_m=0.1e-3)
"""Variation between tests of one sample, chosen."""
MATERIALS: Mapping[str, SimulatedTissue] = {
    "acrylamide 10 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 1300.0, 40.0), variation=_LIKE),
    "acrylamide 20 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 2300.0, 40.0), variation=_LIKE),
    "acrylamide 30 %": SimulatedTissue(Tissue(0.010, 0.010, 2.5, 20.0, 3500.0, 40.0), variation=_LIKE),
    "Buna-N": SimulatedTissue(Tissue(0.010, 0.012, 40.0, 0.0, 6000.0, 30.0), variation=_LIKE),
    "latex": SimulatedTissue(Tissue(0.010, 0.003, 6.0, 0.0, 800.0, 40.0), variation=_LIKE),
}
"""Samples in the order of thesis 7.2: stiffness of acrylamide rises with its concentration, mass and damping hardly;
Buna is stiff and damped; latex is soft. Figures chosen: the thesis prints none.
"""
MATERIAL_TESTS = 10
"""Tests of each sample (thesis 7.2)."""


@dataclass(frozen=True)
class Person:
    """Demographic values of one simulated subject. ``number`` is the person of ``SimulatedTissue.of_subject``."""

    pseudonym: str
    number: int
    gender: str
    age_years: float
    height_m: float
    weight_kg: float
    handedness: str
    ethnicity: str

    @property
    def bmi(self) -> float:
        """Body mass index, kg/m²."""
        return self.weight_kg / self.height_m**2

    def seed(self, site: str) -> int:
        """Return the seed of the instrument at a site."""
        return 100 * self.number + list(SITES).index(site)

    def tissue(self, site: str, condition: str = "") -> SimulatedTissue:
        """Return the tissue at a site, under a lotion or without one; the instrument varies it from test to test."""
        kind = replace(TISSUES[SITES[site]], people=PEOPLE)
        found = kind.of_subject(self.number).heavier(self.mass_factor(site))
        factor, skin = LOTIONS.get(condition, 1.0), found.tissue
        stretched = replace(  # depth at constant force divided by the factor
            skin,
            stiffness_n_per_m=factor * skin.stiffness_n_per_m,
            stiffness_growth_per_m=factor * skin.stiffness_growth_per_m,
        )
        return replace(found, tissue=stretched)

    def mass_factor(self, site: str) -> float:
        """Return the relative mass of the tissue at a site, with the effects of gender and body mass index."""
        if "anterior" not in site:
            return 1.0
        return (HEAVIER_MALE[site] if self.gender == "male" else 1.0) * float(
            np.exp(HEAVIER_PER_BMI * (self.bmi - MEAN_BMI))
        )


def population(count: int, seed: int) -> list[Person]:
    """Draw subjects as in the thesis: 18 to 36 years, both genders equally often."""
    random = np.random.default_rng([seed, 7])
    origins = np.random.default_rng([seed, 8]).permutation(np.resize(ETHNICITIES, count))
    people = []
    for number in range(count):
        male = number % 2 == 1
        height = random.normal(1.77 if male else 1.64, 0.065)
        bmi = float(np.clip(random.normal(MEAN_BMI, 2.8), 17.5, 33.0))
        people.append(
            Person(
                f"P-{number + 1:03d}",
                1000 * seed + number,
                "male" if male else "female",
                float(random.integers(18, 37)),
                round(float(height), 3),
                round(bmi * float(height) ** 2, 1),
                "left" if random.random() < 0.1 else "right",
                str(origins[number]),
            )
        )
    return people


def sample_name(material: str) -> str:
    """Return the pseudonym of the sample of a material."""
    return f"M-{list(MATERIALS).index(material) + 1}"


def subjects_file(people: Sequence[Person], materials: Iterable[str] = ()) -> str:
    """Return the demographic values of people, and the materials of samples, as CSV."""
    head = "subject,age_years,weight_kg,height_m,gender,handedness,ethnicity,material"
    rows = [
        f"{who.pseudonym},{who.age_years:g},{who.weight_kg:g},{who.height_m:g},{who.gender},{who.handedness},{who.ethnicity},"
        for who in people
    ]
    rows += [f"{sample_name(name)},,,,,,,{name}" for name in materials]
    return "\n".join([head, *rows]) + "\n"
